"""Results of fits: numbers with their errors, as a medium and as files."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from torch import Tensor

from uwaug._support import checks, codec
from uwaug._support.atomic import require_regular, written_whole
from uwaug._support.types import Array
from uwaug.fitting.data import Geometry, Pictures
from uwaug.formation.setting import Setting
from uwaug.formation.underwater import Underwater
from uwaug.optics.medium import Medium
from uwaug.optics.water import Water

if TYPE_CHECKING:
    from matplotlib.figure import Figure

State = Literal["free", "at bound", "not identified", "fixed"]

VISIBLE_LIGHT = 0.002  # of linear light, the least that shows: half of a step of 8 bits
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
    values: Mapping[str, float] = field(default_factory=dict)  # visibility and depth of a type, m


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
        setting: the water (exposure included, a batch of one, float64), and the view and color
            space of the pictures: `module` makes the observed picture of the clean one by it.
        geometry: distances [m] and size [px] of the pictures.
        rms: root mean square of the residual, in linear light.
        notes: sentences on the result, and on what the pictures cannot tell.
        candidates: the models or types that were tried.
        remainder: residuals by distance.
        adequate: True if the residuals are noise; False if the model misses something; None by
            `fit_veil`.
        water: spectra with the fitted contents, for `uwaug.RandomUnderwater`; by `fit_water` alone.
        pictures: the fitted pictures; None if the fit was read from a file.
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
        from uwaug.fitting.words import summary

        return summary(self)

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


def load_fit(path: str | os.PathLike[str]) -> Fit:
    """Read a fit that `Fit.save` wrote. A file that is none is a ValueError that names it."""
    require_regular(path)
    try:
        fit: Fit = codec.from_plain(json.loads(Path(path).read_text(encoding="utf-8")), Fit)
        checks.instance("fit", fit, Fit)
        return fit
    except (LookupError, RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: not a fit: {error}") from None
