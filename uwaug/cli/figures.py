"""`uwaug demo`, `uwaug plot` and `uwaug compare`: sheets of pictures."""

import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uwaug.cli.choices import Distance, Force, Holes, Picture, Preset, Unit, Water, read_scene
from uwaug.cli.console import (
    end,
    print_written,
    reported_errors,
    require_folder,
    require_writable,
    status,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from uwaug.presets.scene import Scene

OutFolder = Annotated[Path, typer.Option(help="Folder to write the pictures to.")]


def demo(out: OutFolder = Path("uwaug-demo"), force: Force = False) -> None:
    """Draw a real scene in ten waters, term by term."""
    from uwaug.figures.demo import PICTURES
    from uwaug.presets import scene

    _draw_into(out, scene.motorcycle(), PICTURES, force)


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
    from uwaug.figures.demo import own_pictures, preset_case, water_case
    from uwaug.optics import load_water
    from uwaug.presets import load_preset

    with reported_errors():
        scene = read_scene(picture, distance, unit, holes)
        if preset is None:
            case = water_case(load_water(water or "1C"), scene)
        else:
            case = preset_case(preset, load_preset(preset, water=water))
    _draw_into(out, scene, own_pictures(case), force)
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
        list[str] | None, typer.Option(help="Published system; repeat it for more. All by default.")
    ] = None,
    stretch: Annotated[
        float, typer.Option(help="Factor of all distances: .2 brings the scene 5 times nearer.")
    ] = 1.0,
    force: Force = False,
) -> None:
    """Draw your own scene as uwaug and each published system make it."""
    require_writable(out, force=force, endings=(".png", ".jpg"))
    from uwaug._support.extras import require
    from uwaug.figures.comparison import draw_comparison
    from uwaug.figures.sheet import save

    with reported_errors(), status() as say:
        require("plot", "matplotlib")
        scene = read_scene(picture, distance, unit, holes)
        say("computing the systems")
        save(draw_comparison(scene, water or "II", system or (), stretch=stretch), out)
    print_written(out)


def _draw_into(
    out: Path, scene: "Scene", pictures: "Mapping[str, Callable[[Scene], Figure]]", force: bool
) -> None:
    from uwaug._support.extras import require
    from uwaug.figures.sheet import save

    require_folder(out)
    names = sorted(set(os.listdir(out)) - set(pictures)) if out.is_dir() else []
    if names and not force:
        end(2, f"{out} holds other files, such as {names[0]}: choose an empty folder, or --force")
    start = time.perf_counter()
    with reported_errors(), status() as say:
        require("plot", "matplotlib")
        out.mkdir(parents=True, exist_ok=True)
        for name, draw in pictures.items():
            say(f"drawing {name}")
            save(draw(scene), out / name)
    print_written(*(out / name for name in pictures))
    print(f"{len(pictures)} pictures, {time.perf_counter() - start:.1f} s")
