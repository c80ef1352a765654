"""The camera's rays, and the slope of what they meet.

A pinhole camera at the origin looks along z; x points to the right of the picture, y down. All
lengths are metres.
"""

import math
from typing import NamedTuple, Self

import torch
import torch.nn.functional as F
from torch import Tensor

Vector = tuple[float, float, float]

_NEAREST_M, _FARTHEST_M = 1e-3, 1e5
"""m: what lies nearer or farther counts as so far, where a slope is asked for. Squares of both
keep their digits.
"""

_SLOPE_PX = 2
"""px to either side, over which a surface's slope is taken: over 1 px, the steps of a map of 8 bits
are walls.
"""

_SMOOTH_PX, _PASSES = 4, 2
"""px to either side, over which a distance map is smoothed before slopes are taken, and how often:
without, shading was noise (benchmarks/README.md).
"""

_MAX_RELIEF = 0.03
"""Of the distance: pixels on both sides whose mean is farther from the one between them than so do
not lie on its surface.
"""

_INVERSE_OUTSIDE = 1e6
"""1/m: the inverse of no distance, beyond the borders of the picture."""

_MAX_SLOPE = 8.0
"""The tangent of 83°: what is steeper is the gap between two surfaces, and counts as facing the
camera. As a surface it would draw a black line round every object.
"""


class Rays(NamedTuple):
    """The rays of a picture.

    Attributes:
        x (1x1x1xW tensor): tangent of each column's angle to the right.
        y (1x1xHx1 tensor): tangent of each row's angle down.
        shortening (1x1xHxW tensor): 1/|(x, y, 1)|, the share of a ray's length that lies along z.
        focal: focal length, px.
    """

    x: Tensor
    y: Tensor
    shortening: Tensor
    focal: float

    @classmethod
    def of(cls, z: Tensor, view: float) -> Self:
        """Those of a map (Bx1xHxW) that is `view` degrees wide, and looks along z in its middle."""
        height, width = z.shape[-2:]
        focal = width / 2 / math.tan(math.radians(view / 2))
        # in tensors, as a graph knows the size when it runs
        column = torch.arange(width, dtype=z.dtype, device=z.device) - (width - 1) / 2
        row = torch.arange(height, dtype=z.dtype, device=z.device) - (height - 1) / 2
        x, y = (column / focal).reshape(1, 1, 1, -1), (row / focal).reshape(1, 1, -1, 1)
        return cls(x, y, (1 + x.square() + y.square()).rsqrt(), focal)

    def along(self, vector: Vector) -> Tensor:
        """The part of a vector along each ray (1x1xHxW)."""
        return (self.x * vector[0] + (self.y * vector[1] + vector[2])) * self.shortening

    def distance(self, point: Vector) -> Tensor:
        """How far each ray, drawn to both sides, is from a point (1x1xHxW)."""
        x, y, z = point
        # by the vector product: |point|² − along² would lose the digits of a point in view
        squared = (y - z * self.y).square() + (z * self.x - x).square()
        squared = squared + (x * self.y - y * self.x).square()
        return squared.sqrt() * self.shortening

    def normals(self, z: Tensor) -> Tensor:
        """The normal N of the surface at each pixel (Bx3xHxW), away from the camera, of such a
        length that N·P = 1 for the point P that is seen.

        On a plane N·P = 1 the inverse of the depth along z is N·(x, y, 1): linear in the picture,
        so that N are its slopes, without an error on planes of any tilt. Measured maps are smoothed
        before.

        Args:
            z (Bx1xHxW tensor): distance along the ray, m.
        """
        inverse = _smoothed(1 / (z.clamp(_NEAREST_M, _FARTHEST_M) * self.shortening))
        across, down = (_slope(inverse, self.focal, axis) for axis in (3, 2))
        return torch.cat([across, down, inverse - self.x * across - self.y * down], 1)


def dot(normals: Tensor, vector: Vector) -> Tensor:
    """The product of vectors (Bx3xHxW) with one (Bx1xHxW)."""
    x, y, z = vector
    return normals[:, :1] * x + normals[:, 1:2] * y + normals[:, 2:] * z


def _sides(values: Tensor, far: int, axis: int) -> tuple[Tensor, Tensor]:
    """What is so many pixels before each, and after it, of values with `_SMOOTH_PX` more on each
    side along an axis.
    """
    size = values.shape[axis] - 2 * _SMOOTH_PX
    return values.narrow(axis, _SMOOTH_PX - far, size), values.narrow(axis, _SMOOTH_PX + far, size)


def _padded(inverse: Tensor, axis: int) -> Tensor:
    pads = (_SMOOTH_PX, _SMOOTH_PX, 0, 0) if axis == 3 else (0, 0, _SMOOTH_PX, _SMOOTH_PX)
    return F.pad(inverse, pads, value=_INVERSE_OUTSIDE)


def _smoothed(inverse: Tensor) -> Tensor:
    """A map of inverse depths without its noise. Planes stay as they are, with their borders, and
    so do the edges of surfaces: pixels count in pairs, one on either side, whose mean is on the
    plane of the one between them.
    """
    for _ in range(_PASSES):
        for axis in (3, 2):
            around, most = _padded(inverse, axis), 1 / (_MAX_RELIEF * inverse)
            change, weight = torch.zeros_like(inverse), torch.ones_like(inverse)
            for far in range(1, _SMOOTH_PX + 1):
                before, after = _sides(around, far, axis)
                bend = 0.5 * (before + after) - inverse
                alike = (1 - (bend * most).square()).clamp(min=0.0)
                change = torch.addcmul(change, alike, bend, value=2.0)
                weight = torch.add(weight, alike, alpha=2.0)
            inverse = inverse + change / weight
    return inverse


def _slope(inverse: Tensor, focal: float, axis: int) -> Tensor:
    """The slope of a map along an axis: of the two sides of a pixel, that where it is smaller,
    which is its own surface where another begins.
    """
    before, after = _sides(_padded(inverse, axis), _SLOPE_PX, axis)
    before, after = (
        (inverse - before) * (focal / _SLOPE_PX),
        (after - inverse) * (focal / _SLOPE_PX),
    )
    slope = torch.where(before.abs() <= after.abs(), before, after)
    return torch.where(slope.abs() > _MAX_SLOPE * inverse, 0.0, slope)
