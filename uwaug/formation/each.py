"""Pictures that each have a medium of their own, formed where their values are."""

from collections.abc import Sequence

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import ColorSpace
from uwaug.formation.demand import blur_demand
from uwaug.formation.development import Development, Means
from uwaug.formation.image import form
from uwaug.light import Light
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium

_GREY = 0.25
"""Linear light of a scene that nobody has looked at."""


def form_each(
    images: Tensor,
    z: Tensor,
    media: Sequence[Medium],
    developments: Sequence[Development],
    *,
    color_space: ColorSpace,
    spans: Sequence[tuple[float, float, float]],
    alike: bool,
    lights: Sequence[Light | None] = (),
    metres: Tensor | None = None,
) -> Tensor:
    """Pictures (Bx3xHxW) as cameras store them, see `uwaug.formation.image.form`.

    On the host one after the other, as what one of them needs then stays in the caches. (By
    PyTorch, 16 of 256² take 15 ms each; all at once, with rates padded to as many for all, 29.) On
    a device at once, but for those with lamps.

    Args:
        images, z, color_space, metres: as for `form`, which says what they are.
        media, developments, lights: of one row, one for each picture; no lights: daylight.
        spans: nearest, median and farthest effective distance of each, m, for which blurs are
            planned on a device, in a scene of grey: nobody waits there for a look at its light.
        alike: whether all have one law of widths, and are metered or none is.
    """
    lit = {i for i, light in enumerate(lights) if light is not None}
    together = [] if checks.on_host(images) or not alike else sorted({*range(len(images))} - lit)
    results = {
        i: form(
            images[i : i + 1],
            z[i : i + 1],
            media[i],
            developments[i],
            color_space=color_space,
            light=lights[i] if lights else None,
            metres=None if metres is None else metres[i : i + 1],
        )
        for i in range(len(images))
        if i not in together
    }
    if together:
        some = slice(None) if len(together) == len(images) else together
        formed = _at_once(
            images[some],
            z[some],
            [media[i] for i in together],
            [developments[i] for i in together],
            [spans[i] for i in together],
            color_space,
        )
        results |= dict(zip(together, formed[:, None], strict=True))
        if not lit:
            return formed
    ordered = [results[i] for i in range(len(images))]
    return ordered[0] if len(ordered) == 1 else torch.cat(ordered)


def _at_once(
    images: Tensor,
    z: Tensor,
    media: Sequence[Medium],
    developments: Sequence[Development],
    spans: Sequence[tuple[float, float, float]],
    color_space: ColorSpace,
) -> Tensor:
    """Pictures by daylight, without a look at their values."""
    medium, development = Medium.stack(media), Development.stack(developments, z)
    grey = _of_grey(medium, developments, spans)
    size = (z.shape[-2], z.shape[-1])
    demands = [blur_demand(grey[i], (near, far)) for i, (near, _, far) in enumerate(spans)]
    plans = [demand.plan(size, shared=True) for demand in demands]
    return form(images, z, medium, development, color_space=color_space, plans=plans)


def _of_grey(
    medium: Medium,
    developments: Sequence[Development],
    spans: Sequence[tuple[float, float, float]],
) -> Medium:
    """Media as a camera brightens them where the scene is grey and all at its median distance."""
    rows = torch.tensor(spans, dtype=torch.float64)
    z, far = rows.T[1:, :, None, None, None].clamp(max=FARTHEST)
    grey = z.new_full((len(z), 3, 1, 1), _GREY)
    arriving = medium.image(z, grey, grey).flatten(1)
    veil = medium.curves(far).veil.flatten(1).amax(1, keepdim=True)
    means = Means(grey.flatten(1), arriving, arriving.clamp(min=0.0), veil)
    return medium.brightened(Development.stack(developments, z).gain_of(means, z))
