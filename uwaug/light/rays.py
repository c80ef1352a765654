"""From pixels to rays, points and normals: the geometry that light with a direction needs.

A pinhole camera at the origin looks along z; x points to the right of the picture, y down. All
lengths are metres.
"""

from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support import checks

__all__ = ["NEAREST", "View", "beyond", "normals", "require_centre", "view_of"]

NEAREST = 1e-3
"""m: what lies nearer counts as so far, where a direction is asked for."""

_FARTHEST = 1e5
"""m: open water, where a direction is asked for. Squares of it keep their digits."""

_BESIDE = 2
"""px to either side, over which a surface's slope is taken: over 1 px, the steps of a map of 8 bits
are walls.
"""


_WALL = 1e30
"""1/m: steeper than any surface."""


_STEEPEST = 8.0
"""The tangent of 83°: what is steeper is the gap between two surfaces, and counts as facing the
camera. As a surface it would draw a black line round every object.
"""


class View(NamedTuple):
    """The rays of a picture, or of a part of it.

    Attributes:
        x (1x1x1xW tensor): tangent of each column's angle to the right.
        y (1x1xHx1 tensor): tangent of each row's angle down.
    """

    x: Tensor
    y: Tensor

    def part(self, rows: slice, columns: slice) -> "View":
        """The rays of some rows and columns."""
        return View(self.x[..., columns], self.y[..., rows, :])

    def shortening(self) -> Tensor:
        """1/|(x, y, 1)|, the share of a ray's length that lies along z (1x1xHxW)."""
        return (1 + self.x.square() + self.y.square()).rsqrt()


def require_centre(centre: Any) -> None:
    """Refuse what is neither None nor a pair of numbers."""
    if centre is not None:
        for value in checks.pair("centre", centre, "a pair (column, row) of px"):
            checks.within("centre", value)


def view_of(
    size: tuple[int, int], focal_px: float, centre: tuple[float, float] | None, like: Tensor
) -> View:
    """The rays of a picture of (height, width) `size`.

    Args:
        size: height and width, px.
        focal_px: focal length, px.
        centre: column and row that look along z, from 0 at the middle of the first pixel; None for
            the middle of the picture.
        like: a tensor of the wanted type and device.
    """
    height, width = size
    # a graph knows the size when it runs, so that the middle is reckoned in tensors
    column = torch.arange(width, dtype=like.dtype, device=like.device)
    row = torch.arange(height, dtype=like.dtype, device=like.device)
    if centre is None:
        column, row = column - (width - 1) / 2, row - (height - 1) / 2
    else:
        column, row = column - centre[0], row - centre[1]
    x, y = column / focal_px, row / focal_px
    return View(x.reshape(1, 1, 1, -1), y.reshape(1, 1, -1, 1))


def beyond(part: slice) -> tuple[slice, slice]:
    """The rows or columns on which the normals of a part rest; and where it lies among them."""
    first = max(part.start - _BESIDE, 0)
    inner = slice(part.start - first, part.stop - first)
    return slice(first, part.stop + _BESIDE), inner


def normals(z: Tensor, view: View) -> Tensor:
    """The normal N of the surface at each pixel (Bx3xHxW), away from the camera, of such a length
    that N·P = 1 for the point P that is seen.

    On a plane N·P = 1 the inverse of the depth along z is N·(x, y, 1): linear in the picture, so
    that N are its slopes, without an error on planes of any tilt. Of the two slopes to either side
    of a pixel the smaller counts, which is that of its own surface where another begins.

    Args:
        z (Bx1xHxW tensor): distance along the ray, m.
        view: of the same pixels.
    """
    inverse = 1 / (z.clamp(NEAREST, _FARTHEST) * view.shortening())
    across, down = _slope(inverse, view.x, 3), _slope(inverse, view.y, 2)
    return torch.cat([across, down, inverse - view.x * across - view.y * down], 1)


def _slope(values: Tensor, along: Tensor, axis: int) -> Tensor:
    """The slope of a map along an axis, of the side where it is smaller."""
    size = values.shape[axis]
    pads = (_BESIDE, _BESIDE, 0, 0) if axis == 3 else (0, 0, _BESIDE, _BESIDE)
    wide, far = (F.pad(one, pads, mode="replicate") for one in (values, along))
    more = size + _BESIDE
    gap = far.narrow(axis, _BESIDE, more) - far.narrow(axis, 0, more)
    # at the border one side is missing
    missing = gap <= 0
    steep = wide.narrow(axis, _BESIDE, more) - wide.narrow(axis, 0, more)
    steep = steep * (1 / torch.where(missing, torch.inf, gap))
    size_of = steep.abs() + torch.where(missing, _WALL, 0.0)
    before, after = (steep.narrow(axis, start, size) for start in (0, _BESIDE))
    nearer = size_of.narrow(axis, 0, size) <= size_of.narrow(axis, _BESIDE, size)
    found = torch.where(nearer, before, after)
    return torch.where(found.abs() > _STEEPEST * values, 0.0, found)
