"""Sums over many bands as sums over a few rates."""

import math

import numpy as np
from numpy.typing import NDArray

from uwaug._support.compiled import compiled
from uwaug._support.types import Array
from uwaug.optics.curves import FARTHEST

Reduced = tuple[Array, Array, float]  # rates (K), ascending; weights (C, K); the largest error

# Largest numbers of rates that are tried first and at all. At a tolerance of .002 the ten types
# need 2 to 4. Each takes time before it is known whether it is needed.
_FIRST_RATES, _MAX_RATES = 4, 12
# Sampled places in the logarithm of distance, 20 a decade. Between them the error is as claimed,
# within 1 %.
_LOG_STEPS = np.linspace(0, 1, 96)
# Optical depths between which distances are sampled: of the fastest rate, below which all curves
# are straight, and of the slowest, above which they have faded.
_STRAIGHT_DEPTH, _FADED_DEPTH = 0.01, 10.0
_NEAREST_M = 1e-12  # smallest distance that is sampled, beside 0
_TINY = 1e-300  # stands for 0 under a logarithm and below a fraction


def reduce_rates(rates: Array, weights: Array, tolerance: float) -> Reduced:
    """Replace sums over all bands by sums over as few shared rates as `tolerance` allows.

    The rates are the nodes of the Gauss quadrature (Golub & Welsch 1969) of all measures taken
    together, on the logarithm of the rates, as distances spread over decades. The weights fit each
    curve by least squares over the logarithm of distance, exact at z = 0. A curve without negative
    weights gets none.

    Args:
        rates (M): rate of each band.
        weights (C, M): weights of the C curves Σ_m weight_cm e^(−rate_m z).
        tolerance: largest error of any curve; 0 keeps every band.
    """
    if tolerance == 0:
        return rates, weights, 0.0
    # of rates that are huge: an overflow has decayed, and an invalid number keeps no tolerance
    with np.errstate(over="ignore", invalid="ignore"):
        z = distances_of(rates)
        # not in the compiled function, as NumPy's exp takes a third of the time of numba's
        exact = weights @ np.exp(-rates[:, None] * z)  # (C, N)
        return _reduced(rates, weights, z, exact, tolerance)


@compiled
def _reduced(rates: Array, weights: Array, z: Array, exact: Array, tolerance: float) -> Reduced:
    sizes = np.abs(weights)
    totals = np.maximum(sizes.sum(1), _TINY)
    if totals.max() == _TINY:  # no light so deep
        return rates[:1].copy(), weights[:, :1].copy(), 0.0
    shares = (sizes / totals[:, None]).sum(0)
    positive = (weights < 0).sum(1) == 0
    logs = np.log(np.maximum(rates, _TINY))
    last_count = 1
    for max_rates in (_FIRST_RATES, _MAX_RATES):
        jacobi = _jacobi(logs, shares, max_rates)
        for count in range(min(last_count + 1, len(jacobi)), len(jacobi) + 1):
            fit = _fit(jacobi, count, z, exact, positive, tolerance)
            if fit[2] <= tolerance:
                if count > 2:
                    return fit
                # one rate seldom serves, and never where two do not
                single = _fit(jacobi, 1, z, exact, positive, tolerance)
                return single if single[2] <= tolerance else fit
        last_count = len(jacobi)
    return rates, weights, 0.0  # every band is a rate: slow, and exact


def distances_of(rates: Array) -> Array:
    """Distances, m: 0, then logarithmic steps over which the curves of these rates bend."""
    near = min(max(_STRAIGHT_DEPTH / max(float(rates.max()), _TINY), _NEAREST_M), FARTHEST)
    far = min(_FADED_DEPTH / max(float(rates.min()), _TINY), FARTHEST)
    return np.concatenate((np.zeros(1), near * (far / near) ** _LOG_STEPS))


@compiled
def _jacobi(points: Array, weights: Array, max_size: int) -> Array:
    """Jacobi matrix of a discrete measure, below the diagonal: the nodes of the k-point Gauss rule
    are the eigenvalues of its leading k×k block. It is Lanczos' recurrence, orthogonalised against
    all vectors before.
    """
    matrix = np.zeros((max_size, max_size))
    vectors = np.empty((max_size, len(points)))
    vectors[0] = np.sqrt(weights / weights.sum())
    for k in range(max_size):
        residual = points * vectors[k]
        components = vectors[: k + 1] @ residual
        matrix[k, k] = components[k]
        residual -= components @ vectors[: k + 1]
        norm = math.sqrt(residual @ residual)
        if k + 1 == max_size or norm < 1e-9:  # as many nodes as there are different points
            return matrix[: k + 1, : k + 1].copy()
        matrix[k + 1, k] = norm
        vectors[k + 1] = residual / norm
    return matrix


@compiled
def _fit(
    jacobi: Array, count: int, z: Array, exact: Array, positive: NDArray[np.bool_], tolerance: float
) -> Reduced:
    """Rates (K), weights (C, K) and error of a fit by `count` rates. `positive` marks curves that
    get no negative weights; an error beyond the tolerance is that of weights of any sign.
    """
    nodes = np.exp(np.linalg.eigvalsh(jacobi[:count, :count].copy()))
    basis = np.exp(-nodes[:, None] * z)
    # normal equations, bordered by the condition that the weights keep their sum, the value at
    # z = 0. They hold down to a tolerance of 1e-6, and take half as long as QR factors
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
    except Exception:  # two rates that no distance tells apart; numba knows no narrower class
        return nodes, weights, math.inf
    return nodes, weights, error


@compiled
def _positive(system: Array, right: Array, weights: Array) -> Array:
    """Weights (K) ≥ 0 of a curve: sets the most negative weight to 0 and fits the rest again."""
    mask = np.ones(len(right))
    while weights.min() < 0:
        mask[weights.argmin()] = 0
        # the equation of a masked weight says that it is 0
        masked = system * mask[:, None] * mask
        for i in range(len(mask)):
            masked[i, i] += 1 - mask[i]
        weights = np.linalg.solve(masked, right * mask)[: len(weights)] * mask[: len(weights)]
    return weights
