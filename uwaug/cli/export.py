"""`uwaug export` and `uwaug check`: ONNX files."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from uwaug.cli.choices import SIDES, ForceFile, preset_option, water_option
from uwaug.cli.console import print_written, refuse, reported_errors, require_writable, status


def export(
    out: Annotated[Path, typer.Option(help="The file to write.")],
    preset: Annotated[
        str | None, preset_option("Name of a preset, or path of its TOML file.")
    ] = None,
    fit: Annotated[
        Path | None, typer.Option(help="In place of a preset: what uwaug fit has written.")
    ] = None,
    water: Annotated[str | None, water_option("Takes the place of the preset's.")] = None,
    parameters: Annotated[
        Literal["frozen", "inputs"], typer.Option(help="inputs: one file for many waters.")
    ] = "frozen",
    field: Annotated[
        Literal["none", "input"], typer.Option(help="input: the medium field is an input.")
    ] = "none",
    image: Annotated[
        Literal["float32", "uint8"], typer.Option(help="float32: 0…1; uint8: 0…255.")
    ] = "float32",
    sides: Annotated[
        tuple[int, int], typer.Option(help="Smallest and largest short side that it serves, px.")
    ] = SIDES,
    focal_px: Annotated[
        float | None, typer.Option(help="Focal length, px: of a preset with a lamp or a sun.")
    ] = None,
    force: ForceFile = False,
) -> None:
    """Write a preset, or a fit, as an ONNX file, and check it.

    A fit's file takes sRGB pictures, at the exposure of the clean picture. It serves distances from
    .2 times the median of those that were fitted to 1.5 times the farthest.
    """
    if (preset is None) == (fit is None):
        refuse(f"expected --preset or --fit, got {'neither' if fit is None else 'both'}")
    if fit is not None and water is not None:
        refuse("--water takes the place of a preset's: a fit has its own")
    require_writable("--out", out, force=force, endings=(".onnx",))
    from uwaug.fitting import load_fit
    from uwaug.onnx import export_onnx, read_metadata
    from uwaug.presets import load_preset

    with reported_errors(out), status() as say:
        if fit is not None:
            module = load_fit(fit).module(sides)
        else:
            module = load_preset(str(preset), water=water).module(sides, focal_px)
        export_onnx(module, out, parameters=parameters, field=field, image=image, progress=say)
        metadata = read_metadata(out)
    print_written(out)
    print(f"    {metadata['uwaug_medium']}\n    {metadata['uwaug_plan']}")


def check(path: Annotated[Path, typer.Argument(help="A file that uwaug has exported.")]) -> None:
    """Check an ONNX file against the module it came from."""
    from uwaug.onnx import check_onnx, read_metadata, read_module

    with reported_errors(), status() as say:
        report = check_onnx(path, read_module(path), progress=say)
        unit = " of 255" if read_metadata(path)["uwaug_image"] == "uint8" else ""
    worst = f"largest difference {report.worst:.2g}{unit}"
    print(f"{path}: {report.cases} cases, {worst} ({report.where})")
