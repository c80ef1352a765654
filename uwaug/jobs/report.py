"""The index of a run: a line for each picture, as CSV and, with pyarrow, as Parquet."""

import csv
import importlib.util
import os
from array import array
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from uwaug._support.atomic import require_regular, written_whole
from uwaug.jobs.one import Outcome
from uwaug.jobs.rows import hash_of

__all__ = ["COLUMNS", "Index", "index_of", "written_outputs"]

COLUMNS = {
    "id": str,
    "variant": int,
    "input": str,
    "distance": str,
    "output": str,
    "water": str,
    "visibility": float,
    "contrast": float,
    "seconds": float,
    "status": str,
    "reason": str,
}
"""Of an index; visibility in m, contrast as the mean share that is left."""

_BATCH = 10_000
"""Lines that are turned into Parquet at once."""


class Index:
    """Takes down what became of pictures, as lines of a CSV file that is being written."""

    def __init__(self, out: Path, file: Any) -> None:
        self._out = out
        self._writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        self._writer.writeheader()
        self._outputs = array("q")

    def add(self, outcome: Outcome) -> None:
        """Take down one."""
        row, record = outcome.row, outcome.record
        line: dict[str, Any] = {
            "id": row.id,
            "variant": row.variant,
            "input": self._path(row.input),
            "distance": self._path(row.distance),
            "output": row.place.as_posix(),
            "seconds": f"{outcome.seconds:.3f}",
            "status": outcome.status,
            "reason": outcome.reason,
        }
        if record is not None:
            line["water"] = record.water
            for name, value in (("visibility", record.visibility), ("contrast", record.contrast)):
                line[name] = None if value is None else f"{value:.4g}"
        self._outputs.append(hash_of(line["output"]))
        self._writer.writerow(line)

    def _path(self, path: Path | float | None) -> Path | float | str | None:
        """From the folder of the index, as lists are read."""
        if not isinstance(path, Path):
            return path
        try:
            return os.path.relpath(path, self._out)
        except ValueError:  # of another drive
            return path.absolute()

    def keep_others(self, path: Path) -> None:
        """Take over the lines of an earlier index, of pictures that were not in this run."""
        if not path.exists():
            return
        mine = np.sort(np.frombuffer(self._outputs, dtype=np.int64))
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            for line in reader:
                value = hash_of(line["output"])
                place = int(np.searchsorted(mine, value))
                if place == len(mine) or mine[place] != value:
                    self._writer.writerow(line)


def written_outputs(out: Path) -> Iterator[Path]:
    """The pictures that the index of a folder knows of."""
    with (out / "index.csv").open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file):
            if line["status"] != "failed":
                yield out / line["output"]


@contextmanager
def index_of(out: Path) -> Iterator[Index]:
    """An index in a folder, which is there once all went well: index.csv, and index.parquet where
    pyarrow is installed. Pictures of earlier runs stay in it.

    Raises:
        ValueError: if index.csv is there and is none.
        OSError: if it cannot be written.
    """
    path = out / "index.csv"
    _require_index(path)
    with written_whole(path) as part:
        with part.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file:
            index = Index(out, file)
            yield index
            index.keep_others(path)
        if importlib.util.find_spec("pyarrow") is not None:
            with written_whole(path.with_suffix(".parquet")) as other:
                _write_parquet(part, other)


def _require_index(path: Path) -> None:
    """Refuse to write over what is no index, before the work begins."""
    if not path.exists():
        return
    require_regular(path)
    with path.open(encoding="utf-8", errors="replace", newline="") as file:
        if file.readline().rstrip("\r\n") != ",".join(COLUMNS):
            raise ValueError(f"{path} is no index of uwaug: choose another folder, or move it")


def _write_parquet(source: Path, path: Path) -> None:
    """The same lines as columns with types."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {str: pa.string(), int: pa.int64(), float: pa.float64()}
    schema = pa.schema([(name, kinds[kind]) for name, kind in COLUMNS.items()])
    with source.open(encoding="utf-8", newline="") as file, pq.ParquetWriter(path, schema) as out:
        lines = csv.DictReader(file)
        while batch := list(islice(lines, _BATCH)):
            columns = {}
            for name, kind in COLUMNS.items():
                columns[name] = [kind(line[name]) if line[name] else None for line in batch]
            out.write_table(pa.table(columns, schema))
