"""Coefficients of the medium, band by band, or as they are given for three channels."""

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug.optics.spectra import Array
from uwaug.optics.water import Water

__all__ = ["WAVELENGTHS", "BandCoefficients", "band_coefficients", "default_bands", "given_rows"]

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


def given_rows(name: str, value: Any, shape: tuple[int, ...], dtype: torch.dtype) -> Tensor:
    """A coefficient of `shape`, or a batch of them, as (B, *shape); finite and ≥ 0."""
    row = torch.as_tensor(value, dtype=None if isinstance(value, Tensor) else dtype).to(dtype)
    batched = row.ndim == len(shape) + 1
    if row.shape[batched:] != shape:
        wanted = "a number or (B,)" if shape == () else "(3,) or (B, 3)"
        raise ValueError(f"{name} must have shape {wanted}, got {tuple(row.shape)}")
    known = row.detach()
    if not bool(((known >= 0) & known.isfinite()).all()):
        raise ValueError(f"{name} must be finite and ≥ 0, got {known.tolist()}")
    return row if batched else row[None]
