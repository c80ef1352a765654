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
    light: Light | None = None,
    metres: Tensor | None = None,
) -> Tensor:
    """Pictures (Bx3xHxW) as cameras store them, see `uwaug.formation.image.form`.

    On the host one after the other, as what one of them needs then stays in the caches. (By
    PyTorch, 16 of 256² take 15 ms each; all at once, with rates padded to as many for all, 29.) On
    a device at once.

    Args:
        images, z, color_space, light, metres: as for `form`, which says what they are.
        media, developments: of one row, one for each picture.
        spans: nearest, median and farthest effective distance of each, m, for which blurs are
            planned on a device, in a scene of grey: nobody waits there for a look at its light.
        alike: whether all have one law of widths, and are metered or none is.
    """
    if checks.on_host(images) or light is not None or not alike:
        rows = [slice(i, i + 1) for i in range(len(images))]
        results = [
            form(
                images[row],
                z[row],
                media[i],
                developments[i],
                color_space=color_space,
                light=light,
                metres=None if metres is None else metres[row],
            )
            for i, row in enumerate(rows)
        ]
        return results[0] if len(results) == 1 else torch.cat(results)
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
