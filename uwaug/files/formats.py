"""The formats of labels."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from uwaug.files.coco import Coco, CocoSplits
from uwaug.files.labels import STEM, Labels
from uwaug.files.masks import Masks
from uwaug.files.voc import Voc
from uwaug.files.yolo import Yolo

if TYPE_CHECKING:
    from uwaug.files.items import Item

# in the order of trial: data sets in any format may hold masks, too
FORMATS: tuple[type[Labels], ...] = (Coco, Yolo, Voc, CocoSplits, Masks)


def formats() -> str:
    """Files and folders that labels may be, in words."""
    *first, last = (format.reads for format in FORMATS)
    return f"{', '.join(first)}, or {last}"


def open_labels(path: str | Path, items: Sequence["Item"]) -> Labels:
    """Open the labels of pictures in a file or a folder, or by a pattern such as
    "masks/{stem}_gt.png", in any of the formats; a ValueError says what was looked for.
    """
    path = Path(path)
    (folder := path.parent if path.name.startswith(STEM) else path).stat()
    reasons = []
    for format in FORMATS:
        labels = format.opened(path, items)
        if isinstance(labels, Labels):
            return labels
        reasons.append(labels)
    ends = Counter(file.suffix for file in folder.rglob("*.*") if file.is_file())
    reasons += [f"found {count} files ending in {end}" for end, count in ends.most_common(1)]
    reasons += [f"{file} is MOT's: make a COCO file of it" for file in folder.rglob("gt.txt")][:1]
    looked = "; ".join(filter(None, reasons))
    raise ValueError(f"labels belong to no picture: {path} must be {formats()}: {looked}")
