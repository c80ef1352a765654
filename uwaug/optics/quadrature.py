"""Sums over many bands as sums over a few rates."""

import numpy as np

from uwaug.optics.spectra import Array

__all__ = ["Reduced", "reduce_rates"]

_MOST_RATES = 12

Reduced = tuple[Array, list[Array], float]
"""The rates (K), ascending; the weights, (3, K) for each measure; the largest error."""


def reduce_rates(rates: Array, measures: tuple[Array, ...], z: Array, tolerance: float) -> Reduced:
    """Replace sums over all bands by sums over as few shared rates as `tolerance` allows.

    The rates are the nodes of the Gauss quadrature (Golub & Welsch 1969) of all measures taken
    together. The weights fit each curve by non-negative least squares over z, with the value at
    z = 0 exact.

    Args:
        rates (M): rate of each band.
        measures: each (3, M), the weights of three curves Σ_m measure_cm e^(−rate_m z).
        z (N): distances at which the error counts; z[0] = 0.
        tolerance: largest error of any curve; 0 keeps every band.
    """
    wanted = np.concatenate(measures)  # (C, M)
    if tolerance == 0:
        return rates, list(measures), 0.0
    if wanted.max() < 1e-300:  # no light so deep
        return rates[:1], [measure[:, :1] for measure in measures], 0.0
    exact = wanted @ np.exp(-rates[:, None] * z)  # (C, N)
    shares = wanted / np.maximum(wanted.sum(1, keepdims=True), 1e-300)
    jacobi = _jacobi(rates, shares.sum(0))
    for k in range(1, len(jacobi) + 1):
        nodes = np.maximum(np.linalg.eigvalsh(jacobi[:k, :k]), 0.0).astype(np.float64)
        basis = np.exp(-nodes[:, None] * z)
        weights = _fit_weights(basis, exact)
        if np.abs(weights @ basis - exact).max() > tolerance:
            continue  # and non-negative weights fit no better
        for row in np.flatnonzero(weights.min(1) < 0):
            weights[row] = _fit_positive(basis, exact[row])
        error = float(np.abs(weights @ basis - exact).max())
        if error <= tolerance:
            return nodes, list(np.split(weights, len(measures))), error
    return rates, list(measures), 0.0  # every band is a rate: slow, and exact


def _jacobi(points: Array, weights: Array) -> Array:
    """Jacobi matrix of a discrete measure: the nodes of the k-point Gauss rule are the eigenvalues
    of its leading k×k block.

    From the QR factors of weighted Chebyshev polynomials; Lanczos' recurrence gives the same and
    takes six times as long.
    """
    low, high = points.min(), points.max()
    scaled = np.clip(2 * (points - low) / max(high - low, 1e-300) - 1, -1, 1)
    basis = np.polynomial.chebyshev.chebvander(scaled, min(_MOST_RATES, len(points)) - 1)
    q, r = np.linalg.qr(np.sqrt(weights)[:, None] * basis)
    diagonal = np.abs(np.diag(r))
    rank = int((diagonal > 1e-9 * diagonal[0]).cumprod().sum())
    q = q[:, :rank]
    return np.asarray(q.T @ (points[:, None] * q))


def _fit_weights(basis: Array, exact: Array) -> Array:
    """Least-squares weights (C, K), weights @ basis ≈ exact, equal in the first column (z = 0).

    There the basis is 1, so that the sum of the weights is known: the last of them is eliminated.
    """
    total, last = exact[:, :1], basis[-1]
    free = np.linalg.lstsq((basis[:-1] - last).T, (exact - total * last).T, rcond=None)[0].T
    return np.concatenate([free, total - free.sum(1, keepdims=True)], 1)


def _fit_positive(basis: Array, curve: Array) -> Array:
    """The same for one curve, with weights ≥ 0: strikes out the most negative, refits the rest."""
    weights = np.zeros(len(basis))
    active = list(range(len(basis)))
    values = _fit_weights(basis, curve[None])[0]
    while values.min() < 0:
        del active[int(values.argmin())]
        values = _fit_weights(basis[active], curve[None])[0]
    weights[active] = values
    return weights
