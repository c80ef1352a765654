"""Choice of the model that a picture supports."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np
import torch

from uwaug._support.types import Array
from uwaug.fitting.data import Pictures
from uwaug.fitting.errors import covariance_of, fit_of, left_over
from uwaug.fitting.result import Candidate, Fit
from uwaug.fitting.solve import M, Objective, Solution, loss, solve
from uwaug.formation.setting import Setting

_FOLDS = 5
_CHANCE_LOSS = 2.0  # summed loss that a number gains by chance
_FOLD_STEPS = 6  # largest number of steps of a fit without a fold


@dataclass(frozen=True, eq=False)
class FittedModel(Generic[M]):
    objective: Objective[M]
    solution: Solution
    losses: Array  # summed loss of each block of the picture

    @property
    def model(self) -> M:
        return self.objective.model

    @property
    def numbers(self) -> dict[str, float]:
        return dict(zip(self.model.bounds, self.solution.theta.tolist(), strict=True))

    @property
    def loss(self) -> float:
        return float(self.losses.sum())

    def behind(self, other: "FittedModel[M]") -> tuple[float, float]:
        """Excess of the loss over that of another candidate, and the standard error of it."""
        # blocks are independent of each other, their pixels are not
        difference = (self.losses - other.losses)[(self.losses > 0) | (other.losses > 0)]
        mean = difference.sum() / max(difference.size, 1)
        return float(difference.sum()), float(np.linalg.norm(difference - mean))


def result_of(
    winner: FittedModel[M],
    candidates: Sequence[FittedModel[M]],
    setting: Setting,
    pictures: Pictures,
) -> Fit:
    """The result of pictures, and of what was tried."""
    lost, best, rows = [], best_of(candidates), []
    if pictures.jpeg is not None:
        # the fit may take what the file has lost for a blur: with and without one
        sharp = replace(setting, medium=replace(setting.medium, scale=0 * setting.medium.scale))
        lost = [pictures.lost(pictures.rendered(x), pictures.jpeg) for x in (setting, sharp)]
    covariance = covariance_of(winner.objective, winner.solution, lost)
    fit = fit_of(winner.objective, winner.solution, covariance, setting, pictures.geometry)
    doubts = left_over(fit.remainder, covariance.design_effect, fit.rms)
    for x in candidates:
        count = int((x.objective.pixels.weights > 0).sum())
        error = float(np.sqrt(x.loss / max(count, 1)))
        numbers_of = len(x.solution.theta), error, *x.behind(best), x is winner
        rows.append(Candidate(x.model.name, *numbers_of))
    return replace(
        fit,
        notes=(*doubts, *fit.notes),
        candidates=tuple(rows),
        adequate=not doubts,
        pictures=pictures,
    )


def best_of(candidates: Sequence[FittedModel[M]]) -> FittedModel[M]:
    return min(candidates, key=lambda candidate: candidate.loss)


def one_standard_error_rule(candidates: Sequence[FittedModel[M]]) -> FittedModel[M]:
    """The candidate with the fewest numbers, of those whose held-out loss is within one standard
    error, of the difference, of the least (Breiman et al. 1984).
    """
    excesses = [x.behind(best_of(candidates)) for x in candidates]
    pairs = zip(candidates, excesses, strict=True)
    equals = [x for x, (excess, error) in pairs if excess <= max(error, _CHANCE_LOSS)]
    return min(equals, key=lambda candidate: (len(candidate.solution.theta), candidate.loss))


def block_losses(objective: Objective[M], theta: Array) -> Array:
    losses = loss(objective.residual(theta))
    return np.asarray(np.bincount(objective.pixels.blocks_of_values, weights=losses), dtype=float)


def cross_validated(objective: Objective[M], solution: Solution, seed: int) -> FittedModel[M]:
    """A candidate with its held-out loss: that of each block under numbers fitted without it."""
    # A single Gauss–Newton step from the solution is not enough where numbers are hardly
    # identified: a model with a blur that is not there then won in 3 of 3 pictures.
    pixels = objective.pixels
    count = int(pixels.blocks.max()) + 1
    fold = np.random.default_rng(seed).permutation(count) % _FOLDS
    losses = np.zeros(count)
    for k in range(_FOLDS):
        outside = torch.from_numpy(fold[pixels.blocks] != k)
        part = replace(objective, pixels=replace(pixels, weights=pixels.weights * outside))
        theta = solve(part, solution.theta, max_steps=_FOLD_STEPS).theta
        losses += np.where(fold == k, block_losses(objective, theta), 0.0)
    return FittedModel(objective, solution, losses)
