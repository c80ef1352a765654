"""Which model a picture supports: the fewest numbers that foretell left-out pixels as well."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic

import numpy as np
import torch

from uwaug._support.types import Array
from uwaug.fitting.solve import Problem, S, Solution, loss, solve

__all__ = ["Tried", "best_of", "choose", "held_out", "tried_of"]

_FOLDS = 5

_CHANCE = 2.0
"""Of summed loss: what a number gains by chance."""

_STEPS = 6
"""Of a fit without a fold."""


@dataclass(frozen=True, eq=False)
class Tried(Generic[S]):
    """A candidate that was fitted.

    Attributes:
        problem, solution: what was fitted, and where it ended.
        losses: what each block adds to the loss, from numbers fitted without it.
        pixels: how many values were counted.
    """

    problem: Problem[S]
    solution: Solution
    losses: Array
    pixels: int

    @property
    def structure(self) -> S:
        """What was fitted."""
        return self.problem.structure

    @property
    def name(self) -> str:
        """Of the candidate."""
        return self.structure.name

    @property
    def loss(self) -> float:
        """The summed held-out loss."""
        return float(self.losses.sum())

    @property
    def error(self) -> float:
        """Root of the mean held-out loss, in standard deviations of the noise."""
        return float(np.sqrt(self.losses.sum() / self.pixels))

    def behind(self, other: "Tried[S]") -> tuple[float, float]:
        """By how much the loss exceeds that of another, and the standard error of that."""
        if self is other:
            return 0.0, 0.0
        difference = self.losses - other.losses
        used = difference[(self.losses > 0) | (other.losses > 0)]
        # blocks are independent of each other, their pixels are not
        return float(used.sum()), float(np.sqrt(used.size * used.var()))


def best_of(tried: Sequence[Tried[S]]) -> Tried[S]:
    """That of the least held-out loss."""
    return min(tried, key=lambda one: one.loss)


def choose(tried: Sequence[Tried[S]]) -> Tried[S]:
    """The one-standard-error rule: of all candidates whose held-out loss is within one standard
    error of the least, that of the fewest numbers. The error is that of the difference: what makes
    a block hard for all says nothing.
    """
    best = best_of(tried)
    near = []
    for one in tried:
        excess, error = one.behind(best)
        if excess <= max(error, _CHANCE):
            near.append(one)
    return min(near, key=lambda one: (len(one.solution.theta), one.loss))


def tried_of(problem: Problem[S], solution: Solution, seed: int) -> Tried[S]:
    """A candidate with its held-out loss."""
    losses = held_out(problem, solution, seed)
    return Tried(problem, solution, losses, int((problem.pixels.weights > 0).sum()))


def held_out(problem: Problem[Any], solution: Solution, seed: int) -> Array:
    """The loss of each block, from numbers that were fitted without it.

    Every fit begins at the solution and takes a few steps. (One Gauss–Newton step is not enough
    where numbers are hardly identified: it leads astray, or, shortened, leaves numbers that have
    seen the blocks, and a model with a blur that is not there won in 3 of 3 pictures.)
    """
    pixels = problem.pixels
    blocks = pixels.block_of_value
    count = int(pixels.blocks.max()) + 1
    fold = np.random.default_rng(seed).permutation(count) % _FOLDS
    losses = np.zeros(count)
    for k in range(_FOLDS):
        outside = torch.from_numpy(fold[pixels.blocks] != k)[:, None, None]
        part = replace(problem, pixels=pixels.weighed(pixels.weights * outside))
        theta = solve(part, solution.theta, most=_STEPS).theta
        inside = fold[blocks] == k
        residual = problem.residual(theta)[inside]
        np.add.at(losses, blocks[inside], loss(residual, problem.robust))
    return losses
