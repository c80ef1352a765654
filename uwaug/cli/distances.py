"""Flags that say where the distances of pictures are and what their numbers mean: the same words in
every command, and what they come to.
"""

import os
import re
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from uwaug.cli.choices import complete

if TYPE_CHECKING:
    from uwaug.io import DistanceFormat

Place = str | float | tuple[float, float]
"""Where distances are: a path or a pattern of paths; metres of all pixels; or a range of these."""

flag = partial(typer.Option, rich_help_panel="Distances")
"""An option in the group of the help that is about distances."""

FILE_HELP = "Distance of each pixel: .npy, .npz, TIFF, PNG, PFM, EXR. Or metres, for all."
FILE = "FILE|METRES"

Distance = Annotated[str, flag(help=FILE_HELP, metavar=FILE)]
Kind = Annotated[
    Literal["metric", "relative", "inverse", "disparity"], flag(help="Of distance files.")
]
Unit = Annotated[
    str,
    flag(
        help="Of distance files: m, cm, mm, um, or how many metres 1 stands for.",
        metavar="UNIT",
        autocompletion=complete("m", "cm", "mm", "um"),
    ),
]
Unknown = Annotated[
    str,
    flag(
        help="What 0 and NaN get: behind (what is behind, as maps of depth cameras want it), fill "
        "(what is around), far (open water), metres; skip, error.",
        metavar="WORD|METRES",
        autocompletion=complete("error", "fill", "behind", "skip", "far"),
    ),
]
Planar = Annotated[
    bool, flag("--planar", help="Files hold depth along the optical axis, not the ray.")
]
FocalPx = Annotated[
    float | None,
    flag(help="Focal length, px of the picture: of planar depth and disparity, blur and lamps."),
]
Baseline = Annotated[float | None, flag(help="m, between the cameras of a disparity.")]
OffsetPx = Annotated[float, flag(help="px, of the principal points of a disparity.")]
Near = Annotated[float | None, flag(help="m, of relative and inverse distances.")]
Far = Annotated[float | None, flag(help="m, of relative and inverse distances.")]
Gamma = Annotated[float | None, flag(help="Exponent, of relative distances.")]


def place_of(text: str) -> Place:
    """What `--distance` says.

    Raises:
        ValueError: if it is like a number, and is neither metres nor a path.
    """
    from uwaug.jobs.items import metres_in

    metres = metres_in(text)
    if metres is not None:
        return metres
    if os.path.exists(text):
        return text
    low, colon, high = text.partition(":")
    ends = (metres_in(low, None), metres_in(high, None)) if colon else (None, None)
    if ends[0] is not None and ends[1] is not None:
        if ends[0] > ends[1]:
            raise ValueError(f"distance: expected a range, low first, got {text}")
        return ends[0], ends[1]
    if re.fullmatch(r"[\d.,:]+ *[a-z]*", text, re.IGNORECASE):
        expected = "metres without a unit, such as 3, a range, such as 1:5, or a file"
        raise ValueError(f"distance: expected {expected}, got {text}")
    return text


def one_place(text: str) -> Path | float:
    """What `--distance` says where one picture has one file, or one distance everywhere.

    Raises:
        ValueError: as `place_of`; or if it is a range.
    """
    place = place_of(text)
    if isinstance(place, tuple):
        cure = "uwaug degrade draws from it; here, give a file, or metres"
        raise ValueError(f"distance: {text} is a range: {cure}")
    return Path(place) if isinstance(place, str) else place


def files(picture: Path, place: Path | float) -> tuple[Path, ...]:
    """The files that are read of a picture and its distances."""
    return (picture, place) if isinstance(place, Path) else (picture,)


def word_or_number(text: str) -> str | float:
    """A number where it is one."""
    try:
        return float(text)
    except ValueError:
        return text


def format_of(
    kind: Literal["metric", "relative", "inverse", "disparity"],
    unit: str,
    unknown: str,
    *,
    planar: bool,
    focal_px: float | None,
    baseline: float | None,
    offset_px: float,
    network: Path | None = None,
) -> "DistanceFormat":
    """What distance files hold.

    Raises:
        ValueError: as `DistanceFormat`.
    """
    from uwaug.io import DistanceFormat

    return DistanceFormat(
        # a depth network gives inverse depth
        kind="inverse" if network is not None and kind == "metric" else kind,
        unit=word_or_number(unit),
        focal_px=focal_px,
        baseline_m=baseline,
        offset_px=offset_px,
        planar=planar,
        unknown=word_or_number(unknown),
        network=None if network is None else str(network),
    )
