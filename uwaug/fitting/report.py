"""What a fit says: numbers with their errors, and in words what the pictures cannot tell."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch

from uwaug.fitting.solve import Problem, Solution
from uwaug.fitting.structure import Quantity, Structure
from uwaug.fitting.uncertainty import Limit, Spread, limits
from uwaug.optics.spectra import Array

__all__ = ["Parameter", "State", "correlation", "parameters_of", "table"]

State = Literal["free", "at bound", "not identified", "fixed"]

_VAGUE = 0.5
"""Standard errors of a number that is not identified are larger than what would show, and than this
share of the least that the number may be.
"""

_NORMAL = 1.96
"""Standard errors to either end of a 95 % interval."""

_NEAR_BOUND = 3.0
"""Standard errors from a bound, within which an interval is taken from the profile."""


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


def parameters_of(
    problem: Problem[Any], solution: Solution, spread: Spread
) -> dict[str, Parameter]:
    """Every quantity that is reported."""
    structure = problem.structure
    values = _reported(structure, solution.theta)
    slopes = _slopes(structure, solution.theta)
    errors = np.sqrt(np.maximum(np.einsum("qi,ij,qj->q", slopes, spread.covariance, slopes), 0.0))
    ends = _profiles(problem, solution, spread)
    found = {}
    for q, quantity in enumerate(structure.quantities):
        rows = [ends[i] for i in ends if slopes[q, i] != 0]
        numbers = float(values[q]), float(errors[q])
        found[quantity.name] = _parameter(
            quantity, *numbers, slopes[q], solution, structure, rows, q
        )
    return found


def _parameter(
    quantity: Quantity,
    value: float,
    error: float,
    slope: Array,
    solution: Solution,
    structure: Structure,
    ends: list[tuple[Limit, Limit]],
    place: int,
) -> Parameter:
    unit = quantity.unit
    if not slope.any():
        return Parameter(value, None, None, None, unit, "fixed")
    low, high = value - _NORMAL * error, value + _NORMAL * error
    for pair in ends:
        reached = [float(_reported(structure, end.theta)[place]) for end in pair]
        low, high = min(low, *reached), max(high, *reached)
    half = (high - low) / (2 * _NORMAL)
    least = min(abs(value), abs(low), abs(high))
    if not half <= max(quantity.shows, _VAGUE * least):
        return Parameter(None, None, None, None, unit, "not identified")
    if (solution.at_bound[slope != 0] != 0).any():
        return Parameter(value, None, low, high, unit, "at bound")
    return Parameter(value, error, low, high, unit, "free")


def _profiles(
    problem: Problem[Any], solution: Solution, spread: Spread
) -> dict[int, tuple[Limit, Limit]]:
    """The intervals of numbers at a bound or near one, by place."""
    low, high = problem.limits
    error = np.sqrt(np.diag(spread.covariance))
    found = {}
    for i in range(len(low)):
        away = min(solution.theta[i] - low[i], high[i] - solution.theta[i])
        if problem.free[i] and (solution.at_bound[i] != 0 or away < _NEAR_BOUND * error[i]):
            found[i] = limits(problem, solution, i)
    return found


def _reported(structure: Structure, theta: Array) -> Array:
    return structure.reported(torch.from_numpy(theta)).numpy()


def _slopes(structure: Structure, theta: Array) -> Array:
    """Derivatives of the quantities by the numbers that are fitted."""
    found = torch.func.jacrev(structure.reported)(torch.from_numpy(theta))
    return np.asarray(found.nan_to_num(0.0, 0.0, 0.0))


def correlation(
    structure: Structure, solution: Solution, spread: Spread
) -> tuple[list[str], Array]:
    """Names of the quantities that have an error, and their correlation matrix."""
    slopes = _slopes(structure, solution.theta)
    covariance = slopes @ spread.covariance @ slopes.T
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    known = np.flatnonzero(error > 0)
    matrix = covariance[np.ix_(known, known)] / np.outer(error[known], error[known])
    return [structure.quantities[i].name for i in known], matrix


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
