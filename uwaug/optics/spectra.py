"""Arrays over wavelength, checked, with value semantics."""

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uwaug._support.atomic import require_regular
from uwaug._support.types import Array

WAVELENGTHS = np.arange(400.0, 701.0, 5.0)
"""nm, the 61 bands that stand for the integral."""


@lru_cache(maxsize=16)
def bands_between(low: float, high: float) -> Array:
    """Those of `WAVELENGTHS` that lie between two, nm."""
    bands: Array = WAVELENGTHS[(low <= WAVELENGTHS) & (high >= WAVELENGTHS)]
    bands.flags.writeable = False
    return bands


class Spectra:
    """Value semantics for a frozen dataclass of arrays: compared, hashed, copied by content."""

    name: str
    wavelengths: Array

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return all(np.array_equal(mine, theirs) for mine, theirs in pairs)

    def __hash__(self) -> int:
        return hash((self.name, self.wavelengths.size))  # of all of it, it takes 10 µs

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        # rebuilt by the constructor, because unpickled arrays are writable
        return partial(type(self), **vars(self)), ()

    def __repr__(self) -> str:
        low, high = self.wavelengths[[0, -1]]
        count = self.wavelengths.size
        return f"{type(self).__name__}({self.name!r}, {count} wavelengths, {low:g}–{high:g} nm)"


def _frozen_array(name: str, values: ArrayLike) -> Array:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name} must be an array of numbers, got {values!r:.80}") from error
    array.flags.writeable = False
    return array


def wavelength_axis(values: ArrayLike) -> Array:
    """A read-only, strictly ascending wavelength axis in nm.

    Raises:
        TypeError: if the values are no numbers.
        ValueError: if the axis is empty, not 1-D, not strictly ascending or not in nm (100…3000).
    """
    axis = _frozen_array("wavelengths", values)
    if axis.ndim != 1 or axis.size == 0:
        raise ValueError(
            f"wavelengths must be 1-D with at least one sample, got shape {axis.shape}"
        )
    bad = np.count_nonzero(~np.isfinite(axis))
    if bad:
        raise ValueError(f"wavelengths must be finite, got {bad} NaN or infinite values")
    drops = np.flatnonzero(np.diff(axis) <= 0)
    if drops.size:
        left, right = axis[drops[0] : drops[0] + 2]
        raise ValueError(
            f"wavelengths must be strictly ascending, but {left:g} is followed by {right:g}: "
            "sort them, each once"
        )
    low, high = axis[[0, -1]]
    if not (low >= 100 and high <= 3000):
        raise ValueError(f"wavelengths must be in nm, between 100 and 3000, got {low:g}…{high:g}")
    return axis


def spectrum(name: str, values: ArrayLike, axis: Array, channels: tuple[int, ...] = ()) -> Array:
    """A read-only spectrum ≥ 0 on a wavelength axis (N), of shape (N, *channels).

    Raises:
        TypeError: if the values are no numbers.
        ValueError: if the shape is another, or a value is NaN, infinite or negative.
    """
    array = _frozen_array(name, values)
    expected = (*axis.shape, *channels)
    if array.shape != expected:
        raise ValueError(
            f"{name} must have one row per wavelength, shape {expected}, got {array.shape}"
        )
    unknown = ~np.isfinite(array)
    _refuse(name, unknown, axis, "NaN or infinite", "fill them or leave these wavelengths out")
    _refuse(name, array < 0, axis, "negative", "set measurement noise to 0")
    return array


def _refuse(name: str, bad: NDArray[np.bool_], axis: Array, what: str, cure: str) -> None:
    if not bad.any():
        return
    nm = axis[bad.reshape(axis.size, -1).any(axis=1)]
    where = ", ".join(f"{at:g}" for at in nm[:8]) + (", …" if nm.size > 8 else "")
    raise ValueError(f"{name} has {bad.sum()} {what} of {bad.size} values, at {where} nm: {cure}")


_NO_LETTER = re.compile(r"[\W\d]")


def read_spectra(path: Path, spectra: Mapping[str, str]) -> Array:
    """The table (N, 1 + spectra) of a CSV file: wavelengths, then spectra, with or without one
    header line.

    Args:
        path: of the file.
        spectra: their names, and a word that may stand for each. With one of both the cells of a
            header begin, in small letters or capitals: "b [1/m]" and "scattering", while "beta"
            and "bb" are something else.

    Raises:
        ValueError: if it is no such table; the message names the line.
        OSError: if the file cannot be read.
    """
    require_regular(path)
    named, table = ", ".join(["wavelength", *spectra]), []
    columns = 1 + len(spectra)
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        reader = csv.reader(file)
        header = True
        try:
            for row in reader:
                if not any(cell.strip() for cell in row):
                    continue
                try:
                    numbers = [float(cell) for cell in row]
                except ValueError:
                    numbers = []
                if len(numbers) == columns:
                    table.append(numbers)
                elif not (header and len(row) == columns and _named(row[1:], spectra)):
                    # what it says instead is not shown: a preset of somebody else may name a file
                    # that is none of theirs
                    where = f"{path}, line {reader.line_num}"
                    count = {3: "three", 4: "four"}[columns]
                    raise ValueError(
                        f"{where}: expected {count} numbers, {named}, separated by commas, "
                        "below a header with these names or none"
                    )
                header = False
        except csv.Error as error:
            raise ValueError(f"{path}, line {reader.line_num}: {error}") from None
    if not table:
        raise ValueError(f"{path}: no rows of {named}")
    return np.array(table)


def _named(cells: Sequence[str], spectra: Mapping[str, str]) -> bool:
    """Whether each cell of a header begins with the name of its spectrum, or its other word."""
    words = [_NO_LETTER.split(cell.strip().lower(), 1)[0] for cell in cells]
    pairs = zip(words, spectra.items(), strict=True)
    return all(word in (name.lower(), other) for word, (name, other) in pairs)
