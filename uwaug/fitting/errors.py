"""How sure a fit is: the spread of its numbers over other pictures of the same kind; and the one
place, `parameter`, where a number is reported or is "not identified".
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uwaug._support.types import Array
from uwaug.fitting.least_squares import M, Objective, Solution, influence, solve
from uwaug.fitting.models import Quantity
from uwaug.fitting.results import Parameter

NORMAL = 1.96  # standard errors to either end of a 95 % interval
# Of a number at either end of its interval: where its standard error is larger, and larger than
# what shows in a picture, the number is not identified.
#
# Measured by the ends, which asks of a symmetric number for an error below a quarter of it. Of 672
# numbers of 76 random waters that pass so, one was more than half off, by less than shows. Of 37
# more that pass if the number itself is the measure, 14 were, and of 55 that do not pass either
# way, 26; among the 37 were veils off by a factor of 10⁷.
_VAGUE = 0.5
# Standard errors from a bound, within which an interval is taken from the profile.
_NEAR_BOUND = 3.0
# Standard errors as a share of a number, from which its interval is taken from the profile.
_ASYMMETRIC = 0.08
_PROFILED = 5000  # pixels that profiles are made with; all of them would take most of a fit's time
_CHI2 = 3.841  # χ² of one degree of freedom that 95 % stay below
_TRIES = 6  # fits in search of one end of an interval
_STEPS = 15  # evaluations of each, which begins where the last one ended
_NEAR_ENOUGH = 0.1  # of an interval's half width
# Ratio of variances, from which other clusters count beside blocks. A compromise: 4 widens what has
# no faults, of 8 only 89 % of the numbers below hold.
_LARGER = 5.0
_FLAT = 1e-9  # of the largest eigenvalue of a matrix of unit scale: what is less is not seen
_UNMOVED = 1e-4  # of what a quantity could move along a direction that is not seen


@dataclass(frozen=True, eq=False)
class ClusterCovariance:
    """Of the numbers that are fitted, over clusters of pixels.

    Attributes:
        matrix: rows and columns of numbers at a bound are 0.
        independent: the same if all residuals were independent.
        by_curvature: variances if the cost were a logarithm of likelihood, the diagonal of
            H⁻¹; infinite of numbers that do nothing, or are not free.
        length: of the Jacobian's columns; 0 if a number does nothing, or is not free.
        idle: which numbers do nothing at all.
        null_space (numbers x directions): changes of numbers times length that do not show at all.
        singular: singular values of the Jacobian, whose columns are scaled to one length: the
            smallest says how nearly two numbers do the same.
    """

    matrix: Array
    independent: Array
    by_curvature: Array
    length: Array
    idle: NDArray[np.bool_]
    null_space: Array
    singular: Array

    def identifies(self, slope: Array) -> bool:
        """Whether the pictures show a quantity of these slopes."""
        scaled = np.divide(slope, self.length, out=np.zeros_like(slope), where=self.length > 0)
        moved = np.abs(scaled @ self.null_space)
        still = bool((moved <= _UNMOVED * np.linalg.norm(scaled)).all())
        return still and not self.idle[slope != 0].any()

    @property
    def design_effect(self) -> float:
        """By how much errors are larger than if residuals were independent."""
        return math.sqrt(_ratio(self.matrix, self.independent))


def cluster_covariance(
    objective: Objective[M], solution: Solution, free: Array | None = None
) -> ClusterCovariance:
    """The sandwich H⁻¹·S·H⁻¹: H from the slopes, S from the scores of clusters of pixels, whose
    residuals may depend on each other, as a wrong model's do: neighbours, like distances, like
    brightness. Each direction of θ has the largest error of all kinds of clusters.

    (Of 225 numbers of 25 pictures that a camera or a file had changed, 95 % hold the truth or are
    not identified, in a trial, 80 % without suspected faults. With the largest error of
    each number in place of each direction, 94 %, but G becomes uncertain where β and G/β are; with
    one factor for all numbers, 93 %; with blocks of three sizes alone, 84 %.)

    Args:
        objective, solution: what was fitted, and where it ended.
        free: the numbers that are not taken for known; by default those inside their bounds.

    Source: White 1982; over clusters, Liang and Zeger 1986.
    """
    free = objective.free & (solution.at_bound == 0) if free is None else free
    score, curvature = influence(solution.residual)
    length = np.sqrt((solution.jacobian**2).sum(0))
    used = free & (length > 0)
    scaled = solution.jacobian[:, used] / length[used]
    values, vectors = np.linalg.eigh(scaled.T @ (curvature[:, None] * scaled))
    seen = values > _FLAT * max(values.max(initial=0.0), 1e-300)
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    scores = scaled * score[:, None]
    counted = solution.residual != 0
    pixels = objective.pixels
    middle = _over_clusters(scores, pixels.of_values(pixels.clusters), counted)
    covariance = inverse @ middle @ inverse
    for others in pixels.others:
        other = inverse @ _over_clusters(scores, pixels.of_values(others), counted) @ inverse
        covariance = _joined(covariance, other)
    n = len(free)
    matrix, independent = np.zeros((n, n)), np.zeros((n, n))
    scale, inside = np.outer(length[used], length[used]), np.ix_(used, used)
    matrix[inside] = covariance / scale
    independent[inside] = inverse @ (scores.T @ scores) @ inverse / scale
    by_curvature = np.full(n, np.inf)
    by_curvature[used] = np.diag(inverse) / length[used] ** 2
    null_space = np.zeros((n, int((~seen).sum())))
    null_space[used] = vectors[:, ~seen]
    return ClusterCovariance(
        matrix=matrix,
        independent=independent,
        by_curvature=by_curvature,
        length=np.where(used, length, 0.0),
        idle=free & (length == 0),
        null_space=null_space,
        singular=np.linalg.svd(scaled.T @ scaled, compute_uv=False) ** 0.5,
    )


def _joined(covariance: Array, other: Array) -> Array:
    """A covariance that is as large as another in all directions where that is much larger: few
    clusters make a rough estimate, which counts where it says something else.
    """
    values, vectors = np.linalg.eigh(covariance)
    root = np.sqrt(np.maximum(values, _FLAT * values.max(initial=0.0)).clip(min=1e-300))
    whitened = (vectors / root).T @ other @ (vectors / root)
    ratios, directions = np.linalg.eigh(whitened)
    larger = ratios > _LARGER
    wider = (vectors * root) @ directions[:, larger]
    return np.asarray(covariance + (wider * (ratios[larger] - 1)) @ wider.T)


def _over_clusters(scores: Array, clusters: NDArray[np.int64], counted: NDArray[np.bool_]) -> Array:
    """The covariance of the summed scores, if clusters are independent of each other."""
    summed = np.zeros((int(clusters.max()) + 1, scores.shape[1]))
    np.add.at(summed, clusters, scores)
    used = int(np.unique(clusters[counted]).size)
    # the fit has made the sums of scores smaller than they are elsewhere; few clusters bear no more
    freedom = max(used - scores.shape[1], used / 2, 1)
    return np.asarray(used / freedom * summed.T @ summed)


def _ratio(matrix: Array, other: Array) -> float:
    """The median ratio of two covariances' variances."""
    positive = np.diag(other) > 0
    ratios = np.diag(matrix)[positive] / np.diag(other)[positive]
    return float(np.median(ratios)) if ratios.size else 1.0


