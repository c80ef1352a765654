"""What may be wrong with pictures that no number of a fit stands for: how it would change them,
whether the residuals tell of it, and how far it would move the numbers.

Each fault is followed to first order: one step of the fit with its changes of the picture as more
columns of the Jacobian. So eight of them cost less than fitting one.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import Array
from uwaug.fitting.coefficients import arriving, as_taken, shading_slopes, veil_growth
from uwaug.fitting.data import Pixels
from uwaug.fitting.least_squares import Objective, Solution, influence
from uwaug.fitting.models import CoefficientModel
from uwaug.fitting.noise import light_of_srgb

# Share of the cost, from which a fault that explains it is suspected: in the benchmark's pictures
# sharpening explains .4 %, and where nothing is wrong no fault .3 %. By chance, K numbers explain
# K/values.
_EXPLAINS = 0.003
_CHANCE = 20.0  # times K/values
_STEP = 1e-4  # of a change of light, for a difference that stands for its slope
_FLAT = 1e-9  # of the largest eigenvalue of a matrix of unit scale: what is less is not seen
_OUTLYING = 3.0  # standard deviations of noise, more than which no residual counts in a variance
_SURELY = 3.0  # standard errors of a variance that is there
_DETAIL_OF_NOISE = 0.8  # standard deviation of the `detail` of noise of 1
_MAD = 1.4826  # standard deviations in a median absolute deviation of Gaussian noise


class Suspect(NamedTuple):
    """A fault that the residuals tell of.

    Attributes:
        name: of the fault, as in `changes`, or "noise": of the clean picture.
        size: of it, in the units of `changes`; the noise's standard deviation, 1 = white in sRGB.
        explained: share of the cost that it would save.
        shift: how far the numbers θ would move if it was part of the model.
    """

    name: str
    size: Array
    explained: float
    shift: Array


def changes(model: CoefficientModel, theta: Array, pixels: Pixels) -> dict[str, list[Tensor]]:
    """What each fault of size 1 does to the pixels (Px3x1xN), by the name of the fault:

    * gain: of each colour; tone: a power of the light and a bend; shading: as of `Coefficients`;
    * scene, veil: more of the scene's light, or of the veil, downwards and to the right;
    * alignment: clean and distance lie 1 px too low, too far right;
    * sharpness: the scene's detail is twice what it was;
    * offset: distances are 1 m too short; planar: rays are longer by z·r², r in half diagonals.
    """
    c = model.coefficients(torch.from_numpy(theta))
    light = arriving(c, pixels, model.shape)
    veil = c.veil_slope[:, :, None, None] * veil_growth(c.G, pixels)
    direct = torch.exp(-c.beta[:, :, None, None] * pixels.z)
    farther = replace(pixels, z=pixels.z * (1 + _STEP))
    by_metre = (arriving(c, farther, model.shape) - light) / (_STEP * pixels.z)
    y, x = pixels.position[:, :1], pixels.position[:, 1:]
    down, right = pixels.slopes.unbind(1)
    added: dict[str, list[Tensor]] = {
        "scene": [y * (light - veil), x * (light - veil)],
        "veil": [y * veil, x * veil],
        "alignment": [direct * down, direct * right],
        "sharpness": [direct * pixels.detail],
        "offset": [by_metre],
        "planar": [by_metre * pixels.z * (y * y + x * x)],
    }
    if model.gain == "fixed":
        added["gain"] = [light * one[:, None, None] for one in torch.eye(3, dtype=light.dtype)]
    if not model.shading:
        added["shading"] = [
            light * part[:, None] for part in shading_slopes(pixels.position).unbind(1)
        ]
    if not model.tone:
        added["tone"] = [light * light.clamp(min=_STEP).log(), light * light]
    taken = as_taken(light, c, pixels.position)
    return {
        name: [(as_taken(light + _STEP * one, c, pixels.position) - taken) / _STEP for one in many]
        for name, many in added.items()
    }


def suspects(objective: Objective[CoefficientModel], solution: Solution) -> list[Suspect]:
    """The faults that the residuals tell of, that which explains most first."""
    weights = objective.pixels.weights
    values = int((weights > 0).sum())
    found = []
    for name, columns in changes(objective.model, solution.theta, objective.pixels).items():
        seen = np.stack([(weights * column).flatten().numpy() for column in columns], 1)
        suspect = _followed(name, seen, objective, solution)
        if suspect.explained > max(_EXPLAINS, _CHANCE * len(columns) / values):
            found.append(suspect)
    found += _noise_of_clean(objective, solution)
    return sorted(found, key=lambda suspect: -suspect.explained)


def _noise_of_clean(
    objective: Objective[CoefficientModel], solution: Solution
) -> Iterator[Suspect]:
    """Noise of the clean picture, if the residuals tell of it: they vary more where more of the
    clean light comes through, and by no more than its detail may be noise. The fit takes it for
    detail that the water has taken away; what the same noise once more would do to the numbers is
    what it has done.

    Source: simulation-extrapolation, Cook and Stefanski 1994, here to second order in the noise.
    """
    pixels, theta = objective.pixels, solution.theta
    weights, unit = pixels.weights, light_of_srgb(pixels.clean)
    light = objective.render(theta)
    through = (objective.model.render(theta, pixels.with_noise(_STEP * unit)) - light) / _STEP
    counted = weights > 0
    residual = torch.from_numpy(solution.residual).reshape(weights.shape)
    squares = residual[counted].square().clamp(max=_OUTLYING**2).numpy()
    # in each colour, the observed picture's own noise follows its light; as sRGB, not quite a line
    colour = torch.eye(3, dtype=light.dtype)[:, None, None].expand(*light.shape, 3)
    own = [colour * light[..., None] ** power for power in range(3)]
    system = torch.cat([*own, through[..., None] ** 2], -1)
    columns = (system * weights[..., None] ** 2)[counted].numpy()
    if not columns[:, -1].any():
        return
    columns = columns[:, columns.any(0)]  # a colour may have no pixels
    inverse = _inverse(columns, np.ones(len(columns)))
    variances = inverse @ (columns.T @ squares)
    scatter = columns * (squares - columns @ variances)[:, None]
    error = math.sqrt((inverse @ (scatter.T @ scatter) @ inverse)[-1, -1])
    variance = float(variances[-1])
    detail = float((pixels.detail / unit)[counted].abs().median()) * _MAD / _DETAIL_OF_NOISE
    if not _SURELY * error < variance < (2 * detail) ** 2:
        return
    size = min(math.sqrt(variance), detail)

    # a residual depends on its own pixel's noise alone: all pixels may be moved at once
    def slope(noise: float) -> Array:
        noisy = replace(objective, pixels=pixels.with_noise(noise * unit))
        residual, jacobian = noisy.linearised(theta)
        return jacobian.T @ influence(residual)[0]

    more = (slope(size) + slope(-size)) / 2 - slope(0.0)
    free = objective.free & (solution.at_bound == 0) & (solution.jacobian != 0).any(0)
    shift = np.zeros(len(theta))
    curvature = influence(solution.residual)[1]
    shift[free] = -_inverse(solution.jacobian[:, free], curvature) @ more[free]
    explained = (variance / error) ** 2 / 2 / max(solution.cost, 1e-300)
    yield Suspect("noise", np.array([size]), explained, shift)


def _followed(
    name: str, seen: Array, objective: Objective[CoefficientModel], solution: Solution
) -> Suspect:
    """A fault of which the residuals see so much (values x K), after a step of the fit."""
    n = len(solution.theta)
    free = np.append(objective.free & (solution.at_bound == 0), np.ones(seen.shape[1], dtype=bool))
    jacobian = np.concatenate([solution.jacobian, seen], 1)
    free &= (jacobian != 0).any(0)
    score, curvature = influence(solution.residual)
    used = jacobian[:, free]
    slope, step = used.T @ score, np.zeros(len(free))
    step[free] = -_inverse(used, curvature) @ slope
    explained = float(-slope @ step[free] / 2) / max(solution.cost, 1e-300)
    return Suspect(name, step[n:], explained, step[:n])


def _inverse(jacobian: Array, curvature: Array) -> Array:
    """Of the cost's second derivatives; 0 along what is not seen."""
    normal = jacobian.T @ (curvature[:, None] * jacobian)
    scale = np.sqrt(np.diag(normal))
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    plain = values > _FLAT * values.max(initial=0.0)
    inverse = (vectors[:, plain] / values[plain]) @ vectors[:, plain].T
    return np.asarray(inverse / np.outer(scale, scale))


def spread(found: Sequence[Suspect], numbers: int) -> Array:
    """The covariance of θ (numbers x numbers) of not knowing whether the faults are there."""
    return sum((np.outer(one.shift, one.shift) for one in found), np.zeros((numbers, numbers)))
