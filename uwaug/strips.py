"""Large pictures: formed a few rows at a time, so that their light is never held whole."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from uwaug.blur.pieces import blurred_pieces
from uwaug.colour import ColorSpace, decoded, encoded, headroom, require_values
from uwaug.exposure import balanced, looks
from uwaug.formation import (
    Order,
    at_lens,
    farthest_seen,
    plan_between,
    scattered,
    together,
)
from uwaug.optics.curves import FARTHEST, curves
from uwaug.optics.medium import Medium
from uwaug.rows import Rows, at_pixels, bands

__all__ = [
    "LARGE",
    "Strips",
    "Survey",
    "effective",
    "is_large",
    "light_of",
    "plane",
    "some_of",
    "surveyed",
]

LARGE = 24_000_000
"""Pixels from which a picture is formed in strips. To hold its light whole would take 40 bytes a
pixel, 1 GB here; in strips a picture takes a tenth longer.
"""


def is_large(image: Tensor) -> bool:
    """Whether a picture (3xHxW) is formed in strips."""
    return image.shape[-2] * image.shape[-1] >= LARGE


def light_of(image: Tensor, color_space: ColorSpace) -> Rows:
    """`uwaug.colour.to_light`, a few rows at a time."""
    require_values(image, color_space)
    return lambda start, stop: decoded(image[:, start:stop].contiguous(), color_space)


def plane(distance: float, size: tuple[int, int], image: Tensor) -> Rows:
    """A map of one distance, m."""
    dtype = torch.promote_types(image.dtype, torch.float32)
    row = torch.full((1, 1, size[1]), distance, dtype=dtype, device=image.device)
    return lambda start, stop: row.expand(-1, stop - start, -1).contiguous()


def effective(z: Rows, field: Rows | None, dtype: torch.dtype) -> Rows:
    """The distance that water counts, m·z, as `uwaug.formation.prepare` has it."""

    def rows(start: int, stop: int) -> Tensor:
        part = z(start, stop).to(dtype).clamp(0.0, FARTHEST)
        return part if field is None else part * field(start, stop).to(part)

    return rows


def some_of(z: Rows, size: tuple[int, int], device: torch.device) -> Iterator[Tensor]:
    """Distances at some pixels; then, if asked for, all but those of open water."""
    yield at_pixels(z, size, looks(*size, device))
    near = []
    for start, stop in bands(*size):
        band = z(start, stop)
        near.append(band[band.isfinite()])
    yield torch.cat(near)


class Survey(NamedTuple):
    """The least and the largest effective distance, and the largest that asks for a blur, m."""

    low: float
    high: float
    shown: float


def surveyed(z: Rows, size: tuple[int, int], end: float) -> Survey:
    """Look at all distances once; from `end` on they ask for no blur."""
    low, high, shown = math.inf, 0.0, -math.inf
    for start, stop in bands(*size):
        band = z(start, stop)
        least, largest = (float(value) for value in band.aminmax())
        low, high = min(low, least), max(high, largest)
        if largest >= end < FARTHEST:
            band = band[band < end]
            largest = float(band.max()) if band.numel() else -math.inf
        shown = max(shown, largest)
    return Survey(low, high, max(shown, low))


class Strips(NamedTuple):
    """A picture in its water, as `form` takes it, in rows.

    Attributes:
        image (3xHxW tensor): as it was given.
        light: of the scene.
        z: effective distance, m.
        medium: one row, of the type of the light.
        order: as for `form_image`.
    """

    image: Tensor
    light: Rows
    z: Rows
    medium: Medium
    order: Order
    color_space: ColorSpace

    @property
    def size(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.image.shape[-2], self.image.shape[-1]

    def survey(self) -> Survey:
        """All distances, looked at once."""
        return surveyed(self.z, self.size, farthest_seen(self.medium, self.order))

    def auto_gain(self, farthest: float) -> Tensor:
        """`uwaug.exposure.auto_gain`, given the largest effective distance, m."""
        some = looks(*self.size, self.image.device)
        seen = self.image.flatten(1)[:, some]
        light = decoded(seen, self.color_space)[None, :, None]
        z = at_pixels(self.z, self.size, some)[None, :, None]
        sums = self.medium.sums(exact_at_lens=False)
        return balanced(light, z, z.new_full((1, 1, 1, 1), farthest), sums)

    def formed(self, survey: Survey, tolerance: float) -> Tensor:
        """The degraded picture, like the image."""
        size, medium, order = self.size, self.medium, self.order
        plan = plan_between((survey.low, survey.shown), size, medium, tolerance, order)
        nearest = medium.beta.new_full((1,), survey.low)
        sums = medium.sums(exact_at_lens=at_lens(nearest, medium))

        def weighed(start: int, stop: int) -> Tensor:
            found = curves(sums, self.z(start, stop)[None])
            return found.scatter[0] * self.light(start, stop)

        source = self.light if order == "line_of_sight" else weighed
        most = headroom(self.image)
        out, last = torch.empty_like(self.image), slice(0, 0)
        (_, band), *_ = bands(*size)
        pieces = blurred_pieces(source, (3, *size), medium.beta, plan, band)
        for rows, columns, stack in pieces:
            if rows != last:
                last = rows
                light, z = self.light(rows.start, rows.stop), self.z(rows.start, rows.stop)
            part, far = light[None, ..., columns], z[None, ..., columns]
            found = curves(sums, far)
            if order == "source":
                found = found._replace(scatter=light.new_ones(()))
            (result,) = together(part, found, scattered(stack, far, medium, plan, size))
            out[:, rows, columns] = encoded(result[0], self.color_space, self.image.dtype, most)
        return out
