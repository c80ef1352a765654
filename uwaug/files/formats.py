"""The formats of labels."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from uwaug.files.coco import Coco
from uwaug.files.labels import Labels
from uwaug.files.masks import Masks
from uwaug.files.voc import Voc
from uwaug.files.yolo import Yolo

if TYPE_CHECKING:
    from uwaug.files.items import Item

FORMATS: tuple[type[Labels], ...] = (Coco, Yolo, Voc, Masks)
"""In this order: data sets in any format may hold masks, too."""


def formats() -> str:
    """What labels may be, in words."""
    *others, last = (format.reads for format in FORMATS)
    return f"{', '.join(others)}, or {last}"


def open_labels(path: str | Path, items: Sequence["Item"]) -> Labels:
    """The labels of some pictures in a file or a folder: of the first format that it holds, by what
    stands in the files that belong to pictures.

    Raises:
        ValueError: if it has labels for none of them, of no format; says what was looked for.
        OSError: if there is no such file or folder.
    """
    Path(path).stat()
    reasons = []
    for format in FORMATS:
        labels = format.opened(Path(path), items)
        if isinstance(labels, Labels):
            return labels
        reasons.append(labels)
    looked = "; ".join(filter(None, reasons))
    raise ValueError(f"labels belong to no picture: {path} must be {formats()}: {looked}")
