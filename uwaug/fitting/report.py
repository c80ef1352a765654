"""What a fit says: numbers with their errors, and in words what the pictures cannot tell."""

from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
import torch

from uwaug._support.types import Array
from uwaug.fitting.pixels import thinned
from uwaug.fitting.solve import Problem, Solution, solve
from uwaug.fitting.structure import Quantity, Structure
from uwaug.fitting.uncertainty import Spread, limits

__all__ = [
    "NEAR_BOUND",
    "NORMAL",
    "THIN",
    "VAGUE",
    "Candidate",
    "Correlation",
    "Parameter",
    "State",
    "correlation",
    "dependent",
    "errors_of",
    "explains",
    "not_identified",
    "parameters_of",
    "table",
]

State = Literal["free", "at bound", "not identified", "fixed"]

NORMAL = 1.96
"""Standard errors to either end of a 95 % interval."""

VAGUE = 0.5
"""Of a number: where its standard error is larger, and larger than what shows in a picture, the
number is not identified.
"""

NEAR_BOUND = 3.0
"""Standard errors from a bound, within which an interval is taken from the profile."""

THIN = 0.3
"""Optical depth G·z at the far end, below which a veil is still a straight line."""

_PROFILED = 5000
"""Pixels that profiles are made with; all of them would take most of a fit's time."""

_LARGE = 0.08
"""Standard errors as a share of a number, from which its interval is taken from the profile."""

_DEPENDENT = 1.5
"""Ratio of standard errors over blocks to those of independent residuals, above which the model
misses something.
"""


@dataclass(frozen=True)
class Parameter:
    """A number that a fit reports.

    Attributes:
        value: None if it is not identified.
        error: standard error; None if there is none: not identified, fixed, or at a bound.
        low, high: ends of the 95 % interval; None as the error, but at a bound known.
        unit: "1/m", "px" or "1".
        state: "free"; "at bound": at the least or largest value that it may have; "not
            identified": the pictures do not tell; "fixed": it was given.
    """

    value: float | None
    error: float | None
    low: float | None
    high: float | None
    unit: str
    state: State


def not_identified(unit: str) -> Parameter:
    """A number that the pictures do not tell."""
    return Parameter(None, None, None, None, unit, "not identified")


class Candidate(NamedTuple):
    """A model that was tried.

    Attributes:
        name: of the model.
        numbers: how many were fitted.
        error: root of the mean held-out loss, in standard deviations of the noise.
        behind: how far the summed held-out loss lies behind the best.
        behind_error: standard error of that.
    """

    name: str
    numbers: int
    error: float
    behind: float
    behind_error: float


class Correlation(NamedTuple):
    """Of the parameters that have a standard error.

    Attributes:
        names: of rows and columns.
        matrix: −1…1.
    """

    names: list[str]
    matrix: Array


def parameters_of(
    problem: Problem[Any], solution: Solution, spread: Spread
) -> dict[str, Parameter]:
    """Every quantity that is reported."""
    structure = problem.structure
    values = _reported(structure, solution.theta)
    slopes = _slopes(structure, solution.theta)
    errors = np.sqrt(np.maximum(np.einsum("qi,ij,qj->q", slopes, spread.covariance, slopes), 0.0))
    ends = _profiles(problem, solution, spread)
    names = list(structure.bounds)
    found = {}
    for q, quantity in enumerate(structure.quantities):
        value, error, slope = float(values[q]), float(errors[q]), slopes[q]
        if not slope.any():
            found[quantity.name] = Parameter(value, None, None, None, quantity.unit, "fixed")
            continue
        if not spread.sees(slope):
            found[quantity.name] = not_identified(quantity.unit)
            continue
        reached = []
        for i in ends:
            if slope[i] != 0:
                for end in ends[i]:
                    reached.append(float(_reported(structure, end)[q]))
        bounded = [names[i] for i in np.flatnonzero(solution.at_bound)]
        at_end = any(quantity.name in _ends_with(name) for name in bounded)
        found[quantity.name] = _parameter(quantity, value, error, reached, at_end=at_end)
    return found


def _ends_with(name: str) -> tuple[str, ...]:
    """The quantities that are at the end of what they may be where a number is."""
    kind, _, colour = name.partition("_")
    kinds = {"share": ("G", "b"), "source": ("source", "veil")}.get(kind)
    return (name,) if kinds is None else tuple(f"{one}_{colour}" for one in kinds)


