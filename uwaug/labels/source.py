"""Labels of pictures, how much can still be seen of each object, and where labels come from."""

import json
import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, Protocol

from numpy.typing import NDArray
from torch import Tensor

from uwaug._support import checks
from uwaug._support.atomic import written_whole
from uwaug._support.hashing import FileHash
from uwaug.labels.regions import Region, Size, mean_over

Record = dict[str, Any]
"""What `with_contrast` returns, see there."""

_DIGITS = 4
"""Of a contrast in files; a `min_contrast` is compared with the number that the file shows."""


class Object(NamedTuple):
    """One object of a picture.

    Attributes:
        key: the id of a COCO annotation, a line of a YOLO file counted from 1, a value of a mask.
        region: its pixels in the picture; None if there are none, as of an object that a crop has
            cut off.
    """

    key: int | str
    region: Region | None


@dataclass(frozen=True)
class Labels(ABC):
    """The labels of one picture, for whoever degrades it: they pickle, and are small.

    Attributes:
        picture: its name in the source.
        file: the label file; None if the picture has none, which says that it shows no object.
    """

    picture: str
    file: str | None

    @abstractmethod
    def objects(self, size: Size) -> list[Object]:
        """The objects of the picture, in the file's order; `size` is its height and width, px.

        Raises:
            ValueError: if labels are malformed or of a picture of another size; names file and
                line, annotation or value.
            OSError: if a file cannot be read.
        """

    @abstractmethod
    def write(self, record: Record, path: str | os.PathLike[str]) -> list[Path]:
        """Write the labels of one picture, each file whole.

        Args:
            record: from `with_contrast`.
            path: of the picture that was written, as it would be in a folder for labels alone;
                its end is replaced. (A mask beside its picture may have the same name.)

        Returns:
            The files; none if the format has one for the whole run, or the picture has no labels.

        Raises:
            ValueError: if it would write over the labels that it read.
            OSError: if a file cannot be written.
        """

    def file_hash(self) -> FileHash | None:
        """The label file as it is now; None if there is none.

        Raises:
            OSError: if it cannot be read.
        """
        return None if self.file is None else FileHash.of(self.file)


class LabelSource(Protocol):
    """Where labels come from, and go to: one process holds it. See `uwaug.labels`."""

    def labels_of(self, picture: str | os.PathLike[str]) -> Labels:
        """The labels of a picture, by its path below the folder of pictures.

        Raises:
            ValueError: if there is no such picture (COCO).
            OSError: if a file cannot be read.
        """

    def write_run(self, records: Iterable[Record], folder: str | os.PathLike[str]) -> list[Path]:
        """Write what the format has one file of for the whole run.

        Args:
            records: from `with_contrast`, with "output", the path of each picture below `folder`.
            folder: that is written to.

        Returns:
            The files; none if the format has one for each picture.

        Raises:
            ValueError: if it would write over the labels that it read, or records are of others.
            OSError: if a file cannot be written.
        """


def with_contrast(
    labels: Labels, contrast_map: Tensor, min_contrast: float | None = None
) -> Record:
    """How much contrast is left of each object, as plain values.

    Args:
        labels: of the picture.
        contrast_map (1xHxW tensor): see `uwaug.contrast`; of the picture's size.
        min_contrast: objects with less are marked as ignored; None for none.

    Returns:
        {"picture": name in the source, "objects": [{"key": …, "contrast": …, "ignored": …}]}, in
        the order of the file. The contrast of an object without a pixel in the picture is 0.

    Raises:
        ValueError, OSError: as of `Labels.objects`.
    """
    if min_contrast is not None:
        checks.within("min_contrast", min_contrast, 0.0, 1.0)
    checks.floating("contrast_map", contrast_map)
    checks.picture("contrast_map", contrast_map, 1)
    values: NDArray[Any] = contrast_map[0].detach().cpu().float().numpy()
    objects = []
    for key, region in labels.objects((values.shape[0], values.shape[1])):
        contrast = round(mean_over(values, region), _DIGITS)
        ignored = min_contrast is not None and contrast < min_contrast
        objects.append({"key": key, "contrast": contrast, "ignored": ignored})
    return {"picture": labels.picture, "objects": objects}


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
    from uwaug.labels.coco import CocoLabels
    from uwaug.labels.folders import MaskLabels, YoloLabels

    place = Path(path)
    if not place.exists():
        raise FileNotFoundError(f"labels: there is nothing at {path}")
    files = [place] if place.is_file() else place.rglob("*")
    formats = {".json"} if place.is_file() else {".txt", ".png"}
    ends = {file.suffix.lower() for file in files} & formats
    if len(ends) != 1:
        expected = "a COCO file (.json) or a folder of YOLO's .txt or of .png masks"
        got = f"{path}, a folder with both" if ends else f"{path}"
        raise ValueError(f"labels must be {expected}, got {got}")
    if void is not None and ends != {".png"}:
        raise ValueError(f"void is a value of masks, but {path} has none")
    if ends == {".json"}:
        return CocoLabels.read(place)
    return YoloLabels(place) if ends == {".txt"} else MaskLabels(place, void)


def label_paths(end: str, path: Path) -> list[Path]:
    """The files that `Labels.write` writes for a picture at `path`, of a label file whose name has
    this `end`; none of COCO's, which is one for the whole run.
    """
    ends = () if end == ".json" else (end, ".contrast.json")
    return [path.with_name(path.stem + each) for each in ends]


def plain_name(picture: str | os.PathLike[str]) -> str:
    """A path with forward slashes, as label files have it."""
    return PurePosixPath(*Path(picture).parts).as_posix()


def refuse_source(target: Path, source: str | None) -> None:
    """Refuse to write over what was read."""
    if source is not None and target.exists() and target.samefile(source):
        raise ValueError(f"{target} is the labels' own file: choose another output folder")


def write_json(path: Path, values: Mapping[str, Any] | Sequence[Any]) -> Path:
    """Write JSON, whole."""
    with written_whole(path) as part:
        part.write_text(json.dumps(values, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return path
