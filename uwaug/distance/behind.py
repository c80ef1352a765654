"""Holes of sensors' maps, filled with what is behind: the shadows that edges throw, and what lies
beyond the range.
"""

from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support.tiles import Rows, row_bands
from uwaug.distance.complete import spanned

# Artificial holes in three RGB-D pairs and the bundled scene, mean error of e^(−z/2) there:
# shadows of a Kinect's projector .0079 (`filled` .067), the farthest quarter of the map .019
# (.032), blobs of 10 to 20 px .0027 (.0024), specks of 1 to 5 px .0020 (.0012: those on edges).
# It takes 3.5 times as long. Far sides of all holes at once, whichever is nearest, took 2.5 times
# as long: specks .0044, and shadows were filled from specks beside them.

_RIM = 3
"""Pixels beside a hole from which it is filled; the edges of holes are ragged."""

_REACH = 4
"""Widths of a hole over which the two sides of its rim are compared, halved: a shadow's two sides
are one width apart. With 2, slanted shadows keep parts of the near side; 4 and 6 differ little.
"""

_NEAR_SIDE = 1.25
"""A rim that is so many times nearer than what is across the hole is what throws the shadow. 1.5
differs little; with 1.1, holes in floors lose the near half of their rim.
"""

_WIDE = 1 / 20
"""Of the map's shorter side; a hole that is wider than twice that, in the middle, is no shadow.
Registered maps have frames of up to 1/16.
"""

_FARTHEST = 0.98
"""Quantile of the distances of a rim that is its farthest: beyond it are wild pixels at edges."""

_NARROWEST = 4
"""Pixels, half the width of a wide hole in the smallest maps."""

_PIXELS = 2**20
"""On which holes of larger maps are filled."""


def filled_behind(distance: Tensor, unknown: Tensor) -> Tensor:
    """Maps without holes, each hole filled from the farther side of its own rim.

    The middle of a wide hole gets the farthest distance of its rim, but for wild pixels: a sensor
    sees nothing beyond its range, and shadows are narrow. The rest is filled as `filled` does it,
    from what of the rim is not much nearer than what is across the hole.

    Args:
        distance (NxHxW tensor): m.
        unknown (NxHxW tensor): boolean; each map has a pixel that is known.
    """
    maps = zip(distance.detach().cpu().numpy(), unknown.cpu().numpy(), strict=True)
    sources = zip(*(_sources(*each) for each in maps), strict=True)
    index, away, free = (torch.from_numpy(np.stack(x)).to(distance.device) for x in sources)
    behind = distance.flatten(1).gather(1, index.flatten(1)).view_as(distance)
    return torch.where(unknown, spanned(behind, away, free), distance)


def filled_behind_rows(distance: Rows, size: tuple[int, int]) -> Rows:
    """One map (1xHxW) without holes that is read a few rows at a time: holes are filled on blocks
    of pixels, of which each is as far as its farthest.
    """
    height, width = size
    side = max(1, round((height * width / _PIXELS) ** 0.5))
    bands = row_bands(*size, multiple=side)
    coarse = torch.cat([_farthest(distance(start, stop), side) for start, stop in bands], 1)
    unknown = ~(coarse > 0)
    if bool(unknown.any()):
        coarse = filled_behind(coarse, unknown)
    columns = torch.arange(width, device=coarse.device) // side

    def rows(start: int, stop: int) -> Tensor:
        part = distance(start, stop)
        lines = torch.arange(start, stop, device=coarse.device) // side
        return torch.where(part > 0, part, coarse[:, lines][:, :, columns])

    return rows


def _farthest(distance: Tensor, side: int) -> Tensor:
    """Of each block of pixels; 0 where none is known."""
    known = torch.where(distance > 0, distance, 0)
    height, width = known.shape[-2:]
    whole = F.pad(known, (0, -width % side, 0, -height % side))
    return F.max_pool2d(whole, side)


def _sources(distance: Any, unknown: Any) -> tuple[Any, Any, Any]:
    """Of each pixel (HxW) the flat index of that whose distance it has, and how far away it is, px;
    and where a membrane is free: not on rims, of which near sides have sources, too, and not in
    the middle of wide holes.
    """
    from scipy import ndimage
    from scipy.spatial import cKDTree

    def widened(values: Any, pixels: int) -> Any:
        return ndimage.maximum_filter(values, 2 * pixels + 1, mode="constant")

    height, width = unknown.shape
    holes, count = ndimage.label(unknown, np.ones((3, 3)))
    rows, columns = ndimage.distance_transform_edt(
        ~unknown, return_distances=False, return_indices=True
    )
    beside = rows * width + columns  # the nearest pixel of a hole
    owner = holes.flat[beside]
    rim = widened(unknown, _RIM) & ~unknown
    values = np.where(rim, distance, 0)
    farthest, highest = _far_ends(values, np.where(rim, owner, 0), count)
    # what is beyond the picture's border is no hole: frames are as wide as they look
    deep = ndimage.distance_transform_cdt(np.pad(unknown, 1), "chessboard")[1:-1, 1:-1]
    wide = max(_NARROWEST, _WIDE * min(height, width))
    middle = (deep >= wide) & (farthest[holes] >= 0)
    index = np.where(middle, farthest[holes], np.arange(unknown.size).reshape(height, width))
    values[middle] = distance.flat[index[middle]]
    across = np.where(unknown, widened(values, 2 * _REACH), 0)
    half = 1
    while half < 2 * wide and (core := deep > half).any():
        # all of a hole that is at least so wide, up to its rim
        opened = widened(core, half) & unknown
        across = np.where(opened, widened(values, _REACH * (half + 1)), across)
        half *= 2
    # not what another hole has across
    across = np.minimum(across, highest[holes])
    far_side = (rim & (values * _NEAR_SIDE >= across.flat[beside])) | middle

    def points(pixels: Any) -> Any:
        # of one hole nearer to each other than to any of another
        apart = owner.flat[pixels] * float(height + width)
        return np.stack([pixels // width, pixels % width, apart], -1)

    sources, wanted = np.flatnonzero(far_side), np.flatnonzero((rim | unknown) & ~far_side)
    steps, nearest = cKDTree(points(sources)).query(points(wanted))
    away = np.zeros(unknown.shape)
    away.flat[wanted] = steps
    index.flat[wanted] = index.flat[sources[nearest]]
    return index, away, ~(rim | middle)


def _far_ends(values: Any, rims: Any, count: int) -> tuple[Any, Any]:
    """Of each rim's distances the flat index of the farthest but for wild ones, and the largest; -1
    and infinite of one without pixels. `rims` (HxW): 0 beside them, else 1…count.
    """
    # rim by rim, the nearest first
    pixels = np.flatnonzero(rims)
    pixels = pixels[np.lexsort((values.flat[pixels], rims.flat[pixels]))]
    ends = np.cumsum(np.bincount(rims.flat[pixels], minlength=count + 1))
    starts = np.concatenate([[0], ends[:-1]])
    there = ends > starts
    farthest, highest = np.full(count + 1, -1), np.full(count + 1, np.inf)
    farthest[there] = pixels[(starts + _FARTHEST * (ends - starts - 1)).astype(int)[there]]
    highest[there] = values.flat[pixels[ends[there] - 1]]
    return farthest, highest
