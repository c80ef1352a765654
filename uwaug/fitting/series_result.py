"""`SeriesFit`: the waters of a series of turbidities, and whether scattering follows turbidity."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import Array
from uwaug.fitting import saved
from uwaug.fitting.choice import Tried
from uwaug.fitting.finish import candidates_of, explained
from uwaug.fitting.media import media_of
from uwaug.fitting.noise import Noise
from uwaug.fitting.report import Candidate, Parameter, dependent, explains, parameters_of, table
from uwaug.fitting.series_model import SeriesWater
from uwaug.fitting.structure import COLOURS, Geometry
from uwaug.fitting.uncertainty import Spread, spread
from uwaug.optics.medium import Medium

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Line", "SeriesFit", "finished_series"]

_UNLIKELY = 0.05 / 3
"""Probability, below which scattering does not follow turbidity; there are three colours."""


class Line(NamedTuple):
    """b = b₀ + k·turbidity, in one colour, by generalised least squares.

    Attributes:
        b0, b0_error: scattering at turbidity 0 and its standard error, 1/m.
        k, k_error: its growth with turbidity, 1/m for each unit.
        correlation: of the two.
        probability: of a misfit at least as large if b lay on a line; None with two levels.
    """

    b0: float
    b0_error: float
    k: float
    k_error: float
    correlation: float
    probability: float | None

    def error_at(self, turbidity: Array) -> Array:
        """The standard error of the line, 1/m."""
        both = 2 * self.correlation * self.b0_error * self.k_error * turbidity
        return np.asarray(np.sqrt(self.b0_error**2 + both + (self.k_error * turbidity) ** 2))


@dataclass(frozen=True, eq=False)
class SeriesFit:
    """A series of turbidities; made by `uwaug.fitting.fit_series`, or read by `SeriesFit.load`.

    Attributes:
        model: the name of the model that was chosen.
        levels: the turbidities, ascending.
        unit: of the turbidities.
        parameters: each number by name, as of `uwaug.fitting.Fit`: a of each colour; b of each
            colour and level, such as b_red_1; m, veil for each unit of scattering, G·V(0)/b; g;
            scale and exponent of the width law.
        lines: b₀ + k·turbidity, by colour.
        candidates: the models that were tried.
        message: in words, what was found.
        noise, rms: of the observed pictures; of the residual, in linear light.
        structure, theta, covariance: the numbers as they were fitted.
    """

    model: str
    levels: tuple[float, ...]
    unit: str
    parameters: dict[str, Parameter]
    lines: dict[str, Line]
    candidates: tuple[Candidate, ...]
    message: str
    noise: Noise
    rms: float
    structure: SeriesWater
    theta: Array
    covariance: Array

    @property
    def media(self) -> Medium:
        """The water of each level: a batch."""
        theta = torch.from_numpy(self.theta)
        return self._media(self.structure.scattering(theta))

    def medium(self, turbidity: float) -> Medium:
        """The water at a turbidity, by the line: a batch of one.

        Args:
            turbidity: ≥ 0, in the unit of the series.
        """
        checks.within("turbidity", turbidity, 0.0)
        b = [max(line.b0 + line.k * turbidity, 0.0) for line in self.lines.values()]
        return self._media(torch.tensor([b], dtype=torch.float64))

    def _media(self, b: Tensor) -> Medium:
        natural = self.structure.at(torch.from_numpy(self.theta), b)
        return media_of(natural, b.mean(1), self.structure.shape, self.structure.geometry)

    def summary(self) -> str:
        """The series as text: verdict, lines, parameters."""
        head = f"  {'':14}{'b₀ [1/m]':>18}{f'k [1/m per {self.unit}]':>24}{'on a line':>12}"
        parts = [self.message, "", head]
        for colour, line in self.lines.items():
            b0, k = f"{line.b0:.4g} ± {line.b0_error:.2g}", f"{line.k:.4g} ± {line.k_error:.2g}"
            odds = "" if line.probability is None else f"p = {line.probability:.2g}"
            parts.append(f"  {colour:14}{b0:>18}{k:>24}{odds:>12}")
        return "\n".join([*parts, "", table(self.parameters)])

    def plot(self) -> "Figure":
        """Draw a and b against turbidity, with 95 % intervals, and the lines."""
        from uwaug.fitting.series_drawing import draw_series

        return draw_series(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the series as JSON, whole or not at all. Pictures are not part of it."""
        structure = self.structure
        own = {
            "levels": self.levels,
            "unit": self.unit,
            "lines": {colour: line._asdict() for colour, line in self.lines.items()},
            "structure": {
                "name": structure.name,
                "shape": structure.shape,
                "geometry": structure.geometry._asdict(),
                "level": structure.level,
                "levels": structure.levels,
            },
        }
        saved.write(path, saved.SERIES, {**saved.packed(self), **own})

    @staticmethod
    def load(path: str | os.PathLike[str]) -> "SeriesFit":
        """Read a series that `save` wrote.

        Raises:
            ValueError: if the file is none, or one of a newer version; names it.
            OSError: if it cannot be read.
        """
        return saved.read(path, saved.SERIES, _from_json)

    def __repr__(self) -> str:
        return f"SeriesFit({self.model!r}, {len(self.levels)} turbidities, {self.unit})"


