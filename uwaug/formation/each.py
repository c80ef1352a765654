"""Image formation of pictures that each have a setting, on the device of their values."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.blur.plan import BlurPlan
from uwaug.formation.demand import blur_demand
from uwaug.formation.development import Development, Means
from uwaug.formation.image import form
from uwaug.formation.setting import Setting
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium

_GREY = 0.25  # linear light that stands for a scene whose values are not looked at
_WALL_PX = (9, 12)  # height and width of a wall that stands for a scene under lamps


def form_each(images: Tensor, z: Tensor, metres: Tensor, settings: Sequence[Setting]) -> Tensor:
    """Pictures (Bx3xHxW) as cameras store them, see `uwaug.formation.image.form`.

    On the host they are formed one after the other, which keeps the data of one in the caches. On a
    device pictures by daylight alone are formed at once, then those with lamps one by one, without
    a look at values: blurs are planned for the `span` of each, in a scene of grey.
    """
    results: dict[int, Tensor] = {}
    on_host = checks.on_host(images)
    for indices in () if on_host else _days(settings):
        rows = slice(None) if len(indices) == len(images) else indices
        pictures = _at_once(images[rows], z[rows], metres[rows], [settings[i] for i in indices])
        results |= dict(zip(indices, torch.split(pictures, 1), strict=True))
    for i, setting in enumerate(settings):
        if i in results:
            continue
        plans = list[BlurPlan]()
        if setting.light is not None and not on_host:
            plans = _plans(_lit_grey(setting, z.shape[-1]), [setting], z)
        row = slice(i, i + 1)
        results[i] = form(images[row], z[row], setting, metres=metres[row], plans=plans)
    ordered = [results[i] for i in range(len(images))]
    return ordered[0] if len(ordered) == 1 else torch.cat(ordered)


def _days(settings: Sequence[Setting]) -> list[list[int]]:
    """Indices of pictures that can be formed at once: by daylight alone, of one law of widths,
    metered or not, and at most of other pitches.
    """
    days: dict[Any, list[int]] = {}
    for i, setting in enumerate(settings):
        light, development = setting.light, setting.development
        of_one_pitch = light is None or (not light.lamps and isinstance(light.pitch, float))
        if of_one_pitch and not isinstance(development.white_balance, tuple):
            daylight = None if light is None else light.daylight
            key = daylight, setting.view, setting.medium.law, development.metered
            days.setdefault(key, []).append(i)
    return list(days.values())


def _at_once(images: Tensor, z: Tensor, metres: Tensor, settings: Sequence[Setting]) -> Tensor:
    medium = Medium.stack([setting.medium for setting in settings])
    development = Development.stack([setting.development for setting in settings], z)
    light, day = settings[0].light, medium
    if light is not None:
        light = replace(light, pitch=torch.tensor([x.light.pitch for x in settings if x.light]))
        day = medium.brightened(torch.full((1, 1), light.daylight))
    stacked = replace(settings[0], medium=medium, light=light, development=development)
    plans = _plans(_of_grey(day, settings), settings, z)
    return form(images, z, stacked, metres=metres, plans=plans)


def _plans(media: Medium, settings: Sequence[Setting], z: Tensor) -> list[BlurPlan]:
    """Blurs of pictures of the size of a map, for media as cameras brighten them."""
    demands = [
        blur_demand(media[i], (setting.span[0], setting.span[2]), view=setting.view)
        for i, setting in enumerate(settings)
    ]
    return [demand.plan((z.shape[-2], z.shape[-1]), shared=True) for demand in demands]


def _lit_grey(setting: Setting, width: int) -> Medium:
    """The medium as a camera brightens it where lamps light a grey wall at the median distance."""
    assert setting.light is not None
    metres = min(setting.span[1], FARTHEST)
    z = torch.full((1, 1, *_WALL_PX), metres, dtype=torch.float64)
    grey, water = z.new_full((1, 3, *_WALL_PX), _GREY), setting.medium.to(z)
    T = setting.light.curves(water, z, setting.view.resized(_WALL_PX[1] / width))
    gain = setting.development.gain(grey, z, water, T)
    return setting.light.planned(water).brightened(gain)


def _of_grey(medium: Medium, settings: Sequence[Setting]) -> Medium:
    """Media as a camera brightens them where the scene is grey and all at its median distance."""
    rows = torch.tensor([setting.span for setting in settings], dtype=torch.float64)
    z = rows[:, 1, None, None, None].clamp(max=FARTHEST)
    grey = z.new_full((len(z), 3, 1, 1), _GREY)
    arriving = medium.image(z, grey, grey).flatten(1)
    brightest = arriving.amax(1, keepdim=True)
    means = Means(grey.flatten(1), arriving, arriving.clamp(min=0.0), brightest)
    development = Development.stack([setting.development for setting in settings], z)
    return medium.brightened(development.gain_of(means, z))
