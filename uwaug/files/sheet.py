"""A sheet of pictures before and after a run."""

import io
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw
from torch import Tensor

from uwaug.files.pictures import read_picture

_MAX_PICTURES, _MAX_VARIANTS = 12, 5  # pictures, spread over a run, and variants of each
_MAX_COLUMNS = 6  # pictures side by side, before and after
_WIDTH_PX, _HEIGHT_PX = 240, 180  # of a picture
_LINE_PX, _GAP_PX = 16, 4  # height of a line of text, and the gap between two labels


def drawn_sheet(
    variants: Sequence[tuple[Path, Sequence[Path]]],
    read: Callable[[Path], Tensor],
    caption: Callable[[Path], str],
    beside: Sequence[Path] = (),
) -> bytes:
    """A JPEG of pictures, each with its variants to the right, and names and captions below; then
    of photographs to compare. `read` and `caption` give the picture (3xHxW) and the caption of a
    variant's file.
    """
    step = max(1, (len(variants) - 1) // max(1, _MAX_PICTURES - 1))
    sample = variants[::step][:_MAX_PICTURES]
    groups = [(before, *after[:_MAX_VARIANTS]) for before, after in sample]
    columns = max(map(len, groups))
    real = beside[:: -(-len(beside) // _MAX_PICTURES) or 1]
    groups += [tuple(real[i : i + columns]) for i in range(0, len(real), columns)]
    across = min(len(groups), max(1, _MAX_COLUMNS // columns))
    cell = (columns * _WIDTH_PX + _LINE_PX, _HEIGHT_PX + 4 * _LINE_PX)
    sheet = Image.new("RGB", (across * cell[0], -(-len(groups) // across) * cell[1]), "white")
    for number, files in enumerate(groups):
        y, x = number // across * cell[1], number % across * cell[0]
        for column, file in enumerate(files):
            if column > 0 and number < len(sample):
                picture, words = read(file), caption(file)
            else:
                picture = read_picture(file, background="white")
                words = "" if number < len(sample) else "real"
            sheet.paste(_small(picture), (x, y))
            sheet.paste(_label(file.name, words), (x, y + _HEIGHT_PX))
            x += _WIDTH_PX
    jpeg = io.BytesIO()
    sheet.save(jpeg, "JPEG", quality=90)
    return jpeg.getvalue()


def _label(*lines: str) -> Image.Image:
    label = Image.new("RGB", (_WIDTH_PX - _GAP_PX, 3 * _LINE_PX), "white")
    text = "\n".join(lines).encode("ascii", "replace").decode()
    ImageDraw.Draw(label).multiline_text((0, 0), text, "black")
    return label


def _small(picture: Tensor) -> Image.Image:
    if picture.dtype != torch.uint8:
        picture = (picture.clamp(0, 1) * 255).to(torch.uint8)
    small = Image.fromarray(np.ascontiguousarray(picture.permute(1, 2, 0).numpy()))
    small.thumbnail((_WIDTH_PX, _HEIGHT_PX))
    return small
