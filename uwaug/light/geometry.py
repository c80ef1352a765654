"""From pixels to rays, surfaces and a lamp's irradiance: the geometry that light with a direction
needs.

A pinhole camera at the origin looks along z; x points to the right of the picture, y down. All
lengths are metres.

A surface at r metres from a lamp gets cone(ψ)·cos(ι)/r² of its light, where ψ is the angle to the
lamp's axis and ι the angle of incidence. The lamp is no point but as wide as its radius R: r² is
the squared distance and R².
"""

import math
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support import checks
from uwaug.light.light import Lamp

_NEAREST = 1e-3
"""m: what lies nearer counts as so far, where a direction is asked for."""

_FARTHEST = 1e5
"""m: open water, where a direction is asked for. Squares of it keep their digits."""

_BESIDE = 2
"""px to either side, over which a surface's slope is taken: over 1 px, the steps of a map of 8 bits
are walls.
"""

_WALL = 1e30
"""1/m: steeper than any surface."""

_SMOOTH, _PASSES = 4, 2
"""px to either side, over which a distance map is smoothed before slopes are taken, and how often.

Without, shading was noise: of the lit pixels of the motorcycle, whose map is
rounded to 1 cm, to 5 cm, or has .3 % or 1 % of noise, 15, 47, 57 and 82 % changed by more than 30 %
of their light; so 0, 12, 2 and 8 %. (Planes fitted to 11×11 px of like distance: 0, 20, 1 and 9 %,
in ten times the time. Means of 7×7 px of like distance, twice: 0, 14, 0, 3 %, in three times the
time, and wrong on planes at borders and edges.)
"""

_RELIEF = 0.03
"""Of the distance: pixels on both sides whose mean is farther from the one between them than so do
not lie on its surface. (.05 noises less, and takes more relief away.)
"""

_OUTSIDE = 1e6
"""1/m: the inverse of no distance."""

HALO = _BESIDE + _PASSES * _SMOOTH
"""px around a pixel, on which its normal rests."""

_STEEPEST = 8.0
"""The tangent of 83°: what is steeper is the gap between two surfaces, and counts as facing the
camera. As a surface it would draw a black line round every object.
"""

_FOCAL = 0.5 / math.tan(math.radians(30))
"""Focal length of a view 60° wide, as a share of the picture's width."""


def focal_of(focal_px: float | None, width: int) -> float:
    """Focal length for a picture of `width` px, px; by default that of a view 60° wide."""
    return focal_px or _FOCAL * width


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
    """The rays of a picture.

    Args:
        size: height and width, px.
        focal_px: focal length, px.
        centre: column and row that look along z, from 0 at the middle of the first pixel; None for
            the middle of the picture.
        like: a tensor of the type and device.
    """
    height, width = size
    # a graph knows the size when it runs, so that the middle is computed in tensors
    column = torch.arange(width, dtype=like.dtype, device=like.device)
    row = torch.arange(height, dtype=like.dtype, device=like.device)
    if centre is None:
        column, row = column - (width - 1) / 2, row - (height - 1) / 2
    else:
        column, row = column - centre[0], row - centre[1]
    x, y = column / focal_px, row / focal_px
    return View(x.reshape(1, 1, 1, -1), y.reshape(1, 1, -1, 1))