def parameters(
    objective: Objective[M],
    solution: Solution,
    covariance: ClusterCovariance,
    more: Array | None = None,
) -> dict[str, Parameter]:
    """Every quantity that is reported, by the delta method; by profiles where errors are not
    symmetric.

    Args:
        objective, solution: what was fitted, and where it ended.
        covariance: there, over clusters.
        more: the covariance of what is no scatter of pixels.
    """
    model, theta = objective.model, solution.theta
    more = np.zeros_like(covariance.matrix) if more is None else more
    profiles = _profiles(objective, solution, covariance)
    at_bound = {name for name, end in zip(model.bounds, solution.at_bound, strict=True) if end}
    rows = {}
    slopes = model.report_jacobian(theta)
    everything = covariance.matrix + more
    for q, (quantity, value) in enumerate(zip(model.quantities, model.report(theta), strict=True)):
        slope = slopes[q]
        if not slope.any():
            rows[quantity.name] = Parameter(float(value), None, None, None, quantity.unit, "fixed")
            continue
        rows[quantity.name] = parameter(
            quantity,
            value,
            error=math.sqrt(max(float(slope @ everything @ slope), 0.0)),
            profile=_widened(
                value,
                [model.report(end)[q] for i in profiles if slope[i] for end in profiles[i]],
                NORMAL * math.sqrt(max(float(slope @ more @ slope), 0.0)),
            ),
            shows=covariance.identifies(slope),
            at_bound=not at_bound.isdisjoint(quantity.follows),
        )
    return rows


