"""The record beside each picture that a run writes: what it was made of, and how to make it again.

It is put in place before its picture is. A picture without a record is therefore none of a run's,
and a record whose picture is missing is of a run that was stopped there.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import torch

from uwaug._support.atomic import require_regular, written_whole
from uwaug.jobs.recipe import Recipe, sha256_of
from uwaug.jobs.row import Row, record_path

__all__ = [
    "Record",
    "Source",
    "read_record",
    "record_of",
    "source_of",
    "versions",
    "write_record",
]

_FORMAT = 1


@dataclass(frozen=True)
class Source:
    """A file that went into a picture."""

    path: str
    sha256: str
    bytes: int

    @property
    def is_there(self) -> bool:
        """Whether the file is as it was."""
        return source_of(Path(self.path)) == self


def source_of(path: Path) -> Source:
    """A file as it is now.

    Raises:
        OSError: if it cannot be read.
    """
    whole = path.absolute()
    return Source(str(whole), sha256_of(whole), whole.stat().st_size)


@dataclass(frozen=True)
class Record:
    """What is written beside a picture.

    Attributes:
        uwaug, torch: versions.
        id, variant: of the row.
        input: the picture.
        distance: its file; metres; or None, of a depth network.
        output: the name of the picture that was written.
        sha256, bytes: of its file.
        recipe: as JSON has it.
        drawn: all that is random, and what it came to: of `RandomUnderwater`, its record.
        water, visibility, contrast: name; m; mean share of contrast that is left. None if unknown.
        notes: what is worth knowing.
        labels: what became of the picture's labels; None if it has none.
        label_file: that they are from.
    """

    uwaug: str
    torch: str
    id: str
    variant: int
    input: Source
    distance: Source | float | None
    output: str
    sha256: str
    bytes: int
    recipe: dict[str, Any]
    drawn: dict[str, Any]
    water: str
    visibility: float | None
    contrast: float | None
    notes: list[str]
    labels: Any = None
    label_file: Source | None = None

    def row(self, output: Path) -> Row:
        """The row that makes the picture again, into another file."""
        where = self.distance
        distance = Path(where.path) if isinstance(where, Source) else where
        name = self.labels["picture"] if self.labels else ""
        return Row(self.id, Path(self.input.path), distance, output, self.variant, name=name)

    def is_of(self, row: Row, recipe: Recipe) -> bool:
        """Whether this recipe made this picture of these files, and it is there still."""
        if (self.id, self.variant) != (row.id, row.variant) or self.recipe != recipe.to_json():
            return False
        distance = row.distance
        try:
            written = os.stat(row.output).st_size
            mapped = source_of(distance) if isinstance(distance, Path) else distance
            read = source_of(row.input)
            unchanged = self.label_file is None or self.label_file.is_there
        except OSError:
            return False
        return (written, read, mapped) == (self.bytes, self.input, self.distance) and unchanged


def versions() -> tuple[str, str]:
    """Of uwaug and torch."""
    from importlib.metadata import version

    return version("uwaug"), str(torch.__version__)


def record_of(picture: Path) -> Record | None:
    """The record that stands beside a picture; None if no run has written it."""
    beside = record_path(picture)
    if not beside.is_file():
        return None
    try:
        return read_record(beside)
    except (OSError, ValueError):
        return None


def write_record(record: Record, path: Path) -> None:
    """Write a record, whole or not at all.

    Raises:
        OSError: if it cannot be written.
    """
    values = {"format": _FORMAT, **asdict(record)}
    with written_whole(path) as part:
        part.write_text(json.dumps(values, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def read_record(path: Path) -> Record:
    """Read a record.

    Raises:
        ValueError: if the file is no record; names it.
        OSError: if it cannot be read.
    """
    require_regular(path)
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: is no record of a picture: {error}") from None
    known = {one.name for one in fields(Record)}
    if not isinstance(values, Mapping) or set(values) != known | {"format"}:
        raise ValueError(f"{path}: is no record of a picture that uwaug has written")
    if values["format"] != _FORMAT:
        got = values["format"]
        raise ValueError(f"{path}: expected a record of format {_FORMAT}, got {got}")
    given = {name: values[name] for name in known}
    try:
        given["input"] = Source(**given["input"])
        for name in ("distance", "label_file"):
            if isinstance(given[name], Mapping):
                given[name] = Source(**given[name])
    except TypeError:
        raise ValueError(f"{path}: is no record of a picture that uwaug has written") from None
    return Record(**given)
