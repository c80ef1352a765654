"""Direction of daylight: open water is brightest towards the surface.

A ray that rises by s = sin(elevation) sees (1 − .8·s)⁻² times the veil of the level one. Light on
its way grows by e^(K_d·s·x) at x metres, where K_d is some .8 of the veil's attenuation G, so that
the veil of endless water grows by G/(G − K_d·s). Light from above also turns by less than 90° into
such a ray, which is more probable; by Monte Carlo transport this makes the same factor once more.

Against transport of an overcast sky in seas with Petzold's phase function, 8 m deep, the veil of
endless water relative to the level one is .53 to .66 at −20° in II, 1C and 3C, and 1.50 to 2.35 at
20°, where it is .62 and 1.89 here (`python -m benchmarks.accuracy.direction`).
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from uwaug.optics.view import View

MAX_RISE = math.sqrt(0.5)  # sine of 45°, above which the surface is in view and the veil is even
RISE = 0.8  # share K_d/G of the attenuation of daylight in that of the veil


def veil_factor(pitch: float | Tensor | Sequence[float], z: Tensor, view: View) -> Tensor:
    """Factor of daylight's veil on each ray of the pictures of a map z (B or 1, 1, H, W), for
    angles of the camera's axis above the horizon (a number or B), degrees.
    """
    angles = torch.as_tensor(pitch).to(z).reshape(-1, 1, 1, 1) * (math.pi / 180)
    rays = view.rays(z)
    rise = (angles.sin() - rays.y * angles.cos()) * rays.shortening
    return (1 - RISE * rise.clamp(max=MAX_RISE)) ** -2
