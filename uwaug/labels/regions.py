"""Where an object is in a picture, and what a map holds there.

Coordinates are those of detection labels: x to the right, y down, 0 at the picture's upper left
corner, so that pixel (row i, column j) covers j ≤ x < j + 1, i ≤ y < i + 1.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]

Size = tuple[int, int]
"""Height and width, px."""


class Region(NamedTuple):
    """Some pixels: a rectangle, or those of it that a mask has."""

    rows: slice
    columns: slice
    mask: Mask | None = None


def box_region(corners: Sequence[float], size: Size) -> Region | None:
    """All pixels that a box (x1, y1, x2, y2) touches inside a picture; None if there are none."""
    x1, y1, x2, y2 = corners
    if not all(map(math.isfinite, corners)) or x2 <= x1 or y2 <= y1:
        return None
    height, width = size
    rows = slice(max(0, math.floor(y1)), min(height, math.ceil(y2)))
    columns = slice(max(0, math.floor(x1)), min(width, math.ceil(x2)))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return None
    return Region(rows, columns)


def polygon_region(polygons: Sequence[Any], size: Size) -> Region | None:
    """The pixels whose centres lie in any of some polygons (each Nx2), clipped to the picture; of a
    sliver without any centre, its box. None if nothing of them is in the picture.
    """
    from skimage.draw import polygon

    mask = np.zeros(size, bool)
    for corners in polygons:
        rows, columns = polygon(corners[:, 1] - 0.5, corners[:, 0] - 0.5, size)
        mask[rows, columns] = True
    if mask.any():
        return mask_region(mask)
    points = np.concatenate(list(polygons))
    return box_region((*points.min(0), *points.max(0)), size)


def mask_region(mask: Mask) -> Region | None:
    """The pixels of a mask (HxW); None if there are none."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not rows.size:
        return None
    across = slice(int(columns[0]), int(columns[-1]) + 1)
    down = slice(int(rows[0]), int(rows[-1]) + 1)
    return Region(down, across, mask[down, across])


def runs_region(counts: Sequence[int], size: Size) -> Region | None:
    """The pixels of COCO's run lengths, which go down the columns and begin outside; None if there
    are none.
    """
    inside = np.arange(len(counts)) % 2 == 1
    mask = np.repeat(inside, counts).reshape(size[::-1]).T
    return mask_region(mask)


def mean_over(values: NDArray[Any], region: Region | None) -> float:
    """The mean of a map (HxW) over a region; 0 where there are no pixels."""
    if region is None:
        return 0.0
    part = values[region.rows, region.columns]
    inside = part if region.mask is None else part[region.mask]
    return float(inside.mean(dtype=np.float64))
