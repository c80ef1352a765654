"""The formats of labels, told by the endings of files."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from uwaug.files.coco import Coco
from uwaug.files.labels import Labels, PerPicture
from uwaug.files.masks import Masks
from uwaug.files.yolo import Yolo

if TYPE_CHECKING:
    from uwaug.files.table import Row

FORMATS: tuple[type[Labels], ...] = (Coco, Yolo, Masks)
# of files that are of one picture each, and of those that are of many
ENDINGS = sum((each.endings for each in FORMATS if issubclass(each, PerPicture)), ())
SHARED = sum((each.endings for each in FORMATS if not issubclass(each, PerPicture)), ())


def formats() -> str:
    """Files that labels may be, in words."""
    *first, last = (f"{format.reads} ({', '.join(format.endings)})" for format in FORMATS)
    return f"{', '.join(first)}, or {last}"


def open_labels(rows: Sequence["Row"], classes: str | Path | None = None) -> Labels | None:
    """Open the labels of rows, all in one format, which the endings of their names tell; None if
    no row has any.

    Args:
        rows: rows of a table; those without labels are backgrounds.
        classes: file that names the classes of YOLO's labels, and how many keypoints they have, as
            a data.yaml does. Without it, a data.yaml in the folder of all labels, or the nearest of
            the two above.

    Raises:
        ValueError: if they are no labels, of several formats, or belong to no picture.
        OSError: if a file cannot be read.
    """
    files = {row.labels.suffix.lower(): row.labels for row in rows if row.labels is not None}
    if not files:
        return None
    format = next((format for format in FORMATS if {*files} <= {*format.endings}), None)
    got = " and ".join(map(str, files.values()))
    if format is None:
        raise ValueError(f"labels: expected {formats()}, one of these for all rows, got {got}")
    if classes is not None and format is not Yolo:
        raise ValueError(f"classes (--classes) are of YOLO's labels, got {got}")
    return format.opened(rows, None if classes is None else Path(classes))