def _parameter(
    quantity: Quantity, value: float, error: float, reached: list[float], *, at_end: bool
) -> Parameter:
    """reached: its values at the ends of profiles, which take the place of the normal interval."""
    low, high = value - NORMAL * error, value + NORMAL * error
    if reached:
        low, high = min(value, *reached), max(value, *reached)
    low = max(low, min(value, 0.0))  # no quantity is negative
    half = (high - low) / (2 * NORMAL)
    least = min(abs(value), abs(low), abs(high))
    if not half <= max(quantity.shows, VAGUE * least):
        return not_identified(quantity.unit)
    if at_end:
        return Parameter(value, None, low, high, quantity.unit, "at bound")
    return Parameter(
        value, max(error, half) if reached else error, low, high, quantity.unit, "free"
    )


def _profiles(
    problem: Problem[Any], solution: Solution, spread: Spread
) -> dict[int, tuple[Array, Array]]:
    """The intervals of numbers at a bound or near one, by place."""
    low, high = problem.limits
    error = np.sqrt(np.diag(spread.covariance))
    few = replace(problem, pixels=thinned(problem.pixels, _PROFILED, np.random.default_rng(0)))
    share = few.pixels.z.numel() / problem.pixels.z.numel()
    nearby = solve(few, solution.theta) if share < 1 else solution
    found = {}
    for i in range(len(low)):
        away = min(solution.theta[i] - low[i], high[i] - solution.theta[i])
        # where errors are large, they are not symmetric either
        near = solution.at_bound[i] != 0 or away < NEAR_BOUND * error[i]
        near = near or error[i] > _LARGE * abs(solution.theta[i])
        if problem.free[i] and near and spread.sees(np.eye(len(low))[i]):
            moved = solution.theta - nearby.theta
            ends = limits(few, nearby, i, share)
            found[i] = (
                np.clip(ends[0].theta + moved, low, high),
                np.clip(ends[1].theta + moved, low, high),
            )
    return found


def _reported(structure: Structure, theta: Array) -> Array:
    return structure.reported(torch.from_numpy(theta)).numpy()


def _slopes(structure: Structure, theta: Array) -> Array:
    """Derivatives of the quantities by the numbers that are fitted."""
    found = torch.func.jacrev(structure.reported)(torch.from_numpy(theta))
    return np.asarray(found.nan_to_num(0.0, 0.0, 0.0))


def errors_of(parameters: dict[str, Parameter]) -> dict[str, float]:
    """The standard errors that are known, by name."""
    found = {}
    for name, one in parameters.items():
        if one.error is not None:
            found[name] = one.error
    return found


def correlation(structure: Structure, solution: Solution, spread: Spread) -> Correlation:
    """The correlations of the quantities that have an error."""
    slopes = _slopes(structure, solution.theta)
    covariance = slopes @ spread.covariance @ slopes.T
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    known = np.flatnonzero(error > 0)
    matrix = covariance[np.ix_(known, known)] / np.outer(error[known], error[known])
    return Correlation([structure.quantities[i].name for i in known], matrix)


def explains(rms: float, share: float, variance: str) -> str:
    """The sentence on what a model leaves, and what it explains of a variance (0…1), in words."""
    percent = f"{100 * np.floor(1e4 * share) / 1e4:.4g} %"
    return f"The residual is {rms:.2g} RMS of linear light; {percent} of {variance} is explained."


def dependent(spread: Spread, end: str) -> list[str]:
    """The sentence on residuals that depend on each other, if they do, and how it ends."""
    if spread.widened <= _DEPENDENT:
        return []
    return [
        f"Residuals of neighbouring pixels depend on each other: errors are {spread.widened:.1f} "
        f"times those of independent noise{end}."
    ]


def table(parameters: dict[str, Parameter]) -> str:
    """The parameters as lines of text."""
    lines = [f"  {'':14}{'value':>10}{'std. error':>12}{'95 % interval':>22}  unit"]
    for name, one in parameters.items():
        if one.value is None:
            lines.append(f"  {name:14}{'not identified':>22}")
            continue
        error = "" if one.error is None else f"{one.error:.2g}"
        interval = ""
        if one.low is not None and one.high is not None:
            interval = f"{one.low:.4g} … {one.high:.4g}"
        state = "" if one.state == "free" else f"  ({one.state})"
        lines.append(f"  {name:14}{one.value:>10.4g}{error:>12}{interval:>22}  {one.unit}{state}")
    return "\n".join(lines)
