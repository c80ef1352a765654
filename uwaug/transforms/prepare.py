"""One picture in one random water: what `RandomUnderwater` does once it has drawn."""

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from uwaug._support.deterministic import reproducible
from uwaug._support.tiles import RowSource, bands
from uwaug.distance.sample import metres_of
from uwaug.formation.exposure import GAINS, Exposure, metering_points
from uwaug.formation.field import random_field
from uwaug.formation.scene import Scene, Setup
from uwaug.optics.camera import Camera
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import CONTRAST_THRESHOLD, Water
from uwaug.transforms.choice import Choice, Draw, Settings

__all__ = [
    "Choice",
    "Draw",
    "InWater",
    "Settings",
    "Settled",
    "exactly",
    "in_water",
    "used",
]

_DIMMEST = 2 / GAINS[1]
"""Share of the surface's light that a scene has at least, where an exposure is automatic: what the
largest gain makes up for, and an octave for what is lost on the way to the camera. Waters that are
turbid enough for a scene at arm's length are black at 10 m.
"""


@contextmanager
def exactly(image: Tensor) -> Iterator[None]:
    """Where a picture is degraded: without gradients, and bit for bit the same each time."""
    with reproducible(), torch.no_grad(), torch.autocast(image.device.type, enabled=False):
        yield


def used(image: Tensor, distance: Tensor | None, choice: Choice) -> dict[str, float]:
    """What the draw comes to on a picture; arguments as for `in_water`.

    Returns:
        contents: factor on all that is in the water besides pure water.
        visibility: of that water, m.
        vertical_depth: m, where it was limited to what an automatic exposure makes up for.
        gain: of the exposure.
    """
    with exactly(image):
        return in_water(image, distance, choice).used()


class Settled(NamedTuple):
    """What a draw comes to on a picture, but for the gain.

    Attributes:
        water: with its contents.
        contents: factor on all that is in it besides pure water.
        vertical_depth: m, no deeper than an automatic exposure can make up for.
        medium: before exposure.
    """

    water: Water
    contents: float
    vertical_depth: float
    medium: Medium

    def used(self, gain: Tensor) -> dict[str, float]:
        """What a record says of it."""
        return {
            "contents": self.contents,
            "visibility": self.water.visibility(),
            "vertical_depth": self.vertical_depth,
            "gain": float(gain),
        }


class InWater(NamedTuple):
    """A picture in its water, before it is formed, and what the draw came to."""

    scene: Scene
    settled: Settled

    def used(self) -> dict[str, float]:
        """What a record says of it."""
        return self.settled.used(self.scene.gain)


def in_water(image: Tensor, distance: Tensor | None, choice: Choice) -> InWater:
    """A picture in its water, before it is formed.

    Args:
        image (3xHxW tensor): uint8 or floating point.
        distance (1xHxW tensor): of the kind that is set; None for a plane at the distance drawn.
        choice: what it is degraded with.
    """
    draw, settings = choice.draw, choice.settings
    size = (image.shape[-2], image.shape[-1])
    metres: Tensor | RowSource
    if distance is None:
        dtype = torch.promote_types(image.dtype, torch.float32)
        metres = image.new_full((1, 1, 1), draw.distance, dtype=dtype).expand(1, *size)
    else:
        given = distance.contiguous()
        metres = metres_of(given, draw.scaling, settings.distance_kind, settings.unknown)
    settled = _settled(choice, _some_of(metres), size[1])
    field = None
    if not math.isnan(draw.field_seed):
        like = metres if isinstance(metres, Tensor) else metres.like
        field = random_field(size, int(draw.field_seed), draw.field_low, draw.field_high, like)
    exposure: Exposure = draw.exposure if settings.exposure == "drawn" else settings.exposure
    setup = Setup(
        medium=settled.medium,
        light=settings.light(draw),
        exposure=exposure,
        color_space=settings.color_space,
        focal_px=settings.focal(size[1]),
        tolerance=settings.tolerance,
        order=settings.order,
    )
    gain = None if math.isnan(draw.gain) else draw.gain
    return InWater(Scene.of(image, metres, setup, field, draw.path, gain=gain), settled)


def _some_of(metres: Tensor | RowSource) -> Iterator[Tensor]:
    """Distances at some pixels; then, if asked for, all, of a large picture but for open water."""
    points = metering_points(metres.shape[-2], metres.shape[-1], metres.device)
    if isinstance(metres, Tensor):
        yield metres.flatten()[points]
        yield metres
        return
    yield metres.at(points)
    bands_of = (metres.rows(*band) for band in bands(*metres.size))
    yield torch.cat([band[band.isfinite()] for band in bands_of])


def _settled(choice: Choice, some: Iterable[Tensor], width: int) -> Settled:
    """The water and the medium of a picture of `width` px; `some` of its distances, then all."""
    waters, camera, draw, settings = choice
    water, contents = _water(waters, draw, some)
    light = settings.light(draw)
    # a lamp shines at any depth
    if settings.exposure == "auto" and not (light is not None and light.lamps):
        draw = draw._replace(vertical_depth=_lit_depth(water, draw.vertical_depth))
    medium = _medium(water, camera, draw, settings.law(width), settings)
    return Settled(water, contents, draw.vertical_depth, medium)


def _water(waters: Sequence[Water], draw: Draw, some: Iterable[Tensor]) -> tuple[Water, float]:
    """The water of a picture, and the factor on what is in it."""
    water = waters[0].mix(waters[1], draw.mixing) if len(waters) > 1 else waters[0]
    if not math.isnan(draw.contents):
        contents = draw.contents
    elif not math.isnan(draw.visibility):
        contents = water.contents_for(CONTRAST_THRESHOLD, draw.visibility)
    elif not math.isnan(draw.contrast):
        contents = water.contents_for(draw.contrast, _middle(some))
    else:
        return water, 1.0
    return water.with_contents(contents), contents


def _middle(some: Iterable[Tensor]) -> float:
    """The median of the first distances that are not all open water, m."""
    for z in some:
        known = z.isfinite()
        # to pick them takes longer than the median itself
        near = z if bool(known.all()) else z[known]
        if near.numel():
            return float(near.median())
    return math.inf


def _lit_depth(water: Water, metres: float) -> float:
    """A vertical depth, or that where the light is dimmest if it is deeper."""
    if water.daylight(metres) >= _DIMMEST:
        return metres
    return min(metres, water.depth_of_daylight(_DIMMEST))


def _medium(
    water: Water, camera: Camera, draw: Draw, law: PointSpread, settings: Settings
) -> Medium:
    # media that are kept for nothing would lie between the pictures in memory, so that the heap
    # could not shrink
    make = _new_medium if settings.varied else _kept_medium
    numbers = (draw.vertical_depth, draw.g, draw.mu)
    return make(water, camera, numbers, law.widened(draw.blur_factor), settings.tolerance)


def _new_medium(
    water: Water,
    camera: Camera,
    numbers: tuple[float, float, float],
    law: PointSpread,
    tolerance: float,
) -> Medium:
    depth, g, mu = numbers
    return Medium.from_water(
        water,
        camera,
        vertical_depth=depth,
        g=g,
        mu=mu,
        point_spread=law,
        tolerance=tolerance,
    )


_kept_medium = lru_cache(maxsize=64)(_new_medium)
"""Nine waters, or pairs of them, seen by a few cameras."""
