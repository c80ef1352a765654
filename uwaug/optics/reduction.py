"""From spectra to the rates and weights of a medium: coefficients at each band, then sums over few
shared rates.
"""

import numpy as np
from torch import Tensor

from uwaug._support.types import Array
from uwaug.optics.quadrature import distances_of, reduce_rates
from uwaug.optics.spectra import bands_between
from uwaug.optics.surfaces import measure, row_of
from uwaug.optics.water import Water

_LOSSLESS = 1e-6
"""1/m, stands for G = 0, where the veil has the limit μ·b·E·z. Over 20 m it is off by 1e-5 of
that; a smaller one loses digits in V(0) − V(z), two large numbers.
"""


def default_bands(water: Water) -> Array:
    """Those of `WAVELENGTHS` that the water covers."""
    low, high = float(water.wavelengths[0]), float(water.wavelengths[-1])
    bands = bands_between(low, high)
    if len(bands) == 0:
        raise ValueError(f"water covers {low:g}–{high:g} nm: no band of 400–700 nm")
    return bands


def attenuations(a: Array, b: Array, g: float | Array) -> tuple[Array, Array]:
    """β = a + b and G = a + g·b [1/m] at each band."""
    return a + b, np.maximum(a + g * b, _LOSSLESS)


def reduced(
    beta: Array,
    G: Array,
    light: Array,
    veil: Array,
    response: Array,
    basis: Array | None,
    tolerance: float,
) -> tuple[dict[str, Tensor], float]:
    """Rates and weights of a medium (of one row) by name, and the largest error of a curve.

    Args:
        beta, G (M arrays): from `attenuations`.
        light, veil (M arrays): E = e^(−K_d d) and V(0) = μ·b·E/G.
        response (3xM array): of the camera, with its colour matrix if there is a basis; rows sum
            to 1.
        basis (3xM array): reflectances of surfaces with spectra; None for grey ones.
        tolerance: largest error of each curve; 0 keeps every band.
    """
    lit, haze = measure(response, basis) * light, response * veil
    if basis is not None and not _mixes(lit, np.stack([beta, G]), tolerance / 2):
        # three numbers serve, and so leave half of the tolerance
        lit, tolerance = response * light, tolerance / 2
    return reduced_curves(beta, G, lit, haze, tolerance)


def reduced_curves(
    beta: Array, G: Array, lit: Array, veil: Array, tolerance: float
) -> tuple[dict[str, Tensor], float]:
    """As `reduced`, of the weights of each band: of T_β and T_G (3xM or 9xM), and of V (3xM)."""
    both = np.concatenate([lit, veil])
    if np.array_equal(beta, G):
        # nothing is scattered forward: of two reductions, the difference would be left
        G_rates, weights, error = reduce_rates(beta, both, tolerance)
        rates, direct = G_rates, weights[:-3]
    else:
        rates, direct, direct_error = reduce_rates(beta, lit, tolerance)
        G_rates, weights, error = reduce_rates(G, both, tolerance)
        error = max(error, direct_error)
    arrays = {
        "beta": rates,
        "direct_weights": direct,
        "G": G_rates,
        "signal_weights": weights[:-3],
        "veil_weights": weights[-3:],
    }
    return {name: row_of(array) for name, array in arrays.items()}, error


def _mixes(lit: Array, rates: Array, tolerance: float) -> bool:
    """Whether a channel takes more than a tolerance from the other two at some distance.

    Args:
        lit (9xN array): weights of the nine curves.
        rates (2xN array): β and G, 1/m.
    """
    others = lit[[1, 2, 3, 5, 6, 7]]
    if (np.abs(others.sum(1)).reshape(3, 2).sum(1) > tolerance).any():  # at the lens, as most do
        return True
    with np.errstate(over="ignore", invalid="ignore"):
        curves = (others @ np.exp(-rate[:, None] * distances_of(rate)) for rate in rates)
        taken = [np.abs(of_others).reshape(3, 2, -1).sum(1) for of_others in curves]
    return max(float(curve.max()) for curve in taken) > tolerance
