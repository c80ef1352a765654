"""Nonlinear least squares on pixels: starts, solutions, and the noise that residuals tell."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from uwaug._support.types import Array
from uwaug.fitting.data import Pixels
from uwaug.fitting.model import COLOURS, MAX_GAIN, CoefficientModel, Model

M = TypeVar("M", bound=Model)
ROBUST = 2.0  # standard deviations of noise, from where on a residual counts less than its square
_START_MARGIN = 1e-4  # share of a number's range between a start and the bounds
_BOUND_MARGIN = 1e-6  # share of a number's range, below which it is at its bound
_MIN_CHANGE = 1e-7  # relative change of cost or numbers, below which a fit ends
# Grid of a guess: optical depths β·z at the reference distance, and G/β.
_OPTICAL_DEPTHS = np.geomspace(0.05, 12.0, 24)
_G_OVER_BETA = (0.1, 0.3, 0.6, 1.0)
_START_PIXELS = 2000  # pixels that decide between starts
MIN_NOISE = 1e-4  # linear light; no camera is better
_LEVELS = 16  # steps of brightness, each with a spread of residuals
MAD = 1.4826  # standard deviations in a median absolute deviation of Gaussian noise
_CLIP_MARGIN = 3.0  # standard deviations of noise between a value and black or white
_MAX_CLIP_MARGIN = 0.1  # linear light; with more, a very noisy picture would have no pixels
_OUTLIER = 6.0  # standard deviations of noise, from where on a residual does not count at all
_MIN_VALUES = 100  # values between noise and white that a fit needs
_NOISE_ROUNDS = 2  # a third changes no number by a tenth of its error


@dataclass(frozen=True, eq=False)
class Objective(Generic[M]):
    model: M
    pixels: Pixels

    @property
    def bounds(self) -> tuple[Array, Array]:
        low, high, _ = np.array([*self.model.bounds.values()]).T
        return low, high

    @cached_property
    def own(self) -> Array:
        """Derivatives by θ of its last numbers, in standard deviations, where these are known."""
        rates = np.diag(1 / self.model.spreads)
        return np.pad(rates, ((0, 0), (len(self.model.bounds) - len(rates), 0)))

    def residual(self, theta: Array) -> Array:
        """Model − observation in standard deviations of the noise (3·N), then `own` numbers."""
        light = self.model.render(theta, self.pixels)
        values = (self.pixels.weights * (light - self.pixels.observed)).flatten().numpy()
        return np.concatenate([values, self.own @ theta])

    def jacobian(self, theta: Array) -> Array:
        weights = self.pixels.weights.flatten().numpy()
        return np.concatenate([weights[:, None] * self.model.slopes(theta, self.pixels), self.own])


@dataclass(frozen=True, eq=False)
class Solution:
    theta: Array
    cost: float  # half of the summed loss
    at_bound: NDArray[np.bool_]  # True where a number is at its least or largest value


def loss(residual: Array) -> Array:
    """Loss of each residual: its square, or less where it is large."""
    return np.asarray(2 * ROBUST**2 * (np.sqrt(1 + (residual / ROBUST) ** 2) - 1))


def influence(residual: Array) -> tuple[Array, Array]:
    root = np.sqrt(1 + (residual / ROBUST) ** 2)
    return residual / root, 1 / root**3


def solve(objective: Objective[M], start: Array, max_steps: int = 60) -> Solution:
    """The least cost inside the bounds, from a start. No logarithms: numbers may be at a bound."""
    from scipy.optimize import least_squares

    low, high = objective.bounds
    margin = _START_MARGIN * (high - low)
    result = least_squares(
        objective.residual,
        np.clip(start, low + margin, high - margin),
        objective.jacobian,
        bounds=(low, high),
        x_scale="jac",
        loss="soft_l1",
        f_scale=ROBUST,
        max_nfev=max_steps,
        ftol=_MIN_CHANGE,
        xtol=_MIN_CHANGE,
        gtol=_MIN_CHANGE,
    )
    # the method stays inside, if only just
    ends = np.minimum(result.x - low, high - result.x) < _BOUND_MARGIN * (high - low)
    theta = np.where(ends, np.where(result.x - low < high - result.x, low, high), result.x)
    return Solution(theta, float(loss(objective.residual(theta)).sum() / 2), ends)


def multistart(
    objective: Objective[CoefficientModel], hints: Sequence[Mapping[str, float]] = (), seed: int = 0
) -> Solution:
    """The least cost from several starts, of which a few pixels decide: a guess, and the numbers
    that other fits have found (`hints`, θ by name).
    """
    model = objective.model
    subset = replace(objective, pixels=objective.pixels.subsample(_START_PIXELS, seed))
    numbers = guess(subset)
    starts = [model.start({**numbers, **hint}) for hint in ({}, *hints)]
    best = min((solve(subset, x, max_steps=20) for x in starts), key=lambda end: end.cost)
    # a colour taken for opaque, a veil and no scene, would not come back; 1 start in 9 ended so
    numbers = guess(subset, dict(zip(model.bounds, best.theta.tolist(), strict=True)))
    second = solve(subset, model.start(numbers), max_steps=20)
    best = min(best, second, key=lambda end: end.cost)
    return solve(objective, best.theta)


def guess(
    objective: Objective[CoefficientModel], numbers: Mapping[str, float] | None = None
) -> dict[str, float]:
    """The best of a grid of β and G/β for each colour, whose light and veil follow by linear least
    squares; the width law is that of `numbers` (θ by name).
    """
    from scipy.optimize import nnls

    model = objective.model
    values = {name: bound.begin for name, bound in model.bounds.items()} | dict(numbers or {})
    law = model.coefficients(np.array([values[name] for name in model.bounds]))
    pixels, reference = objective.pixels.subsample(_START_PIXELS // 2, 0), model.geometry.reference
    observed = (pixels.weights * pixels.observed)[0, :, 0].numpy()
    trials: dict[str, list[tuple[float, ...]]] = {colour: [] for colour in COLOURS}
    shares, ones = _G_OVER_BETA if model.spec.separate_veil else (1.0,), np.ones(3)
    for share, beta in product(shares, (_OPTICAL_DEPTHS / reference).tolist()):
        c = law._replace(beta=beta * ones, G=share * beta * ones, source=0 * ones, light=ones)
        both = [model.picture(x, pixels) for x in (c, c._replace(light=0 * ones, source=ones))]
        scene, growth = ((pixels.weights * x)[0, :, 0].numpy() for x in both)
        for i, colour in enumerate(COLOURS):
            if model.gain:
                (light, source), error = nnls(np.stack([scene[i], growth[i]], 1), observed[i])
            else:
                light, ((source,), error) = 1, nnls(growth[i, :, None], observed[i] - scene[i])
            light = np.log(np.clip(light, 1 / MAX_GAIN, MAX_GAIN))
            trials[colour].append((error, beta, share, light, source))
    for colour in COLOURS:
        numbers_of = zip(("beta", "share", "light", "source"), min(trials[colour])[1:], strict=True)
        values |= {f"{kind}_{colour}": float(value) for kind, value in numbers_of}
    return values


# ---- noise


def reweighed(objective: Objective[M], theta: Array, clips: bool) -> tuple[Pixels, Array]:
    """Weigh pixels for all candidates by the light of the best model, with a noise estimated from
    its residuals; also its θ. Refuses pixels of which too few values lie above the noise.
    """
    pixels = objective.pixels
    for _ in range(_NOISE_ROUNDS):
        theta = solve(objective, theta).theta
        light = objective.model.render(theta, pixels)
        error = light - pixels.observed
        deviation = noise(error, light, objective.pixels.weights > 0)
        # one-sided outliers, such as particles, would pull the veil up for ever
        is_used = error.abs() < _OUTLIER * deviation
        if clips:
            # by the light of the model: leaving out dark observations alone would keep the noise
            # that brightens
            margin = (_CLIP_MARGIN * deviation).clamp(max=_MAX_CLIP_MARGIN)
            is_used &= (light > margin) & (light < 1 - margin) & (pixels.observed > 0)
        count = int(is_used.sum())
        if count < _MIN_VALUES:
            got = f"only {count} of {is_used.numel()} values lie above the noise"
            cure = "raise the exposure, or check distances, g and blur"
            raise ValueError(f"observed: {got}, expected {_MIN_VALUES}: {cure}")
        objective = replace(objective, pixels=replace(pixels, weights=is_used / deviation))
    return objective.pixels, theta


def noise(error: Tensor, light: Tensor, is_used: Tensor) -> Tensor:
    """Standard deviation (read² + shot·light)^½ of the noise of each value, from residuals."""
    from scipy.optimize import nnls

    errors, levels = error[is_used].numpy(), light[is_used].numpy()
    rows = []
    for part in np.array_split(np.argsort(levels), _LEVELS):
        if len(part) > 1:
            spread = MAD * float(np.median(np.abs(errors[part] - np.median(errors[part]))))
            rows.append((max(float(levels[part].mean()), 0.0), max(spread, MIN_NOISE) ** 2))
    level, variance = np.array(rows).T
    # each variance counts by its own size
    system = np.stack([np.ones_like(level), level], 1) / variance[:, None]
    (read, shot), _ = nnls(system, np.ones_like(level))
    deviation: Tensor = (read + shot * light.clamp(min=0.0)).clamp(min=MIN_NOISE**2).sqrt()
    return deviation
