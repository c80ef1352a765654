"""Which model a picture supports: the fewest numbers that foretell left-out pixels as well."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic

import numpy as np
import torch

from uwaug._support.types import Array
from uwaug.fitting.data import Pictures
from uwaug.fitting.errors import covariance_of, parameters, remainder
from uwaug.fitting.result import Candidate, Fit, left_over, unknown
from uwaug.fitting.solve import M, Objective, Solution, loss, solve
from uwaug.optics.medium import Medium

_FOLDS = 5
_CHANCE = 2.0  # of summed loss: what a number gains by chance
_STEPS = 6  # of a fit without a fold


@dataclass(frozen=True, eq=False)
class FittedModel(Generic[M]):
    """A candidate that was fitted.

    Attributes:
        objective, solution: what was fitted, and where it ended.
        losses: what each block of the picture adds to the loss.
    """

    objective: Objective[M]
    solution: Solution
    losses: Array

    @property
    def model(self) -> M:
        """What was fitted."""
        return self.objective.model

    @property
    def numbers(self) -> dict[str, float]:
        """θ by name."""
        return dict(zip(self.model.bounds, self.solution.theta.tolist(), strict=True))

    @property
    def loss(self) -> float:
        """The summed loss."""
        return float(self.losses.sum())

    def behind(self, other: "FittedModel[M]") -> tuple[float, float]:
        """By how much the loss exceeds that of another, and the standard error of that."""
        # blocks are independent of each other, their pixels are not
        difference = (self.losses - other.losses)[(self.losses > 0) | (other.losses > 0)]
        return float(difference.sum()), float(np.sqrt(difference.size * difference.var()))

    @cached_property
    def rms(self) -> float:
        """Of the residual, in linear light."""
        pixels = self.objective.pixels
        residual = self.model.render(self.solution.theta, pixels) - pixels.observed
        return float(residual[pixels.weights > 0].square().mean().sqrt())

    @property
    def explained(self) -> float:
        """The share of the variance of the observed pixels that the model explains."""
        pixels, variance, count = self.objective.pixels, 0.0, 0
        for light, weight in zip(pixels.observed[0], pixels.weights[0], strict=True):
            values = light[weight > 0]
            if values.numel():
                variance += float((values - values.mean()).square().sum())
                count += values.numel()
        return 1 - self.rms**2 * count / variance if variance > 0 else 0.0


def result_of(
    chosen: FittedModel[M],
    tried: Sequence[FittedModel[M]],
    name: str,
    medium: Medium,
    pictures: Pictures,
) -> Fit:
    """The fit: numbers and errors of the chosen candidate, and the notes that all fits share."""
    objective, solution = chosen.objective, chosen.solution
    covariance = covariance_of(objective, solution)
    numbers, matrix = parameters(chosen.model, solution, covariance)
    left, best, rows = remainder(objective, solution.theta), best_of(tried), []
    for x in tried:
        counted = int((x.objective.pixels.weights > 0).sum())
        error = float(np.sqrt(x.loss / max(counted, 1)))
        about = (x.model.name, len(x.solution.theta), error, *x.behind(best), x is chosen)
        rows.append(Candidate(*about, x.model.shown(x.solution.theta)))
    return Fit(
        model=name,
        parameters=numbers,
        covariance=matrix,
        medium=medium,
        geometry=pictures.geometry,
        rms=chosen.rms,
        notes=(*left_over(left, covariance.design_effect, chosen.rms), *unknown(numbers)),
        candidates=tuple(rows),
        remainder=tuple(left),
        color_space=pictures.color_space,
        pictures=pictures,
    )


def best_of(fitted: Sequence[FittedModel[M]]) -> FittedModel[M]:
    """The candidate of the least loss."""
    return min(fitted, key=lambda candidate: candidate.loss)


def one_standard_error_rule(fitted: Sequence[FittedModel[M]]) -> FittedModel[M]:
    """Of all candidates whose held-out loss is within one standard error of the least, that of the
    fewest numbers. The error is that of the difference: what makes a block hard for all says
    nothing.

    Source: Breiman et al. 1984.
    """
    best = best_of(fitted)
    near = []
    for candidate in fitted:
        excess, error = candidate.behind(best)
        if excess <= max(error, _CHANCE):
            near.append(candidate)
    return min(near, key=lambda candidate: (len(candidate.solution.theta), candidate.loss))


def block_losses(objective: Objective[M], theta: Array) -> Array:
    """What each block of the picture adds to the loss."""
    blocks = objective.pixels.blocks_of_values
    losses: Array = np.bincount(blocks, weights=loss(objective.residual(theta))).astype(float)
    return losses


def cross_validated(objective: Objective[M], solution: Solution, seed: int) -> FittedModel[M]:
    """A candidate with its held-out loss: of each block, from numbers fitted without it.

    Every fit begins at the solution and takes a few steps. (One Gauss–Newton step is not enough
    where numbers are hardly identified: it leads astray, or, shortened, leaves numbers that have
    seen the blocks, and a model with a blur that is not there won in 3 of 3 pictures.)
    """
    pixels = objective.pixels
    count = int(pixels.blocks.max()) + 1
    fold = np.random.default_rng(seed).permutation(count) % _FOLDS
    losses = np.zeros(count)
    for k in range(_FOLDS):
        outside = torch.from_numpy(fold[pixels.blocks] != k)
        kept = replace(pixels, weights=pixels.weights * outside)
        part = replace(objective, pixels=kept)
        theta = solve(part, solution.theta, most=_STEPS).theta
        losses += np.where(fold == k, block_losses(objective, theta), 0.0)
    return FittedModel(objective, solution, losses)
