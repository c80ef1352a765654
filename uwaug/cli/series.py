"""The CSV of a series of turbidities."""

import csv
from pathlib import Path

from uwaug._support.atomic import require_regular

__all__ = ["read_series"]

_FILES = ("clean", "observed", "distance")
_COLUMNS = (*_FILES, "turbidity")


def read_series(path: Path) -> tuple[dict[str, list[Path]], list[float]]:
    """The files of each picture by column, and its turbidity.

    Args:
        path: of a CSV with the columns clean, observed, distance (paths from its folder) and
            turbidity; others are not looked at.

    Raises:
        ValueError: if a column or a value is missing, or a turbidity is no number; names the line.
        OSError: if it cannot be read.
    """
    require_regular(path)
    files: dict[str, list[Path]] = {name: [] for name in _FILES}
    turbidity: list[float] = []
    # some spreadsheets begin a file with a mark
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.DictReader(file, skipinitialspace=True)
        columns = reader.fieldnames or []
        if not set(_COLUMNS) <= set(columns):
            got = ", ".join(columns) or "none"
            raise ValueError(f"{path}: expected the columns {', '.join(_COLUMNS)}, got {got}")
        for row in reader:
            line = f"line {reader.line_num}"
            for name in _COLUMNS:
                if not row[name]:
                    raise ValueError(f"{path}: {line} has no {name}")
            for name in _FILES:
                files[name].append(path.parent / row[name])
            try:
                turbidity.append(float(row["turbidity"]))
            except ValueError:
                got = f"got {row['turbidity']!r} in {line}"
                raise ValueError(f"{path}: turbidity must be a number, {got}") from None
    if not turbidity:
        raise ValueError(f"{path}: holds no pictures: expected a line for each")
    return files, turbidity
