"""How sure a fit is: the spread of its numbers over other pictures of the same kind."""

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from uwaug.fitting.solve import Problem, Solution, influence, solve
from uwaug.optics.spectra import Array

__all__ = ["Limit", "Spread", "limits", "spread"]

_CHI = 3.841
"""χ² of one degree of freedom that 95 % stay below."""

_TRIES = 6
"""Fits in search of one end of an interval."""

_STEPS = 8
"""Evaluations of each, which begins where the last one ended."""

_NEAR_ENOUGH = 0.1
"""Of an interval's half width."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Of the numbers that are fitted.

    Attributes:
        covariance: over spatial blocks; rows and columns of numbers at a bound are 0.
        independent: the same if all residuals were independent.
        blocks: how many there are.
        singular: singular values of the Jacobian, whose columns are scaled to one length: the
            smallest says how nearly two numbers do the same.
    """

    covariance: Array
    independent: Array
    blocks: int
    singular: Array

    @property
    def widened(self) -> float:
        """By how much errors are larger than if residuals were independent."""
        known = np.diag(self.independent) > 0
        if not known.any():
            return 1.0
        ratio = np.diag(self.covariance)[known] / np.diag(self.independent)[known]
        return float(np.sqrt(np.median(ratio)))


def spread(problem: Problem[Any], solution: Solution, free: Array | None = None) -> Spread:
    """The sandwich H⁻¹·S·H⁻¹: H from the slopes, S from the scores of blocks of the picture, whose
    residuals may depend on each other, as a wrong model's do.

    free: the numbers that are not taken for known; by default those inside their bounds.
    """
    free = problem.free & (solution.at_bound == 0) if free is None else free
    n = len(free)
    jacobian = solution.jacobian[:, free]
    score, curvature = influence(solution.residual, problem.robust)
    length = np.sqrt((jacobian**2).sum(0))
    scaled = jacobian / np.maximum(length, 1e-300)
    hessian = scaled.T @ (curvature[:, None] * scaled)
    inverse = np.linalg.pinv(hessian, rcond=1e-12, hermitian=True)
    scores = scaled * score[:, None]
    blocks = problem.pixels.block_of_value
    count = int(blocks.max()) + 1
    summed = np.zeros((count, scaled.shape[1]))
    np.add.at(summed, blocks, scores)
    used = int(np.unique(blocks[solution.residual != 0]).size)
    correction = used / max(used - 1, 1)
    covariance = np.zeros((n, n))
    independent = np.zeros((n, n))
    scale = np.outer(length, length)
    inside = np.ix_(free, free)
    covariance[inside] = correction * inverse @ (summed.T @ summed) @ inverse / scale
    independent[inside] = inverse @ (scores.T @ scores) @ inverse / scale
    singular = np.linalg.svd(scaled.T @ scaled, compute_uv=False) ** 0.5
    return Spread(covariance, independent, used, singular)


class Limit(NamedTuple):
    """One end of a number's 95 % interval: the numbers there, all others as good as they get."""

    theta: Array
    at_bound: bool


def limits(problem: Problem[Any], solution: Solution, place: int) -> tuple[Limit, Limit]:
    """Both ends of the interval of a number, by its profile: where the cost, with all others fitted
    anew, has risen by as much as 95 % of repetitions stay below. Near a bound, where errors are not
    symmetric, this holds and the standard error does not.
    """
    everything = spread(problem, solution, free=problem.free)
    variance = float(everything.covariance[place, place])
    # residuals that depend on each other make the cost rise too steeply
    plain = _curvature(problem, solution, place)
    rise = 0.5 * _CHI * max(variance / plain, 1e-12)
    step = math.sqrt(_CHI * variance)
    low, high = (limit[place] for limit in problem.limits)
    return (
        _limit(problem, solution, place, -step, low, rise),
        _limit(problem, solution, place, step, high, rise),
    )


def _curvature(problem: Problem[Any], solution: Solution, place: int) -> float:
    """The variance of a number if the cost were a logarithm of likelihood."""
    _, curvature = influence(solution.residual, problem.robust)
    jacobian = solution.jacobian[:, problem.free]
    length = np.maximum(np.sqrt((jacobian**2).sum(0)), 1e-300)
    scaled = jacobian / length
    inverse = np.linalg.pinv(scaled.T @ (curvature[:, None] * scaled), rcond=1e-12, hermitian=True)
    i = int(problem.free[:place].sum())
    return float(inverse[i, i] / length[i] ** 2)


def _limit(
    problem: Problem[Any], solution: Solution, place: int, step: float, bound: float, rise: float
) -> Limit:
    """Search from the solution outwards: the root of the risen cost is nearly a straight line."""
    here, start = float(solution.theta[place]), solution.theta
    furthest = bound - here
    if abs(furthest) <= 1e-9 * max(1.0, abs(bound)):
        return Limit(solution.theta, True)
    low, high = 0.0, math.inf
    theta = solution.theta
    for _ in range(_TRIES):
        reach = step if abs(step) < abs(furthest) else furthest
        held = replace(problem, held={**problem.held, place: here + reach})
        found = solve(held, start, most=_STEPS)
        start = theta = found.theta
        root = math.sqrt(max(found.cost - solution.cost, 0.0) / rise)
        if reach == furthest and root <= 1:
            return Limit(theta, True)
        if abs(root - 1) < _NEAR_ENOUGH:
            break
        low, high = (max(low, abs(reach)), high) if root < 1 else (low, min(high, abs(reach)))
        wanted = abs(reach) / max(root, 0.1)
        if not low < wanted < high:
            wanted = 2 * low if high == math.inf else 0.5 * (low + high)
        step = math.copysign(wanted, furthest)
    return Limit(theta, False)
