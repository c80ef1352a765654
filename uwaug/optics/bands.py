"""Coefficients of the medium, band by band, or as they are given for three channels."""

from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import Array
from uwaug.optics.water import Water

__all__ = [
    "WAVELENGTHS",
    "BandCoefficients",
    "Dims",
    "Downwelling",
    "VeilRate",
    "band_coefficients",
    "default_bands",
    "given_rows",
]

Downwelling = Literal["kd", "beam", "none"]
"""What dims light on its way down: K_d, beam attenuation β, or nothing."""

Dims = Literal["both", "direct", "veil"]
"""What that light is lost to: the picture and the veil, the picture alone, or the veil alone."""

VeilRate = Literal["G", "beta"]
"""At which the veil of each wavelength comes in."""

WAVELENGTHS = np.arange(400.0, 701.0, 5.0)
"""nm, the 61 bands that stand for the integral."""

_LOSSLESS = 1e-6
"""1/m, stands for G = 0, where the veil has the limit μ·b·E·z. Over 20 m it is off by 1e-5 of
that; a smaller one loses digits in V(0) − V(z), two large numbers.
"""


class BandCoefficients(NamedTuple):
    """β [1/m], G [1/m], rate of the veil [1/m], light of the picture and V(0) at each band."""

    beta: Array
    G: Array
    veil_rate: Array
    light: Array
    veil: Array


def band_coefficients(
    a: Array,
    b: Array,
    kd: Array,
    *,
    vertical_depth: float,
    g: float | Array,
    mu: float,
    downwelling: Downwelling = "kd",
    dims: Dims = "both",
    veil_rate: VeilRate = "G",
) -> BandCoefficients:
    """β = a + b, G = a + g·b, E = e^(−K_d d), V(0) = μ·b·E/G; see `uwaug.optics.medium` and, for
    what else K_d, E and G may be in V(0), `uwaug.Medium.from_water`.
    """
    checks.one_of("downwelling", downwelling, get_args(Downwelling))
    checks.one_of("dims", dims, get_args(Dims))
    checks.one_of("veil_rate", veil_rate, get_args(VeilRate))
    beta, G = a + b, np.maximum(a + g * b, _LOSSLESS)
    loss = {"kd": kd, "beam": beta, "none": np.zeros_like(beta)}[downwelling]
    left = np.exp(-loss * vertical_depth)
    full = np.ones_like(left)
    light = full if dims == "veil" else left
    ambient = full if dims == "direct" else left
    rate = G if veil_rate == "G" else np.maximum(beta, _LOSSLESS)
    return BandCoefficients(beta, G, rate, light, veil=mu * b * ambient / rate)


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
