"""Share of an object's contrast that water leaves.

A surface of mean light ρ with a pattern on it, ρ·(1 + m·cos …), is seen through water as

    T_G·ρ + T_β·ρ·m·cos … + B

where B is the veil. Light that was scattered forward (T_G − T_β) keeps the mean and blurs the
pattern away. The modulation falls from m to m·T_β·ρ/(T_G·ρ + B), and `contrast_left` is their
ratio in luminance, for the grey of photography. The gain of an exposure cancels.

That holds for patterns finer than the blur, such as the texture and the edges of an object. Coarser
ones keep more, up to T_G·ρ/(T_G·ρ + B): this is a lower bound.
"""

import math

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.formation.colour import LUMINANCE
from uwaug.formation.development import MID_GREY
from uwaug.formation.inputs import agree
from uwaug.formation.setting import Setting
from uwaug.light import Light
from uwaug.light.snow import snowing
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium
from uwaug.optics.view import WIDE, View
from uwaug.optics.water import Water

FAINT = 0.03  # share of contrast below which next to nothing can be seen
_TRIED_M, _LEAST = np.geomspace(1e-3, FARTHEST, 500), 1e-30


def contrast_left(
    distance: Tensor,
    medium: Medium,
    *,
    light: Light | None = None,
    metres: Tensor | None = None,
    view: View = WIDE,
) -> Tensor:
    """Share of the contrast of fine detail on grey that water leaves at each pixel: Michelson's, of
    luminance, (lightest − darkest) / (lightest + darkest).

    Args:
        distance (1xHxW or Bx1xHxW tensor): metres along the ray, ≥ 0; +inf is open water. In uneven
            water, times the medium field.
        medium: one row, or as many as maps.
        light, view: as of `uwaug.form_image`.
        metres (as distance): distance without the field, for lamps in uneven water.

    Returns:
        1xHxW if distance has no batch, and medium one row, else Bx1xHxW; of distance's type. 1 at
        the lens, 0 in open water, and where no light falls.

    Raises:
        TypeError, ValueError: as `uwaug.form_image`.

    Examples:
        >>> import torch
        >>> from uwaug import Medium, Water
        >>> medium = Medium.from_water(Water.jerlov("3C"))
        >>> contrast_left(torch.tensor([[[0.0, 1.0, 3.0, torch.inf]]]), medium).round(decimals=2)
        tensor([[[1.0000, 0.2300, 0.0200, 0.0000]]])
    """
    agree(medium, light, distance=distance, metres=metres)
    maps = {"distance": distance} if metres is None else {"distance": distance, "metres": metres}
    if not torch.compiler.is_compiling():
        for name, value in maps.items():
            checks.distances(name, value)
    with checks.full_precision(distance):
        dtype = torch.promote_types(distance.dtype, torch.float32)
        z, *unscaled = (
            (value if value.ndim == 4 else value[None]).to(dtype).clamp(0.0, FARTHEST)
            for value in maps.values()
        )
        grey = z.new_full((1, 3, *z.shape[-2:]), MID_GREY)
        water = medium.to(z)
        setting = Setting(medium, light, view=view)
        T = snowing(setting.curves(water, z, *unscaled), water, light, z, view, *unscaled)
        # an even surface, which no blur changes
        terms = water.parts(z, grey, grey, T)
        detail = _luminance(terms["direct"])
        arriving = _luminance(sum(terms.values(), z.new_zeros(())))
        # where no light arrives the slope of a quotient would be NaN
        dark = arriving <= 0
        share = torch.where(dark, 0.0, detail / torch.where(dark, 1.0, arriving))
        share = share.to(distance.dtype)
    return share[0] if distance.ndim == 3 and len(share) == 1 else share


def metres_for(water: Water | Medium, contrast: float) -> float:
    """Distance [m] at which an object keeps this share of its luminance contrast by daylight, see
    `Water.metres_for`; of the first of several media.
    """
    if isinstance(water, Water):
        return water.metres_for(contrast)
    weights = water.weights().row(0)
    of_grey = LUMINANCE @ weights.direct.reshape(3, 3, -1).sum(1)
    left = np.exp(-_TRIED_M[:, None] * weights.beta[0]) @ of_grey / of_grey.sum()
    return float(np.interp(-math.log(contrast), -np.log(left.clip(min=_LEAST)), _TRIED_M))


def _luminance(light: Tensor) -> Tensor:
    return (light * light.new_tensor(LUMINANCE)[:, None, None]).sum(-3, keepdim=True)
