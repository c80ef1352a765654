"""What is refused of a run before anything is done: pictures that would get in each other's way."""

import os
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from uwaug.io.write import FORMATS
from uwaug.jobs.row import Row, terms_path
from uwaug.jobs.rows import Rows, hash_of

__all__ = ["counted_rows"]


def counted_rows(rows: Rows, terms: Sequence[str] = ()) -> int:
    """Look all rows through, and count them. Memory grows by 32 bytes for each.

    Args:
        rows: of the run.
        terms: that are written beside each picture, see `terms_path`.

    Raises:
        ValueError: if there are none; if two have one id, or would be written to one file; if a
            file that is read would be written over; or if two get one map from a folder. Names
            them.
        OSError: if an input does not exist.
    """
    _require_own_folder(rows)
    # a map that is found by the name of its picture may be that of another too
    by_name = rows.distance is not None and ("{" in rows.distance or Path(rows.distance).is_dir())
    count = 0
    ids, outputs, inputs, maps = array("q"), array("q"), array("q"), array("q")
    for row in rows:
        count += 1
        ids.append(hash_of(row.key))
        outputs.extend(hash_of(path) for path in _written(row, terms))
        inputs.extend(hash_of(path) for path in _read(row))
        if by_name and row.variant == 0 and isinstance(row.distance, Path):
            maps.append(hash_of(str(row.distance)))
    if not count:
        known = ", ".join(name for name in FORMATS if name != ".npy")
        raise ValueError(f"no pictures in {', '.join(map(str, rows.inputs))}: expected {known}")
    _require_read(rows, outputs, inputs, terms)
    _require_apart(rows, ids, lambda row: [row.key], "one id", "give an index with a column id")
    cure = "give an index with a column output"
    _require_apart(rows, outputs, lambda row: _written(row, terms), "one output", cure)
    cure = "give an index with a column distance"
    _require_apart(rows, maps, lambda row: [str(row.distance)], "one map", cure)
    return count


def _require_own_folder(rows: Rows) -> None:
    """Else the next run would take what this one has written for pictures."""
    for given in rows.inputs:
        if given.is_dir() and os.path.realpath(given) == os.path.realpath(rows.out):
            cure = "expected a folder of its own to write to"
            raise ValueError(f"{given} would be written into: {cure}")


def _written(row: Row, terms: Sequence[str]) -> list[str]:
    """The pictures that a row makes; some file systems know no difference between A and a."""
    paths = [row.output, *(terms_path(row.output, term) for term in terms)]
    return [os.path.realpath(path).casefold() for path in paths]


def _read(row: Row) -> list[str]:
    """The files that a row is made of."""
    paths = [row.input]
    if isinstance(row.distance, Path):
        paths.append(row.distance)
    return [os.path.realpath(path).casefold() for path in paths]


def _require_read(
    rows: Rows, outputs: "array[int]", inputs: "array[int]", terms: Sequence[str]
) -> None:
    """Refuse to write over what the run reads, whatever is forced."""
    read = np.unique(np.frombuffer(inputs, dtype=np.int64))
    both = set(np.intersect1d(np.frombuffer(outputs, dtype=np.int64), read).tolist())
    for row in rows if both else ():
        for path in _written(row, terms):
            if hash_of(path) in both:
                got = f"{row.output}, made of {row.input}"
                raise ValueError(f"{got}, would be written over what is read: another folder?")


def _require_apart(
    rows: Rows,
    hashes: "array[int]",
    keys: Callable[[Row], list[str]],
    what: str,
    cure: str,
) -> None:
    values, counts = np.unique(np.frombuffer(hashes, dtype=np.int64), return_counts=True)
    twice = set(values[counts > 1].tolist())
    seen: dict[str, Row] = {}
    for row in rows if twice else ():
        for key in keys(row):
            if hash_of(key) not in twice:
                continue
            before = seen.setdefault(key, row)
            if (before.input, before.variant) != (row.input, row.variant):
                raise ValueError(f"{before.input} and {row.input} have {what}, {key}: {cure}")
            if before is not row and before.output == row.output:
                raise ValueError(f"{row.input} was given twice")
