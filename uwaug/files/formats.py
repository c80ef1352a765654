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

# in the order of trial: data sets in any format may hold masks, too
FORMATS: tuple[type[Labels], ...] = (Coco, Yolo, Voc, Masks)


def formats() -> str:
    """Files and folders that labels may be, in words."""
    *first, last = (format.reads for format in FORMATS)
    return f"{', '.join(first)}, or {last}"


def open_labels(path: str | Path, items: Sequence["Item"]) -> Labels:
    """Open the labels of pictures in a file or a folder, in any of the formats; a ValueError says
    what was looked for.
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