def _from_json(values: Mapping[str, Any]) -> SeriesFit:
    made = dict(values["structure"])
    made["geometry"] = Geometry(**made["geometry"])
    made["level"] = tuple(made["level"])
    return SeriesFit(
        **saved.unpacked(values, SeriesWater(**made)),
        levels=tuple(values["levels"]),
        unit=values["unit"],
        lines={colour: Line(**line) for colour, line in values["lines"].items()},
    )


def finished_series(
    chosen: Tried[SeriesWater],
    tried: Sequence[Tried[SeriesWater]],
    levels: tuple[float, ...],
    noise: Noise,
    unit: str,
) -> SeriesFit:
    """The fit of `chosen`, one of `tried`."""
    problem, solution = chosen.problem, chosen.solution
    found = spread(problem, solution)
    lines = {}
    for c, colour in enumerate(COLOURS):
        places = 3 + 3 * np.arange(len(levels)) + c
        block = found.covariance[np.ix_(places, places)]
        lines[colour] = _line(np.array(levels), solution.theta[places], block)
    share, rms = explained(chosen)
    return SeriesFit(
        model=chosen.name,
        levels=levels,
        unit=unit,
        parameters=parameters_of(problem, solution, found),
        lines=lines,
        candidates=candidates_of(tried),
        message=_message(chosen, lines, share, rms, found),
        noise=noise,
        rms=rms,
        structure=chosen.structure,
        theta=solution.theta,
        covariance=found.covariance,
    )


def _line(turbidity: Array, b: Array, covariance: Array) -> Line:
    """Generalised least squares, and the χ² test of what is left."""
    from scipy.stats import chi2

    # what is at a bound has no error, and says nothing
    known = np.diag(covariance) > 0
    turbidity, b, covariance = turbidity[known], b[known], covariance[np.ix_(known, known)]
    system = np.stack([np.ones_like(turbidity), turbidity], 1)
    inverse = np.linalg.pinv(covariance, hermitian=True)
    spread_of_line = np.linalg.pinv(system.T @ inverse @ system, hermitian=True)
    values = spread_of_line @ system.T @ inverse @ b
    left = b - system @ values
    errors = np.sqrt(np.maximum(np.diag(spread_of_line), 0.0))
    free = len(b) - 2
    odds = float(chi2.sf(left @ inverse @ left, free)) if free > 0 else None
    (b0, k), (b0_error, k_error) = values.tolist(), errors.tolist()
    correlation = float(spread_of_line[0, 1]) / max(b0_error * k_error, 1e-300)
    return Line(b0, b0_error, k, k_error, correlation, odds)


def _message(
    chosen: Tried[SeriesWater],
    lines: Mapping[str, Line],
    share: float,
    rms: float,
    spread: Spread,
) -> str:
    """A few sentences."""
    sentences = [f"Model {chosen.name!r}. {explains(rms, share, 'the variance')}"]
    off = []
    for colour, line in lines.items():
        if line.probability is not None and line.probability < _UNLIKELY:
            off.append(colour)
    untested = [colour for colour, line in lines.items() if line.probability is None]
    if untested:
        known = f"In {', '.join(untested)} two turbidities or fewer have a known b"
        sentences.append(f"{known}, which lie on any line: a third would test it.")
    if off:
        sentences.append(f"Scattering does not follow turbidity on a line in {', '.join(off)}.")
    elif len(untested) < len(lines):
        sentences.append("Scattering follows turbidity on a line, within its errors.")
    sentences += dependent(spread, ", as the model misses something")
    return "\n".join(sentences)
