"""Arrays over wavelength: checked, read from files, with value semantics."""

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
"""The 61 bands, nm, that stand for an integral over wavelength."""


@lru_cache(maxsize=16)
def bands_between(low: float, high: float) -> Array:
    """Bands of `WAVELENGTHS` between two wavelengths, nm."""
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
        return hash((self.name, self.wavelengths.size))  # a hash of the arrays takes 10 µs

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
    """Check a wavelength axis, nm, and make it a read-only array.

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
    """Check a spectrum ≥ 0 on a wavelength axis (N), and make it a read-only array (N, *channels).

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
    nonfinite = ~np.isfinite(array)
    _refuse(name, nonfinite, axis, "NaN or infinite", "fill them or leave these wavelengths out")
    _refuse(name, array < 0, axis, "negative", "set measurement noise to 0")
    return array


def _refuse(name: str, bad: NDArray[np.bool_], axis: Array, fault: str, cure: str) -> None:
    if not bad.any():
        return
    nm = axis[bad.reshape(axis.size, -1).any(axis=1)]
    places = ", ".join(f"{at:g}" for at in nm[:8]) + (", …" if nm.size > 8 else "")
    raise ValueError(f"{name} has {bad.sum()} {fault} of {bad.size} values, at {places} nm: {cure}")


_NO_LETTER = re.compile(r"[\W\d]")


def read_spectra(path: Path, spectra: Mapping[str, str]) -> Array:
    """Read the table (N, 1 + spectra) of a CSV file: wavelengths, then spectra, with or without one
    header line.

    Args:
        path: path of the file.
        spectra: name of each spectrum, and a word that may stand for it. The cells of a header
            begin with one of both, in any case: "b [1/m]" and "scattering", while "beta" and "bb"
            are something else.

    Raises:
        ValueError: if it is no such table; the message names the line.
        OSError: if the file cannot be read.
    """
    require_regular(path)
    table: list[list[float]] = []
    names = ", ".join(["wavelength", *spectra])
    columns = 1 + len(spectra)
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        reader = csv.reader(file)
        is_first = True
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
                elif not (is_first and len(row) == columns and _is_header(row[1:], spectra)):
                    # the row is not shown: a preset of somebody else may name a private file
                    count = {3: "three", 4: "four"}[columns]
                    raise ValueError(
                        f"{path}, line {reader.line_num}: expected {count} numbers, {names}, "
                        "separated by commas, below a header with these names or none"
                    )
                is_first = False
        except csv.Error as error:
            raise ValueError(f"{path}, line {reader.line_num}: {error}") from None
    if not table:
        raise ValueError(f"{path}: no rows of {names}")
    return np.array(table)


def _is_header(cells: Sequence[str], spectra: Mapping[str, str]) -> bool:
    """True if each cell begins with the name of its spectrum, or the word that stands for it."""
    words = [_NO_LETTER.split(cell.strip().lower(), 1)[0] for cell in cells]
    pairs = zip(words, spectra.items(), strict=True)
    return all(word in (name.lower(), other) for word, (name, other) in pairs)
