"""Labels as pictures: one channel, a value above 0 for each object or class."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from uwaug._support.atomic import require_regular, written_whole
from uwaug.labels.source import (
    LabelFolder,
    Labels,
    Object,
    Record,
    beside,
    plain_name,
    write_json,
)

__all__ = ["MaskLabels"]

_MODES = ("L", "P", "1", "I;16", "I")
"""Pillow's names of one channel of whole numbers."""


@dataclass(frozen=True)
class MaskLabels(LabelFolder):
    """A folder of masks, laid out as the pictures are, or flat; see `uwaug.labels`.

    Attributes:
        folder: where they are.
        void: value that already means "ignored": it is no object, and stays.
    """

    folder: Path
    void: int | None = None

    end: ClassVar[str] = ".png"

    def labels_of(self, picture: str | os.PathLike[str], size: tuple[int, int]) -> Labels:
        """See `LabelSource`. A picture without a mask shows no object."""
        name = plain_name(picture)
        path = self.file_of(name)
        if path is None:
            return Labels(name, size, None, ())
        values, _ = _read(path)
        if values.shape != size:
            got = f"it is {values.shape} but the picture {size} px, height and width"
            raise ValueError(f"{path}: {got}: expected the mask of this picture")
        objects = []
        for value in np.unique(values).tolist():
            if value not in (0, self.void):
                objects.append(Object(value, f"{path}, value {value}", "mask", values == value))
        return Labels(name, size, str(path), tuple(objects))

    def write_picture(
        self, labels: Labels, record: Record, path: str | os.PathLike[str]
    ) -> list[Path]:
        """See `LabelSource`."""
        if labels.file is None:
            return []
        values, palette = _read(Path(labels.file))
        gone = int(np.iinfo(values.dtype).max)
        if any(one["ignored"] for one in record["objects"]):
            _refuse_taken(record, gone, labels.file)
        rows, written = [], values.copy()
        for one in record["objects"]:
            row = {"value": one["key"], "contrast": one["contrast"], "ignored": one["ignored"]}
            rows.append(row)
            if one["ignored"]:
                written[values == one["key"]] = gone
        target = beside(path, ".png", labels.file)
        _write(target, written, palette)
        return [target, write_json(beside(path, ".contrast.json", labels.file), rows)]


def _refuse_taken(record: Record, gone: int, file: str) -> None:
    if any(one["key"] == gone for one in record["objects"]):
        cure = f"give void={gone} if it means that already, or renumber the mask"
        raise ValueError(f"{file}: {gone} marks what is ignored, but it is a value in use: {cure}")


def _read(path: Path) -> tuple[NDArray[Any], list[int] | None]:
    """Values (HxW, uint8 or uint16), and a palette if there is one."""
    from PIL import Image

    require_regular(path)
    with Image.open(path) as image:
        if image.mode not in _MODES:
            wanted = "one channel of whole numbers, a value for each object"
            raise ValueError(f"{path}: expected {wanted}, got {image.mode}")
        palette = image.getpalette() if image.mode == "P" else None
        values = np.asarray(image)
    if values.dtype in (np.uint8, np.bool_):
        return values.astype(np.uint8), palette
    return values.astype(np.uint16), None


def _write(path: Path, values: NDArray[Any], palette: list[int] | None) -> None:
    from PIL import Image

    image = Image.fromarray(values)
    if palette is not None:
        # Pillow writes fewer bits for a short palette, and cuts the values
        image.putpalette(palette + [0] * (3 * 256 - len(palette)))
    with written_whole(path) as part, part.open("wb") as file:
        image.save(file, "PNG")
