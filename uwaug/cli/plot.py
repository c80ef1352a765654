"""`uwaug plot`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uwaug._support import checks
from uwaug.cli.console import fail, refuse, require_matplotlib, said
from uwaug.cli.drawing import draw_into, require_folder
from uwaug.cli.names import complete_preset, complete_water

if TYPE_CHECKING:
    from uwaug.figures.cases import Case
    from uwaug.presets.scene import Scene

__all__ = ["plot", "read_scene"]


def plot(
    image: Annotated[Path, typer.Option(help="Picture of the scene without water.")],
    distance: Annotated[
        Path, typer.Option(help="Distance of each pixel: .npy, .npz, TIFF, PNG, PFM, EXR.")
    ],
    water: Annotated[
        str | None,
        typer.Option(
            help="Jerlov type for the sheet of terms, or in place of the preset's. [default: 1C]",
            autocompletion=complete_water,
        ),
    ] = None,
    preset: Annotated[
        str | None,
        typer.Option(
            help="Preset for the sheet of terms, or path of its TOML file.",
            autocompletion=complete_preset,
        ),
    ] = None,
    distance_unit: Annotated[
        str, typer.Option(help="Of the numbers in the distance file: m, cm, mm or um.")
    ] = "m",
    out: Annotated[Path, typer.Option(help="Folder for the pictures; made if need be.")] = Path(
        "uwaug-plot"
    ),
    force: Annotated[
        bool, typer.Option("--force", help="Write even if the folder holds other files.")
    ] = False,
) -> None:
    """Draw your own scene in ten waters, and term by term."""
    require_matplotlib("a plot is drawn")
    from uwaug.figures.demo import own_pictures
    from uwaug.io.distances import UNITS

    try:
        checks.one_of("--distance-unit", distance_unit, UNITS)
    except ValueError as error:
        refuse(error)
    pictures = own_pictures(_case(water, preset))
    require_folder(out, pictures, force)
    for name in pictures:
        if (out / name).resolve() in (image.resolve(), distance.resolve()):
            refuse(f"{out / name} is read, and would be written over: choose another --out")
    with said() as say:
        say("reading the picture")
        scene = read_scene(image, distance, distance_unit)
    draw_into(out, scene, pictures)
    if scene.note:
        print(scene.note)


def _case(water: str | None, preset: str | None) -> "Case | None":
    """What was asked for, if anything was."""
    from uwaug.figures.cases import preset_case, water_case
    from uwaug.presets.preset import load_preset

    try:
        if preset is not None:
            return preset_case(load_preset(preset, water=water))
        return None if water is None else water_case(water)
    except ValueError as error:
        refuse(error)
    except OSError as error:
        fail(error)


def read_scene(image: Path, distance: Path, unit: str) -> "Scene":
    """A picture and its distances as a sheet shows them; fails where they cannot be read."""
    from uwaug.io.distances import read_distance
    from uwaug.io.read import read_picture
    from uwaug.presets.scene import own_scene

    try:
        picture, metres = read_picture(image), read_distance(distance, unit)
    except (OSError, ValueError) as error:
        fail(error)
    try:
        return own_scene(picture, metres)
    except ValueError as error:
        fail(f"{image} and {distance}: {error}")
