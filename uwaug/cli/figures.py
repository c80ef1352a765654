"""`uwaug demo`, `uwaug plot` and `uwaug compare`: sheets of pictures."""

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uwaug.cli import console
from uwaug.cli.choices import Distance, Force, Holes, Picture, Preset, Unit, Water, read_scene

if TYPE_CHECKING:
    from PIL import Image

    from uwaug.figures.demo import Case
    from uwaug.presets.scene import Scene

OutFolder = Annotated[Path, typer.Option(help="Folder to write the pictures to.")]


def demo(out: OutFolder = Path("uwaug-demo"), force: Force = False) -> None:
    """Draw a real scene in ten waters, term by term."""
    from uwaug.figures.demo import water_case
    from uwaug.optics import load_water
    from uwaug.presets import scene

    _draw_into(
        out, scene.motorcycle(), lambda own: water_case(load_water("1C"), own, (0.3, 1.7)), force
    )


def plot(
    picture: Picture,
    distance: Distance,
    unit: Unit = "m",
    holes: Holes = "error",
    water: Water = None,
    preset: Preset = None,
    out: OutFolder = Path("uwaug-plot"),
    force: Force = False,
) -> None:
    """Draw your own scene in ten waters, and term by term in one: 1C by default."""
    from uwaug.figures.demo import preset_case, water_case
    from uwaug.optics import load_water
    from uwaug.presets import load_preset

    def case(scene: "Scene") -> "Case":
        if preset is None:
            return water_case(load_water(water or "1C"), scene)
        return preset_case(preset, load_preset(preset, water=water))

    with console.reported_errors():
        scene = read_scene(picture, distance, unit, holes)
    _draw_into(out, scene, case, force)
    if scene.note:
        print(scene.note)


def compare(
    picture: Picture,
    distance: Distance,
    out: Annotated[Path, typer.Option(help="Sheet to write: .png or .jpg.")],
    unit: Unit = "m",
    holes: Holes = "error",
    water: Water = "II",
    system: Annotated[
        list[str] | None,
        typer.Option(
            help="Published system; repeat it for more. By default all that know the water: "
            "li-2020 (UWCNN) and slurpp-2025 know Jerlov types alone."
        ),
    ] = None,
    force: Force = False,
) -> None:
    """Draw your own scene as uwaug and each published system make it."""
    console.require_writable(out, force=force, endings=(".png", ".jpg"))
    from uwaug.figures.comparison import draw_comparison
    from uwaug.figures.sheet import save

    with console.reported_errors(), console.status() as say:
        scene = read_scene(picture, distance, unit, holes)
        say("computing the systems")
        save(draw_comparison(scene, water or "II", system or ()), out)
    console.print_written(out)


def _draw_into(out: Path, scene: "Scene", case: "Callable[[Scene], Case]", force: bool) -> None:
    from uwaug._support.extras import require
    from uwaug.figures.demo import draw_terms, draw_waters
    from uwaug.figures.sheet import save

    sheets: dict[Path, Callable[[], Image.Image]] = {
        out / "1-waters.jpg": lambda: draw_waters(scene),
        out / "2-terms.jpg": lambda: draw_terms(scene, case(scene)),
    }
    console.require_folder(out)
    names = sorted({*os.listdir(out)} - {path.name for path in sheets}) if out.is_dir() else []
    if names and not force:
        console.end(
            2, f"{out} holds other files, such as {names[0]}: choose an empty folder, or --force"
        )
    start = time.perf_counter()
    with console.reported_errors(), console.status() as say:
        require("plot", "matplotlib")
        out.mkdir(parents=True, exist_ok=True)
        for path, draw in sheets.items():
            say(f"drawing {path.name}")
            save(draw(), path)
    console.print_written(*sheets)
    print(f"{len(sheets)} pictures, {time.perf_counter() - start:.1f} s")