class Place(NamedTuple):
    """Where the surfaces of a scene are, or those of a part of it.

    Attributes:
        z (Bx1xHxW tensor): distance, m, without the field.
        field (Bx1xHxW tensor): m, or None.
        view: the rays; None if no light differs from ray to ray.
        columns: of the picture, which this part has.
        around: what the normals of a part rest on: distances and rays of the part and of a few
            pixels on all sides, and the rows and columns of the part among them.
        slopes (Bx3xHxW tensor): the normals, where they are known.
    """

    z: Tensor
    field: Tensor | None
    view: View | None
    columns: slice = slice(None)
    around: tuple[Tensor, View, slice, slice] | None = None
    slopes: Tensor | None = None

    def row(self, n: int) -> "Place":
        """The n-th scene of the batch, before it is divided into parts."""
        field = None if self.field is None else self.field[n % len(self.field)][None]
        return self._replace(z=self.z[n % len(self.z)][None], field=field)

    def part(self, rows: slice, columns: slice) -> "Place":
        """Some rows and columns of the whole scene."""
        field = None if self.field is None else self.field[..., rows, columns]
        part = Place(self.z[..., rows, columns], field, None, columns)
        if self.view is None:
            return part
        tall, wide = (slice(max(s.start - HALO, 0), s.stop + HALO) for s in (rows, columns))
        inner = [
            slice(cut.start - outer.start, cut.stop - outer.start)
            for cut, outer in ((rows, tall), (columns, wide))
        ]
        around = (self.z[..., tall, wide], self.view.part(tall, wide), inner[0], inner[1])
        return part._replace(view=self.view.part(rows, columns), around=around)

    def at(self, pixels: Tensor) -> "Place":
        """Some pixels of the whole scene, given by their flat indices (N), as one row of them."""

        def pick(value: Tensor) -> Tensor:
            return value.flatten(-2)[..., pixels][:, :, None]

        field = None if self.field is None else pick(self.field)
        if self.view is None:
            return Place(pick(self.z), field, None)
        width, (x, y) = self.z.shape[-1], self.view
        x, y = x.flatten()[pixels % width], y.flatten()[pixels // width]
        view = View(x.reshape(1, 1, 1, -1), y.reshape(1, 1, 1, -1))
        return Place(pick(self.z), field, view, slopes=pick(normals(self.z, self.view)))

    def normals(self) -> Tensor:
        """The normals of the surfaces (Bx3xHxW), see `normals`."""
        if self.slopes is not None:
            return self.slopes
        if self.around is None:
            assert self.view is not None
            return normals(self.z, self.view)
        z, view, rows, columns = self.around
        return normals(z, view)[..., rows, columns]


def normals(z: Tensor, view: View) -> Tensor:
    """The normal N of the surface at each pixel (Bx3xHxW), away from the camera, of such a length
    that N·P = 1 for the point P that is seen.

    On a plane N·P = 1 the inverse of the depth along z is N·(x, y, 1): linear in the picture, so
    that N are its slopes, without an error on planes of any tilt. Of the two slopes to either side
    of a pixel the smaller counts, which is that of its own surface where another begins. Measured
    maps are smoothed before.

    Args:
        z (Bx1xHxW tensor): distance along the ray, m.
        view: of the same pixels.
    """
    inverse = _smoothed(1 / (z.clamp(_NEAREST, _FARTHEST) * view.shortening()))
    across, down = _slope(inverse, view.x, 3), _slope(inverse, view.y, 2)
    return torch.cat([across, down, inverse - view.x * across - view.y * down], 1)


def _smoothed(inverse: Tensor) -> Tensor:
    """A map of inverse depths without its noise. Planes stay as they are, with their borders, and
    so do the edges of surfaces: pixels count in pairs, one on either side, whose mean is on the
    plane of the one between them.
    """
    for _ in range(_PASSES):
        for axis, pads in ((3, (_SMOOTH, _SMOOTH, 0, 0)), (2, (0, 0, _SMOOTH, _SMOOTH))):
            size, around = inverse.shape[axis], F.pad(inverse, pads, value=_OUTSIDE)
            most = 1 / (_RELIEF * inverse)
            change, weight = torch.zeros_like(inverse), torch.ones_like(inverse)
            for far in range(1, _SMOOTH + 1):
                before, after = (around.narrow(axis, _SMOOTH + at, size) for at in (-far, far))
                bend = 0.5 * (before + after) - inverse
                alike = (1 - (bend * most).square()).clamp(min=0.0)
                change = torch.addcmul(change, alike, bend, value=2.0)
                weight = torch.add(weight, alike, alpha=2.0)
            inverse = inverse + change / weight
    return inverse


def _slope(values: Tensor, tangents: Tensor, axis: int) -> Tensor:
    """The slope of a map along an axis, of the side where it is smaller."""
    size = values.shape[axis]
    pads = (_BESIDE, _BESIDE, 0, 0) if axis == 3 else (0, 0, _BESIDE, _BESIDE)
    values_around, tangents_around = (F.pad(t, pads, mode="replicate") for t in (values, tangents))
    more = size + _BESIDE
    gap = tangents_around.narrow(axis, _BESIDE, more) - tangents_around.narrow(axis, 0, more)
    # at the border one side is missing
    missing = gap <= 0
    steep = values_around.narrow(axis, _BESIDE, more) - values_around.narrow(axis, 0, more)
    steep = steep * (1 / torch.where(missing, torch.inf, gap))
    size_of = steep.abs() + torch.where(missing, _WALL, 0.0)
    before, after = (steep.narrow(axis, start, size) for start in (0, _BESIDE))
    nearer = size_of.narrow(axis, 0, size) <= size_of.narrow(axis, _BESIDE, size)
    slope = torch.where(nearer, before, after)
    return torch.where(slope.abs() > _STEEPEST * values, 0.0, slope)


class Ray(NamedTuple):
    """The camera's rays as a lamp sees them: the point of each that is nearest to the lamp.

    Attributes:
        middle (Bx1xHxW tensor): how far along the ray it is, m; below 0 behind the camera.
        height (Bx1xHxW tensor): how far it is from the lamp, m, which is as wide as its radius:
            √(distance² + radius²), never 0.
    """

    middle: Tensor
    height: Tensor


class Irradiance(NamedTuple):
    """What a lamp sends to each pixel's surface.

    Attributes:
        share (Bx1xHxW tensor): of the lamp's light, without the water between.
        path (Bx1xHxW tensor): from the lamp to the surface, m.
    """

    share: Tensor
    path: Tensor


def as_map(value: Tensor) -> Tensor:
    """A number of each picture (B) beside pictures."""
    return value.reshape(-1, 1, 1, 1)


def ray_of(lamp: Lamp, view: View) -> Ray:
    """The rays of a view as the lamp sees them."""
    x, y, z = (as_map(value) for value in lamp.position.unbind(-1))
    # the vector product: |L|² − s₀² would lose the digits of a lamp in view
    squared = (y - z * view.y).square() + (z * view.x - x).square()
    squared = squared + (x * view.y - y * view.x).square()
    squared = squared * view.shortening().square()
    return Ray(along(lamp.position, view), torch.sqrt(squared + as_map(lamp.radius.square())))


def along(vector: Tensor, view: View) -> Tensor:
    """The part of a vector (B, 3) along each ray (Bx1xHxW)."""
    x, y, z = (as_map(value) for value in vector.unbind(-1))
    return (view.x * x + (view.y * y + z)) * view.shortening()


def irradiance(lamp: Lamp, view: View, ray: Ray, z: Tensor, normals: Tensor) -> Irradiance:
    """The light of a lamp on points at distance z (Bx1xHxW) whose `normals` are N with N·P = 1."""
    squared = (z - ray.middle).square() + ray.height.square()
    one_over = squared.rsqrt()
    before = z * along(lamp.direction, view) - before_camera(lamp)
    cone = lamp.cone_at(before * one_over)
    # N points away from the camera: (P − L)·N = 1 − L·N
    above = (1 - _dot(normals, lamp.position)).clamp(min=0.0)
    incident = above * _one_over_length(normals) * one_over
    share = cone * incident.clamp(max=1.0) * one_over.square()
    return Irradiance(share, squared * one_over)


def before_camera(lamp: Lamp) -> Tensor:
    """How far the lamp lies along its own axis from the camera, m."""
    return as_map((lamp.position * lamp.direction).sum(-1))


def facing(normals: Tensor, direction: Tensor) -> Tensor:
    """The cosine between a surface's normal and a direction (B, 3), 0 on its back (Bx1xHxW)."""
    return (-_dot(normals, direction) * _one_over_length(normals)).clamp(min=0.0)


def _dot(normals: Tensor, vector: Tensor) -> Tensor:
    x, y, z = (as_map(value) for value in vector.unbind(-1))
    return normals[:, :1] * x + normals[:, 1:2] * y + normals[:, 2:] * z


def _one_over_length(normals: Tensor) -> Tensor:
    x, y, z = normals[:, :1], normals[:, 1:2], normals[:, 2:]
    return (x.square() + y.square() + z.square()).rsqrt()
