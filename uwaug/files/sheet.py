"""A sheet of pictures before and after, for a person to look at."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw
from torch import Tensor

from uwaug._support.atomic import written_whole
from uwaug.files.pictures import read_picture

_PICTURES, _VARIANTS = 12, 5
"""On a sheet, at most: pictures from the first to the last of a run, and variants of each."""

_ACROSS = 6
"""Columns, before and after."""

_WIDTH, _HEIGHT, _LINE, _GAP = 240, 180, 16, 4
"""Of a picture, the height of a line below it, and what lies between two labels, px."""


def write_sheet(
    path: Path,
    made: Sequence[tuple[Path, Sequence[Path]]],
    read: Callable[[Path], Tensor],
    caption: Callable[[Path], str],
) -> None:
    """Draw pictures, each with what was made of it to its right; below, names and captions.

    Args:
        path: of the sheet.
        made: a file before, and those after.
        read: gives the picture (3xHxW) of a file after.
        caption: what is said of a file after, in two lines at most.

    Raises:
        ValueError, OSError: if a picture cannot be read, or the sheet not be written.
    """
    step = max(1, (len(made) - 1) // max(1, _PICTURES - 1))
    shown = [(before, *after[:_VARIANTS]) for before, after in made[::step][:_PICTURES]]
    columns = max(map(len, shown))
    across = min(len(shown), max(1, _ACROSS // columns))
    cell = (columns * _WIDTH + _LINE, _HEIGHT + 4 * _LINE)
    sheet = Image.new("RGB", (across * cell[0], -(-len(shown) // across) * cell[1]), "white")
    for number, files in enumerate(shown):
        y, x = number // across * cell[1], number % across * cell[0]
        for column, file in enumerate(files):
            picture = read(file) if column else read_picture(file)
            sheet.paste(_small(picture), (x, y))
            sheet.paste(_label(file.name, caption(file) if column else ""), (x, y + _HEIGHT))
            x += _WIDTH
    with written_whole(path) as part:
        sheet.save(part, "JPEG", quality=90)


def _label(*lines: str) -> Image.Image:
    """Lines of text, cut off where the next picture begins."""
    label = Image.new("RGB", (_WIDTH - _GAP, 3 * _LINE), "white")
    text = "\n".join(lines).encode("ascii", "replace").decode()
    ImageDraw.Draw(label).multiline_text((0, 0), text, "black")
    return label


def _small(picture: Tensor) -> Image.Image:
    if picture.dtype != torch.uint8:
        picture = (picture.clamp(0, 1) * 255).to(torch.uint8)
    small = Image.fromarray(np.ascontiguousarray(picture.permute(1, 2, 0).numpy()))
    small.thumbnail((_WIDTH, _HEIGHT))
    return small
