"""Results of fits: numbers with their errors, as a medium and as files."""

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from torch import Tensor

from uwaug._support import checks, codec
from uwaug._support.atomic import require_regular, written_whole
from uwaug._support.types import Array
from uwaug.fitting.data import Geometry, Pictures
from uwaug.fitting.model import COLOURS
from uwaug.formation.setting import Setting
from uwaug.formation.underwater import Underwater
from uwaug.optics.medium import Medium
from uwaug.optics.water import Water

if TYPE_CHECKING:
    from matplotlib.figure import Figure

State = Literal["free", "at bound", "not identified", "fixed"]

_MAX_DIGITS = 12  # of the ends of an interval
# of numbers whose name and unit are not enough, by kind
_MEANINGS = {
    "veil": "of white, V(0)",
    "source": "of white, G·V(0)",
    "gain": "times the light of clean",
    "exponent": "of σ over distance",
    "contents": "times those of the type",
    "exposure": "times that of the first picture",
    "light": "on the chart, of the common light",
    "distance": "times that given",
}
# Range that a fit's module is planned for, in shares of the median and of the farthest distance.
_NEAR_SHARE, _FAR_SHARE = 0.2, 1.5


@codec.plain
@dataclass(frozen=True)
class Parameter:
    """A number that a fit reports; None for what there is not."""

    value: float | None
    error: float | None  # standard error
    low: float | None  # this and the next: ends of the 95 % interval
    high: float | None
    unit: str  # "1/m", "m", "px" or "1"
    state: State  # free, at the end of its range, not told by the pictures, or given

    @property
    def interval(self) -> str:
        """The 95 % interval in words, with as many digits as tell its ends apart."""
        if self.low is None or self.high is None:
            return ""
        for digits in range(4, _MAX_DIGITS):
            low, high = f"{self.low:.{digits}g}", f"{self.high:.{digits}g}"
            if low != high:
                break
        return f"{low} … {high}"


@codec.plain
@dataclass(frozen=True)
class Candidate:
    """A model, or a Jerlov type, that was tried."""

    name: str
    numbers: int  # count of the fitted numbers
    # root of the mean loss of left-out pixels (for a type: of the fitted pixels), in standard
    # deviations of the noise
    error: float
    behind: float  # excess of the summed loss over that of the best
    behind_error: float  # standard error of it
    chosen: bool = False  # True for the candidate of the fit


@codec.plain
@dataclass(frozen=True)
class Remainder:
    """Residual of the pixels at one distance."""

    distance: float  # median, m
    mean: tuple[float, ...]  # of observed − fitted, in linear light, for red, green and blue
    error: tuple[float, ...]  # standard error of each mean, if the noise were independent


