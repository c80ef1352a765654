"""A sheet of pictures before and after, for a person to look at."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw
from torch import Tensor

from uwaug._support.atomic import written_whole
from uwaug.files.pictures import read_picture

_PAIRS = 12
"""On a sheet, at most: from the first to the last of a run."""

_ACROSS = 3
"""Pairs in a row."""

_WIDTH, _HEIGHT, _LINE = 240, 180, 16
"""Of a picture, and the height of a line below it, px."""


def write_sheet(
    path: Path,
    pairs: Sequence[tuple[Path, Path]],
    read: Callable[[Path], Tensor] = read_picture,
) -> None:
    """Draw pictures, each with what was made of it to its right and its name below.

    Args:
        path: of the sheet.
        pairs: files before and after.
        read: gives the picture (3xHxW) of a file after.

    Raises:
        ValueError, OSError: if a picture cannot be read, or the sheet not be written.
    """
    step = max(1, (len(pairs) - 1) // max(1, _PAIRS - 1))
    shown = pairs[::step][:_PAIRS]
    rows = -(-len(shown) // _ACROSS)
    cell = (2 * _WIDTH + _LINE, _HEIGHT + 2 * _LINE)
    size = (min(len(shown), _ACROSS) * cell[0], rows * cell[1])
    sheet = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(sheet)
    for number, (before, after) in enumerate(shown):
        x, y = number % _ACROSS * cell[0], number // _ACROSS * cell[1]
        for column, picture in enumerate((read_picture(before), read(after))):
            sheet.paste(_small(picture), (x + column * _WIDTH, y))
        draw.text((x, y + _HEIGHT), after.name.encode("ascii", "replace").decode(), "black")
    with written_whole(path) as part:
        sheet.save(part, "JPEG", quality=90)


def _small(picture: Tensor) -> Image.Image:
    if picture.dtype != torch.uint8:
        picture = (picture.clamp(0, 1) * 255).to(torch.uint8)
    small = Image.fromarray(np.ascontiguousarray(picture.permute(1, 2, 0).numpy()))
    small.thumbnail((_WIDTH, _HEIGHT))
    return small
