"""A sheet of some of a run's results, for a person to look at."""

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from uwaug._support.drawing import save
from uwaug.figures import sheet as sheets
from uwaug.io.read import read_picture

_SHOWN = 10
"""Results on a sheet, about."""

_VARIANTS = 3
"""Of one picture, at most."""

_COLUMNS = 4
_SIDE = 400
"""px, which a cell has room for."""

_LONGEST = 32
"""Letters of a line of a title."""

_CAPTION = (
    "Each picture as it was read, and what was made of it (→): visibility, and water. “0.3·3C” is "
    "pure water with 0.3 times\nwhat else is in type 3C; chl is chlorophyll, mg/m³; CDOM is "
    "coloured dissolved matter, 1/m at 440 nm; min is minerals, g/m³."
)

_BRIEF = {"contents of ": "", "chlorophyll=": "chl ", "cdom=": "CDOM ", "minerals=": "min "}

_MANIFOLD = re.compile(r"([\d.e-]+)·contents of ((?:\w+=[\d.e-]+,?)+)")
"""So many times the contents of a water that was drawn."""


def shown_of(pictures: int, variants: int) -> set[int]:
    """Which results of a run a sheet shows: of pictures from the first to the last, by their places
    in the run, where the variants of a picture follow each other.
    """
    of_each = min(variants, _VARIANTS)
    count = min(pictures, math.ceil(_SHOWN / of_each))
    steps = max(1, count - 1)
    chosen = [(pictures - 1) * place // steps for place in range(count)]
    return {picture * variants + variant for picture in chosen for variant in range(of_each)}


def draw_sheet(
    groups: Sequence[Sequence[tuple[str, Path]]], path: Path, count: int | None = None
) -> None:
    """Draw pictures in files, each under its title: in each group one that was read, and what was
    made of it. Groups begin in the same columns.

    Args:
        groups: titles and files.
        path: of the sheet.
        count: pictures that were read, if there may be more than groups.

    Raises:
        ValueError, OSError: if a picture cannot be read, or the sheet not written.
    """
    width = max(map(len, groups))
    side_by_side = max(1, _COLUMNS // width)
    columns = width * side_by_side
    rows = math.ceil(len(groups) / side_by_side)
    shown = len(groups)
    heading = f"{shown} of {count} pictures" if count and count > shown else "All pictures"
    figure, axes = sheets.sheet(rows, columns, (3, 4), heading, _CAPTION, title_lines=2)
    for place, group in enumerate(groups):
        for axis, (label, file) in zip(axes[place * width :], group, strict=False):
            # a path ends in what tells it from others, a water begins with it
            is_first = file == group[0][1]
            lines = [_ending(label)] if is_first else map(_brief, f"→ {label}".split("\n"))
            sheets.show(axis, _small(file), "\n".join(lines))
            axis.set_aspect("equal", adjustable="box", anchor="NW")
    save(figure, path)


def _ending(label: str) -> str:
    return label if len(label) <= _LONGEST else f"…{label[1 - _LONGEST :]}"


def _brief(water: str) -> str:
    """A water in few letters: contents by two digits."""
    water = _MANIFOLD.sub(_multiplied, water)
    text = re.sub(r"\d+\.\d+", lambda match: f"{float(match[0]):.2g}", water).replace(",", ", ")
    for name, short in _BRIEF.items():
        text = text.replace(name, short)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def _multiplied(match: re.Match[str]) -> str:
    parts = [part.split("=") for part in match[2].rstrip(",").split(",")]
    return ",".join(f"{name}={float(match[1]) * float(number):.2g}" for name, number in parts)


def _small(path: Path) -> Tensor:
    """A picture (3xHxW, 0…1), reduced."""
    picture = read_picture(path)
    step = max(1, max(picture.shape[-2:]) // _SIDE)
    small = picture[:, ::step, ::step]
    values = np.ascontiguousarray(small.numpy())
    scale = 255 if picture.dtype == torch.uint8 else 1
    return torch.from_numpy(values).float() / scale
