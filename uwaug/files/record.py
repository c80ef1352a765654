"""The record beside each result of a run: its sources, and all its random numbers."""

import hashlib
import json
from pathlib import Path
from typing import Any

from uwaug._support.atomic import require_regular, write_whole


def record_path(result: Path) -> Path:
    """Path of the record of a result."""
    return result.with_name(result.name + ".json")


def write_record(path: Path, record: dict[str, Any]) -> None:
    """Write a record, whole or not at all."""
    write_whole(path, f"{json.dumps(record, indent=1, ensure_ascii=False)}\n".encode())


def read_record(path: Path) -> dict[str, Any]:
    """Read the record of a result; a ValueError if the file is none."""
    require_regular(path)
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: is no record of a picture: {error}") from None
    keys = {"uwaug", "torch", "numba", "row", "variant", "sha256"}  # of all
    if not isinstance(record, dict) or not keys <= record.keys():
        raise ValueError(f"{path}: is no record of a picture that uwaug has written")
    return record


def record_of(result: Path) -> dict[str, Any] | None:
    """Record of a file that a run has written; None without one."""
    try:
        return read_record(record_path(result))
    except (OSError, ValueError):
        return None


def digest(path: Path) -> str | None:
    """SHA-256 of a file; None if it cannot be read."""
    try:
        require_regular(path)
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def reason_of(error: Exception) -> str:
    """An error in words, with its kind if no check of this package has raised it."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, UnicodeEncodeError):
        return "the name of its file, or of a folder, is not UTF-8: rename it"
    if isinstance(error, (ValueError, OSError, ImportError)) and str(error):
        return str(error)
    return f"{type(error).__name__}: {error}"
