"""Kernels of one axis: a Gaussian on the image's grid, or on a coarser grid and back."""

import math
from fractions import Fraction
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import Array

PERIOD = 16  # of grids, px: their cells divide it evenly, or are whole multiples of it
MARGIN = 2  # cells of a grid beyond either edge, which a cubic spline needs
# Of the picture at half of its size, which coarser grids read: a row of Pascal's triangle lets less
# through than a Gaussian of what would alias.
HALVING = np.array([1, 5, 10, 10, 5, 1]) / 32
_HALVING_VARIANCE = 5 / 4  # px²
_POLE = math.sqrt(3.0) - 2.0  # of the filter that makes cubic B-spline coefficients of samples
_SPLINE_REACH = 8  # cells that the filter reaches: |_POLE|^8 = 3e-5, where the Gaussian leaves 1e-2


def sampled_parameter(sigma: Array) -> Array:
    """Parameter of the sampled Gaussian whose variance is sigma² px²: sigma itself from 1 px on."""
    parameters, variances = _sampled_variances()
    return np.where(sigma < 1, np.interp(sigma**2, variances, parameters), sigma)


@lru_cache(maxsize=1)
def _sampled_variances() -> tuple[Array, Array]:
    parameters = np.linspace(0.08, 1.05, 4096)
    squares = np.arange(1, 9) ** 2
    weights = np.exp(-0.5 * squares / parameters[:, None] ** 2)
    return parameters, 2 * (weights @ squares) / (1 + 2 * weights.sum(1))


def reflect(index: Tensor, turn: int) -> Tensor:
    """Fold indices at the edges of an axis, which repeats after a `turn` there and back: of 2·size,
    or of `size` for the half picture, whose last sample lies on the edge of an odd size.
    """
    # a tensor, as ONNX has no remainder by a symbolic number
    period = torch.full((1,), turn, dtype=torch.int64)
    index = torch.remainder(index, period)
    return torch.minimum(index, period - 1 - index)


def blur_kernel(sigma: float, reach: float) -> Tensor:
    """Sampled Gaussian (1, 2r + 1) of variance sigma² px², cut at `reach`·sigma."""
    from kornia.filters import get_gaussian_kernel1d  # loads 435 modules

    radius = math.ceil(reach * sigma)
    parameter = float(sampled_parameter(np.array(sigma)))
    kind = {"dtype": torch.float64, "device": torch.device("cpu")}
    kernel: Tensor = get_gaussian_kernel1d(2 * radius + 1, parameter, **kind)
    return kernel


def per_cell(cell: float) -> tuple[int, int]:
    """Pitch of a grid as (a, q): `a` cells on `q` px."""
    pitch = Fraction(cell).limit_denominator(PERIOD)
    return pitch.denominator, pitch.numerator


def rest_of(sigma: float) -> float:
    """Width (px of the half picture) that makes a blur of `sigma` px of the half picture."""
    return math.sqrt(sigma**2 - _HALVING_VARIANCE) / 2


def shrink_kernels(
    index: Tensor, a: int, q: int, sigma: float, reach: float
) -> tuple[Tensor, Tensor]:
    """First px (n) and weights (n, taps) of the cells `index`, on a grid of `a` cells for `q` px:
    cubic B-spline coefficients of the axis blurred by `sigma` px. Periodic, to the last bit.

    Sampling a Gaussian and solving for spline coefficients (Unser 1999, eq. 11) is one kernel,
    Σ_k √3·pole^|k| g(x + k·cell). The blur is the anti-aliasing filter. The spline errs by 70 dB at
    cell = σ/1.1 (linear interpolation: 45; Keys' cubic: 57). With
    g(x + k·cell) = g(x)·g(k·cell)·ratio^k it takes two exponentials and a polynomial.
    """
    cell = q / a
    centre = (torch.remainder(index, a).double() + 0.5) * cell - 0.5
    radius = math.ceil(reach * sigma)
    first = torch.floor(centre).long() - radius
    x = (first[:, None] + torch.arange(2 * radius + 2, device=index.device)) - centre[:, None]
    ratio = torch.exp(-x * (cell / sigma**2))
    g_cell = math.exp(-0.5 * (cell / sigma) ** 2)
    kernel, forth, back = torch.ones_like(x), torch.ones_like(x), torch.ones_like(x)
    for k in range(1, _SPLINE_REACH + 1):
        # by recurrence: g(k·cell) = g((k − 1)·cell)·g(cell)^(2k − 1)
        step = g_cell ** (2 * k - 1)
        forth, back = forth * (ratio * step), back / ratio * step
        kernel = kernel + _POLE**k * (forth + back)
    # cut at the same distance on both sides of a centre between two pixels
    kernel = kernel * torch.exp(-0.5 * (x / sigma) ** 2) * (x.abs() <= radius + 0.5)
    period = torch.div(index, a, rounding_mode="floor")
    return first + period * q, kernel / kernel.sum(1, keepdim=True)


def enlarge_kernels(index: Tensor, a: int, q: int) -> tuple[Tensor, Tensor]:
    """First cell (n) and weights (n, 4) of the cubic B-spline at pixels `index` (n), see above."""
    x = (torch.remainder(index, q).double() + 0.5) * (a / q) - 0.5
    first = torch.floor(x).long() + torch.div(index, q, rounding_mode="floor") * a - 1
    t = (x - torch.floor(x))[:, None]
    u = 1 - t
    weights = [u**3, 3 * t**3 - 6 * t**2 + 4, 3 * u**3 - 6 * u**2 + 4, t**3]
    return first, torch.cat(weights, 1) / 6
