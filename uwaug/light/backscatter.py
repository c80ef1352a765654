"""Near-field backscatter: a lamp's light that the water scatters into the camera, once.

Along a ray of the camera, s metres from it, the water scatters b·p(α) of the lamp's light to the
camera, of which e^(−G(s + r)) is left of both ways:

    B_c(z) = π·power ∫_0^z Σ_l m·f_cl e^(−m·G_l (s + r)) p(α) cone(ψ) / r² ds

r is the distance to the lamp, α the angle of scattering with p of Henyey & Greenstein (1941), ψ the
angle to the lamp's axis; f_cl are the weights of b, m is the field at the pixel. In the angle
θ = atan((s − s₀)/h) that the lamp sees (Kulla & Fajardo 2012, equiangular), with s₀ the ray's
nearest point to the lamp and h the distance there, ds/r² is dθ/h: the inverse square is gone, and
with u = tan(π/4 + θ/2)

    s + r = s₀ + h·u        cos α = −sin θ = 1 − 2u²/(1 + u²)        cos θ = 2u/(1 + u²)

What is left is smooth within the cone, whose ends in θ are known: a few nodes serve.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug.optics.curves import decay

ASYMMETRY = 0.924
"""Mean cosine of the phase function: that of Petzold's waters."""

_NODES, _WEIGHTS = (values.tolist() for values in np.polynomial.legendre.leggauss(8))
"""Of the Gauss quadrature over the lit part of a ray. The worst of 1,800 random lamps is off by
2e-4 (benchmarks/README.md).
"""

_MAX_ANGLE = math.pi / 2 - 1e-6
"""Beyond, in single precision, the tangent of an angle may be negative."""

_MIN_LENGTH = 1e-6
"""Stands for a vector's length 0."""


class Cone(NamedTuple):
    """A lamp's cone as the camera's rays cross it: cos ψ = across·cos θ + along·sin θ.

    Attributes:
        across, along (1x1xHxW tensors): see above.
        inner, outer: cosines of the angles ψ at which the light begins to fade, and has faded.
    """

    across: Tensor
    along: Tensor
    inner: float
    outer: float

    def share(self, cosine: Tensor, sine: Tensor) -> Tensor:
        """The share of the light at angles θ."""
        toward = torch.addcmul(self.along * sine, self.across, cosine)
        t = ((toward - self.outer) * (1 / (self.inner - self.outer))).clamp(0.0, 1.0)
        return t * t * (3 - 2 * t)

    def ends(self) -> tuple[Tensor, Tensor]:
        """The angles θ between which each ray is lit; of a ray that is not, twice the same."""
        size = (self.across.square() + self.along.square()).sqrt().clamp(min=_MIN_LENGTH)
        half = torch.acos((self.outer / size).clamp(max=1.0))
        middle = torch.atan2(self.along, self.across)
        return middle - half, middle + half


def backscatter(
    G: Tensor,
    weights: Tensor,
    nearest: Tensor,
    height: Tensor,
    cone: Cone | None,
    z: Tensor,
    density: float | Tensor = 1.0,
) -> Tensor:
    """What a lamp of power 1 sends to the camera before points at a distance (Bx3xHxW).

    Args:
        G (BxL tensor): rates of the water, 1/m.
        weights (Bx3xL tensor): of b, 1/m, see `uwaug.Medium.under_lamp`.
        nearest (1x1xHxW tensor): s₀ of each ray, m.
        height (1x1xHxW tensor): h of each ray, m, > 0.
        cone: None for a lamp that shines to all sides.
        z (Bx1xHxW tensor): distance, m.
        density (number or Bx1xHxW tensor): m, the medium field.
    """
    low, high = torch.atan(-nearest / height), torch.atan((z - nearest) / height)
    if cone is not None:
        begin, end = cone.ends()
        low, high = torch.maximum(low, begin), torch.minimum(high, end)
    half = ((high - low) / 2).clamp(min=0.0)
    angle = math.pi / 4 + (low + half) / 2
    rates, total = G[..., None, None], z.new_zeros(())
    optical_nearest, optical_height = density * nearest, density * height
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        u = torch.tan((angle + (node / 2) * half).clamp(max=_MAX_ANGLE))
        level = 2 * u / (1 + u * u)  # cos θ
        raised = u * level  # 1 + sin θ
        root = ((1 - ASYMMETRY) ** 2 + 2 * ASYMMETRY * raised).rsqrt()
        scattered = root * root * root * weight
        if cone is not None:
            scattered = scattered * cone.share(level, raised - 1)
        arriving = decay(rates, torch.addcmul(optical_nearest, optical_height, u))
        total = torch.addcmul(total, scattered, arriving)
    # the 4π of the phase function and the π of a white plate leave 1/4
    summed = torch.unflatten(weights @ total.flatten(2), -1, z.shape[-2:])
    return summed * (density * half / height * ((1 - ASYMMETRY**2) / 4))
