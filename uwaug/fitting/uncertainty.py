"""How sure a fit is: the spread of its numbers over other pictures of the same kind."""

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uwaug._support.types import Array
from uwaug.fitting.solve import Problem, Solution, influence, solve

__all__ = ["Limit", "Spread", "limits", "spread"]

_CHI = 3.841
"""χ² of one degree of freedom that 95 % stay below."""

_TRIES = 6
"""Fits in search of one end of an interval."""

_STEPS = 15
"""Evaluations of each, which begins where the last one ended."""

_FLAT = 1e-9
"""Of the largest eigenvalue of a matrix of unit scale: what is less is not seen."""

_UNMOVED = 1e-4
"""Of what a quantity could move along a direction that is not seen."""

_COARSE = 1.5
"""Ratio of variances, from which larger blocks take the place of smaller ones."""

_NEAR_ENOUGH = 0.1
"""Of an interval's half width."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Of the numbers that are fitted.

    Attributes:
        covariance: over spatial blocks; rows and columns of numbers at a bound are 0.
        independent: the same if all residuals were independent.
        by_curvature: variances if the cost were a logarithm of likelihood, the diagonal of
            H⁻¹; infinite of numbers that do nothing, or are not free.
        length: of the Jacobian's columns; 0 if a number does nothing, or is not free.
        idle: which numbers do nothing at all.
        unseen (numbers x directions): changes of numbers times length that do not show at all.
        singular: singular values of the Jacobian, whose columns are scaled to one length: the
            smallest says how nearly two numbers do the same.
    """

    covariance: Array
    independent: Array
    by_curvature: Array
    length: Array
    idle: NDArray[np.bool_]
    unseen: Array
    singular: Array

    def sees(self, slope: Array) -> bool:
        """Whether the pictures show a quantity of these slopes."""
        scaled = np.divide(slope, self.length, out=np.zeros_like(slope), where=self.length > 0)
        moved = np.abs(scaled @ self.unseen)
        still = bool((moved <= _UNMOVED * np.linalg.norm(scaled)).all())
        return still and not self.idle[slope != 0].any()

    @property
    def widened(self) -> float:
        """By how much errors are larger than if residuals were independent."""
        return math.sqrt(_ratio(self.covariance, self.independent))


def spread(problem: Problem[Any], solution: Solution, free: Array | None = None) -> Spread:
    """The sandwich H⁻¹·S·H⁻¹: H from the slopes, S from the scores of blocks of the picture, whose
    residuals may depend on each other, as a wrong model's do.

    free: the numbers that are not taken for known; by default those inside their bounds.
    """
    free = problem.free & (solution.at_bound == 0) if free is None else free
    score, curvature = influence(solution.residual, problem.robust)
    length = np.sqrt((solution.jacobian**2).sum(0))
    used = free & (length > 0)
    scaled = solution.jacobian[:, used] / length[used]
    inverse, null = _inverse(scaled.T @ (curvature[:, None] * scaled))
    scores = scaled * score[:, None]
    counted = solution.residual != 0
    pixels = problem.pixels
    middle = _over_blocks(scores, pixels.block_of_value, counted)
    for coarser in pixels.coarser:
        wider = _over_blocks(scores, pixels.of_values(coarser), counted)
        # few blocks make a rough estimate: it counts where it says something else
        if _ratio(inverse @ wider @ inverse, inverse @ middle @ inverse) > _COARSE:
            middle = wider
    n = len(free)
    covariance, independent = np.zeros((n, n)), np.zeros((n, n))
    scale, inside = np.outer(length[used], length[used]), np.ix_(used, used)
    covariance[inside] = inverse @ middle @ inverse / scale
    independent[inside] = inverse @ (scores.T @ scores) @ inverse / scale
    by_curvature = np.full(n, np.inf)
    by_curvature[used] = np.diag(inverse) / length[used] ** 2
    unseen = np.zeros((n, null.shape[1]))
    unseen[used] = null
    singular = np.linalg.svd(scaled.T @ scaled, compute_uv=False) ** 0.5
    idle = free & (length == 0)
    return Spread(
        covariance=covariance,
        independent=independent,
        by_curvature=by_curvature,
        length=np.where(used, length, 0.0),
        idle=idle,
        unseen=unseen,
        singular=singular,
    )


def _inverse(hessian: Array) -> tuple[Array, Array]:
    """The inverse of a matrix of unit scale where it has one, and the directions without."""
    values, vectors = np.linalg.eigh(hessian)
    seen = values > _FLAT * max(values.max(initial=0.0), 1e-300)
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    return inverse, vectors[:, ~seen]


def _over_blocks(scores: Array, blocks: NDArray[np.int64], counted: NDArray[np.bool_]) -> Array:
    """The covariance of the summed scores, if blocks are independent of each other."""
    summed = np.zeros((int(blocks.max()) + 1, scores.shape[1]))
    np.add.at(summed, blocks, scores)
    used = int(np.unique(blocks[counted]).size)
    # the fit has made the sums of scores smaller than they are elsewhere; few blocks bear no more
    left = max(used - scores.shape[1], used / 2, 1)
    return np.asarray(used / left * summed.T @ summed)


def _ratio(one: Array, other: Array) -> float:
    """The median ratio of two covariances' variances."""
    known = np.diag(other) > 0
    return float(np.median(np.diag(one)[known] / np.diag(other)[known])) if known.any() else 1.0


class Limit(NamedTuple):
    """One end of a number's 95 % interval: the numbers there, all others as good as they get."""

    theta: Array
    at_bound: bool


def limits(
    problem: Problem[Any], solution: Solution, place: int, share: float = 1.0
) -> tuple[Limit, Limit]:
    """Both ends of the interval of a number, by its profile: where the cost, with all others fitted
    anew, has risen by as much as 95 % of repetitions stay below. Near a bound, where errors are not
    symmetric, this holds and the standard error does not.

    share: of the pixels that the interval is wanted for, if these are fewer.
    """
    everything = spread(problem, solution, free=problem.free)
    variance = float(everything.covariance[place, place])
    # residuals that depend on each other make the cost rise too steeply
    ratio = variance / float(everything.by_curvature[place])
    rise = 0.5 * _CHI * share * max(ratio, 1e-12)
    step = math.sqrt(_CHI * share * variance)
    low, high = (limit[place] for limit in problem.limits)
    return (
        _limit(problem, solution, place, -step, low, rise),
        _limit(problem, solution, place, step, high, rise),
    )


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
