"""Arrays over wavelength: checked, read from files, with value semantics."""

import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uwaug._support.atomic import require_regular
from uwaug._support.types import Array

WAVELENGTHS = np.arange(400.0, 701.0, 5.0)  # nm, bands that stand for an integral


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
    """Check a wavelength axis, strictly ascending, 100…3000 nm, and make it a read-only array."""
    axis = _frozen_array("wavelengths", values)
    if axis.ndim != 1 or axis.size == 0:
        raise ValueError(f"wavelengths must be 1-D and not empty, got shape {axis.shape}")
    for before, after in pairwise(axis):
        if not before < after:
            raise ValueError(f"wavelengths must ascend strictly, got {after:g} after {before:g}")
    low, high = axis[[0, -1]]
    if not (low >= 100 and high <= 3000):
        raise ValueError(f"wavelengths must be in nm, between 100 and 3000, got {low:g}…{high:g}")
    return axis


def spectrum(name: str, values: ArrayLike, axis: Array, channels: tuple[int, ...] = ()) -> Array:
    """Check a spectrum ≥ 0 on a wavelength axis (N), and make it a read-only (N, *channels)."""
    array = _frozen_array(name, values)
    expected = (*axis.shape, *channels)
    if array.shape != expected:
        raise ValueError(f"{name} must have shape {expected}, as wavelengths, got {array.shape}")
    bad = ~((array >= 0) & (array < np.inf))
    if bad.any():
        at = f"{axis[np.nonzero(bad)[0][0]]:g} nm, and {bad.sum()} of {bad.size} in all"
        raise ValueError(f"{name} must be finite and ≥ 0, got {array[bad][0]:g} at {at}")
    return array


_NO_LETTER = re.compile(r"[\W\d]")
# as headers write them: "a [1/m]", "b (m^-1)", "K_d/m⁻¹"
_NM, _PER_METRE = ("", "nm", "/nm"), ("", "1/m", "/m", "m-1", "/m-1")


def read_spectra(
    path: Path, *tables: Mapping[str, str], per_metre: bool = False, cure: str = ""
) -> dict[str, Array]:
    """Read a table of a CSV file: wavelengths, then spectra, with or without one header line.

    Args:
        path: path of the file. Commas separate cells; or semicolons or tabs, beside which decimal
            commas are read, too.
        tables: name of each spectrum, and a word that may stand for it, of each table that a header
            may announce; without one it is the first. Cells of a header begin with one of both, in
            any case: "b [1/m]" and "scattering", but not "beta" or "bb".
        per_metre: spectra are rates: a unit in the header must be 1/m.
        cure: end of the error where the first line is of no such table.

    Returns:
        Arrays (N) by name: "wavelength" [nm], and the spectra. A file that is no such table is a
        ValueError that names the line.
    """
    require_regular(path)
    lines = path.read_text("utf-8-sig", errors="replace").splitlines()
    sign = next((sign for sign in ";\t" if lines and sign in lines[0]), ",")
    texts = {number: line.split(sign) for number, line in enumerate(lines, 1)}
    cells = {
        n: [cell.strip(' "') for cell in row]
        for n, row in texts.items()
        if any(map(str.strip, row))
    }
    first = min(cells, default=0)
    announced = [table for table in tables if first and _announces(cells[first][1:], table)]
    names = ["wavelength", *(announced or tables)[0]]
    header = cells.pop(first) if announced else []
    for name, cell in zip(names, header, strict=False):
        units = _NM if name == "wavelength" else _PER_METRE
        if (name == "wavelength" or per_metre) and _unit(cell) not in units:
            raise ValueError(f"{path}: the header gives {name} in another unit than {units[1]}")
    rows: list[list[float]] = []
    for number, row in cells.items():
        try:
            rows.append([float(cell.replace(",", ".")) for cell in row])
        except ValueError:
            rows.append([])
        if len(rows[-1]) != len(names):
            # the row is not shown: a preset of somebody else may name a private file
            expected = f"numbers {', '.join(names)}, separated by commas or semicolons"
            more = f", below a header of these names or none{cure}" if number == first else ""
            raise ValueError(f"{path}, line {number}: expected {expected}{more}")
    if not rows:
        raise ValueError(f"{path}: no rows of {', '.join(names)}")
    return dict(zip(names, np.array(rows).T, strict=True))


def _announces(cells: Sequence[str], spectra: Mapping[str, str]) -> bool:
    words = [_NO_LETTER.split(cell.lower(), 1)[0] for cell in cells]
    pairs = zip(words, spectra.items(), strict=False)
    is_whole = len(words) == len(spectra)
    return is_whole and all(word in (name.lower(), other) for word, (name, other) in pairs)


def _unit(cell: str) -> str:
    """What follows the first word in a cell of a header, without blanks, brackets and ^."""
    text = unicodedata.normalize("NFKC", cell).lower().replace("\u2212", "-")
    return re.sub(r"[\s^{}()\[\]]", "", text[len(_NO_LETTER.split(text, 1)[0]) :])
