"""Rates and weights of a medium from spectra."""

import numpy as np

from uwaug._support.types import Array
from uwaug.optics.quadrature import distances_of, reduce_rates
from uwaug.optics.spectra import bands_between
from uwaug.optics.surfaces import measure
from uwaug.optics.water import Water

# Smallest G, 1/m. It stands for 0, where the veil has the limit μ·b·E·z, and over 20 m is off by
# 1e-5 of that. A smaller one loses digits in V(0) − V(z), the difference of two large numbers.
_MIN_G = 1e-6


def default_bands(water: Water) -> Array:
    """Bands of `WAVELENGTHS` that a water covers; refuses a water that covers none."""
    low, high = float(water.wavelengths[0]), float(water.wavelengths[-1])
    bands = bands_between(low, high)
    if len(bands) == 0:
        raise ValueError(f"water covers {low:g}–{high:g} nm: no band of 400–700 nm")
    return bands


def attenuations(a: Array, b: Array, g: float | Array) -> tuple[Array, Array]:
    """β = a + b and G = a + g·b [1/m] at each band."""
    return a + b, np.maximum(a + g * b, _MIN_G)


def reduced(
    beta: Array,
    G: Array,
    light: Array,
    veil: Array,
    response: Array,
    basis: Array | None,
    tolerance: float,
) -> tuple[dict[str, Array], float]:
    """Rates and weights of a medium (of one row) by name, and the largest error of a curve.

    Args:
        beta, G (M arrays): from `attenuations`.
        light, veil (M arrays): E = e^(−K_d d) and V(0) = μ·b·E/G.
        response (3xM array): of the camera, with its colour matrix if there is a basis.
        basis (3xM array): reflectances of surfaces with spectra; None for grey ones.
        tolerance: largest error of each curve; 0 keeps every band.
    """
    lit = measure(response, basis) * light
    if basis is not None and not _mixes(lit, np.stack([beta, G]), tolerance / 2):
        # diagonals serve, and leave half of the tolerance
        lit, tolerance = response * light, tolerance / 2
    return reduced_curves(beta, G, lit, response * veil, tolerance)


def reduced_curves(
    beta: Array, G: Array, lit: Array, veil: Array, tolerance: float
) -> tuple[dict[str, Array], float]:
    """As `reduced`, from the weights of each band: of T_β and T_G (3xM or 9xM) and of V (3xM)."""
    G_weights = np.concatenate([lit, veil])
    if np.array_equal(beta, G):
        # two reductions would differ, and the difference would be scattered forward
        G_rates, weights, error = reduce_rates(beta, G_weights, tolerance)
        beta_rates, direct = G_rates, weights[:-3]
    else:
        beta_rates, direct, direct_error = reduce_rates(beta, lit, tolerance)
        G_rates, weights, error = reduce_rates(G, G_weights, tolerance)
        error = max(error, direct_error)
    return {
        "beta": beta_rates,
        "direct_weights": direct,
        "G": G_rates,
        "signal_weights": weights[:-3],
        "veil_weights": weights[-3:],
    }, error


def _mixes(lit: Array, rates: Array, tolerance: float) -> bool:
    """True if a channel takes more than a tolerance from the other two at some distance, by the
    weights of the nine curves (9xN) and rates β and G (2xN), 1/m.
    """
    off_diagonal = lit[[1, 2, 3, 5, 6, 7]]
    at_lens = np.abs(off_diagonal.sum(1)).reshape(3, 2).sum(1)
    if (at_lens > tolerance).any():
        return True
    with np.errstate(over="ignore", invalid="ignore"):
        curves = (off_diagonal @ np.exp(-rate[:, None] * distances_of(rate)) for rate in rates)
        exchanged = [np.abs(curve).reshape(3, 2, -1).sum(1) for curve in curves]
    return max(float(light.max()) for light in exchanged) > tolerance
