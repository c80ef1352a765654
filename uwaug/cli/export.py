"""`uwaug export`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from uwaug.cli.console import fail, refuse, require_room, said
from uwaug.cli.names import complete_preset, complete_water
from uwaug.formation.planned import SIDES, sides_of
from uwaug.formation.underwater import Underwater
from uwaug.presets.preset import load_preset

__all__ = ["export"]

_NEAREST, _FARTHEST = 0.2, 1.5
"""Of a fit's median distance and of its farthest: what its file is planned for."""


def export(
    out: Annotated[Path, typer.Option(help="The file to write.")],
    preset: Annotated[
        str | None,
        typer.Option(
            help="Name of a preset, or path of its TOML file.", autocompletion=complete_preset
        ),
    ] = None,
    fit: Annotated[
        Path | None, typer.Option(help="In place of a preset: what uwaug fit has written.")
    ] = None,
    water: Annotated[
        str | None,
        typer.Option(
            help="Jerlov type that takes the place of the preset's.", autocompletion=complete_water
        ),
    ] = None,
    parameters: Annotated[
        str, typer.Option(help="frozen, or inputs: one file for many waters.")
    ] = "frozen",
    field: Annotated[
        str, typer.Option(help="none, or input: the medium field as an input.")
    ] = "none",
    image: Annotated[str, typer.Option(help="float32 (0…1) or uint8 (0…255).")] = "float32",
    sides: Annotated[
        tuple[int, int], typer.Option(help="Smallest and largest short side that it serves, px.")
    ] = SIDES,
    focal_px: Annotated[
        float | None, typer.Option(help="Focal length, px: of a preset with a lamp or a sun.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over an existing file.")] = False,
) -> None:
    """Write a preset, or a fit, as an ONNX file, and check it.

    A fit's file takes sRGB pictures, at the exposure of the clean picture. It serves distances from
    .2 times the median of those that were fitted to 1.5 times the farthest.
    """
    from uwaug.onnx import export_onnx, read_metadata
    from uwaug.onnx.metadata import Options

    if (preset is None) == (fit is None):
        refuse(f"expected --preset or --fit, got {'neither' if fit is None else 'both'}")
    if fit is not None and water is not None:
        refuse("--water takes the place of a preset's: a fit has found its own")
    require_room(out, force)
    options: dict[str, Any] = {"parameters": parameters, "field": field, "image": image}
    try:
        Options(**options)
        sides_of(sides)
    except ValueError as error:
        refuse(error)
    if fit is not None:
        module = _fitted(fit, sides)
    else:
        module = _preset(str(preset), water, sides, focal_px)
    try:
        with said() as say:
            export_onnx(module, out, **options, progress=say)
        metadata = read_metadata(out)
    except (ImportError, OSError, ValueError) as error:
        fail(error)
    print(f"{out}  ({out.stat().st_size / 1024:.0f} KiB)")
    print(f"    {metadata['uwaug_medium']}\n    {metadata['uwaug_plan']}")


def _preset(
    name: str, water: str | None, sides: tuple[int, int], focal_px: float | None
) -> Underwater:
    try:
        return load_preset(name, water=water).module(sides, focal_px)
    except ValueError as error:
        refuse(error)
    except OSError as error:
        fail(error)


def _fitted(path: Path, sides: tuple[int, int]) -> Underwater:
    from uwaug.fitting import Fit

    try:
        found = Fit.load(path)
    except (OSError, ValueError) as error:
        fail(error)
    geometry = found.structure.geometry
    distances = (_NEAREST * geometry.reference, _FARTHEST * geometry.farthest)
    return Underwater(found.medium, distances, sides=sides)
