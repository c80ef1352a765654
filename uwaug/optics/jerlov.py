"""Tables of the Jerlov water types, with misprints repaired; sources: `waters/NOTICE`."""

import csv
from functools import cache
from pathlib import Path

import numpy as np

from uwaug._support import checks
from uwaug._support.types import Array

# the types as they are classified: open ocean, then coast, clear to turbid
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
JERLOV_TYPES = tuple(IN_WORDS)

# a new table is a file of `waters`, with lines of `provenance.csv`
SOURCES = ("solonenko2015", "williamson2022")


def repaired_table(type: str, source: str) -> tuple[Array, dict[str, Array], list[str]]:
    """Wavelengths [nm], spectra a, b and kd [1/m] without gaps, and their sources, of a water type;
    see `Water.jerlov`.
    """
    checks.one_of("source", source, SOURCES)
    rows = _rows(source)
    types = dict.fromkeys(row["type"] for row in rows)
    if type not in types:
        names = f"{', '.join(types)} with source {source!r}"
        raise ValueError(f"type must be one of {names}, got {type!r}")
    axis, *spectra = (
        np.array([float(row[key]) for row in rows if row["type"] == type])
        for key in ("wavelength", "a", "b", "kd")
    )
    notes = [
        f"Jerlov {type}: {row['note']}"
        for row in _rows("provenance")
        if (row["source"], row["type"]) == (source, type)
    ]
    return axis, dict(zip(("a", "b", "kd"), spectra, strict=True)), notes


@cache
def _rows(name: str) -> list[dict[str, str]]:
    path = Path(__file__).parent / "waters" / f"{name}.csv"
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))
