"""Near-field backscatter: a lamp's light that the water scatters into the camera, once.

At s metres along a ray of the camera, the water scatters b·p(α) of the lamp's light to the camera,
and e^(−G(s + r)) of it is left after both ways:

    B_c(z) = π·power ∫_0^z Σ_l m·f_cl e^(−m·G_l (s + r)) p(α) cone(ψ) / r² ds

Here r is the distance to the lamp, α the angle of scattering with p of Henyey & Greenstein (1941),
ψ the angle to the lamp's axis, f_cl are the weights of b, and m is the field at the pixel. Let s₀
be the ray's nearest point to the lamp and h the distance there. In the angle θ = atan((s − s₀)/h)
that the lamp sees, ds/r² is dθ/h (Kulla & Fajardo 2012, equiangular). With t = tan(θ/2), which
needs no angles,

    s + r = s₀ − h + 2·h/(1 − t)          dθ = 2/(1 + t²) dt
    −cos α = sin θ = 2t/(1 + t²)          cos θ = (1 − t²)/(1 + t²)

The integrand is smooth within the cone, whose ends in t are known: a few nodes serve.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug.optics.curves import decay

ASYMMETRY = 0.924  # mean cosine of the phase function, that of Petzold's waters

# Gauss quadrature over the lit part of a ray (benchmarks/CHOICES.md)
NODES, NODE_WEIGHTS = (values.tolist() for values in np.polynomial.legendre.leggauss(7))
MAX_T = 1 - 1e-6  # largest t: 1 − t is above 0 in single precision
MIN_LENGTH = 1e-6  # length that stands for 0


class Cone(NamedTuple):
    """Cone of a lamp as the rays (1x1xHxW) cross it: across·cos θ + along·sin θ = slope·cos ψ."""

    across: Tensor
    along: Tensor
    edge: float  # slope·cos ψ at which the light has faded; it is whole from edge + 1 on

    def share(self, cosine: Tensor, sine: Tensor) -> Tensor:
        """Share of the light at angles θ."""
        t = (torch.addcmul(self.along * sine, self.across, cosine) - self.edge).clamp(0.0, 1.0)
        return t * t * (3 - 2 * t)

    def ends(self) -> tuple[Tensor, Tensor]:
        """Ends of the lit part of each ray, as t = tan(θ/2), −1…1; equal ends for a dark ray."""
        size = (self.across.square() + self.along.square()).sqrt().clamp(min=MIN_LENGTH)
        across, along = self.across / size, self.along / size
        cosine = (self.edge / size).clamp(max=1.0)
        sine = (1 - cosine.square()).sqrt()
        # (across, along) is the direction of the axis, from which the cone reaches either way
        side = torch.where(along > 0, 1.0, -1.0)
        ends = []
        for turn in (-sine, sine):
            forward = across * cosine - along * turn
            t = (along * cosine + across * turn) / (1 + forward.clamp(min=0.0))
            ends.append(torch.where(forward > 0, t, side))
        return ends[0], ends[1]


def backscatter(
    G: Tensor,
    weights: Tensor,
    nearest: Tensor,
    height: Tensor,
    cone: Cone | None,
    z: Tensor,
    density: float | Tensor = 1.0,
) -> Tensor:
    """Backscatter (Bx3xHxW) of a lamp of power 1 along each ray, up to the scene.

    Args:
        G (BxL tensor): rates of the water, 1/m.
        weights (Bx3xL tensor): weights of b, 1/m, see `uwaug.Medium.under_lamp`.
        nearest, height (1x1xHxW tensors): s₀ and h > 0 of each ray, m.
        cone: None for a lamp that shines to all sides.
        z (Bx1xHxW tensor): distance, m.
        density (number or Bx1xHxW tensor): the medium field m.
    """
    low, high = (q / (1 + (1 + q * q).sqrt()) for q in (-nearest / height, (z - nearest) / height))
    if cone is not None:
        begin, end = cone.ends()
        low, high = torch.maximum(low, begin), torch.minimum(high, end)
    low, high = low.clamp(max=MAX_T), high.clamp(max=MAX_T)
    half = ((high - low) / 2).clamp(min=0.0)
    middle = low + half
    rates, total = G[..., None, None], z.new_zeros(())
    shortest, twice = density * (nearest - height), 2 * density * height
    for node, weight in zip(NODES, NODE_WEIGHTS, strict=True):
        t = torch.add(middle, half, alpha=node)
        turned = 2 / (1 + t * t)  # dθ for each dt, and 1 + cos θ
        sine = t * turned
        factor = weight ** (-2 / 3)  # puts the weight into the phase function, without a pass
        level = z.new_tensor(factor * (1 + ASYMMETRY**2))
        phase = torch.add(level, sine, alpha=2 * factor * ASYMMETRY)
        scattered = turned / (phase * phase.sqrt())
        if cone is not None:
            scattered = scattered * cone.share(turned - 1, sine)
        arriving = decay(rates, shortest + twice / (1 - t))
        total = torch.addcmul(total, scattered, arriving)
    # the 4π of the phase function and the π of a white plate leave 1/4
    summed = torch.unflatten(weights @ total.flatten(2), -1, z.shape[-2:])
    return summed * (density * half / height * ((1 - ASYMMETRY**2) / 4))
