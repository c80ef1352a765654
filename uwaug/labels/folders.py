"""Labels in folders, with a file for each picture: YOLO's text files, and masks."""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from uwaug._support.atomic import require_regular, written_whole
from uwaug.labels.layout import (
    DESCRIPTION,
    described,
    description_of,
    has_keypoints,
    label_place,
    parted,
    splits_of,
)
from uwaug.labels.regions import Region, Size, box_region, mask_region, polygon_region
from uwaug.labels.source import (
    Labels,
    Object,
    Record,
    plain_name,
    refuse_source,
    write_json,
)

_BOX = 5
_TRIANGLE = 7
"""Columns of a YOLO file."""

_MODES = ("L", "P", "1", "I;16", "I")
"""Pillow's names of one channel of whole numbers."""


class _LabelFolder:
    """A folder with a file for each picture, laid out as the pictures are, or flat."""

    folder: Path
    end: ClassVar[str]

    @cached_property
    def _flat(self) -> bool:
        """Whether no label file lies in a folder inside this one."""
        return next(self.folder.rglob(f"*/*{self.end}"), None) is None

    def file_of(self, picture: str) -> str | None:
        """The label file of a picture: in a folder of the same layout; in one where "images" is
        missing, or "labels" stands in its place; or, of a flat folder, the one of its name.
        """
        name = Path(picture).with_suffix(self.end)
        names = [name]
        if (folders := parted(name)) is not None:
            before, after = folders
            # train/1.txt or labels/train/1.txt
            names += [Path(*before, *after, name.name), label_place(name)]
        if self._flat:
            # elsewhere b/1.txt may be missing, and 1.txt be that of another picture
            names.append(Path(name.name))
        for candidate in names:
            if (self.folder / candidate).exists():
                require_regular(self.folder / candidate)
                return str(self.folder / candidate)
        return None

    def write_run(self, records: Iterable[Record], folder: str | os.PathLike[str]) -> list[Path]:
        """None: see `LabelSource`."""
        return []


@dataclass(frozen=True)
class YoloLabels(_LabelFolder):
    """A folder of text files as Ultralytics' YOLO has them, one object a line.

    `class cx cy w h` is a box, `class x1 y1 x2 y2 x3 y3 …` a polygon of three corners or more (four
    for an oriented box); all but the class are shares of the picture's width or height. Where the
    data.yaml of the labels has `kpt_shape`, a box comes first, and keypoints follow it. A picture
    without a file shows no object.
    """

    folder: Path

    end: ClassVar[str] = ".txt"

    def labels_of(self, picture: str | os.PathLike[str]) -> Labels:
        """See `LabelSource`."""
        name = plain_name(picture)
        return _YoloFile(name, self.file_of(name), self._has_keypoints)

    @cached_property
    def _has_keypoints(self) -> bool:
        return has_keypoints(description_of(self.folder))

    def write_run(self, records: Iterable[Record], folder: str | os.PathLike[str]) -> list[Path]:
        """See `LabelSource`. data.yaml says where the pictures are, and names the classes as the
        one of the labels does, or a classes.txt; without either it counts them.
        """
        listed = list(records)
        splits = splits_of(record["output"] for record in listed)
        if not splits:
            return []
        target, before = Path(folder) / DESCRIPTION, description_of(self.folder)
        refuse_source(target, None if before is None else str(before))
        classes = [] if before is not None else self._classes(listed)
        with written_whole(target) as part:
            part.write_text(described(splits, before, classes), encoding="utf-8")
        return [target]

    def _classes(self, records: Iterable[Record]) -> list[str] | int:
        """Their names, or how many the labels of these pictures tell of."""
        for folder in (self.folder, self.folder.parent):
            names = folder / "classes.txt"
            if names.is_file():
                return [line for _, line in _lines(str(names))]
        numbers = [0]
        for picture in {record["picture"] for record in records}:
            numbers += [int(line.split()[0]) for _, line in _lines(self.file_of(picture))]
        return max(numbers) + 1


@dataclass(frozen=True)
class _YoloFile(Labels):
    has_keypoints: bool

    def objects(self, size: Size) -> list[Object]:
        """As of `Labels`."""
        objects = []
        for number, line in _lines(self.file):
            where = f"{self.file}, line {number}"
            box = " ".join(line.split()[:_BOX]) if self.has_keypoints else line
            objects.append(Object(number, _yolo_region(box, where, size)))
        return objects

    def write(self, record: Record, path: str | os.PathLike[str]) -> list[Path]:
        """What is still seen keeps its line, character for character."""
        if self.file is None:
            return []
        ignored, rows = set(), []
        for entry in record["objects"]:
            if entry["ignored"]:
                ignored.add(entry["key"])
            rows.append(_with_key("line", entry))
        kept = [line + "\n" for number, line in _lines(self.file) if number not in ignored]
        target = _beside(path, ".txt", self.file)
        with written_whole(target) as part:
            part.write_text("".join(kept), encoding="utf-8")
        return [target, write_json(_beside(path, ".contrast.json", self.file), rows)]


