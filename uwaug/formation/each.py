"""Image formation of pictures that each have a medium, on the device of their values."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import ColorSpace
from uwaug.blur.plan import BlurPlan
from uwaug.formation.demand import blur_demand
from uwaug.formation.development import Development, Means, farthest_veil
from uwaug.formation.image import form
from uwaug.light import Light
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium

_GREY = 0.25
"""Linear light that stands for a scene whose values are not looked at."""

_WALL_PX = (9, 12)
"""Height and width of a wall that stands for a scene under lamps, which light a part of it."""


def form_each(
    images: Tensor,
    z: Tensor,
    media: Sequence[Medium],
    developments: Sequence[Development],
    *,
    color_space: ColorSpace,
    lights: Sequence[Light | None],
    metres: Tensor,
    spans: Sequence[tuple[float, float, float]],
    alike: bool,
) -> Tensor:
    """Pictures (Bx3xHxW) as cameras store them, see `uwaug.formation.image.form`.

    On the host they are formed one after the other, which keeps the data of one in the caches. (By
    PyTorch, 16 of 256² take 15 ms each; all at once, with rates padded to as many for all, 29.) On
    a device pictures by daylight alone are formed at once, then those with lamps one by one,
    without a look at values.

    Args:
        images, z, color_space, metres: as for `form`.
        media, developments, lights: one row for each picture; a light is None for daylight that is
            alike in all directions.
        spans: nearest, median and farthest effective distance of each picture, m. On a device blurs
            are planned for these, in a scene of grey.
        alike: True if all have one width law, and all or none are metered.
    """
    planned = alike and not checks.on_host(images)
    by_day = _of_one_day(lights) if planned else []
    results: dict[int, Tensor] = {}
    if by_day:
        rows = slice(None) if len(by_day) == len(images) else by_day
        pictures = _at_once(
            images[rows],
            z[rows],
            [media[i] for i in by_day],
            [developments[i] for i in by_day],
            [spans[i] for i in by_day],
            [lights[i] for i in by_day],
            color_space,
        )
        if len(by_day) == len(images):
            return pictures
        results |= dict(zip(by_day, torch.split(pictures, 1), strict=True))
    for i in sorted({*range(len(images))} - {*by_day}):
        light, plans = lights[i], list[BlurPlan]()
        if planned and light is not None:
            brightened = _lit_grey(media[i], developments[i], light, spans[i][1])
            plans = _plans([brightened], [spans[i]], z)
        results[i] = form(
            images[i : i + 1],
            z[i : i + 1],
            media[i],
            developments[i],
            color_space=color_space,
            light=light,
            metres=metres[i : i + 1],
            plans=plans,
        )
    ordered = [results[i] for i in range(len(images))]
    return ordered[0] if len(ordered) == 1 else torch.cat(ordered)


def _at_once(
    images: Tensor,
    z: Tensor,
    media: Sequence[Medium],
    developments: Sequence[Development],
    spans: Sequence[tuple[float, float, float]],
    lights: Sequence[Light | None],
    color_space: ColorSpace,
) -> Tensor:
    """Form all pictures by daylight at once, without reading their values on the host."""
    medium, development = Medium.stack(media), Development.stack(developments, z)
    light = lights[0]
    if light is not None:
        light = replace(light, pitch=torch.tensor([day.pitch for day in lights if day]))
    day = medium if light is None else medium.brightened(torch.full((1, 1), light.daylight))
    grey = _of_grey(day, developments, spans)
    plans = _plans([grey[i] for i in range(len(spans))], spans, z)
    return form(images, z, medium, development, color_space=color_space, light=light, plans=plans)


def _of_one_day(lights: Sequence[Light | None]) -> list[int]:
    """Indices of pictures by daylight alone, which differ at most in the pitch of the camera."""
    days: dict[Any, list[int]] = {}
    for i, light in enumerate(lights):
        if light is None:
            days.setdefault(None, []).append(i)
        elif not light.lamps and isinstance(light.pitch, float):
            days.setdefault((light.daylight, light.view), []).append(i)
    return max(days.values(), key=len, default=[])


def _plans(
    media: Sequence[Medium], spans: Sequence[tuple[float, float, float]], z: Tensor
) -> list[BlurPlan]:
    """Blurs of pictures of the size of a map, for media as cameras brighten them."""
    size = (z.shape[-2], z.shape[-1])
    demands = (
        blur_demand(medium, (near, far))
        for medium, (near, _, far) in zip(media, spans, strict=True)
    )
    return [demand.plan(size, shared=True) for demand in demands]


def _lit_grey(medium: Medium, development: Development, light: Light, median: float) -> Medium:
    """A medium as a camera brightens it where lamps light a grey wall at the median distance."""
    z = torch.full((1, 1, *_WALL_PX), min(median, FARTHEST), dtype=torch.float64)
    grey, water = z.new_full((1, 3, *_WALL_PX), _GREY), medium.to(z)
    gain = development.gain(grey, z, water, light.curves(water, z))
    return light.planned(water).brightened(gain)


def _of_grey(
    medium: Medium,
    developments: Sequence[Development],
    spans: Sequence[tuple[float, float, float]],
) -> Medium:
    """Media as a camera brightens them where the scene is grey and all at its median distance."""
    rows = torch.tensor(spans, dtype=torch.float64)
    z, farthest = rows.T[1:, :, None, None, None].clamp(max=FARTHEST)
    grey = z.new_full((len(z), 3, 1, 1), _GREY)
    arriving = medium.image(z, grey, grey).flatten(1)
    means = Means(
        grey.flatten(1), arriving, arriving.clamp(min=0.0), farthest_veil(farthest, medium)
    )
    return medium.brightened(Development.stack(developments, z).gain_of(means, z))
