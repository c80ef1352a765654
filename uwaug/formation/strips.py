"""Large pictures: formed a few rows at a time, so that their light is never held whole."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from uwaug._support.tiles import Rows, at_pixels, bands
from uwaug._support.types import ColorSpace, Order
from uwaug.blur.tiled import blurred_pieces
from uwaug.formation.at_hand import farthest_seen, plan_between
from uwaug.formation.colour import decoded, encoded, headroom
from uwaug.formation.contrast import contrast
from uwaug.formation.exposure import Exposure, balanced, fixed_gain, looks
from uwaug.formation.model import Combine, at_lens, scattered
from uwaug.light.light import Light
from uwaug.optics.curves import FARTHEST, Sums, curves
from uwaug.optics.medium import Medium

__all__ = [
    "LARGE",
    "Strips",
    "Survey",
    "in_rows",
    "is_large",
    "plane",
    "require_daylight",
    "some_of",
]

LARGE = 24_000_000
"""Pixels from which a picture is formed in strips. To hold its light whole would take 40 bytes a
pixel, 1 GB here; strips take as long.
"""


def require_daylight(light: Light | None) -> None:
    """Refuse any other light on a large picture."""
    if light is not None and not light.plain:
        what = f"a picture of {LARGE / 1e6:g} megapixels or more is formed in strips"
        raise ValueError(f"light: {what}, which know daylight alone; make it smaller")


def is_large(image: Tensor) -> bool:
    """Whether a picture (3xHxW) is formed in strips."""
    return image.shape[-2] * image.shape[-1] >= LARGE


def plane(distance: float, size: tuple[int, int], image: Tensor) -> Rows:
    """A map of one distance, m."""
    dtype = torch.promote_types(image.dtype, torch.float32)
    row = torch.full((1, 1, size[1]), distance, dtype=dtype, device=image.device)
    return lambda start, stop: row.expand(-1, stop - start, -1).contiguous()


def _effective(z: Rows, field: Rows | None, dtype: torch.dtype) -> Rows:
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


def _surveyed(z: Rows, size: tuple[int, int], end: float) -> Survey:
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
    """A picture in its water, as `form` takes it, in rows; made by `in_rows`.

    Attributes:
        image (3xHxW tensor): as it was given.
        color_space: of its values.
        light: of the scene.
        z: effective distance, m.
        medium: one row, of the type of the light.
        survey: of all distances.
        order, tolerance: as for `uwaug.form_image`.
    """

    image: Tensor
    color_space: ColorSpace
    light: Rows
    z: Rows
    medium: Medium
    survey: Survey
    order: Order
    tolerance: float

    @property
    def size(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.image.shape[-2], self.image.shape[-1]

    def _some(self) -> Tensor:
        """Effective distances of some pixels, spread over the picture (N)."""
        return at_pixels(self.z, self.size, looks(*self.size, self.image.device))[0]

    def gain_of(self, exposure: Exposure) -> Tensor:
        """The gain of an exposure (1,), see `uwaug.formation.exposure.gain_of`."""
        if exposure != "auto":
            return fixed_gain(self.medium, exposure)
        seen = self.image.flatten(1)[:, looks(*self.size, self.image.device)]
        light = decoded(seen, self.color_space)[None, :, None]
        z = self._some()[None, None, None]
        farthest = z.new_full((1, 1, 1, 1), self.survey.high)
        return balanced(light, z, farthest, self.medium.sums(exact_at_lens=False))

    def brightened(self, gain: Tensor) -> "Strips":
        """The same as a camera of this gain sees it."""
        return self._replace(medium=self.medium.brightened(gain))

    def pictures(self, combine: Combine) -> tuple[Tensor, ...]:
        """What `combine` makes, `together` or `separately`, as pictures like the image."""
        size, medium, survey = self.size, self.medium, self.survey
        ends = survey.low, survey.shown
        plan = plan_between(ends, size, medium, self.tolerance, self.order)
        nearest = medium.beta.new_full((1,), survey.low)
        sums = medium.sums(exact_at_lens=at_lens(nearest, medium))
        most, dtype = headroom(self.image), self.image.dtype
        (_, band), *_ = bands(*size)
        pieces = blurred_pieces(self.blurred_light(sums), (3, *size), medium.beta, plan, band)
        pictures: list[Tensor] = []
        last = slice(0, 0)
        for rows, columns, stack in pieces:
            if rows != last:
                last = rows
                light, z = self.light(rows.start, rows.stop), self.z(rows.start, rows.stop)
            part, far = light[None, ..., columns], z[None, ..., columns]
            found = curves(sums, far)
            if self.order == "source":
                found = found._replace(scatter=light.new_ones(()))
            results = combine(part, found, scattered(stack, far, medium, plan, size))
            pictures = pictures or [torch.empty_like(self.image) for _ in results]
            for picture, result in zip(pictures, results, strict=True):
                picture[:, rows, columns] = encoded(result[0], self.color_space, dtype, most)
        return tuple(pictures)

    def contrast(self) -> Tensor:
        """The share of contrast that is left at each pixel (1xHxW), see `uwaug.contrast`."""
        parts = []
        for start, stop in bands(*self.size):
            parts.append(contrast(self.medium, self.z(start, stop)[None])[0])
        return torch.cat(parts, 1)

    def some_contrast(self) -> Tensor:
        """The same at some pixels, spread over the picture (N)."""
        return contrast(self.medium, self._some().reshape(1, 1, -1)).flatten()

    def blurred_light(self, sums: Sums) -> Rows:
        """What is blurred."""
        if self.order == "line_of_sight":
            return self.light

        def weighed(start: int, stop: int) -> Tensor:
            found = curves(sums, self.z(start, stop)[None])
            return found.scatter[0] * self.light(start, stop)

        return weighed


def in_rows(
    image: Tensor,
    z: Rows,
    medium: Medium,
    field: Rows | None,
    color_space: ColorSpace,
    order: Order = "line_of_sight",
    tolerance: float = 0.002,
) -> Strips:
    """A picture in its water, all of its distances looked at.

    Args:
        image (3xHxW tensor): uint8 or floating point; checked, see `require_values`.
        z: distances, m, every pixel known.
        medium: one row.
        field: multiplies z; None for homogeneous water.
        color_space: of the image.
        order, tolerance: as for `uwaug.form_image`.
    """
    image = image.contiguous()
    dtype = torch.promote_types(image.dtype, torch.float32)
    far = _effective(z, field, dtype)

    def light(start: int, stop: int) -> Tensor:
        return decoded(image[:, start:stop].contiguous(), color_space)

    size, medium = (image.shape[-2], image.shape[-1]), medium.to(dtype=dtype, device=image.device)
    survey = _surveyed(far, size, farthest_seen(medium, order))
    return Strips(image, color_space, light, far, medium, survey, order, tolerance)
