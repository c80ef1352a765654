"""How far a pixel may be off by chance, and which pixels are too dark or too bright to count."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import Array, ColorSpace
from uwaug.fitting.data import Observations, Pixels
from uwaug.fitting.least_squares import M, Objective, solve
from uwaug.formation.colour import linear_to_srgb

_LEAST = 1e-4  # of linear light; no camera is better
_BINS = 16  # of brightness, in each of which the spread of the residuals is looked at
_INSIDE = 3.0  # standard deviations of noise, by which a value lies above black and below white
_MAX_MARGIN = 0.1  # of linear light: a very noisy picture would have no pixels left
_MAD = 1.4826  # standard deviations in a median absolute deviation of Gaussian noise
_OUTLYING = 6.0  # standard deviations of noise, from where on a residual does not count at all
_ROUNDS = 2  # of learning the noise: a third changes no number by a tenth of its error


@dataclass(frozen=True)
class Noise:
    """Noise of the observed picture, in linear light on a scale of 0…1.

    The variance of a value I is read² + shot·I, and that of rounding to `bits`.

    Attributes:
        read: standard deviation in the dark, ≥ 0.
        shot: variance for each unit of light, ≥ 0.
        bits: of the values in the file, whose rounding counts too; None if they are not rounded.
    """

    read: float = 0.005
    shot: float = 0.0
    bits: int | None = 8

    def __post_init__(self) -> None:
        checks.within("Noise.read", self.read, 0.0, 1.0)
        checks.within("Noise.shot", self.shot, 0.0, 1.0)
        if self.bits is not None:
            checks.within("Noise.bits", self.bits, 1, 32)

    def deviation(self, light: Tensor, color_space: ColorSpace) -> Tensor:
        """The standard deviation of values that are `light` on average."""
        variance = (
            self.read**2 + self.shot * light.clamp(min=0.0) + self._rounding(light, color_space)
        )
        return variance.clamp(min=_LEAST**2).sqrt()

    def _rounding(self, light: Tensor, color_space: ColorSpace) -> Tensor:
        if self.bits is None:
            return torch.zeros_like(light)
        step = torch.full_like(light, 1 / (2**self.bits - 1))
        if color_space == "srgb":
            step = step * light_of_srgb(light)
        return step**2 / 12


def light_of_srgb(light: Tensor) -> Tensor:
    """By how much a light of 0…1 grows with its sRGB value."""
    inside = light.detach().clamp(0.0, 1.0).requires_grad_()
    with torch.enable_grad():
        (slope,) = torch.autograd.grad(linear_to_srgb(inside).sum(), inside)
    return 1 / slope


_ROUGH = Noise(0.01)  # for a first fit, where the noise is not known


def estimate_noise(
    residual: Tensor, light: Tensor, used: Tensor, bits: int | None, color_space: ColorSpace
) -> Noise:
    """The noise that the residuals of a fit speak of.

    Args:
        residual: model − observation, in linear light.
        light: the model's values, of the same shape.
        used: which of them count, of the same shape.
        bits, color_space: of the file.
    """
    error, level = residual[used].numpy(), light[used].numpy()
    rounding = Noise(0.0, 0.0, bits)._rounding(light[used], color_space).numpy()
    order = np.argsort(level)
    levels, variances = [], []
    for part in np.array_split(order, _BINS):
        if len(part) < 2:
            continue
        spread = _MAD * float(np.median(np.abs(error[part] - np.median(error[part]))))
        levels.append(float(level[part].mean()))
        variances.append(max(spread**2 - float(rounding[part].mean()), 0.0))
    read, shot = _line(np.array(levels), np.array(variances))
    return Noise(math.sqrt(read), shot, bits)


def _line(x: Any, variance: Any) -> tuple[float, float]:
    """The line read² + shot·x through variances, both ≥ 0; each counts by its own size."""
    from scipy.optimize import nnls

    scale = 1 / np.maximum(variance, _LEAST**2)
    system = np.stack([np.ones_like(x), np.maximum(x, 0.0)], 1) * scale[:, None]
    (read, shot), _ = nnls(system, variance * scale)
    return float(read), float(shot)


def unclipped(light: Tensor, deviation: Tensor, color_space: ColorSpace) -> Tensor:
    """Which values are far enough from black and white for the noise not to be clipped.

    By what the model says, not by what was observed: leaving out dark observations alone would
    keep the noise that brightens.
    """
    if color_space == "linear":  # is never clipped
        return torch.ones_like(light, dtype=torch.bool)
    margin = (_INSIDE * deviation).clamp(max=_MAX_MARGIN)
    return (light > margin) & (light < 1 - margin)


def initial_weights(pixels: Pixels, noise: Noise | None, color_space: ColorSpace) -> Pixels:
    """The pixels with weights for a first fit, by the observed light."""
    deviation = (noise or _ROUGH).deviation(pixels.observed, color_space)
    return pixels.weighed(pixels.weights / deviation)


def reweight(
    model: M,
    theta: Array,
    pixels: Pixels,
    noise: Noise | None,
    observations: Observations,
) -> tuple[Pixels, Noise, Array]:
    """Weigh pixels by a model's own light, with a noise that is learnt from its residuals.

    Args:
        model: that explains the pixels best, which all candidates are then compared with.
        theta: where it begins.
        pixels: without the weights of any noise.
        noise: if it is known.
        observations: whose color space and bits the noise depends on.

    Returns:
        The pixels with their weights, the noise, and where the model ended.
    """
    color_space, bits = observations.color_space, observations.bits
    estimate, weighed = noise or _ROUGH, initial_weights(pixels, noise, color_space)
    for _ in range(_ROUNDS):
        objective = Objective(model, weighed)
        theta = solve(objective, theta).theta
        light = objective.render(theta)
        error = light - pixels.observed
        if noise is None:
            estimate = estimate_noise(error, light, weighed.weights > 0, bits, color_space)
        deviation = estimate.deviation(light, color_space)
        # one-sided outliers, such as particles, would pull the veil up for ever
        near = error.abs() < _OUTLYING * deviation
        inside = unclipped(light, deviation, color_space) & near
        if color_space == "srgb":  # a wrong model may say that there is light
            inside &= pixels.observed > 0
        weighed = pixels.weighed(pixels.weights * inside / deviation)
    return weighed, estimate, theta