@dataclass(frozen=True)
class MaskLabels(_LabelFolder):
    """A folder of masks: one channel, a value above 0 for each object or class.

    Attributes:
        folder: where they are.
        void: value that already means "ignored": it is no object, and stays.
    """

    folder: Path
    void: int | None = None

    end: ClassVar[str] = ".png"

    def labels_of(self, picture: str | os.PathLike[str]) -> Labels:
        """See `LabelSource`. A picture without a mask shows no object."""
        name = plain_name(picture)
        return _MaskFile(name, self.file_of(name), self.void)


@dataclass(frozen=True)
class _MaskFile(Labels):
    void: int | None

    def objects(self, size: Size) -> list[Object]:
        """As of `Labels`."""
        if self.file is None:
            return []
        values, _ = _read_mask(self.file)
        if values.shape != tuple(size):
            got = f"it is {values.shape} but the picture {tuple(size)} px, height and width"
            raise ValueError(f"{self.file}: {got}: expected the mask of this picture")
        objects = []
        for value in np.unique(values).tolist():
            if value not in (0, self.void):
                objects.append(Object(value, mask_region(values == value)))
        return objects

    def write(self, record: Record, path: str | os.PathLike[str]) -> list[Path]:
        """What is hidden gets the largest value that the mask's type holds."""
        if self.file is None:
            return []
        values, palette = _read_mask(self.file)
        ignored_value = int(np.iinfo(values.dtype).max)
        keys = {entry["key"]: entry["ignored"] for entry in record["objects"]}
        if any(keys.values()) and ignored_value in keys:
            got = f"{ignored_value} marks what is ignored, but it is a value in use"
            cure = f"give void={ignored_value} if it means that already, or renumber the mask"
            raise ValueError(f"{self.file}: {got}: {cure}")
        written = values.copy()
        for key, ignored in keys.items():
            if ignored:
                written[values == key] = ignored_value
        target = _beside(path, ".png", self.file)
        _write_mask(target, written, palette)
        rows = [_with_key("value", entry) for entry in record["objects"]]
        return [target, write_json(_beside(path, ".contrast.json", self.file), rows)]


def _with_key(name: str, entry: Record) -> Record:
    return {name: entry["key"], "contrast": entry["contrast"], "ignored": entry["ignored"]}


def _beside(path: str | os.PathLike[str], end: str, source: str) -> Path:
    """A file beside a picture, of the same stem, in a folder that is made if need be; refused if it
    is the labels' own.
    """
    picture = Path(path)
    picture.parent.mkdir(parents=True, exist_ok=True)
    target = picture.with_name(picture.stem + end)
    refuse_source(target, source)
    return target


def _lines(file: str | None) -> list[tuple[int, str]]:
    """The lines of a YOLO file that say something, counted from 1."""
    if file is None:
        return []
    try:
        lines = Path(file).read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{file}: expected text, got bytes that are none: {error}") from None
    return [(number, line) for number, line in enumerate(lines, 1) if line.strip()]


def _yolo_region(line: str, where: str, size: Size) -> Region | None:
    label, *columns = line.split()
    count = 1 + len(columns)
    if not label.isdecimal():
        raise ValueError(f"{where}: expected a class (0, 1, …) first, got {label!r}")
    if count != _BOX and (count < _TRIANGLE or count % 2 == 0):
        expected = "class cx cy w h, or class x1 y1 x2 y2 x3 y3 …"
        raise ValueError(f"{where}: expected {expected}, got {count} columns")
    try:
        shares = np.array(columns, dtype=float)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    if not np.isfinite(shares).all() or np.abs(shares).max() > 2:
        far = shares[np.abs(shares).argmax()]
        expected = "shares of the picture's width and height, 0…1"
        raise ValueError(
            f"{where}: expected {expected}, got {far:g}: divide px by width and height"
        )
    height, width = size
    if count > _BOX:
        return polygon_region([shares.reshape(-1, 2) * (width, height)], size)
    x, y, w, h = shares * (width, height, width, height)
    return box_region(tuple(map(float, (x - w / 2, y - h / 2, x + w / 2, y + h / 2))), size)


def _read_mask(path: str) -> tuple[NDArray[Any], list[int] | None]:
    """Values (HxW, uint8 or uint16), and a palette if there is one."""
    from PIL import Image

    require_regular(path)
    with Image.open(path) as image:
        if image.mode not in _MODES:
            expected = "one channel of whole numbers, a value for each object"
            raise ValueError(f"{path}: expected {expected}, got {image.mode}")
        palette = image.getpalette() if image.mode == "P" else None
        values = np.asarray(image)
    if values.dtype in (np.uint8, np.bool_):
        return values.astype(np.uint8), palette
    return values.astype(np.uint16), None


def _write_mask(path: Path, values: NDArray[Any], palette: list[int] | None) -> None:
    from PIL import Image

    image = Image.fromarray(values)
    if palette is not None:
        # Pillow writes fewer bits for a short palette, and cuts the values
        image.putpalette(palette + [0] * (3 * 256 - len(palette)))
    with written_whole(path) as part, part.open("wb") as file:
        image.save(file, "PNG")
