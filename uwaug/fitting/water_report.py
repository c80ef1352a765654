"""From the Jerlov water that was chosen to what is reported of it, in numbers and in words."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uwaug._support.types import Array
from uwaug.fitting.choice import Tried, best_of
from uwaug.fitting.noise import Noise
from uwaug.fitting.pixels import Pixels, widest_blur
from uwaug.fitting.report import NEAR_BOUND, NORMAL, VAGUE, Parameter, not_identified
from uwaug.fitting.spectral import OneType
from uwaug.fitting.uncertainty import limits, spread
from uwaug.fitting.water_result import JerlovType, WaterFit
from uwaug.optics.medium import Medium

__all__ = ["Found", "reported"]

_SHOWS = {"visibility": 0.0, "vertical_depth": 0.5}
"""Of these numbers, m, the least change that shows in a picture."""

_STEP = 1e-4
"""Of a fitted number, for differences of what is reported."""

_UNLIKE = 1.25
"""Ratio of held-out errors to those of coefficients that are free in every channel: above, no
Jerlov water explains a picture. Jerlov waters reach 1.002, a wrong g or μ 1.2, grey water, wrong
cameras and wrong exposures 1.5 to 5.
"""

_NOT_QUITE = 1.02
"""Ratio above which none is quite right."""

_UNSEEN = 0.001
"""RMS of linear light: the default tolerance of a medium puts pictures .0007 off."""


@dataclass(frozen=True, eq=False)
class Found:
    """What is reported on.

    Attributes:
        chosen: one of `tried`.
        tried: types and mixtures.
        rival: coefficients that are free in every channel.
        noise: that weights go by.
    """

    chosen: Tried[Any]
    tried: Sequence[Tried[Any]]
    rival: Tried[Any]
    noise: Noise


def reported(found: Found) -> WaterFit:
    """What is reported of the chosen water."""
    chosen = found.chosen
    structure: OneType = chosen.structure
    theta = chosen.solution.theta
    parameters = _parameters(chosen)
    types = _types(found.tried)
    rms = _rms(chosen)
    optics = structure.optics
    water = structure.water(theta)
    medium = Medium.from_water(
        water,
        optics.camera,
        vertical_depth=structure.depth_of(theta),
        g=optics.g,
        mu=optics.mu,
        point_spread=optics.law,
    )
    return WaterFit(
        type=structure.name,
        water=water,
        medium=medium,
        parameters=parameters,
        types=types,
        message="\n".join(_words(found, types, parameters, rms)),
        noise=found.noise,
        rms=rms,
    )


def _rms(tried: Tried[Any]) -> float:
    """Of the residual, in linear light."""
    pixels = tried.problem.pixels
    residual = tried.problem.model(tried.solution.theta) - pixels.observed
    return float((residual[pixels.weights > 0] ** 2).mean().sqrt())


def _parameters(chosen: Tried[Any]) -> dict[str, Parameter]:
    """Numbers by name, with errors by the delta method."""
    structure: OneType = chosen.structure
    solution, theta = chosen.solution, chosen.solution.theta
    known = spread(chosen.problem, solution)
    covariance = known.covariance
    values = structure.reported(theta)
    slopes = _slopes(structure, theta, chosen.problem.limits)
    ends = _profiles(chosen, np.sqrt(np.diag(covariance)))
    found = {}
    for i, (name, value) in enumerate(values.items()):
        if not slopes[i].any():
            found[name] = Parameter(value, None, None, None, _unit(name), "fixed")
            continue
        if not known.sees(slopes[i]):
            found[name] = not_identified(_unit(name))
            continue
        error = float(np.sqrt(max(slopes[i] @ covariance @ slopes[i], 0.0)))
        reached = [value - NORMAL * error, value + NORMAL * error]
        for place, thetas in ends.items():
            if slopes[i, place] != 0:
                reached += [structure.reported(end)[name] for end in thetas]
        low, high = max(min(reached), 0.0), max(reached)
        at_bound = bool((solution.at_bound[slopes[i] != 0] != 0).any())
        found[name] = _parameter(name, value, error, low, high, at_bound=at_bound)
    return found


def _parameter(
    name: str, value: float, error: float, low: float, high: float, *, at_bound: bool
) -> Parameter:
    half, unit = (high - low) / (2 * NORMAL), _unit(name)
    shows = _SHOWS.get(name, 0.05)
    if not half <= max(shows, VAGUE * abs(value)):
        return not_identified(unit)
    if at_bound:
        return Parameter(value, None, low, high, unit, "at bound")
    return Parameter(value, error, low, high, unit, "free")


def _unit(name: str) -> str:
    return "m" if name in _SHOWS else "1"


def _slopes(structure: OneType, theta: Array, ends: tuple[Array, Array]) -> Array:
    """Derivatives of what is reported by the numbers that are fitted."""
    low, high = ends
    columns = []
    for i in range(len(theta)):
        up, down = theta.copy(), theta.copy()
        up[i] = min(theta[i] + _STEP, high[i])
        down[i] = max(theta[i] - _STEP, low[i])
        above = np.array(list(structure.reported(up).values()))
        below = np.array(list(structure.reported(down).values()))
        columns.append((above - below) / (up[i] - down[i]))
    return np.array(columns).T


def _profiles(chosen: Tried[Any], error: Array) -> dict[int, list[Array]]:
    """Both ends of the intervals of numbers at a bound or near one, by place."""
    problem, solution = chosen.problem, chosen.solution
    low, high = problem.limits
    found = {}
    for i in range(len(low)):
        away = min(solution.theta[i] - low[i], high[i] - solution.theta[i])
        if solution.at_bound[i] != 0 or away < NEAR_BOUND * error[i]:
            found[i] = [end.theta for end in limits(problem, solution, i)]
    return found


def _types(tried: Sequence[Tried[Any]]) -> tuple[JerlovType, ...]:
    order = sorted(tried, key=lambda one: one.loss)
    rows = []
    for one in order:
        behind, error = one.behind(order[0])
        theta = one.solution.theta
        rows.append(
            JerlovType(
                name=one.name,
                visibility=one.structure.water(theta).visibility(),
                vertical_depth=one.structure.depth_of(theta),
                error=one.error,
                behind=behind,
                behind_error=error,
                told_apart=behind > error,
            )
        )
    return tuple(rows)


def _words(
    found: Found, types: Sequence[JerlovType], parameters: dict[str, Parameter], rms: float
) -> list[str]:
    """A few sentences."""
    chosen = found.chosen
    lines = [_identity(chosen, parameters)]
    alike = [one.name for one in types if not one.told_apart and one.name != chosen.name]
    if alike:
        lines.append(f"Within one standard error, these foretell as well: {', '.join(alike)}.")
    else:
        lines.append("All others foretell left-out pixels worse by more than one standard error.")
    lines.append(f"The residual is {rms:.2g} RMS of linear light.")
    lines += _verdict(found)
    lines += _unknown(parameters)
    lines += _clamped(chosen)
    if not chosen.solution.converged:
        lines.append("The fit stopped before it settled.")
    return lines


def _identity(chosen: Tried[Any], parameters: dict[str, Parameter]) -> str:
    seen = parameters["visibility"]
    mixed = len(chosen.structure.waters) == 2
    words = f"A mixture of Jerlov types {chosen.name}" if mixed else f"Jerlov type {chosen.name}"
    if seen.value is None:
        return f"{words}."
    error = "" if seen.error is None else f" ± {seen.error:.2g}"
    return f"{words}, visibility {seen.value:.4g}{error} m."


def _verdict(found: Found) -> list[str]:
    """Whether any water explains the pictures."""
    best = best_of(found.tried)
    ratio = best.error / max(found.rival.error, 1e-9)
    behind, error = best.behind(found.rival)
    missed = max(_rms(best) ** 2 - _rms(found.rival) ** 2, 0.0) ** 0.5
    if ratio < _NOT_QUITE or behind < 2 * error or missed < _UNSEEN:
        return []
    than = f"left-out pixels are {ratio:.3g} times as far off as with coefficients free in every"
    causes = "camera, g, μ, exposure (gain), white balance, and distances in metres"
    if ratio < _UNLIKE:
        return [
            f"No type is quite right: {than} channel. Errors do not count that; check {causes}."
        ]
    return [
        f"No Jerlov water explains this picture: {than} channel, for which see uwaug.fit. Do not "
        f"rely on type and numbers; check {causes}."
    ]


def _unknown(parameters: dict[str, Parameter]) -> list[str]:
    lines = []
    for name, one in parameters.items():
        words = name.replace("_", " ")
        if one.state == "not identified":
            lines.append(f"Not identified: {words}. Its standard error is more than half of it.")
        if one.state == "at bound":
            lines.append(f"At the end of what it may be: {words}.")
    return lines


def _clamped(chosen: Tried[Any]) -> list[str]:
    """Whether blurs are wider than any that was made."""
    pixels: Pixels = chosen.problem.pixels
    sizes = chosen.structure.sizes
    widest = max(widest_blur(size) for size in sizes)
    used = (pixels.weights > 0).any(1, keepdim=True)
    sigma = chosen.structure.sigma(chosen.structure.medium(chosen.solution.theta), pixels.z)
    share = float((sigma[used] > widest).double().mean())
    if share < 0.01:
        return []
    return [
        f"At {100 * share:.0f} % of the pixels the width law asks for more than the widest blur, "
        f"{widest:.3g} px, which may bias type and numbers: leave the far ones out with a mask."
    ]
