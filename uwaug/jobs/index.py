"""Lists of pictures, as CSV or Parquet: what a run reads, and what it writes.

A list that is read has a column `input` and, if it likes, `id`, `distance` and `output`; paths
are from its own folder, outputs from the folder of the run. A distance may be a number of metres.
"""

import csv
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from uwaug._support import checks
from uwaug._support.atomic import require_regular

__all__ = ["INDICES", "Line", "number_of", "read_index", "require_pyarrow"]

INDICES = (".csv", ".parquet")
"""Ends of their names."""

_COLUMNS = ("input", "id", "distance", "output")


class Line(NamedTuple):
    """A line of a list; None where it says nothing."""

    input: str
    id: str | None
    distance: str | None
    output: str | None

    def distance_from(self, folder: Path) -> Path | float | None:
        """Metres, or a path; `folder` is the list's own."""
        if self.distance is None:
            return None
        metres = number_of(self.distance)
        return folder / self.distance if metres is None else metres


def number_of(distance: str) -> float | None:
    """Metres, if that is what a distance says.

    Raises:
        ValueError: if they are not finite and > 0.
    """
    try:
        metres = float(distance)
    except ValueError:
        return None
    checks.positive("distance", metres, "m")
    return metres


def read_index(path: Path) -> Iterator[Line]:
    """The lines of a list, one by one.

    Raises:
        ValueError: if it has no column input, or a line none; names it.
        ImportError: if it is Parquet and pyarrow is not installed.
        OSError: if it cannot be read.
    """
    require_regular(path)
    rows = _parquet(path) if path.suffix.lower() == ".parquet" else _csv(path)
    for place, row in rows:
        values = {name: _text(row.get(name)) for name in _COLUMNS}
        if any("\0" in (text or "") for text in values.values()):
            raise ValueError(f"{path}: {place} is no text")
        picture = values["input"]
        if picture is None:
            raise ValueError(f"{path}: {place} has no input")
        yield Line(picture, values["id"], values["distance"], values["output"])


def _text(value: Any) -> str | None:
    return None if value is None or str(value).strip() == "" else str(value).strip()


def _require_input(path: Path, columns: list[str]) -> None:
    if "input" not in columns:
        raise ValueError(f"{path}: expected a column input, got {', '.join(columns) or 'none'}")


def _csv(path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    # some spreadsheets begin a file with a mark
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.DictReader(file, skipinitialspace=True)
        try:
            _require_input(path, list(reader.fieldnames or []))
            for row in reader:
                yield f"line {reader.line_num}", row
        except (csv.Error, UnicodeDecodeError) as error:
            raise ValueError(f"{path}: is no CSV: {error}") from None


def _parquet(path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    require_pyarrow(f"{path} is Parquet")
    import pyarrow as pa
    import pyarrow.parquet as pq

    count = 0
    try:
        with pq.ParquetFile(path) as file:
            names = file.schema_arrow.names
            _require_input(path, names)
            for batch in file.iter_batches(columns=[name for name in _COLUMNS if name in names]):
                for row in batch.to_pylist():
                    count += 1
                    yield f"row {count}", row
    except (pa.ArrowException, OSError) as error:
        raise ValueError(f"{path}: is no Parquet file, or damaged: {error}") from None


def require_pyarrow(what: str) -> None:
    """Refuse what needs pyarrow where it is not installed.

    Raises:
        ImportError: names the extra.
    """
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        cure = 'pip install ".[parquet]" in a checkout of uwaug'
        raise ImportError(f"{what}, which pyarrow reads and writes: {cure}") from None
