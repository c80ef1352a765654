"""A sheet of some of a run's results, for a person to look at."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from uwaug._support.drawing import save
from uwaug.figures import sheet as sheets
from uwaug.io.read import read_picture

SHOWN = 10
"""Pictures, before and after, on a sheet."""

_COLUMNS = 4
_SIDE = 400
"""px, which a cell has room for."""


def draw_sheet(pictures: Sequence[tuple[str, Path]], path: Path) -> None:
    """Draw pictures in files, each under its title: every second one as it was written, after the
    one that was read.

    Raises:
        ValueError, OSError: if a picture cannot be read, or the sheet not written.
    """
    cells = [(title, _small(file)) for title, file in pictures]
    rows = max(1, math.ceil(len(cells) / _COLUMNS))
    caption = "Each picture as it was read, and as it was written."
    figure, axes = sheets.sheet(rows, _COLUMNS, (3, 4), "Some of the pictures", caption)
    for axis, (label, picture) in zip(axes, cells, strict=False):
        sheets.show(axis, picture, _short(label))
        axis.set_aspect("equal", adjustable="box", anchor="NW")
    save(figure, path)


def _short(label: str) -> str:
    return label if len(label) <= 38 else f"…{label[-37:]}"


def _small(path: Path) -> Tensor:
    """A picture (3xHxW, 0…1), reduced."""
    picture = read_picture(path)
    step = max(1, max(picture.shape[-2:]) // _SIDE)
    small = picture[:, ::step, ::step]
    values = np.ascontiguousarray(small.numpy())
    scale = 255 if picture.dtype == torch.uint8 else 1
    return torch.from_numpy(values).float() / scale
