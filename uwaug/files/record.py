"""The record beside each picture of a run: what it was made of, and all that was drawn for it."""

import csv
import json
from pathlib import Path
from typing import Any

from uwaug._support.atomic import written_whole

KEYS = ("uwaug", "torch", "name", "variant", "picture", "distance", "recipe", "params")
"""What a record must have to make its picture again."""

COLUMNS = ("name", "variant", "picture", "distance", "output", "contrast", "status", "reason")
"""Of the index of a run."""


def record_path(picture: Path) -> Path:
    """Of the record of a picture."""
    return picture.with_name(picture.name + ".json")


def write_record(path: Path, record: dict[str, Any]) -> None:
    """Write a record, whole or not at all."""
    with written_whole(path) as part:
        text = json.dumps(record, indent=1, ensure_ascii=False)
        part.write_text(f"{text}\n", encoding="utf-8")


def read_record(path: Path) -> dict[str, Any]:
    """Read a record.

    Raises:
        ValueError: if the file is none; names it.
        OSError: if it cannot be read.
    """
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: is no record of a picture: {error}") from None
    if not isinstance(record, dict) or not set(KEYS) <= record.keys():
        raise ValueError(f"{path}: is no record of a picture that uwaug has written")
    return record


def is_written(picture: Path) -> bool:
    """Whether a run has written a picture: its record lies beside it, or, of a sheet, its index."""
    if picture.name == "sheet.jpg" and (index := picture.with_name("index.csv")).is_file():
        with index.open(encoding="utf-8", errors="replace", newline="") as file:
            return next(csv.reader(file), []) == list(COLUMNS)
    try:
        read_record(record_path(picture))
    except (OSError, ValueError):
        return False
    return True
