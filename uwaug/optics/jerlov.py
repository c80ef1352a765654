"""Tables of the Jerlov water types, as the package `jerlov` holds them, with misprints repaired."""

import re
import warnings
from collections import defaultdict
from typing import NamedTuple

import numpy as np

from uwaug._support import checks
from uwaug._support.types import Array

IN_WORDS = {
    "I": "clearest ocean",
    "IA": "clear ocean",
    "IB": "clear ocean",
    "II": "ocean",
    "III": "murky ocean",
    "1C": "clear coast",
    "3C": "coast",
    "5C": "murky coast",
    "7C": "very murky coast",
    "9C": "murkiest coast",
}
"""The Jerlov water types, each in words."""

JERLOV_TYPES = tuple(IN_WORDS)
"""The Jerlov water types as they are classified: open ocean, then coast, clear to turbid."""


class Source(NamedTuple):
    """A source of tables that `jerlov` holds.

    Attributes:
        cited: paper and doi.
        low, high: range to use, nm, in which all three quantities have to be known.
        repairs: source of `jerlov` that fills the gaps of a quantity, and its citation. (The gaps
            of b come reconstructed from `jerlov` itself.)
        misprint: reason why a quantity has gaps beside values.
        flags: meaning of each flag of `jerlov`.
    """

    cited: str
    low: float
    high: float
    repairs: dict[str, tuple[str, str]]
    misprint: str
    flags: dict[str, str]


_LABELS = {"a": "a", "b": "b", "kd": "K_d"}
_MEASURED = ("williamson2022", "Williamson & Hollins 2022")
_JERLOV = ("jerlov1976", "Jerlov 1976, Table XXVII")
_MISPRINT = "misprinted in Solonenko & Mobley 2015, Table 7"

SOURCES = {
    "solonenko2015": Source(
        cited="Solonenko & Mobley 2015, doi:10.1364/AO.54.005392",
        low=300,
        high=700,
        repairs={"a": _MEASURED, "kd": _JERLOV},
        misprint=_MISPRINT,
        flags={
            "suspect": "suspect: disagrees with the particle concentrations of the paper's own "
            "Table 3",
            "reconstructed": f"reconstructed from Eq. (8) and Table 3 of the paper ({_MISPRINT})",
        },
    ),
    "williamson2022": Source(
        cited="Williamson & Hollins 2022, doi:10.1364/AO.470464",
        # K_d was printed for 310–700 nm; the package extrapolates beyond
        low=310,
        high=700,
        repairs={"kd": _JERLOV},
        misprint="not printed",
        flags={"model_extrapolation": "extrapolated by the paper's model (measured at 412–715 nm)"},
    ),
}


def repaired_table(type: str, source: str) -> tuple[Array, dict[str, Array], list[str]]:
    """Wavelengths [nm], spectra a, b and kd [1/m] without gaps, and their sources, of a water type;
    see `Water.jerlov`.
    """
    import jerlov

    checks.one_of("source", source, SOURCES)
    types = jerlov.SOURCES[source].water_types
    if type not in types:
        names = ", ".join(types)
        raise ValueError(f"type must be one of {names} with source {source!r}, got {type!r}")
    origin = SOURCES[source]
    grid = jerlov.water(type, source=source).wavelengths
    grid = grid[(grid >= origin.low) & (grid <= origin.high)]
    spectra, notes = {}, []
    for key, label in _LABELS.items():
        values, flags = _tabulated(type, source, key, grid)
        gaps = np.isnan(values)
        if not gaps.all():
            notes.append(f"Jerlov {type}: {label}: {origin.cited}")
        if gaps.any():
            if key not in origin.repairs:
                raise ValueError(f"source {source!r} has no {label} for type {type!r}")
            repair, cited = origin.repairs[key]
            values[gaps], _ = _tabulated(type, repair, key, grid[gaps])
            reason = "not in this source" if gaps.all() else origin.misprint
            flags[f"{cited} ({reason})"] = grid[gaps].tolist()
        for flag, nm in flags.items():
            subject = f"{label} at {min(nm):g}–{max(nm):g} nm"
            notes.append(f"Jerlov {type}: {subject}: {origin.flags.get(flag, flag)}")
        spectra[key] = values
    return grid, spectra, notes


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
