"""Direction of daylight: open water is brightest towards the surface.

A ray that rises by s = sin(elevation) sees (1 − .8·s)⁻² times the veil of the level one. Light on
its way grows by e^(K_d·s·x) at x metres, where K_d is some .8 of the veil's attenuation G, so that
the veil of endless water grows by G/(G − K_d·s). Light from above also turns by less than 90° into
such a ray, which is more probable; by Monte Carlo transport this makes the same factor once more.

Against transport of an overcast sky in seas with Petzold's phase function, 8 m deep, veil of
endless water relative to the level one (II at 480 nm, 1C and 3C at 550 nm; `python -m
benchmarks.accuracy.direction`):

| elevation | −45° | −20° | −10° | 10° | 20° | 45° |
|---|---|---|---|---|---|---|
| II | .44 | .66 | .80 | 1.22 | 1.50 | 4.24 |
| 1C | .31 | .53 | .70 | 1.55 | 2.35 | 12.5 |
| 3C | .36 | .58 | .74 | 1.35 | 1.92 | 4.51 |
| here | .41 | .62 | .77 | 1.35 | 1.89 | 5.30 |
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from uwaug.optics.view import View

MAX_RISE = math.sqrt(0.5)
"""Sine of the elevation (45°) above which the veil grows no more: there the surface is in view."""

RISE = 0.8  # share K_d/G of the attenuation of daylight in that of the veil


def veil_factor(pitch: float | Tensor | Sequence[float], z: Tensor, view: View) -> Tensor:
    """Factor of daylight's veil on each ray of pictures (B or 1, 1, H, W).

    Args:
        pitch (number or B): angle of the camera's axis above the horizon, degrees.
        z (Bx1xHxW tensor): a map of the pictures.
        view: of the camera.
    """
    angles = torch.as_tensor(pitch).to(z).reshape(-1, 1, 1, 1) * (math.pi / 180)
    rays = view.rays(z)
    rise = (angles.sin() - rays.y * angles.cos()) * rays.shortening
    return (1 - RISE * rise.clamp(max=MAX_RISE)) ** -2
