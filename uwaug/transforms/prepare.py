"""One picture in one random water: what `RandomUnderwater` does once it has drawn."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwaug._support.deterministic import reproducible
from uwaug._support.types import ColorSpace, Order
from uwaug.distance.sample import metres_by_rows, to_metres
from uwaug.formation import strips
from uwaug.formation.at_hand import plan_at_hand
from uwaug.formation.colour import from_light, require_values
from uwaug.formation.contrast import contrast_under
from uwaug.formation.exposure import GAINS, fixed_gain, gain_of, looks
from uwaug.formation.field import gaussian_random_field, gaussian_random_rows
from uwaug.formation.loops.picture import fused_picture, to_light
from uwaug.formation.loops.serving import serves
from uwaug.formation.loops.switch import Path
from uwaug.formation.model import Combine, form, prepare, together
from uwaug.formation.strips import Strips
from uwaug.light.lit import Lit, lit_of, planned
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
    "Whole",
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


class Whole(NamedTuple):
    """A picture in its water, as `form` takes it; `Strips` is the same of a large one.

    Attributes:
        image (3xHxW tensor): as it was given.
        color_space: of its values.
        light (1x3xHxW tensor): of the scene.
        z (1x1xHxW tensor): effective distance, m.
        medium: as the camera's exposure sees it.
        order, tolerance: as for `uwaug.form_image`.
        lit: the light, if it is not the default, as the exposure sees it.
        path: that its record names, see `uwaug.fused`.
    """

    image: Tensor
    color_space: ColorSpace
    light: Tensor
    z: Tensor
    medium: Medium
    order: Order = "line_of_sight"
    tolerance: float = 0.002
    lit: Lit | None = None
    path: Path | None = None

    def pictures(self, combine: Combine) -> tuple[Tensor, ...]:
        """What `combine` makes, `together` or `separately`, as pictures like the image."""
        shown = self.medium if self.lit is None else planned(self.medium, self.lit.light)
        plan = plan_at_hand(self.z, shown, self.tolerance, self.order)
        given = (self.light, self.z, self.medium)
        daylight = self.lit is None
        if daylight and combine is together and serves(*given, self.order, self.path):
            return (fused_picture(self.image, *given, plan, self.color_space)[0],)
        parts = form(*given, plan, self.order, combine, self.lit)
        return tuple(from_light(part[0], self.color_space, self.image) for part in parts)

    def contrast(self) -> Tensor:
        """The share of contrast that is left at each pixel (1xHxW), see `uwaug.contrast`."""
        lit = None if self.lit is None else self.lit.whole()
        return contrast_under(lit, self.medium, self.z)[0]

    def some_contrast(self) -> Tensor:
        """The same at some pixels, spread over the picture (N)."""
        pixels = looks(self.z.shape[-2], self.z.shape[-1], self.z.device)
        lit = None if self.lit is None else self.lit.at(pixels)
        z = self.z.flatten()[pixels].reshape(1, 1, 1, -1)
        return contrast_under(lit, self.medium, z).flatten()


class InWater(NamedTuple):
    """A picture in its water, before it is formed; what the draw and the gain came to."""

    seen: Whole | Strips
    settled: Settled
    gain: Tensor

    def used(self) -> dict[str, float]:
        """What a record says of it."""
        return self.settled.used(self.gain)


def in_water(image: Tensor, distance: Tensor | None, choice: Choice) -> InWater:
    """A picture in its water, before it is formed.

    Args:
        image (3xHxW tensor): uint8 or floating point.
        distance (1xHxW tensor): of the kind that is set; None for a plane at the distance drawn.
        choice: what it is degraded with.
    """
    make = _in_strips if strips.is_large(image) else _as_a_whole
    return make(image, distance, choice)


def _as_a_whole(image: Tensor, distance: Tensor | None, choice: Choice) -> InWater:
    draw, settings = choice.draw, choice.settings
    # a view with other strides takes other paths through the kernels, which round differently
    light = to_light(image.contiguous(), settings.color_space, draw.path)
    if distance is None:
        z = torch.full_like(light[:1], draw.distance)
    else:
        z = to_metres(distance.contiguous(), draw.scaling, settings.distance_kind, settings.unknown)
    some = z.flatten()[looks(z.shape[-2], z.shape[-1], z.device)]
    settled = _settled(choice, (some, z), image.shape[-1])
    field, metres = _field(draw, z), z
    light, z, medium = prepare(light, z, settled.medium, field)
    focal_px = settings.focal(image.shape[-1])
    lit = lit_of(settings.light(draw), metres, field, medium, focal_px, None)
    gain = _gain(lambda: gain_of(light, z, medium, "auto", lit, draw.path), medium, draw, settings)
    lit = None if lit is None else lit.brightened(gain)
    kept = settings.order, settings.tolerance, lit, draw.path
    seen = Whole(image, settings.color_space, light, z, medium.brightened(gain), *kept)
    return InWater(seen, settled, gain)


def _in_strips(image: Tensor, distance: Tensor | None, choice: Choice) -> InWater:
    draw, settings, size = choice.draw, choice.settings, (image.shape[-2], image.shape[-1])
    require_values(image, settings.color_space)
    strips.require_daylight(settings.light(draw))
    if distance is None:
        z = strips.plane(draw.distance, size, image)
    else:
        given = distance.contiguous()
        z = metres_by_rows(given, draw.scaling, settings.distance_kind, settings.unknown)
    settled = _settled(choice, strips.some_of(z, size, image.device), size[1])
    field = None
    if not math.isnan(draw.field_seed):
        field = gaussian_random_rows(size, **_field_of(draw))
    kept = settings.color_space, settings.order, settings.tolerance
    found = strips.in_rows(image, z, settled.medium, field, *kept)
    gain = _gain(lambda: found.gain_of("auto"), found.medium, draw, settings)
    return InWater(found.brightened(gain), settled, gain)


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


def _field(draw: Draw, z: Tensor) -> Tensor | None:
    if math.isnan(draw.field_seed):
        return None
    field = gaussian_random_field(
        z.shape[-2:], **_field_of(draw), dtype=torch.float32, device="cpu"
    )
    return field.to(z.device)


def _field_of(draw: Draw) -> dict[str, Any]:
    """Which field is drawn."""
    generator = torch.Generator().manual_seed(int(draw.field_seed))
    return {"low": draw.field_low, "high": draw.field_high, "generator": generator}


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


def _gain(balanced: Callable[[], Tensor], medium: Medium, draw: Draw, settings: Settings) -> Tensor:
    """The exposure of a picture, (1,); `balanced` gives an automatic one."""
    if not math.isnan(draw.gain):
        return medium.beta.new_full((1,), draw.gain)
    if settings.exposure == "auto":
        return balanced()
    return fixed_gain(medium, draw.exposure if settings.exposure == "drawn" else settings.exposure)


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
