"""Nonlinear least squares on pixels: where a fit begins, how it proceeds, where it ends; and the
noise, which the residuals tell.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import Array
from uwaug.fitting.data import Pixels
from uwaug.fitting.model import COLOURS, MOST_GAIN, CoefficientModel, Model, picture_slopes

M = TypeVar("M", bound=Model)
ROBUST = 2.0  # standard deviations of noise, from where on a residual counts less than its square
_INSIDE = 1e-4  # of a number's range: a fit begins at least so far from its bounds
_MAX_LOGIT = 16.0  # logarithm of the odds; e^−16 of a number's range is its end
_AT_BOUND = 1e-6  # of a number's range: nearer to its end, it is there
_CONVERGED = 1e-7  # relative change of cost or numbers at which a fit ends
# Optical depths β·z at the reference distance, of the grid that a guess is taken from.
_OPTICAL_DEPTHS = np.geomspace(0.05, 12.0, 24)
_G_OVER_BETA = (0.1, 0.3, 0.6, 1.0)  # of the same grid
_START_PIXELS = 2000  # pixels that decide between starts
_START_SPREAD = 0.5  # of random starts: each number is multiplied by up to e^±_START_SPREAD
_ROUGH_NOISE = 0.01  # of linear light: the noise of a first fit
_MIN_NOISE = 1e-4  # of linear light; no camera is better
_LEVELS = 16  # of brightness, in each of which the spread of the residuals is looked at
_MAD = 1.4826  # standard deviations in a median absolute deviation of Gaussian noise
_UNCLIPPED = 3.0  # standard deviations of noise, by which a value lies above black and below white
_MAX_MARGIN = 0.1  # of linear light: a very noisy picture would have no pixels left
_OUTLYING = 6.0  # standard deviations of noise, from where on a residual does not count at all
_MIN_VALUES = 500  # values between noise and white, of all that are fitted
_ROUNDS = 2  # of learning the noise: a third changes no number by a tenth of its error


@dataclass(frozen=True, eq=False)
class Objective(Generic[M]):
    """A model and the pixels that it is to explain."""

    model: M
    pixels: Pixels

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest value of each number."""
        bounds = self.model.bounds.values()
        return np.array([bound.low for bound in bounds]), np.array([bound.high for bound in bounds])

    def residual(self, theta: Array) -> Array:
        """Model − observation in standard deviations of the noise (3·N)."""
        light = self.model.render(theta, self.pixels)
        return (self.pixels.weights * (light - self.pixels.observed)).flatten().numpy()

    def jacobian(self, theta: Array) -> Array:
        """Derivatives of the residual (3·N x numbers)."""
        weights = self.pixels.weights.flatten().numpy()
        return weights[:, None] * self.model.slopes(theta, self.pixels)


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a fit ended.

    Attributes:
        theta: the numbers.
        cost: half of the summed loss.
        at_bound: −1 or 1 where a number is at its least or largest value, else 0.
        converged: whether it ended because nothing changed any more.
    """

    theta: Array
    cost: float
    at_bound: Array
    converged: bool


def loss(residual: Array) -> Array:
    """What each residual adds to twice the cost: its square, or less where it is large."""
    return np.asarray(2 * ROBUST**2 * (np.sqrt(1 + (residual / ROBUST) ** 2) - 1))


def influence(residual: Array) -> tuple[Array, Array]:
    """The first two derivatives of half the loss."""
    root = np.sqrt(1 + (residual / ROBUST) ** 2)
    return residual / root, 1 / root**3


def solve(objective: Objective[M], start: Array, most: int = 60) -> Solution:
    """The least cost that can be reached from `start`, inside the bounds. Plain bounds, not
    logarithms: a number at its bound is seen to be there.
    """
    from scipy.optimize import least_squares

    low, high = objective.bounds
    margin = _INSIDE * (high - low)
    result = least_squares(
        objective.residual,
        np.clip(start, low + margin, high - margin),
        objective.jacobian,
        bounds=(low, high),
        x_scale="jac",
        loss="soft_l1",
        f_scale=ROBUST,
        max_nfev=most,
        ftol=_CONVERGED,
        xtol=_CONVERGED,
        gtol=_CONVERGED,
    )
    # the method stays inside, if only just
    reached = np.where(result.x - low < _AT_BOUND * (high - low), -1, result.active_mask)
    reached = np.where(high - result.x < _AT_BOUND * (high - low), 1, reached)
    theta = np.select([reached < 0, reached > 0], [low, high], result.x)
    cost = float(loss(objective.residual(theta)).sum() / 2)
    return Solution(theta, cost, reached, result.status > 0)


def logit_prefit(objective: Objective[M], start: Array, most: int = 40) -> Array:
    """Numbers near the least cost, from a start that may be far.

    Each number goes by the logarithm of its distances from its bounds, so that steps are shares of
    it: a rate that overshoots to where its light is gone is called back by nothing
    (benchmarks/CHOICES.md).
    """
    from scipy.optimize import least_squares

    low, high = objective.bounds
    span = high - low
    # at an end itself, its slope would be lost
    inside = np.clip((start - low) / span, _INSIDE, 0.9)

    def theta(logit: Array) -> Array:
        return np.asarray(low + span / (1 + np.exp(-logit)))

    def jacobian(logit: Array) -> Array:
        share = 1 / (1 + np.exp(-logit))
        return objective.jacobian(theta(logit)) * (span * share * (1 - share))

    result = least_squares(
        lambda logit: objective.residual(theta(logit)),
        np.clip(np.log(inside / (1 - inside)), -_MAX_LOGIT, _MAX_LOGIT),
        jacobian,
        bounds=(-_MAX_LOGIT - 1, _MAX_LOGIT + 1),
        loss="soft_l1",
        f_scale=ROBUST,
        max_nfev=most,
        ftol=1e-5,
        xtol=1e-5,
        gtol=1e-5,
    )
    return theta(result.x)


def multistart(
    objective: Objective[CoefficientModel],
    near: Sequence[Mapping[str, float]] = (),
    seed: int = 0,
) -> Solution:
    """The least cost from a guess, from what other fits have found (`near`: numbers of θ by name),
    and from a random place around the guess.

    Few pixels decide which, all of them where it ends. From there each colour is guessed once more,
    with the width law that was reached: a colour that was taken for opaque, a veil and no scene,
    has nothing to call it back (1 start in 9 ended so).
    """
    model, rng = objective.model, np.random.default_rng(seed)
    few = replace(objective, pixels=objective.pixels.subsample(_START_PIXELS, rng))
    first = guess(few)
    starts = [model.start({**first, **numbers}) for numbers in ({}, *near)]
    factor = np.exp(rng.uniform(-_START_SPREAD, _START_SPREAD, len(starts[0])))
    starts.append(np.clip(starts[0] * factor, *objective.bounds))
    ends = [solve(few, logit_prefit(few, theta), most=20) for theta in starts]
    nearest = min(ends, key=lambda end: end.cost)
    reached = dict(zip(model.bounds, nearest.theta.tolist(), strict=True))
    again = solve(few, model.start(guess(few, reached)), most=20)
    nearest = min(nearest, again, key=lambda end: end.cost)
    return solve(objective, nearest.theta)


def guess(
    objective: Objective[CoefficientModel], numbers: Mapping[str, float] | None = None
) -> dict[str, float]:
    """For each colour, the best of a grid of β and G/β, whose light and veil follow by linear least
    squares; the width law as in `numbers` of θ by name, or at its beginning.
    """
    model = objective.model
    values = {name: bound.begin for name, bound in model.bounds.items()} | dict(numbers or {})
    law = model.coefficients(np.array([values[name] for name in model.bounds]))
    pixels, reference = objective.pixels.subsample(_START_PIXELS // 2, 0), model.geometry.reference
    trials = []
    for share in _G_OVER_BETA if model.spec.own_veil else (1.0,):
        for beta in (_OPTICAL_DEPTHS / reference).tolist():
            ones = np.ones(3)
            c = law._replace(beta=beta * ones, G=share * beta * ones, source=0 * ones, light=ones)
            by = picture_slopes(c, pixels, model.spec.shape, reference)
            error, light, source = _light_and_source(
                by["light"], by["source"], pixels, gain=model.gain
            )
            trials.append((error, beta, share, light, source))
    for i, colour in enumerate(COLOURS):
        _, beta, share, light, source = min(trials, key=lambda row: float(row[0][i]))
        best = {"beta": beta, "share": share, "light": np.log(light[i]), "source": source[i]}
        values |= {f"{kind}_{colour}": float(value) for kind, value in best.items()}
    return values


def _light_and_source(
    scene: Tensor, growth: Tensor, pixels: Pixels, *, gain: bool
) -> tuple[Array, Array, Array]:
    """The squared error of each colour with the light and the source (3 each) that suit it best."""
    w = pixels.weights**2

    def product(a: Tensor, b: Tensor) -> Array:
        return (w * a * b).sum((0, 2, 3)).numpy()

    # the picture is linear in both
    ss, sg, gg = product(scene, scene), product(scene, growth), product(growth, growth)
    sy, gy = product(scene, pixels.observed), product(growth, pixels.observed)
    light = np.ones(3)
    if gain:
        light = (gg * sy - sg * gy) / np.maximum(ss * gg - sg**2, 1e-12 * ss * gg + 1e-300)
        light = light.clip(1 / MOST_GAIN, MOST_GAIN)
    source = ((gy - light * sg) / np.maximum(gg, 1e-300)).clip(min=0.0)
    fitted = torch.from_numpy(light).reshape(1, 3, 1, 1) * scene
    residual = fitted + torch.from_numpy(source).reshape(1, 3, 1, 1) * growth - pixels.observed
    return product(residual, residual), light, source


# ---- noise


def roughly_weighed(pixels: Pixels) -> Pixels:
    """The pixels with weights for a first fit."""
    return replace(pixels, weights=pixels.weights / _ROUGH_NOISE)


def reweighed(objective: Objective[M], theta: Array, clips: bool) -> tuple[Pixels, Array]:
    """Weigh pixels by a model's own light, with a noise that is learnt from its residuals.

    Args:
        objective: the model that explains the pixels best, which all candidates are then compared
            with, and roughly weighed pixels.
        theta: where it begins.
        clips: as of `Pictures`.

    Returns:
        The pixels with their weights, and where the model ended.

    Raises:
        ValueError: if too few values lie above the noise.
    """
    pixels = objective.pixels
    for _ in range(_ROUNDS):
        theta = solve(objective, theta).theta
        light = objective.model.render(theta, pixels)
        error = light - pixels.observed
        deviation = noise(error, light, objective.pixels.weights > 0)
        # one-sided outliers, such as particles, would pull the veil up for ever
        counted = error.abs() < _OUTLYING * deviation
        if clips:
            # by what the model says: leaving out dark observations alone would keep the noise
            # that brightens
            margin = (_UNCLIPPED * deviation).clamp(max=_MAX_MARGIN)
            counted &= (light > margin) & (light < 1 - margin) & (pixels.observed > 0)
        bright = int(counted.sum())
        if bright < _MIN_VALUES:
            few = f"only {bright} of {counted.numel()} values that are fitted lie above the noise"
            raise ValueError(
                f"observed: {few}, expected {_MIN_VALUES}: "
                "raise the exposure, or check distances, g and blur"
            )
        objective = replace(objective, pixels=replace(pixels, weights=counted / deviation))
    return objective.pixels, theta


def noise(error: Tensor, light: Tensor, used: Tensor) -> Tensor:
    """The standard deviation that residuals speak of, (read² + shot·light)^½, of each value.

    Args:
        error: model − observation, in linear light.
        light: the model's values, of the same shape.
        used: which of them count, of the same shape.
    """
    from scipy.optimize import nnls

    errors, levels = error[used].numpy(), light[used].numpy()
    rows = []
    for part in np.array_split(np.argsort(levels), _LEVELS):
        if len(part) > 1:
            spread = _MAD * float(np.median(np.abs(errors[part] - np.median(errors[part]))))
            rows.append((max(float(levels[part].mean()), 0.0), max(spread, _MIN_NOISE) ** 2))
    level, variance = np.array(rows).T
    # each variance counts by its own size
    system = np.stack([np.ones_like(level), level], 1) / variance[:, None]
    (read, shot), _ = nnls(system, np.ones_like(level))
    deviation: Tensor = (read + shot * light.clamp(min=0.0)).clamp(min=_MIN_NOISE**2).sqrt()
    return deviation
