"""Sums over many bands as sums over a few rates."""

import math

import numpy as np
from numpy.typing import NDArray

from uwaug._support.compiled import compiled
from uwaug._support.types import Array
from uwaug.optics.curves import FARTHEST

Reduced = tuple[Array, Array, float]
"""The rates (K), ascending; the weights (C, K); the largest error."""

_FIRST_RATES, _MOST_RATES = 4, 12
"""Rates tried first, and at all. At a tolerance of .002 the ten types need 2 to 4, and each of them
costs time before it is known whether it will be asked for.
"""

_STEPS = np.linspace(0, 1, 96)
"""Of the logarithm of distance, 20 a decade: between them the error is as claimed to 1 %."""

_BEGUN, _ENDED = 0.01, 10.0
"""Optical depths of the fastest and of the slowest rate, between which distances are sampled:
nearer, all curves are straight, and farther, they have ended.
"""

_NEAREST = 1e-12
"""m."""

_LEAST = 1e-300
"""Stands for 0 under a logarithm and a fraction."""


def reduce_rates(rates: Array, weights: Array, tolerance: float) -> Reduced:
    """Replace sums over all bands by sums over as few shared rates as `tolerance` allows, at any
    distance.

    The rates are the nodes of the Gauss quadrature (Golub & Welsch 1969) of all measures taken
    together, on the logarithm of the rates, as distances spread over decades. (On the rates
    themselves, 90 media of the ten types need 693 rates where these need 499.) The weights fit each
    curve by least squares over the logarithm of distance, exact at z = 0; those of a curve without
    negative weights are not negative either.

    Args:
        rates (M): rate of each band.
        weights (C, M): of the C curves Σ_m weight_cm e^(−rate_m z).
        tolerance: largest error of any curve; 0 keeps every band.
    """
    if tolerance == 0:
        return rates, weights, 0.0
    # rates of any size: what overflows has decayed, and what is invalid keeps no tolerance
    with np.errstate(over="ignore", invalid="ignore"):
        z = distances_of(rates)
        # here, as NumPy's exp takes a third of the time of numba's
        exact = weights @ np.exp(-rates[:, None] * z)  # (C, N)
        return _reduced(rates, weights, z, exact, tolerance)


@compiled
def _reduced(rates: Array, weights: Array, z: Array, exact: Array, tolerance: float) -> Reduced:
    sizes = np.abs(weights)
    totals = np.maximum(sizes.sum(1), _LEAST)
    if totals.max() == _LEAST:  # no light so deep
        return rates[:1].copy(), weights[:, :1].copy(), 0.0
    shares = (sizes / totals[:, None]).sum(0)
    positive = (weights < 0).sum(1) == 0
    logs = np.log(np.maximum(rates, _LEAST))
    tried = 1
    for most in (_FIRST_RATES, _MOST_RATES):
        jacobi = _jacobi(logs, shares, most)
        for count in range(min(tried + 1, len(jacobi)), len(jacobi) + 1):
            fit = _fit(jacobi, count, z, exact, positive, tolerance)
            if fit[2] <= tolerance:
                if count > 2:
                    return fit
                # one rate seldom serves, and never where two do not
                alone = _fit(jacobi, 1, z, exact, positive, tolerance)
                return alone if alone[2] <= tolerance else fit
        tried = len(jacobi)
    return rates, weights, 0.0  # every band is a rate: slow, and exact


def distances_of(rates: Array) -> Array:
    """0, then logarithmic steps in which the curves of these rates bend."""
    near = min(max(_BEGUN / max(float(rates.max()), _LEAST), _NEAREST), FARTHEST)
    far = min(_ENDED / max(float(rates.min()), _LEAST), FARTHEST)
    return np.concatenate((np.zeros(1), near * (far / near) ** _STEPS))


@compiled
def _jacobi(points: Array, weights: Array, most: int) -> Array:
    """Jacobi matrix of a discrete measure, below the diagonal: the nodes of the k-point Gauss rule
    are the eigenvalues of its leading k×k block.

    Lanczos' recurrence, orthogonalised against all that came before: a step takes a tenth of the
    time of QR factors of Chebyshev polynomials, which give twelve at once.
    """
    matrix = np.zeros((most, most))
    vectors = np.empty((most, len(points)))
    vectors[0] = np.sqrt(weights / weights.sum())
    for k in range(most):
        moved = points * vectors[k]
        along = vectors[: k + 1] @ moved
        matrix[k, k] = along[k]
        moved -= along @ vectors[: k + 1]
        norm = math.sqrt(moved @ moved)
        if k + 1 == most or norm < 1e-9:  # as many nodes as there are different points
            return matrix[: k + 1, : k + 1].copy()
        matrix[k + 1, k] = norm
        vectors[k + 1] = moved / norm
    return matrix


@compiled
def _fit(
    jacobi: Array,
    count: int,
    z: Array,
    exact: Array,
    positive: NDArray[np.bool_],
    tolerance: float,
) -> Reduced:
    """Rates (K), weights (C, K) and error of `count` rates; the error of curves with weights of
    any sign where that is beyond the tolerance. `positive`: which curves have no negative weights.
    """
    nodes = np.exp(np.linalg.eigvalsh(jacobi[:count, :count].copy()))
    basis = np.exp(-nodes[:, None] * z)
    # the normal equations, bordered by the condition that the weights keep their sum, the value
    # at z = 0. They hold down to a tolerance of 1e-6, and take half as long as QR factors
    system = np.ones((count + 1, count + 1))
    system[:count, :count] = basis @ basis.T
    system[count, count] = 0
    right = np.empty((count + 1, len(exact)))
    right[:count] = basis @ exact.T
    right[count] = exact[:, 0]
    weights = np.zeros((len(exact), count))
    try:
        weights[:] = np.linalg.solve(system, right)[:count].T
        error = np.abs(weights @ basis - exact).max()
        if error <= tolerance:  # non-negative weights fit no better than any
            for row in range(len(exact)):
                if positive[row] and weights[row].min() < 0:
                    weights[row] = _positive(system, right[:, row].copy(), weights[row])
                    error = max(error, np.abs(weights[row] @ basis - exact[row]).max())
    except Exception:  # two rates that no distance tells apart; of its kind numba knows no more
        return nodes, weights, math.inf
    return nodes, weights, error


@compiled
def _positive(system: Array, right: Array, weights: Array) -> Array:
    """Weights (K) ≥ 0 of a curve: strikes out the most negative, refits the rest."""
    kept = np.ones(len(right))
    while weights.min() < 0:
        kept[weights.argmin()] = 0
        # a struck weight's equation says that it is 0
        struck = system * kept[:, None] * kept
        for i in range(len(kept)):
            struck[i, i] += 1 - kept[i]
        weights = np.linalg.solve(struck, right * kept)[: len(weights)] * kept[: len(weights)]
    return weights