def parameter(
    quantity: Quantity,
    value: float,
    error: float,
    profile: Sequence[float] = (),
    *,
    shows: bool = True,
    at_bound: bool = False,
) -> Parameter:
    """A number, if the pictures tell it: the one place where that is decided.

    It is not identified in two cases: it does not show in the pictures at all; or its standard
    error is larger than half of the number at either end of its interval, and larger than what
    shows in a picture.

    Args:
        quantity: what it is.
        value, error: the number and its standard error.
        profile: its values at the ends of profiles, which take the place of the normal interval.
        shows: whether a change of it shows in the pictures: nothing else makes up for it.
        at_bound: whether it is at the end of what it may be.
    """
    value = float(value)
    low, high = value - NORMAL * error, value + NORMAL * error
    if len(profile):
        low, high = float(min(value, *profile)), float(max(value, *profile))
    if not quantity.signed:
        low = max(low, min(value, 0.0))
    half = (high - low) / (2 * NORMAL)
    least = min(abs(value), abs(low), abs(high))
    if not (shows and half <= max(quantity.resolution, _VAGUE * least)):
        return Parameter(None, None, None, None, quantity.unit, "not identified")
    if at_bound:
        return Parameter(value, None, low, high, quantity.unit, "at bound")
    error = max(error, half) if len(profile) else error
    return Parameter(value, error, low, high, quantity.unit, "free")


def _widened(value: float, ends: Sequence[float], more: float) -> list[float]:
    """The ends of an interval whose half widths grow by `more`, in squares."""
    if not ends:
        return []
    half = [math.hypot(end - value, more) for end in ends]
    wider = [value + math.copysign(x, end - value) for x, end in zip(half, ends, strict=True)]
    return [value - more, *wider, value + more]


def _profiles(
    objective: Objective[M], solution: Solution, covariance: ClusterCovariance
) -> dict[int, tuple[Array, Array]]:
    """θ at both ends of the intervals of numbers at a bound or near one, by place."""
    low, high = objective.bounds
    theta, error = solution.theta, np.sqrt(np.diag(covariance.matrix))
    logarithm = [bound.log for bound in objective.model.bounds.values()]
    size = np.where(logarithm, 1.0, abs(theta))
    away = np.minimum(theta - low, high - theta)
    # where errors are large, they are not symmetric either
    near = (solution.at_bound != 0) | (away < _NEAR_BOUND * error) | (error > _ASYMMETRIC * size)
    identified = [covariance.identifies(unit) for unit in np.eye(len(theta))]
    places = np.flatnonzero(objective.free & near & identified)
    if not places.size:
        return {}
    few = replace(objective, pixels=objective.pixels.subsample(_PROFILED, 0))
    share = few.pixels.z.numel() / objective.pixels.z.numel()
    middle = solve(few, theta) if share < 1 else solution
    everything = cluster_covariance(few, middle, free=few.free)
    profiles = {}
    for i in places.tolist():
        left, right = profile_interval(few, middle, everything, i, share)
        moved = theta - middle.theta
        profiles[i] = (np.clip(left + moved, low, high), np.clip(right + moved, low, high))
    return profiles


def profile_interval(
    objective: Objective[M],
    solution: Solution,
    everything: ClusterCovariance,
    place: int,
    share: float = 1.0,
) -> tuple[Array, Array]:
    """θ at both ends of the interval of a number, by its profile: where the cost, with all others
    fitted anew, has risen by as much as 95 % of repetitions stay below. Near a bound, where errors
    are not symmetric, this holds and the standard error does not.

    Args:
        objective, solution: what was fitted, and where it ended.
        everything: the covariance there, of all numbers that are not held.
        place: of the number in θ.
        share: of the pixels that the interval is wanted for, if these are fewer.
    """
    variance = float(everything.matrix[place, place])
    # residuals that depend on each other make the cost rise too steeply
    ratio = variance / float(everything.by_curvature[place])
    rise = 0.5 * _CHI2 * share * max(ratio, 1e-12)
    step = math.sqrt(_CHI2 * share * variance)
    low, high = (limit[place] for limit in objective.bounds)
    return (
        _profile_end(objective, solution, place, -step, low, rise),
        _profile_end(objective, solution, place, step, high, rise),
    )


def _profile_end(
    objective: Objective[M], solution: Solution, place: int, step: float, bound: float, rise: float
) -> Array:
    """Search from the solution outwards: the root of the risen cost is nearly a straight line."""
    here, theta = float(solution.theta[place]), solution.theta
    furthest = bound - here
    if abs(furthest) <= 1e-9 * max(1.0, abs(bound)):
        return theta
    low, high = 0.0, math.inf
    for _ in range(_TRIES):
        reach = step if abs(step) < abs(furthest) else furthest
        held = replace(objective, held={**objective.held, place: here + reach})
        end = solve(held, theta, most=_STEPS)
        theta = end.theta
        root = math.sqrt(max(end.cost - solution.cost, 0.0) / rise)
        if (reach == furthest and root <= 1) or abs(root - 1) < _NEAR_ENOUGH:
            break
        low, high = (max(low, abs(reach)), high) if root < 1 else (low, min(high, abs(reach)))
        target = abs(reach) / max(root, 0.1)
        if not low < target < high:
            target = 2 * low if high == math.inf else 0.5 * (low + high)
        step = math.copysign(target, furthest)
    return theta
