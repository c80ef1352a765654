"""The tables of Jerlov's water types, as the package `jerlov` holds them, with their misprints
repaired.
"""

import re
import warnings
from collections import defaultdict
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uwaug import checks

__all__ = ["JERLOV_TYPES", "SOURCES", "Table", "repaired_table"]

Array = NDArray[np.float64]

JERLOV_TYPES = ("I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C")
"""The Jerlov water types in the order of their classification: open ocean, then coast, clear to
turbid.
"""

SOURCES = {
    "solonenko2015": "Solonenko & Mobley 2015, doi:10.1364/AO.54.005392",
    "williamson2022": "Williamson & Hollins 2022, doi:10.1364/AO.470464",
}

_LABELS = {"a": "a", "b": "b", "kd": "K_d"}
_MISPRINT = "misprinted in Solonenko & Mobley 2015, Table 7"
_FLAGS = {
    "suspect": "suspect: disagrees with the particle concentrations of the paper's own Table 3",
    "reconstructed": f"reconstructed from Eq. (8) and Table 3 of the paper ({_MISPRINT})",
    "model_extrapolation": "extrapolated by the paper's model (measured at 412–715 nm)",
}
# a misprinted or missing value is taken from here; b comes reconstructed from `jerlov` itself
_REPAIRS = {
    "a": ("williamson2022", "Williamson & Hollins 2022"),
    "kd": ("jerlov1976", "Jerlov 1976, Table XXVII"),
}


class Table(NamedTuple):
    """Wavelengths [nm], a, b and K_d [1/m] at each, and a statement of where each is from."""

    wavelengths: Array
    spectra: dict[str, Array]
    provenance: list[str]


def repaired_table(type: str, source: str) -> Table:
    """The table of a water type, without gaps; see `Water.jerlov`."""
    import jerlov

    checks.one_of("source", source, SOURCES)
    types = jerlov.SOURCES[source].water_types
    if type not in types:
        known = ", ".join(types)
        raise ValueError(f"type must be one of {known} with source {source!r}, got {type!r}")
    grid = jerlov.water(type, source=source).wavelengths
    if source == "williamson2022":
        # the K_d to go with it was printed for 310–700 nm; the package extrapolates beyond
        grid = grid[(grid >= 310) & (grid <= 700)]
    spectra, notes = {}, []
    for key, label in _LABELS.items():
        values, flags = _tabulated(type, source, key, grid)
        gaps = np.isnan(values)
        if not gaps.all():
            notes.append(f"Jerlov {type}: {label}: {SOURCES[source]}")
        if gaps.any():
            repair, cited = _REPAIRS[key]
            values[gaps], _ = _tabulated(type, repair, key, grid[gaps])
            reason = "not in this source" if gaps.all() else _MISPRINT
            flags[f"{cited} ({reason})"] = grid[gaps].tolist()
        for flag, nm in flags.items():
            where = f"{label} at {min(nm):g}–{max(nm):g} nm"
            notes.append(f"Jerlov {type}: {where}: {_FLAGS.get(flag, flag)}")
        spectra[key] = values
    return Table(grid, spectra, notes)


def _tabulated(
    type: str, source: str, key: str, grid: Array
) -> tuple[Array, dict[str, list[float]]]:
    """One quantity, NaN where `jerlov` has none, and the wavelengths of each flag it raises."""
    import jerlov

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", jerlov.ProvenanceWarning)
        try:
            values = getattr(jerlov.water(type, source=source), key)(grid)
        except jerlov.MissingQuantityError:
            values = np.full(grid.size, np.nan)
    flags: dict[str, list[float]] = defaultdict(list)
    for warning in caught:
        for flag, nm in re.findall(r"(\w+) at ([\d.]+) nm", str(warning.message)):
            flags[flag].append(float(nm))
    flags.pop("missing", None)
    return values, flags
