"""Nonlinear least squares on pixels: where a fit begins, how it proceeds, where it ends."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import Array
from uwaug.fitting.model import KINDS, Natural, rendered, slopes
from uwaug.fitting.pixels import Pixels
from uwaug.fitting.structure import Structure

__all__ = ["ROBUST", "Problem", "S", "Solution", "influence", "loss", "scouted", "solve", "stacked"]

S = TypeVar("S", bound=Structure)

ROBUST = 2.0
"""Standard deviations of noise, from where on a residual counts less than its square."""

_INSIDE = 1e-4
"""Of a number's range: a fit begins at least so far from its bounds."""

_FURTHEST = 16.0
"""Logarithm of the odds; e^−16 of a number's range is its end."""

_AT = 1e-6
"""Of a number's range: nearer to its end, it is there."""

_ENOUGH = 1e-7
"""Relative change of cost or numbers at which a fit ends."""


@dataclass(frozen=True, eq=False)
class Problem(Generic[S]):
    """A structure and the pixels that it is to explain.

    Attributes:
        structure: what is fitted.
        pixels: what it is fitted to.
        robust: whether large residuals count less than their squares.
        held: the value of each number that stays as it is, by its place.
    """

    structure: S
    pixels: Pixels
    robust: bool = True
    held: Mapping[int, float] = field(default_factory=dict)

    @property
    def limits(self) -> tuple[Array, Array]:
        """Least and largest value of each number."""
        bounds = self.structure.bounds.values()
        return np.array([one.low for one in bounds]), np.array([one.high for one in bounds])

    @property
    def free(self) -> Array:
        """Which numbers are not held."""
        return np.array([i not in self.held for i in range(len(self.structure.bounds))])

    def model(self, theta: Array) -> Tensor:
        """The pixels (Px3x1xN) in linear light."""
        natural = self.structure.natural(torch.from_numpy(theta))
        return rendered(natural, self.pixels, self.structure.shape)

    def residual(self, theta: Array) -> Array:
        """Model − observation in standard deviations of the noise (P·3·N)."""
        return self._weighed(self.model(theta)).numpy()

    def _weighed(self, model: Tensor) -> Tensor:
        return (self.pixels.weights * (model - self.pixels.observed)).flatten()

    def linearised(self, theta: Array) -> tuple[Array, Array]:
        """The residual and its Jacobian (P·3·N × numbers)."""
        numbers = torch.from_numpy(theta)
        structure, pixels = self.structure, self.pixels
        model, by_kind = slopes(structure.natural(numbers), pixels, structure.shape)
        kinds: Tensor = torch.func.jacrev(self._kinds)(numbers)  # 6xPx3xn
        by_kind = by_kind * pixels.weights
        jacobian = torch.einsum("kpciN,kpcn->pciNn", by_kind, kinds)
        return self._weighed(model).numpy(), jacobian.reshape(-1, len(theta)).numpy()

    def _kinds(self, theta: Tensor) -> Tensor:
        """What the pixels of each pair depend on (6xPx3)."""
        return stacked(self.structure.natural(theta))


