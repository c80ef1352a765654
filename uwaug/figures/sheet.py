"""Sheets: pictures in rows, words above each, a heading above all."""

import textwrap
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image, ImageColor, ImageDraw, ImageFont, ImageOps
from torch import Tensor

from uwaug._support.atomic import written_whole

NEAR_TO_FAR = ("#fde725", "#7ad151", "#22a884", "#2a788e", "#414487", "#440154")  # viridis
LESS_TO_MORE = ("#2166ac", "#92c5de", "#f7f7f7", "#f4a582", "#b2182b")

_INK, _GREY = "#1a1a1a", "#5a5a5a"
_GAP_PX, _CAPTION_PX, _HEADING_PX, _SMALLEST_PX = 12, 15, 26, 9
_LETTERS = frozenset("°…·±")
"""What Pillow's own font has beside ASCII."""

Cell = tuple[Tensor, str]
"""A picture (3xHxW; uint8, or sRGB 0…1), and the words above it."""


def sheet(
    rows: Iterable[Iterable[Cell]],
    size: tuple[int, int] = (320, 320),
    heading: str = "",
    caption: str = "",
) -> Image.Image:
    """Draw pictures in rows.

    Args:
        rows: pictures with words; each is reduced as it comes.
        size: most width and height of a picture on the sheet, px. Cells are so wide, and as high as
            the highest picture.
        heading: line above all.
        caption: lines below it; long ones are wrapped.
    """
    cells = [[(_fitted(picture, size), words) for picture, words in row] for row in rows]
    every = [cell for row in cells for cell in row]
    high = max(picture.height for picture, _ in every)
    labels = [_written(words, size[0], 9 + size[0] // 50, _INK) for _, words in every]
    label = max(strip.height for strip in labels)
    pitch = size[0] + _GAP_PX, label + high + _GAP_PX
    width = max(map(len, cells)) * pitch[0] + _GAP_PX
    across = width - 2 * _GAP_PX
    lines = [textwrap.fill(line, 2 * across // _CAPTION_PX) for line in caption.splitlines()]
    head = _written(heading, across, _HEADING_PX, _INK)
    below = _written("\n".join(lines), across, _CAPTION_PX, _GREY)
    top = _GAP_PX + head.height + below.height + _GAP_PX * bool(heading)
    drawn = Image.new("RGB", (width, top + len(cells) * pitch[1]), "white")
    drawn.paste(head, (_GAP_PX, _GAP_PX))
    drawn.paste(below, (_GAP_PX, _GAP_PX + head.height))
    strips = iter(labels)
    for i, row in enumerate(cells):
        for j, (picture, _) in enumerate(row):
            x, y = _GAP_PX + j * pitch[0], top + i * pitch[1]
            strip = next(strips)
            drawn.paste(strip, (x, y + label - strip.height))
            drawn.paste(picture, (x, y + label))
    return drawn


def coloured(
    values: Tensor, span: tuple[float, float], colours: Sequence[str] = NEAR_TO_FAR
) -> Tensor:
    """A map (1xHxW) as a picture (3xHxW): the first colour at the low end of a span, the last at
    its high end and above.
    """
    stops = np.array([ImageColor.getrgb(colour) for colour in colours]) / 255
    at = np.linspace(*span, len(colours))
    return torch.from_numpy(np.stack([np.interp(values[0], at, stop) for stop in stops.T]))


def draw_box(picture: Tensor, pixels: Any, colour: str, size: tuple[int, int]) -> None:
    """Draw a box around pixels (mask or slices) of a picture (3xHxW), a line wide on a sheet whose
    pictures have a size at most.
    """
    inside = np.zeros(picture.shape[1:], bool)
    inside[pixels] = True
    y, x = inside.nonzero()
    if len(y):
        box = picture[:, y.min() : y.max() + 1, x.min() : x.max() + 1]
        width = max(1, picture.shape[1] // size[1], picture.shape[2] // size[0])
        core = box[:, width:-width, width:-width].clone()
        ink = torch.tensor(ImageColor.getrgb(colour))[:, None, None]
        box[:] = ink / 255 if picture.is_floating_point() else ink
        box[:, width:-width, width:-width] = core


def save(drawn: Image.Image, path: Path, quality: int = 88) -> None:
    """Write a sheet as PNG or JPEG, whole or not at all."""
    with written_whole(path) as part:
        drawn.save(part, "PNG" if path.suffix == ".png" else "JPEG", quality=quality, optimize=True)


def _fitted(picture: Tensor, size: tuple[int, int]) -> Image.Image:
    if picture.dtype != torch.uint8:
        picture = (255 * picture.clamp(0, 1)).round().to(torch.uint8)
    pixels = np.ascontiguousarray(picture.permute(1, 2, 0).numpy())
    return ImageOps.contain(Image.fromarray(pixels), size)


def _written(text: str, width: int, letters: int, colour: str) -> Image.Image:
    text = text.replace("×", "x")
    text = "".join(c if c.isascii() or c in _LETTERS else "?" for c in text)
    lines = text.splitlines()
    strip = Image.new("RGB", (width, 7 * letters // 5 * len(lines)), "white")
    while letters > _SMALLEST_PX and any(_font(letters).getlength(x) > width for x in lines):
        letters -= 1
    draw = ImageDraw.Draw(strip)
    for i, line in enumerate(lines):
        draw.text((0, i * strip.height // len(lines)), line, colour, _font(letters))
    return strip


@cache
def _font(letters: int) -> "ImageFont.FreeTypeFont | ImageFont.ImageFont":
    return ImageFont.load_default(letters)
