"""Which format the labels at a path have."""

import os
from pathlib import Path

from uwaug.labels.coco import CocoLabels
from uwaug.labels.masks import MaskLabels
from uwaug.labels.source import LabelSource
from uwaug.labels.yolo import YoloLabels

__all__ = ["open_labels"]


def open_labels(path: str | os.PathLike[str], *, void: int | None = None) -> LabelSource:
    """Labels from files.

    Args:
        path: a COCO file (.json); or a folder, with all below it, of YOLO's files (.txt) or of
            masks (.png, one channel, 8 or 16 bit).
        void: value of masks that already means "ignored", such as the 255 of Pascal VOC and
            Cityscapes; None if there is none.

    Raises:
        ValueError: if it is none of these, or more than one; or a COCO file is malformed.
        OSError: if it cannot be read.
    """
    found = Path(path)
    if not found.exists():
        raise FileNotFoundError(f"labels: there is nothing at {path}")
    if found.is_file():
        kinds = {found.suffix.lower()} & {".json"}
    else:
        kinds = {file.suffix.lower() for file in found.rglob("*")} & {".txt", ".png"}
    if len(kinds) != 1:
        wanted = "a COCO file (.json) or a folder of YOLO's .txt or of .png masks"
        got = f"{path}, a folder with both" if kinds else f"{path}"
        raise ValueError(f"labels must be {wanted}, got {got}")
    kind = kinds.pop()
    if void is not None and kind != ".png":
        raise ValueError(f"void is a value of masks, but {path} has none")
    if kind == ".json":
        return CocoLabels.read(found)
    return YoloLabels(found) if kind == ".txt" else MaskLabels(found, void)
