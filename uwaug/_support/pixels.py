"""Pixels of a picture that an object covers. The pixel in row i and column j covers j ≤ x < j + 1,
i ≤ y < i + 1.
"""

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.bool_] | tuple[slice, slice]  # index in a map (HxW)
Size = tuple[int, int]  # height and width, px


def of_box(x1: float, y1: float, x2: float, y2: float, size: Size) -> Pixels:
    """All pixels that a box touches."""
    rows = slice(max(0, math.floor(y1)), max(0, min(size[0], math.ceil(y2))))
    return rows, slice(max(0, math.floor(x1)), max(0, min(size[1], math.ceil(x2))))


def of_polygons(polygons: Sequence[Any], size: Size) -> Pixels:
    """Pixels whose centres lie in any of the polygons (each x1, y1, x2, y2, x3, y3, …); if none do,
    as in a sliver, the pixels of their box.
    """
    from skimage.draw import polygon

    mask, points = np.zeros(size, bool), [np.reshape(corners, (-1, 2)) for corners in polygons]
    for corners in points:
        mask[polygon(corners[:, 1] - 0.5, corners[:, 0] - 0.5, size)] = True
    if mask.any():
        return mask
    (x1, y1), (x2, y2) = np.concatenate(points).min(0), np.concatenate(points).max(0)
    return of_box(x1, y1, x2, y2, size)


def of_runs(counts: str | Sequence[int], size: Size) -> Pixels:
    """Pixels of COCO's run lengths: down the columns, beginning outside."""
    runs = _decompressed(counts) if isinstance(counts, str) else counts
    inside = np.repeat(np.arange(len(runs)) % 2 == 1, runs)
    return inside.reshape(size[::-1]).T


def _decompressed(text: str) -> list[int]:
    """Run lengths of COCO's compressed text: signed numbers of 5 bits a letter, lowest first. From
    the fourth on they are differences to the second last (Lin et al., maskApi.c).
    """
    counts: list[int] = []
    for letters in re.findall("[P-o]*[0-O]", text):  # the last one lacks the bit of 32
        value = sum((ord(letter) - 48 & 31) << 5 * i for i, letter in enumerate(letters))
        if letters[-1] >= "@":  # the bit of 16
            value -= 1 << 5 * len(letters)
        counts.append(value + counts[-2] if len(counts) > 2 else value)
    return counts
