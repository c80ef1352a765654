"""Flags that several commands take, and the words that they know.

The library is not loaded for these, so that help and completion do not wait for it: a test holds
the words against the library's.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from uwaug.presets.files import list_presets

WATERS = ("I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C")

SIDES = (32, 2160)
"""Short sides that a file serves by default, px."""

DistanceUnit = Literal["m", "cm", "mm", "um"]
ColorSpace = Literal["srgb", "linear"]
Gain = Literal["fixed", "free", "channels", "matrix"]
Surfaces = Literal["grey", "spectral"]
FitModel = Literal[
    "auto", "attenuation", "haze", "veil", "paper", "calibrated", "gaussian", "exponential"
]


def complete_water(incomplete: str) -> list[str]:
    """The Jerlov types that begin so."""
    return [name for name in WATERS if name.startswith(incomplete.upper())]


def complete_preset(incomplete: str) -> list[str]:
    """The bundled presets that begin so."""
    return [name for name in list_presets() if name.startswith(incomplete)]


def _water(text: str) -> str:
    # contents, files and types of a preset's own may be called as they like
    return text.upper() if text.upper() in WATERS else text


def water_option(help: str, panel: str | None = None, metavar: str = "TYPE|CONTENTS|CSV") -> Any:
    """`--water`: what `uwaug.load_water` takes; Jerlov types in small letters too."""
    return typer.Option(
        help=help,
        metavar=metavar,
        parser=_water,
        autocompletion=complete_water,
        rich_help_panel=panel,
    )


def preset_option(help: str, panel: str | None = None) -> Any:
    """`--preset` and what else takes a preset's name or path."""
    return typer.Option(
        help=help, metavar="PRESET", autocompletion=complete_preset, rich_help_panel=panel
    )


Image = Annotated[Path, typer.Option(help="Picture of the scene without water.")]
Distance = Annotated[
    Path, typer.Option(help="Distance of each pixel: .npy, .npz, TIFF, PNG, PFM, EXR.")
]
Unit = Annotated[DistanceUnit, typer.Option(help="Of the numbers in distance files.")]
FocalPx = Annotated[float | None, typer.Option(help="Focal length, px of the picture.")]
ForceFile = Annotated[bool, typer.Option("--force", help="Write over existing files.")]
ForceFolder = Annotated[
    bool, typer.Option("--force", help="Write even if the folder holds other files.")
]
