"""Labels as Ultralytics' YOLO has them: one text file for each picture, one object a line.

`class cx cy w h` is a box, `class x1 y1 x2 y2 x3 y3 …` a polygon of three corners or more (four for
an oriented box); all but the class are shares of the picture's width or height. A picture without
a file shows no object.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from uwaug._support.atomic import written_whole
from uwaug.labels.source import (
    LabelFolder,
    Labels,
    Object,
    Record,
    beside,
    plain_name,
    write_json,
)

__all__ = ["YoloLabels"]

_BOX = 5
_TRIANGLE = 7
"""Columns."""


@dataclass(frozen=True)
class YoloLabels(LabelFolder):
    """A folder of label files, laid out as the pictures are, or flat; see `uwaug.labels`."""

    folder: Path

    end: ClassVar[str] = ".txt"

    def labels_of(self, picture: str | os.PathLike[str], size: tuple[int, int]) -> Labels:
        """See `LabelSource`."""
        name = plain_name(picture)
        path = self.file_of(name)
        if path is None:
            return Labels(name, size, None, ())
        objects = []
        for number, line in enumerate(_lines(path), 1):
            if line.strip():
                objects.append(_object(line, number, path, size))
        return Labels(name, size, str(path), tuple(objects))

    def write_picture(
        self, labels: Labels, record: Record, path: str | os.PathLike[str]
    ) -> list[Path]:
        """See `LabelSource`. What is still seen keeps its line, character for character."""
        if labels.file is None:
            return []
        ignored, rows = set(), []
        for one in record["objects"]:
            if one["ignored"]:
                ignored.add(one["key"])
            rows.append({"line": one["key"], **_without_key(one)})
        kept = []
        for number, line in enumerate(_lines(Path(labels.file)), 1):
            if line.strip() and number not in ignored:
                kept.append(line + "\n")
        target = beside(path, ".txt", labels.file)
        with written_whole(target) as part:
            part.write_text("".join(kept), encoding="utf-8")
        return [target, write_json(beside(path, ".contrast.json", labels.file), rows)]


def _without_key(one: Record) -> Record:
    return {"contrast": one["contrast"], "ignored": one["ignored"]}


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected text, got bytes that are none: {error}") from None


def _object(line: str, number: int, path: Path, size: tuple[int, int]) -> Object:
    where = f"{path}, line {number}"
    label, *columns = line.split()
    count = 1 + len(columns)
    if not label.isdecimal():
        raise ValueError(f"{where}: expected a class (0, 1, …) first, got {label!r}")
    if count != _BOX and (count < _TRIANGLE or count % 2 == 0):
        wanted = "class cx cy w h, or class x1 y1 x2 y2 x3 y3 …"
        raise ValueError(f"{where}: expected {wanted}, got {count} columns")
    try:
        shares = np.array(columns, dtype=float)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    if not np.isfinite(shares).all() or np.abs(shares).max() > 2:
        far = shares[np.abs(shares).argmax()]
        wanted = "shares of the picture's width and height, 0…1"
        raise ValueError(f"{where}: expected {wanted}, got {far:g}: divide px by width and height")
    height, width = size
    if count > _BOX:
        points = shares.reshape(-1, 2) * (width, height)
        return Object(number, where, "polygons", (points,))
    x, y, w, h = shares * (width, height, width, height)
    return Object(
        number, where, "box", tuple(map(float, (x - w / 2, y - h / 2, x + w / 2, y + h / 2)))
    )
