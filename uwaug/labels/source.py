"""What all formats of labels share: labels, their contrast, and what a source of them can do."""

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar, Protocol

from numpy.typing import NDArray
from torch import Tensor

from uwaug._support import checks
from uwaug._support.atomic import require_regular, written_whole
from uwaug.labels.regions import (
    Region,
    box_region,
    mask_region,
    mean_over,
    polygon_region,
    runs_region,
)

__all__ = ["LabelSource", "Labels", "Object", "Record", "with_contrast"]

Record = dict[str, Any]
"""What `with_contrast` returns, see there."""

_DIGITS = 4
"""Of a contrast in files; a `min_contrast` is compared with the number that the file shows."""


@dataclass(frozen=True)
class Object:
    """One object of a picture.

    Attributes:
        key: the id of a COCO annotation, a line of a YOLO file counted from 1, a value of a mask.
        where: file and key in words, for errors.
        shape: "box" (x1, y1, x2, y2), "polygons" (Nx2 each), "runs" (COCO's run lengths) or
            "mask" (HxW); x to the right and y down, px.
        values: of that shape.
    """

    key: int | str
    where: str
    shape: str
    values: Any

    def region(self, size: tuple[int, int]) -> Region | None:
        """Its pixels in a picture of (height, width); None if there are none, as of an object that
        a crop has cut off.
        """
        find: Any = {
            "box": box_region,
            "polygons": polygon_region,
            "runs": runs_region,
            "mask": lambda mask, _: mask_region(mask),
        }[self.shape]
        found: Region | None = find(self.values, size)
        return found


@dataclass(frozen=True)
class Labels:
    """The labels of one picture.

    Attributes:
        picture: its name in the source.
        size: height and width, px.
        file: the label file; None if the picture has none, which says that it shows no object.
        objects: in the file's order.
    """

    picture: str
    size: tuple[int, int]
    file: str | None
    objects: tuple[Object, ...]


class LabelSource(Protocol):
    """Where labels come from, and go to. See `uwaug.labels`."""

    def labels_of(self, picture: str | os.PathLike[str], size: tuple[int, int]) -> Labels:
        """The labels of a picture.

        Args:
            picture: its path below the folder of pictures.
            size: its height and width, px.

        Raises:
            ValueError: if they are malformed or of a picture of another size, or (COCO) there is no
                such picture; names file and line, annotation or value.
            OSError: if a file cannot be read.
        """

    def write_picture(
        self, labels: Labels, record: Record, path: str | os.PathLike[str]
    ) -> list[Path]:
        """Write the labels of one picture, each file whole.

        Args:
            labels: from `labels_of`.
            record: from `with_contrast`.
            path: of the picture that was written, as it would be in a folder for labels alone;
                its end is replaced. (A mask beside its picture may have the same name.)

        Returns:
            The files; none if the format has one for the whole run.

        Raises:
            ValueError: if it would write over the labels that it read.
            OSError: if a file cannot be written.
        """

    def write_run(self, records: Iterable[Record], folder: str | os.PathLike[str]) -> list[Path]:
        """Write what the format has one file of for the whole run; arguments and errors as for
        `write_picture`.
        """


def with_contrast(
    labels: Labels, contrast_map: Tensor, min_contrast: float | None = None
) -> Record:
    """How much contrast is left of each object, as plain values.

    Args:
        labels: of the picture.
        contrast_map (1xHxW tensor): see `uwaug.contrast`.
        min_contrast: objects with less are marked as ignored; None for none.

    Returns:
        {"picture": name in the source, "objects": [{"key": …, "contrast": …, "ignored": …}]}, in
        the order of `labels.objects`. The contrast of an object without a pixel in the picture is
        0.

    Raises:
        ValueError: if the map has another size than the picture.
    """
    if min_contrast is not None:
        checks.within("min_contrast", min_contrast, 0.0, 1.0)
    checks.floating("contrast_map", contrast_map)
    if tuple(contrast_map.shape) != (1, *labels.size):
        got, wanted = tuple(contrast_map.shape), (1, *labels.size)
        raise ValueError(f"contrast_map is {got}, but {labels.picture} needs {wanted}")
    values: NDArray[Any] = contrast_map[0].detach().cpu().float().numpy()
    objects = []
    for one in labels.objects:
        left = round(mean_over(values, one.region(labels.size)), _DIGITS)
        ignored = min_contrast is not None and left < min_contrast
        objects.append({"key": one.key, "contrast": left, "ignored": ignored})
    return {"picture": labels.picture, "objects": objects}


def plain_name(picture: str | os.PathLike[str]) -> str:
    """A path with forward slashes, as label files have it."""
    return PurePosixPath(*Path(picture).parts).as_posix()


class LabelFolder:
    """A folder with a file for each picture, laid out as the pictures are, or flat."""

    folder: Path
    end: ClassVar[str]

    @cached_property
    def _flat(self) -> bool:
        """Whether no label file lies in a folder inside this one."""
        return next(self.folder.rglob(f"*/*{self.end}"), None) is None

    def file_of(self, picture: str) -> Path | None:
        """The label file of a picture: in a folder of the same layout; in one where "images" is
        missing, or "labels" stands in its place; or, of a flat folder, the one of its name.
        """
        name = Path(picture).with_suffix(self.end)
        names = [name, *_without_images(name)]
        if self._flat:
            # elsewhere b/1.txt may be missing, and 1.txt be that of another picture
            names.append(Path(name.name))
        for candidate in names:
            if (self.folder / candidate).exists():
                require_regular(self.folder / candidate)
                return self.folder / candidate
        return None

    def write_run(self, records: Iterable[Record], folder: str | os.PathLike[str]) -> list[Path]:
        """None: see `LabelSource`."""
        return []


def _without_images(name: Path) -> list[Path]:
    """Where the labels of images/train/1.png are: train/1.txt or labels/train/1.txt. As for
    Ultralytics, the last folder called "images" counts.
    """
    folders = name.parts[:-1]
    if "images" not in folders:
        return []
    last = len(folders) - 1 - folders[::-1].index("images")
    before, after = name.parts[:last], name.parts[last + 1 :]
    return [Path(*before, *after), Path(*before, "labels", *after)]


def beside(path: str | os.PathLike[str], end: str, source: str | None) -> Path:
    """A file beside a picture, of the same stem, in a folder that is made if need be; refused if it
    is the labels' own.
    """
    found = Path(path)
    found.parent.mkdir(parents=True, exist_ok=True)
    target = found.with_name(found.stem + end)
    refuse_source(target, source)
    return target


def refuse_source(target: Path, source: str | None) -> None:
    """Refuse to write over what was read."""
    if source is not None and target.exists() and target.samefile(source):
        raise ValueError(f"{target} is the labels' own file: choose another output folder")


def write_json(path: Path, values: Mapping[str, Any] | Sequence[Any]) -> Path:
    """Write JSON, whole."""
    with written_whole(path) as part:
        part.write_text(json.dumps(values, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return path
