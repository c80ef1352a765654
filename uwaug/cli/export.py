"""`uwaug export` and `uwaug check`: ONNX files."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uwaug.cli.choices import PLACES, WATERS, Force, Options, Preset, Water, with_tables
from uwaug.cli.console import end, print_written, reported_errors, require_writable, status

if TYPE_CHECKING:
    from uwaug import RandomUnderwater


def export(
    out: Annotated[Path, typer.Option(help=".onnx file to write.")],
    name: Annotated[str | None, typer.Argument(help="As --preset.", metavar="PRESET")] = None,
    preset: Preset = None,
    water: Water = None,
    options: Options = None,
    coefficients: Annotated[
        bool, typer.Option("--coefficients", help="Inputs for coefficients: a file for all waters.")
    ] = False,
    sides: Annotated[
        tuple[int, int], typer.Option(help="Smallest and largest short side of pictures, px.")
    ] = (32, 2160),
    force: Force = False,
) -> None:
    """Write a preset, or what uwaug fit has written, as an ONNX file, and check it."""
    if (name is None) == (preset is None):
        end(2, "expected one preset: a name, a file, or what uwaug fit has written")
    preset = preset or name or ""
    require_writable(out, force=force, endings=(".onnx",))
    from uwaug import Medium, Underwater
    from uwaug.fitting import load_fit
    from uwaug.onnx import export_onnx

    with reported_errors(), status() as say:
        if preset.endswith(".json") and water is None and options is None:
            # planned for the distances of its pictures
            module = load_fit(preset).module(sides=sides)
        else:
            module = _transform(preset, water, options).module(sides=sides)
            if coefficients and water is None:
                # planned for the widths of all named waters
                named = (_transform(preset, other, options) for other in (*WATERS, *PLACES))
                media = [transform.module().medium for transform in named]
                setting = replace(module.setting, medium=Medium.stack([module.medium, *media]))
                module = Underwater.of(setting, module.distance_range, sides=sides)
        export_onnx(module, out, coefficients=coefficients, progress=say)
    print_written(out)
    print(f"    {module.medium}")


def _transform(preset: str, water: str | None, options: Path | None) -> "RandomUnderwater":
    from uwaug.presets import load_preset
    from uwaug.transforms import RandomUnderwater

    values = with_tables(load_preset(preset, water=water).to_dict(), options)
    if water is not None:
        values["water"]["waters"] = water
    return RandomUnderwater.from_dict(values)


def check(path: Annotated[Path, typer.Argument(help="ONNX file that uwaug has exported.")]) -> None:
    """Check an ONNX file against the module it came from."""
    from uwaug.onnx import check_onnx

    with reported_errors(), status() as say:
        report = check_onnx(path, progress=say)
    print(f"{path}: {report}")
