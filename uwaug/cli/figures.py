"""`uwaug demo`, `uwaug plot` and `uwaug compare`: sheets of pictures."""

import os
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uwaug.cli.choices import (
    Distance,
    DistanceUnit,
    ForceFile,
    ForceFolder,
    Image,
    Unit,
    preset_option,
    water_option,
)
from uwaug.cli.console import (
    fail,
    print_written,
    refuse,
    reported_errors,
    require_not_read,
    require_package,
    require_writable,
    status,
)

if TYPE_CHECKING:
    from uwaug.figures.demo import Drawing
    from uwaug.presets.scene import Scene

OutFolder = Annotated[Path, typer.Option(help="Folder for the pictures; made if need be.")]


def demo(out: OutFolder = Path("uwaug-demo"), force: ForceFolder = False) -> None:
    """Draw a real scene in ten waters, term by term."""
    require_package("plot", "matplotlib")
    from uwaug.figures.demo import PICTURES
    from uwaug.presets import scene

    _require_folder(out, PICTURES, force)
    _draw_into(out, scene.motorcycle(), PICTURES)


def plot(
    image: Image,
    distance: Distance,
    water: Annotated[
        str | None,
        water_option("For the sheet of terms, or in place of the preset's: 1C if none is given."),
    ] = None,
    preset: Annotated[
        str | None, preset_option("For the sheet of terms; or the path of a TOML file.")
    ] = None,
    distance_unit: Unit = "m",
    out: OutFolder = Path("uwaug-plot"),
    force: ForceFolder = False,
) -> None:
    """Draw your own scene in ten waters, and term by term."""
    require_package("plot", "matplotlib")
    from uwaug.figures.demo import own_pictures, preset_case, water_case
    from uwaug.presets import load_preset

    with reported_errors():
        if preset is not None:
            case = preset_case(load_preset(preset, water=water))
        else:
            case = water_case(water or "1C")
    pictures = own_pictures(case)
    _require_folder(out, pictures, force)
    for name in pictures:
        require_not_read("--out", out / name, (image, distance))
    with status() as say:
        say("reading the picture")
        scene = _read_scene(image, distance, distance_unit)
    _draw_into(out, scene, pictures)
    if scene.note:
        print(scene.note)


def compare(
    image: Image,
    distance: Distance,
    out: Annotated[Path, typer.Option(help="The sheet to write: .png or .jpg.")],
    water: Annotated[str, water_option("Jerlov type.", metavar="TYPE")] = "II",
    system: Annotated[
        list[str] | None,
        preset_option(
            "A preset, or path of its file; repeat it. All published systems by default."
        ),
    ] = None,
    table: Annotated[Path | None, typer.Option(help="The table too: a .csv or .json file.")] = None,
    distance_unit: Unit = "m",
    force: ForceFile = False,
) -> None:
    """Your scene as each published system makes it, and how they differ."""
    inputs = (image, distance)
    require_writable("--out", out, force=force, endings=(".png", ".jpg"), inputs=inputs)
    if table is not None:
        require_writable("--table", table, force=force, endings=(".csv", ".json"), inputs=inputs)
    require_package("plot", "matplotlib")
    import uwaug
    from uwaug._support.drawing import save

    with status() as say:
        say("reading the picture")
        scene = _read_scene(image, distance, distance_unit)
        say("computing the systems")
        with reported_errors():
            comparison = uwaug.figures.compare(scene.image, scene.distance, water, system)
    try:
        save(comparison.plot(), out)
        if table is not None:
            comparison.save(table)
    except OSError as error:
        print(comparison.summary())  # what took a while is not lost
        fail(error)
    print(f"{comparison.summary()}\n")
    if scene.note:
        print(scene.note)
    print_written(out, table)


def _read_scene(image: Path, distance: Path, unit: DistanceUnit) -> "Scene":
    """A picture and its distances as a sheet shows them."""
    from uwaug.io import read_distance, read_picture
    from uwaug.presets.scene import own_scene

    with reported_errors():
        picture, metres = read_picture(image), read_distance(distance, unit)
        try:
            return own_scene(picture, metres)
        except ValueError as error:
            raise ValueError(f"{distance}: with {image}: {error}") from error


def _require_folder(out: Path, names: Iterable[str], force: bool) -> None:
    """Refuse, before any work, a folder that holds other files than those of `names`."""
    from uwaug._support.atomic import is_part

    try:
        files = os.listdir(out)
    except FileNotFoundError:
        return
    except OSError as error:
        fail(f"cannot write to {out}: {error.strerror or error}")
    # what a killed process has left does not count
    others = sorted(name for name in files if name not in names and not is_part(name))
    if others and not force:
        cure = "choose an empty folder, or --force to write into it"
        refuse(f"{out} holds other files, such as {others[0]}: {cure}")


def _draw_into(
    out: Path, scene: "Scene", pictures: "Mapping[str, Callable[[Scene], Drawing]]"
) -> None:
    """Draw the sheets of a scene and report each; the folder is made if need be."""
    from rich.console import Console
    from rich.progress import Progress

    from uwaug._support.drawing import save

    start = time.perf_counter()
    errors, report = Console(stderr=True), []
    try:
        out.mkdir(parents=True, exist_ok=True)
        with Progress(console=errors, transient=True, disable=not errors.is_terminal) as progress:
            for name, draw in progress.track(pictures.items(), description="Drawing"):
                before = time.perf_counter()
                figure, lines = draw(scene)
                save(figure, out / name)
                report.append(f"{out / name}  ({time.perf_counter() - before:.1f} s)")
                report += [f"    {line}" for line in lines]
    except OSError as error:
        fail(f"cannot write to {out}: {error.strerror or error}")
    print("\n".join(report))
    print(f"{len(pictures)} pictures in {out.resolve()}, {time.perf_counter() - start:.1f} s")
