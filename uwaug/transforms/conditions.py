"""Conditions: numbers of water, light and camera that belong together."""

import csv
import os
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as option
from functools import cache
from itertools import accumulate
from pathlib import Path
from typing import Any

from uwaug._support import codec
from uwaug._support.atomic import read_text
from uwaug._support.nouns import Uniform
from uwaug.optics.constituents import UNITS
from uwaug.transforms.appearance import Nearness

_PHOTOGRAPHED = Path(__file__).with_name("conditions.csv")
BETWEEN = 0.4
"""Share of the way to another condition of photographs; .1 leaves more of what was left out."""

OF_WATER = ("clearness", "vertical_depth", "mu", "color_matrix")
OF_DEVELOPMENT = ("exposure", "white_balance", "saturation", "gamut", "tone")
COLUMNS = ("weight", *UNITS, *OF_WATER, *OF_DEVELOPMENT, "full_well")
"""Numbers of a condition, as the file holds them."""

_LOGARITHMIC = {*UNITS, "full_well"}


@codec.plain
@dataclass(frozen=True, repr=False)
class Conditions:
    """Conditions of photographs: each picture takes one, all of its numbers together.

    Attributes:
        rows: {"water": …, "light": …, "development": …} of each, as `RandomUnderwater.make_params`
            draws them, without seeds. What they leave out is drawn for each picture.
        weights: how often each is picked; None: alike.
        between: a picture lies up to this share of the way from its condition to another, 0…1.
        binding: True if they hold whatever the options say; else an option that differs from its
            default wins.
        nearness: of the conditions to the photographs for which they were found; not in `to_dict`.

    ValueError if there are none.
    """

    rows: Sequence[Mapping[str, Any]]
    weights: Sequence[float] | None = None
    between: float = 0.0
    binding: bool = True
    nearness: Nearness | None = option(default=None, compare=False, metadata={"stored": False})

    def __post_init__(self) -> None:
        if not self.rows:
            raise ValueError("conditions: expected at least one, got none")
        weights = [1.0] * len(self.rows) if self.weights is None else self.weights
        if len(weights) != len(self.rows) or not min(weights) >= 0 < sum(weights):
            got = f"{len(weights)} for {len(self.rows)} conditions"
            raise ValueError(f"weights must be one for each condition, none below 0, got {got}")
        vars(self)["_sums"] = list(accumulate(weights))

    @staticmethod
    def read(path: str | os.PathLike[str]) -> "Conditions":
        """Read a CSV file with the columns of conditions.csv, as the benchmark of conditions writes
        it (`--write`). Options that are set win over them. ValueError if a column is missing, but
        for contents, which are 0 then, or a number is none.
        """
        lines = csv.DictReader(read_text(Path(path)).splitlines())
        none = dict.fromkeys(UNITS, 0.0)
        try:
            numbers = [{n: float((none | line)[n]) for n in COLUMNS} for line in lines]
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path}: expected numbers in {', '.join(COLUMNS)}: {error}") from None
        weights = [row["weight"] for row in numbers]
        return Conditions([*map(_row_of, numbers)], weights, BETWEEN, binding=False)

    def picked(self, uniform: Uniform) -> Mapping[str, Any]:
        """The condition of one picture."""
        row = self._row(uniform("condition"))
        if self.between:
            other, share = self._row(uniform("other condition")), uniform("between")
            row = mixed(row, other, self.between * share)
        return row

    def _row(self, share: float) -> Mapping[str, Any]:
        sums = vars(self)["_sums"]
        return self.rows[bisect_right(sums, share * sums[-1], hi=len(sums) - 1)]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self.rows)} rows)"


@cache
def photographed() -> Conditions:
    """Conditions in which draws look like photographs and the frames of machines' cameras. How they
    were found: benchmarks/README.md, accuracy.
    """
    return Conditions.read(_PHOTOGRAPHED)


def _row_of(numbers: Mapping[str, float]) -> dict[str, Any]:
    """The condition of the numbers in `COLUMNS`."""
    water = {"waters": [{name: numbers[name] for name in UNITS}]}
    development = {name: numbers[name] for name in OF_DEVELOPMENT}
    return {
        "water": water | {name: numbers[name] for name in OF_WATER},
        "development": development | {"noise": {"full_well": numbers["full_well"]}},
    }


def mixed(first: Mapping[str, Any], second: Mapping[str, Any], share: float) -> dict[str, Any]:
    """Numbers a share of the way from one condition to another; all else is the first's."""
    numbers = dict(first)
    for name, value in first.items():
        other: Any = second.get(name)
        if type(value) is type(other) is float:
            if name in _LOGARITHMIC and min(value, other) > 0:
                numbers[name] = value * (other / value) ** share
            else:
                numbers[name] = value + share * (other - value)
        elif isinstance(value, dict) and isinstance(other, dict):
            numbers[name] = mixed(value, other, share)
        elif name == "waters" and other:  # contents, or names
            pairs = zip(value, other, strict=True)
            both = [pair for pair in pairs if all(isinstance(water, dict) for water in pair)]
            numbers[name] = [mixed(*pair, share) for pair in both] or value
    return numbers


def laid_over(sample: Mapping[str, Any], condition: Mapping[str, Any]) -> dict[str, Any]:
    """What a picture has drawn, with the numbers of its condition in their place."""
    merged = dict(sample)
    for name, value in condition.items():
        # daylight and lamps have other numbers
        is_table = isinstance(value, dict) and name in sample and name != "light"
        merged[name] = laid_over(sample[name], value) if is_table else value
    return merged