@codec.plain
@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """A water that was recovered from pictures, or read by `load_fit`.

    Attributes:
        model: a model of `uwaug.fit`, a Jerlov type or "no Jerlov type", or "darkest pixels".
        parameters: each number by name.
        covariance: covariance of all `parameters`, in their order; of no use where one is not
            identified.
        setting: the water (exposure included, a batch of one, float64), view and color space.
        geometry: distances [m] and size [px] of the pictures.
        rms: root mean square of the residual, in linear light.
        notes: sentences on the result, and on what the pictures cannot tell.
        candidates: the models or types that were tried.
        remainder: residuals by distance.
        adequate: True if the residuals are noise; False if the model misses something; None by
            `fit_veil`.
        water: spectra with the fitted contents, for `uwaug.RandomUnderwater`; by `fit_water` alone.
        pictures: the fitted pictures; None if the fit was read from a file.
        patches: distances (N), measured and fitted light (3xN each) of `fit_patches`; else None.
    """

    model: str
    parameters: dict[str, Parameter]
    covariance: Array
    setting: Setting
    geometry: Geometry
    rms: float
    notes: tuple[str, ...]
    candidates: tuple[Candidate, ...] = ()
    remainder: tuple[Remainder, ...] = ()
    adequate: bool | None = None
    water: Water | None = None
    pictures: Pictures | None = field(default=None, metadata={"stored": False})
    patches: tuple[Array, Array, Array] | None = field(default=None, metadata={"stored": False})

    @property
    def medium(self) -> Medium:
        """The water of `setting`."""
        return self.setting.medium

    @property
    def errors(self) -> dict[str, float]:
        """Standard errors by name, of the numbers that have one."""
        return {name: x.error for name, x in self.parameters.items() if x.error is not None}

    def module(self, sides: tuple[int, int] | None = None) -> Underwater:
        """The setting as a module for distances from .2 times the median of the fitted ones to 1.5
        times the farthest; `sides` as of `uwaug.Underwater`.
        """
        low, high = _NEAR_SHARE * self.geometry.reference, _FAR_SHARE * self.geometry.farthest
        return Underwater.of(self.setting, (low, high), sides=sides)

    def rendered(self) -> Tensor:
        """The observed pictures (Bx3xHxW, linear light) as the water makes them of the clean."""
        if self.pictures is None or not self.pictures.clean.any():
            raise ValueError("the fit has no clean pictures: fit them again to see these")
        return self.pictures.rendered(self.setting)

    def summary(self) -> str:
        """The result as text: notes, parameters, candidates, residuals by distance."""
        rows = [["", "value", "std. error", "95 % interval", "unit"]]
        for name, number in self.parameters.items():
            value = "not identified" if number.value is None else f"{number.value:.4g}"
            error = "" if number.error is None else f"{number.error:.2g}"
            rows.append([name, value, error, number.interval, self._meaning(name)])
        lines = [*self.notes, *_aligned(rows)]
        if len(self.candidates) > 1:
            # errors are in standard deviations of the noise, what lies behind in their squares
            rows = [["  model", "numbers", "error [σ]", "behind the best [σ²]", ""]]
            for x in self.candidates:
                behind = f"{x.behind:.4g} ± {x.behind_error:.2g}"
                name = f"{'*' if x.chosen else ' '} {x.name}"
                rows.append([name, str(x.numbers), f"{x.error:.4f}", behind, ""])
            lines += _aligned(rows)
        if self.remainder:
            rows = [["observed − fitted", *COLOURS, "of linear light"]]
            for part in self.remainder:
                cells = [f"{m:+.4f} ± {e:.4f}" for m, e in zip(part.mean, part.error, strict=True)]
                rows.append([f"at {part.distance:.3g} m", *cells, ""])
            lines += _aligned(rows)
        return "\n".join(lines)

    def _meaning(self, name: str) -> str:
        number, kind, geometry = self.parameters[name], name.partition("_")[0], self.geometry
        meaning = _MEANINGS.get(kind, "")
        if kind == "width":
            meaning = f"σ at {geometry.reference:.3g} m"
        if kind in ("beta", "G"):
            meaning = f"one rate for {geometry.nearest:.3g} to {geometry.farthest:.3g} m"
        if kind == "beta" and self.model in ("haze", "veil"):
            meaning += ", of direct and forward light together"
        unit = number.unit if number.unit != "1" or not meaning else ""
        state = f"({number.state})" if number.state in ("at bound", "fixed") else ""
        return "  ".join(filter(None, (unit, meaning, state)))

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        numbers = [f"{name} = {x.value:.3g}" for name, x in self.parameters.items() if x.value]
        return f"Fit({self.model!r}, {', '.join(numbers[:3])}, …)"

    def plot(self) -> "Figure":
        """Draw the result: pictures, residuals by distance, curves; needs matplotlib."""
        from uwaug.fitting.plot import plot

        return plot(self)

    @staticmethod
    def of_plain(covariance: Any, **values: Any) -> "Fit":
        """A fit of plain values, for `uwaug._support.codec`."""
        return Fit(covariance=np.array(covariance), **values)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the result as JSON, whole or not at all; `uwaug.fitting.load_fit` reads it."""
        with written_whole(path) as part:
            part.write_text(json.dumps(codec.to_plain(self), indent=1) + "\n", encoding="utf-8")


def _aligned(rows: list[list[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [""]
    for first, *numbers, last in rows:
        cells = [cell.rjust(width) for cell, width in zip(numbers, widths[1:], strict=False)]
        lines.append("  ".join(["", first.ljust(widths[0]), *cells, last]).rstrip())
    return lines


def load_fit(path: str | os.PathLike[str]) -> Fit:
    """Read a fit that `Fit.save` wrote. A file that is none is a ValueError that names it."""
    require_regular(path)
    try:
        fit: Fit = codec.from_plain(json.loads(Path(path).read_text(encoding="utf-8")), Fit)
        checks.instance("fit", fit, Fit)
        return fit
    except (LookupError, RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: not a fit: {error}") from None
