"""Flags that several commands take, and the words that they know.

The library is not loaded for these, so that help and completion do not wait for it: a test holds
the words against the library's.
"""

from collections.abc import Callable
from typing import Annotated, Any, Literal

import typer

from uwaug.presets.files import list_presets

WATERS = ("I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C")

PICTURE_FORMATS = ("png", "jpg", "webp", "tif", "npy")
"""Kinds of pictures that are written, one name of each."""

SIDES = (32, 2160)
"""Short sides that a file serves by default, px."""

ColorSpace = Literal["srgb", "linear"]
Gain = Literal["auto", "fixed", "free", "channels", "matrix"]
Correction = Literal["auto", "fixed", "free"]
Surfaces = Literal["grey", "spectral"]
FitModel = Literal[
    "auto", "attenuation", "haze", "veil", "paper", "calibrated", "gaussian", "exponential"
]


def complete(*words: str) -> Callable[[str], list[str]]:
    """A function that tells a shell which of the words begin as one that is being typed."""
    return lambda incomplete: [word for word in words if word.startswith(incomplete)]


def complete_water(incomplete: str) -> list[str]:
    """The Jerlov types that begin so."""
    return complete(*WATERS)(incomplete.upper())


def complete_preset(incomplete: str) -> list[str]:
    """The bundled presets that begin so."""
    return complete(*list_presets())(incomplete)


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


ForceFile = Annotated[bool, typer.Option("--force", help="Write over existing files.")]
ForceFolder = Annotated[
    bool, typer.Option("--force", help="Write even if the folder holds other files.")
]
