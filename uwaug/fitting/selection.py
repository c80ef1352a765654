"""Which model a picture supports: the fewest numbers that foretell left-out pixels as well."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import Array
from uwaug.fitting.least_squares import M, Objective, Solution, loss, solve

_FOLDS = 5
_CHANCE = 2.0  # of summed loss: what a number gains by chance
_STEPS = 6  # of a fit without a fold


@dataclass(frozen=True, eq=False)
class FittedModel(Generic[M]):
    """A candidate that was fitted.

    Attributes:
        objective, solution: what was fitted, and where it ended.
        losses: what each cluster adds to the loss, from numbers fitted without it.
        values: how many were counted.
    """

    objective: Objective[M]
    solution: Solution
    losses: Array
    values: int

    @staticmethod
    def of(objective: Objective[M], solution: Solution, seed: int) -> "FittedModel[M]":
        """A candidate with its held-out loss."""
        losses = cross_validate(objective, solution, seed)
        values = int((objective.pixels.weights > 0).sum())
        return FittedModel(objective, solution, losses, values)

    @property
    def model(self) -> M:
        """What was fitted."""
        return self.objective.model

    @property
    def name(self) -> str:
        """Of the candidate."""
        return self.model.name

    @property
    def theta(self) -> Array:
        """The numbers."""
        return self.solution.theta

    @property
    def numbers(self) -> dict[str, float]:
        """The numbers by name."""
        return dict(zip(self.objective.model.bounds, self.theta.tolist(), strict=True))

    @property
    def loss(self) -> float:
        """The summed held-out loss."""
        return float(self.losses.sum())

    @property
    def error(self) -> float:
        """Root of the mean held-out loss, in standard deviations of the noise."""
        return float(np.sqrt(self.losses.sum() / self.values))

    def delta_loss(self, other: "FittedModel[M] | FittedModel[Any]") -> tuple[float, float]:
        """By how much the loss exceeds that of another, and the standard error of that."""
        if self is other:
            return 0.0, 0.0
        difference = self.losses - other.losses
        used = difference[(self.losses > 0) | (other.losses > 0)]
        # clusters are independent of each other, their pixels are not
        return float(used.sum()), float(np.sqrt(used.size * used.var()))

    @cached_property
    def _residual(self) -> Tensor:
        """Model − observation in linear light; NaN where a value does not count."""
        pixels = self.objective.pixels
        residual = self.objective.render(self.theta) - pixels.observed
        return residual.masked_fill(pixels.weights == 0, torch.nan)

    @property
    def rms(self) -> float:
        """Of the residual, in linear light."""
        return float(self._residual.square().nanmean().sqrt())

    @property
    def explained(self) -> float:
        """The share of the variance of the observed pixels that the model explains."""
        pixels = self.objective.pixels
        variance = 0.0
        for channel in range(3):
            values = pixels.observed[:, channel][pixels.weights[:, channel] > 0]
            variance += float(((values - values.mean()) ** 2).sum()) if values.numel() else 0.0
        squares = float(self._residual.square().nansum())
        return 1 - squares / variance if variance > 0 else 0.0


def best_of(fitted: Sequence[FittedModel[M]]) -> FittedModel[M]:
    """The candidate of the least held-out loss."""
    return min(fitted, key=lambda candidate: candidate.loss)


def one_standard_error_rule(fitted: Sequence[FittedModel[M]]) -> FittedModel[M]:
    """Of all candidates whose held-out loss is within one standard error of the least, that of the
    fewest numbers. The error is that of the difference: what makes a cluster hard for all says
    nothing.
    """
    best = best_of(fitted)
    near = []
    for candidate in fitted:
        excess, error = candidate.delta_loss(best)
        if excess <= max(error, _CHANCE):
            near.append(candidate)
    return min(near, key=lambda candidate: (len(candidate.theta), candidate.loss))


def cross_validate(objective: Objective[M], solution: Solution, seed: int) -> Array:
    """The loss of each cluster, from numbers that were fitted without it.

    Every fit begins at the solution and takes a few steps. (One Gauss–Newton step is not enough
    where numbers are hardly identified: it leads astray, or, shortened, leaves numbers that have
    seen the clusters, and a model with a blur that is not there won in 3 of 3 pictures.)
    """
    pixels = objective.pixels
    of_value = pixels.of_values(pixels.clusters)
    count = int(pixels.clusters.max()) + 1
    fold = np.random.default_rng(seed).permutation(count) % _FOLDS
    losses = np.zeros(count)
    for k in range(_FOLDS):
        outside = torch.from_numpy(fold[pixels.clusters] != k)[:, None, None]
        part = replace(objective, pixels=pixels.weighed(pixels.weights * outside))
        theta = solve(part, solution.theta, most=_STEPS).theta
        inside = fold[of_value] == k
        residual = objective.residual(theta)[inside]
        np.add.at(losses, of_value[inside], loss(residual))
    return losses
