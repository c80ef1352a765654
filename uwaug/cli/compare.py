"""`uwaug compare`."""

from pathlib import Path
from typing import Annotated

import typer

from uwaug._support import checks
from uwaug.cli.console import fail, refuse, require_matplotlib, require_room, said
from uwaug.cli.names import complete_preset, complete_water

__all__ = ["compare"]

_DRAWN = (".png", ".jpg")
_TABLES = (".csv", ".json")


def compare(
    image: Annotated[Path, typer.Option(help="Picture of the scene without water.")],
    distance: Annotated[
        Path, typer.Option(help="Distance of each pixel: .npy, .npz, TIFF, PNG, PFM, EXR.")
    ],
    out: Annotated[Path, typer.Option(help="The sheet to write: .png or .jpg.")],
    water: Annotated[str, typer.Option(help="Jerlov type.", autocompletion=complete_water)] = "II",
    system: Annotated[
        list[str] | None,
        typer.Option(
            help="A preset, or path of its file; repeat it. [default: all published systems]",
            autocompletion=complete_preset,
        ),
    ] = None,
    table: Annotated[Path | None, typer.Option(help="The table too: a .csv or .json file.")] = None,
    distance_unit: Annotated[
        str, typer.Option(help="Of the numbers in the distance file: m, cm, mm or um.")
    ] = "m",
    force: Annotated[bool, typer.Option("--force", help="Write over existing files.")] = False,
) -> None:
    """Your scene as each published system makes it, and how they differ."""
    import uwaug
    from uwaug._support import sheet as sheets
    from uwaug.cli.plot import read_scene

    _require(water, system or [], distance_unit)
    _require_files(out, table, [image, distance], force)
    with said() as say:
        say("reading the picture")
        scene = read_scene(image, distance, distance_unit)
        say("computing the systems")
        try:
            found = uwaug.figures.compare(scene.image, scene.distance, water, system)
        except (ImportError, OSError, ValueError) as error:
            fail(error)
    try:
        sheets.save(found.figure(), out)
        if table is not None:
            found.save(table)
    except OSError as error:
        print(found.summary())  # what took a while is not lost
        fail(error)
    print(f"{found.summary()}\n")
    if scene.note:
        print(scene.note)
    for path in filter(None, (out, table)):
        print(f"{path}  ({path.stat().st_size / 1024:.0f} KiB)")


def _require(water: str, systems: list[str], distance_unit: str) -> None:
    """Refuse what no picture could make good."""
    from uwaug.io.distances import UNITS
    from uwaug.optics.water import JERLOV_TYPES
    from uwaug.presets.files import preset_path

    try:
        checks.one_of("--water", water, JERLOV_TYPES)
        checks.one_of("--distance-unit", distance_unit, UNITS)
        for name in systems:
            preset_path(name)
    except ValueError as error:
        refuse(error)
    if len(set(systems)) < len(systems):
        refuse(f"--system names one twice: {', '.join(systems)}")


def _require_files(out: Path, table: Path | None, read: list[Path], force: bool) -> None:
    """Before any work."""
    require_matplotlib("a comparison is drawn")
    for option, path, endings in (("--out", out, _DRAWN), ("--table", table, _TABLES)):
        if path is None:
            continue
        if path.suffix not in endings:
            refuse(f"{option} must end in {' or '.join(endings)}, got {path}")
        if path.resolve() in {one.resolve() for one in read}:
            refuse(f"{path} is read, and would be written over: choose another {option}")
        require_room(path, force)