def stacked(natural: Natural) -> Tensor:
    """The numbers of `KINDS` for each pair and colour (6xPx3)."""
    like, rows = natural.beta, []
    for name in KINDS:
        value = getattr(natural, name)
        if value is None:
            value = torch.zeros_like(like)
        rows.append(value if value.ndim == 2 else value[:, None].expand_as(like))
    return torch.stack(rows)


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a fit ended.

    Attributes:
        theta: the numbers.
        cost: half of the summed loss.
        at_bound: −1 or 1 where a number is at its least or largest value, else 0.
        residual, jacobian: there.
        history: the cost after each evaluation.
        converged: whether it ended because nothing changed any more.
    """

    theta: Array
    cost: float
    at_bound: Array
    residual: Array
    jacobian: Array
    history: list[float] = field(default_factory=list)
    converged: bool = True


def scouted(problem: Problem[Any], start: Array, most: int = 40) -> Array:
    """Numbers near the least cost, from a start that may be far.

    Each number goes by the logarithm of its distances from its bounds, so that steps are shares of
    it. (Without, one start in twelve lets a rate overshoot to where its light is gone, and nothing
    calls it back: 22 of 276 starts up to e^±1 away, against none of 35 in seven such waters.)
    """
    from scipy.optimize import least_squares

    low, high = problem.limits
    span = high - low
    # at an end itself, its slope would be lost
    inside = np.clip((start - low) / span, _INSIDE, 0.9)

    def numbers(u: Array) -> Array:
        return np.asarray(low + span / (1 + np.exp(-u)))

    def jacobian(u: Array) -> Array:
        share = 1 / (1 + np.exp(-u))
        return problem.linearised(numbers(u))[1] * (span * share * (1 - share))

    found = least_squares(
        lambda u: problem.residual(numbers(u)),
        np.clip(np.log(inside / (1 - inside)), -_FURTHEST, _FURTHEST),
        jacobian,
        bounds=(-_FURTHEST - 1, _FURTHEST + 1),
        loss="soft_l1" if problem.robust else "linear",
        f_scale=ROBUST,
        max_nfev=most,
        ftol=1e-5,
        xtol=1e-5,
        gtol=1e-5,
    )
    return numbers(found.x)


def solve(problem: Problem[Any], start: Array, most: int = 60) -> Solution:
    """The least cost that can be reached from `start`, inside the bounds. Plain bounds, not
    logarithms: a number at its bound is seen to be there.
    """
    from scipy.optimize import least_squares

    free = problem.free
    low, high = (limit[free] for limit in problem.limits)
    margin = _INSIDE * (high - low)
    whole = np.array(start, dtype=float)
    for place, value in problem.held.items():
        whole[place] = value
    history: list[float] = []
    kept: dict[bytes, tuple[Array, Array]] = {}

    def at(numbers: Array) -> Array:
        theta = whole.copy()
        theta[free] = numbers
        return theta

    def residual(numbers: Array) -> Array:
        found = problem.residual(at(numbers))
        history.append(float(loss(found, problem.robust).sum() / 2))
        return found

    def jacobian(numbers: Array) -> Array:
        kept.clear()
        kept[numbers.tobytes()] = problem.linearised(at(numbers))
        return kept[numbers.tobytes()][1][:, free]

    found = least_squares(
        residual,
        np.clip(whole[free], low + margin, high - margin),
        jacobian,
        bounds=(low, high),
        x_scale="jac",
        loss="soft_l1" if problem.robust else "linear",
        f_scale=ROBUST,
        max_nfev=most,
        ftol=_ENOUGH,
        xtol=_ENOUGH,
        gtol=_ENOUGH,
    )
    # the method stays inside, if only just
    reached = found.active_mask
    reached = np.where(found.x - low < _AT * (high - low), -1, reached)
    reached = np.where(high - found.x < _AT * (high - low), 1, reached)
    numbers = np.select([reached < 0, reached > 0], [low, high], found.x)
    if numbers.tobytes() not in kept:
        jacobian(numbers)
    values, derivative = kept[numbers.tobytes()]
    at_bound = np.zeros(len(whole), dtype=int)
    at_bound[free] = reached
    return Solution(
        theta=at(numbers),
        cost=float(loss(values, problem.robust).sum() / 2),
        at_bound=at_bound,
        residual=values,
        jacobian=derivative,
        history=history,
        converged=found.status > 0,
    )


def loss(residual: Array, robust: bool) -> Array:
    """What each residual adds to twice the cost: its square, or less."""
    if not robust:
        return np.asarray(residual**2)
    return np.asarray(2 * ROBUST**2 * (np.sqrt(1 + (residual / ROBUST) ** 2) - 1))


def influence(residual: Array, robust: bool) -> tuple[Array, Array]:
    """The first two derivatives of half the loss."""
    if not robust:
        return residual, np.ones_like(residual)
    root = np.sqrt(1 + (residual / ROBUST) ** 2)
    return residual / root, 1 / root**3
