"""A lamp beside the camera, as McGlamery and Jaffe light their scenes."""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug.published.equation import BandedWater

_ASYMMETRY = 0.924
"""Mean cosine of the phase function, Henyey & Greenstein's: that of Petzold's waters."""

_RADIUS = 0.03
"""m, of the lamp: nearer than so its light grows no more."""

_POINTS = 12
"""Of the quadrature over the part of a ray that is lit: within 1e-4 of 2000 (II and 7C, 60°
wide)."""


class Lamp(NamedTuple):
    """A lamp with a soft cone; metres, x to the right of the picture, y down, z forward.

    Attributes:
        position: from the camera, m.
        aim: along its axis, of any length.
        power: of a white plate that faces it at 1 m in air, where 1 is a white plate in daylight.
        cone: from the axis to where its light has faded, degrees; it fades from half of that on.
        view: horizontal angle of view of the camera, degrees.
    """

    position: tuple[float, float, float] = (-0.8, -0.5, 0.0)
    aim: tuple[float, float, float] = (0.8, 0.5, 3.0)
    power: float = 10.0
    cone: float = 50.0
    view: float = 60.0

    def on_scene(self, z: Tensor) -> tuple[Tensor, Tensor]:
        """What it sends to the scene without the water between, and how far that is.

        power·cone(ψ)·cos(ι)/r², as if each point lay on a plane that faces the camera.

        Args:
            z (Bx1xHxW): distance from the camera, m.

        Returns:
            Irradiance, and metres (both Bx1xHxW).
        """
        away = z * self._rays(z) - self._tensor(self.position, z)
        r = (away.square().sum(1, keepdim=True) + _RADIUS**2).sqrt()
        facing = (away[:, 2:] / r).clamp(min=0)
        return self._cone(away, r) * facing / r.square(), r

    def veil(self, z: Tensor, G: Tensor, water: BandedWater) -> Tensor:
        """What the water scatters into the camera (Bx3xHxW): the sum over the lamp's beam

            π·power ∫_0^z ∫ S_c·b·p(α)·e^(−G(s + r)) dλ cone(ψ)/r² ds

        where r is the distance of the point at s on the ray to the lamp, α the angle of scattering.
        In the angle θ = atan((s − m)/h) at which the lamp sees that point, with m where the ray is
        nearest to the lamp and h the distance there, ds/r² is dθ/h. Gauss' quadrature is over the
        part within the cone.
        """
        ray, lamp, axis = self._rays(z), self._tensor(self.position, z), self._axis(z)
        m, forward = ((ray * v).sum(1, keepdim=True) for v in (lamp, axis))
        h = ((m * ray - lamp).square().sum(1, keepdim=True) + _RADIUS**2).sqrt()
        across = (m * forward - (lamp * axis).sum(1, keepdim=True)) / h
        # cos ψ = across·cos θ + forward·sin θ
        middle, most = torch.atan2(forward, across), torch.hypot(forward, across)
        edge = math.cos(math.radians(self.cone))
        half = torch.acos((edge / most).clamp(-1, 1))
        low = torch.maximum(torch.atan(-m / h), middle - half)
        span = (torch.minimum(torch.atan((z - m) / h), middle + half) - low).clamp(min=0)
        total = z.new_zeros(1, 3, 1, 1)
        for node, weight in zip(*np.polynomial.legendre.leggauss(_POINTS), strict=True):
            theta = low + span * float(1 + node) / 2
            s, r = m + h * torch.tan(theta), h / torch.cos(theta)
            cone = self._cone(s * ray - lamp, r)
            # cos α = −sin θ; the 4π of the phase function and π leave 1/4
            g = _ASYMMETRY
            phase = 0.25 * (1 - g * g) / (1 + g * g + 2 * g * torch.sin(theta)) ** 1.5
            source = water.integral(water.b, (G, s + r)) * (cone * phase)
            total = total + float(weight) / 2 * span / h * source
        return total

    def _cone(self, away: Tensor, r: Tensor) -> Tensor:
        """The power that it sends to points at `away` (Bx3xHxW) from it."""
        outer, inner = (math.cos(math.radians(self.cone * share)) for share in (1.0, 0.5))
        cosine = (away * self._axis(away)).sum(1, keepdim=True) / r
        t = ((cosine - outer) / (inner - outer)).clamp(0, 1)
        return self.power * t * t * (3 - 2 * t)

    def _axis(self, like: Tensor) -> Tensor:
        return torch.nn.functional.normalize(self._tensor(self.aim, like), dim=1)

    def _rays(self, z: Tensor) -> Tensor:
        """Unit vectors along the rays of the picture (1x3xHxW)."""
        height, width = z.shape[-2:]
        focal = width / 2 / math.tan(math.radians(self.view) / 2)
        x = (torch.arange(width) - (width - 1) / 2).to(z) / focal
        y = (torch.arange(height) - (height - 1) / 2).to(z) / focal
        down, right = torch.meshgrid(y, x, indexing="ij")
        rays = torch.stack([right, down, torch.ones_like(right)])
        return torch.nn.functional.normalize(rays, dim=0)[None]

    def _tensor(self, vector: tuple[float, float, float], like: Tensor) -> Tensor:
        return like.new_tensor(vector).reshape(1, 3, 1, 1)
