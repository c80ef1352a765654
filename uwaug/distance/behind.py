"""Holes of sensors' maps, filled with what is behind: the shadows that edges throw, and what lies
beyond the range.
"""

from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support.tiles import Rows, row_bands
from uwaug.distance.complete import filled

# Artificial holes in three RGB-D pairs and the bundled scene, mean error of e^(−z/2) there:
# shadows of a Kinect's projector .0085 (`filled` .067), the farthest quarter of the map .019
# (.032), blobs of 10 to 20 px .0028 (.0024), specks of 1 to 5 px .0044 (.0012: those on edges).
# It takes 2.5 times as long.

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

_NARROWEST = 4
"""Pixels, half the width of a wide hole in the smallest maps."""

_PIXELS = 2**20
"""On which holes of larger maps are filled."""


def filled_behind(distance: Tensor, unknown: Tensor) -> Tensor:
    """Maps without holes, each filled from the farther side of its rim.

    The middle of a wide hole gets the farthest distance of all its rim: a sensor sees nothing
    beyond its range, and shadows are narrow. The rest is filled as `filled` does it, from what of
    the rim is not much nearer than what is across the hole.

    Args:
        distance (NxHxW tensor): m.
        unknown (NxHxW tensor): boolean; each map has a pixel that is known.
    """
    maps = zip(distance.detach().cpu().numpy(), unknown.cpu().numpy(), strict=True)
    found = zip(*(_far_side(*each) for each in maps), strict=True)
    index, far_side = (torch.from_numpy(np.stack(x)).to(distance.device) for x in found)
    around = distance.flatten(1).gather(1, index.flatten(1)).view_as(distance)
    return torch.where(unknown, filled(around, ~far_side), distance)


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


def _far_side(distance: Any, unknown: Any) -> tuple[Any, Any]:
    """Which pixels (HxW) holes are filled from, and whose distance each has, as flat indices: its
    own, or, in the middle of a wide hole, that of the farthest pixel of the rim.
    """
    from scipy import ndimage

    def widened(values: Any, pixels: int) -> Any:
        return ndimage.maximum_filter(values, 2 * pixels + 1, mode="constant")

    around = widened(unknown, _RIM)
    rim = around & ~unknown
    values = np.where(rim, distance, 0)
    # what is beyond the picture's border is no hole: frames are as wide as they look
    deep = ndimage.distance_transform_cdt(np.pad(unknown, 1), "chessboard")[1:-1, 1:-1]
    wide = max(_NARROWEST, _WIDE * min(unknown.shape))
    middle = deep >= wide
    holes, count = ndimage.label(around)
    nearest_first = np.flatnonzero(rim)
    nearest_first = nearest_first[np.argsort(values.flat[nearest_first], kind="stable")]
    farthest = np.full(count + 1, -1)
    farthest[holes.flat[nearest_first]] = nearest_first  # the last one stays
    middle &= farthest[holes] >= 0
    index = np.where(middle, farthest[holes], np.arange(unknown.size).reshape(unknown.shape))
    values[middle] = distance.flat[index[middle]]
    candidates = rim | middle
    across = np.where(unknown, widened(values, 2 * _REACH), 0)
    half = 1
    while half < 2 * wide and (core := deep > half).any():
        # all of a hole that is at least so wide, up to its rim
        opened = widened(core, half) & unknown
        across = np.where(opened, widened(values, _REACH * (half + 1)), across)
        half *= 2
    far_side = candidates & (values * _NEAR_SIDE >= widened(across, _RIM + 1))
    return index, far_side
