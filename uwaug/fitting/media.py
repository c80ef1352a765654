"""From the numbers of a fit to media that any picture can be formed in."""

from dataclasses import replace

import torch
from torch import Tensor

from uwaug._support.types import Shape
from uwaug.fitting.model import Natural
from uwaug.fitting.structure import Geometry
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

__all__ = ["media_of"]

_LEAST_SCATTERING = 1e-6
"""1/m, stands for none in a width law."""


def media_of(natural: Natural, b_mean: Tensor, shape: Shape | None, geometry: Geometry) -> Medium:
    """A batch of media.

    Args:
        natural: the numbers of each; its gains are left out, as they are the cameras'.
        b_mean (B tensor): mean scattering coefficient, 1/m.
        shape: of the point spread; None if no light is scattered forward.
        geometry: of the pictures that were fitted.
    """
    beta, G, veil = natural.beta, natural.G, natural.veil
    if shape is None or natural.width is None or natural.exponent is None:
        return _without_scatter(beta, G, veil)
    b, exponent = b_mean.clamp(min=_LEAST_SCATTERING), natural.exponent
    # σ = width·(z/reference)^exponent
    scale = natural.width / (b * geometry.reference) ** exponent
    law = PointSpread(scale, exponent, shape, geometry.short_side)
    if len(beta) == 1:
        law = replace(law, scale=float(scale), exponent=float(exponent))
    return Medium.from_coefficients(beta, G, veil, b_mean=b, point_spread=law)


def _without_scatter(beta: Tensor, G: Tensor, veil: Tensor) -> Medium:
    """Media in which all light that leaves the line of sight is lost: T_G = T_β, and a veil that
    has rates of its own.
    """
    one = torch.diag_embed(torch.ones_like(beta))
    none = torch.zeros_like(one)
    return Medium(
        beta=beta,
        direct_weights=one,
        G=torch.cat([beta, G], 1),
        signal_weights=torch.cat([one, none], 2),
        veil_weights=torch.cat([none, torch.diag_embed(veil)], 2),
        b_mean=beta.new_zeros(len(beta)),
        point_spread=PointSpread.none(),
        notes=("fitted: direct light and veil, no forward scatter",) * len(beta),
    )
