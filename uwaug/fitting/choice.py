"""Which model a picture supports: the fewest numbers that foretell pixels they were not fitted to as
well as any.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uwaug.fitting.solve import Problem, Solution, influence, loss
from uwaug.optics.spectra import Array

__all__ = ["Tried", "choose", "held_out"]

_FOLDS = 5

_HALVINGS = 6


@dataclass(frozen=True, eq=False)
class Tried:
    """A candidate that was fitted.

    Attributes:
        name: of its model.
        problem, solution: what was fitted, and where it ended.
        losses: what each block adds to the loss, from numbers fitted without it.
        pixels: how many values were counted.
    """

    name: str
    problem: Problem
    solution: Solution
    losses: Array
    pixels: int

    @property
    def error(self) -> float:
        """Root of the mean held-out loss, in standard deviations of the noise."""
        return float(np.sqrt(self.losses.sum() / self.pixels))

    def behind(self, other: "Tried") -> tuple[float, float]:
        """By how much the loss exceeds that of another, and the standard error of that."""
        if self is other:
            return 0.0, 0.0
        difference = self.losses - other.losses
        used = difference[(self.losses > 0) | (other.losses > 0)]
        # blocks are independent of each other, their pixels are not
        return float(used.sum()), float(np.sqrt(used.size * used.var()))


def choose(tried: Sequence[Tried]) -> Tried:
    """The one-standard-error rule: of all candidates whose held-out loss is within one standard
    error of the least, that of the fewest numbers. The error is that of the difference: what makes
    a block hard for all says nothing.
    """
    best = min(tried, key=lambda one: float(one.losses.sum()))
    near = []
    for one in tried:
        excess, error = one.behind(best)
        if excess <= error:
            near.append(one)
    return min(near, key=lambda one: (len(one.solution.theta), float(one.losses.sum())))


def held_out(problem: Problem, solution: Solution, seed: int) -> Array:
    """The loss of each block, from numbers that were fitted without it.

    One Gauss–Newton step from the solution, halved until it is no step for the worse, stands for
    each fit: so little changes that fits to the end choose the same.
    """
    blocks = problem.pixels.block_of_value
    count = int(blocks.max()) + 1
    fold = np.random.default_rng(seed).permutation(count) % _FOLDS
    free = problem.free & (solution.at_bound == 0)
    score, curvature = influence(solution.residual, problem.robust)
    length = np.maximum(np.sqrt((solution.jacobian[:, free] ** 2).sum(0)), 1e-300)
    scaled = solution.jacobian[:, free] / length
    low, high = problem.limits
    losses = np.zeros(count)
    for k in range(_FOLDS):
        inside = fold[blocks] == k
        outside = ~inside
        hessian = scaled[outside].T @ (curvature[outside, None] * scaled[outside])
        gradient = scaled[outside].T @ score[outside]
        step = np.zeros(len(free))
        step[free] = -np.linalg.pinv(hessian, rcond=1e-12, hermitian=True) @ gradient / length
        residual = _stepped(problem, solution, step, outside)
        np.add.at(losses, blocks[inside], loss(residual[inside], problem.robust))
    return losses


def _stepped(problem: Problem, solution: Solution, step: Array, outside: Array) -> Array:
    """The residual after a step that does not make those `outside` worse."""
    low, high = problem.limits
    before = loss(solution.residual[outside], problem.robust).sum()
    for _ in range(_HALVINGS):
        residual = problem.residual(np.clip(solution.theta + step, low, high))
        if loss(residual[outside], problem.robust).sum() <= before:
            return residual
        step = step / 2
    return solution.residual
