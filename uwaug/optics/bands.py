"""Coefficients of the medium, band by band."""

from typing import NamedTuple

import numpy as np

from uwaug.optics.spectra import Array
from uwaug.optics.water import Water

__all__ = ["WAVELENGTHS", "BandCoefficients", "band_coefficients", "default_bands"]

WAVELENGTHS = np.arange(400.0, 701.0, 5.0)
"""nm, the 61 bands that stand for the integral."""

_LOSSLESS = 1e-6
"""1/m, stands for G = 0, where the veil has the limit μ·b·E·z. Over 20 m it is off by 1e-5 of
that; a smaller one loses digits in V(0) − V(z), two large numbers.
"""


class BandCoefficients(NamedTuple):
    """β [1/m], G [1/m], E and V(0) at each band."""

    beta: Array
    G: Array
    light: Array
    veil: Array


def band_coefficients(
    a: Array, b: Array, kd: Array, *, vertical_depth: float, g: float | Array, mu: float
) -> BandCoefficients:
    """β = a + b, G = a + g·b, E = e^(−K_d d), V(0) = μ·b·E/G; see `uwaug.optics.medium`."""
    G = np.maximum(a + g * b, _LOSSLESS)
    light = np.exp(-kd * vertical_depth)
    return BandCoefficients(beta=a + b, G=G, light=light, veil=mu * b * light / G)


def default_bands(water: Water) -> Array:
    """Those of `WAVELENGTHS` that the water covers."""
    low, high = water.wavelengths[[0, -1]]
    bands: Array = WAVELENGTHS[(low <= WAVELENGTHS) & (high >= WAVELENGTHS)]
    if len(bands) == 0:
        cure = "give wavelengths in its range"
        raise ValueError(f"water covers {low:g}–{high:g} nm: no band of 400–700 nm; {cure}")
    return bands
