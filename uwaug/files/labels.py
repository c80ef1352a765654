"""Labels of pictures: judged by the contrast left of each object, and written where trainers look.
A format is a class of `Labels` in a file of its own, named in `formats.py`.

This file loads neither NumPy nor PyTorch, as command lines ask formats what they read.
"""

import os
import unicodedata
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, TypeVar

from uwaug._support.atomic import write_whole

if TYPE_CHECKING:
    from torch import Tensor

    from uwaug._support.pixels import Pixels, Size
    from uwaug.files.summary import Result
    from uwaug.files.table import Row

# of an object in its picture: the id of a COCO annotation, a line of a YOLO file counted from 1, or
# a value of a mask
Key = int | str
Entry = dict[str, Any]  # an object of JSON or YAML
_Content = TypeVar("_Content")
_SAMPLE_FILES = 16  # files of labels that are looked at before a run


class Judged(NamedTuple):
    """An object with the share of contrast that is left of it, 0…1."""

    key: Key
    contrast: float
    kept: bool


@dataclass(frozen=True, eq=False)
class Labels:
    """Labels of the pictures of a run."""

    reads: ClassVar[str]  # files of the format, in words
    endings: ClassVar[tuple[str, ...]]  # of their names
    of: Mapping[str, Any]  # entry of each picture that has labels, by the name of its row

    @classmethod
    def opened(cls, rows: Sequence["Row"], classes: Path | None = None) -> Self:
        """Open the labels that rows name, all in this format; `classes` is a file that names their
        classes. A ValueError if they are not.
        """
        raise NotImplementedError

    def only(self, name: str) -> Self:
        """Labels of one picture, small enough to be sent to another process."""
        return replace(self, of={name: self.of[name]} if name in self.of else {})

    def objects(self, name: str, size: "Size") -> Iterator["tuple[Key, Pixels]"]:
        """Objects of a picture that has labels, with their pixels, in the file's order. A
        ValueError names the file and the object of a malformed label.
        """
        raise NotImplementedError

    def place(self, name: str) -> str:
        """Path of a picture in the folder of the run at which trainers find its labels."""
        return name

    def files(self, place: str, out: Path) -> list[Path]:
        """Files with the labels of the picture at a place in the folder of the run."""
        return []

    def write(self, name: str, place: str, dropped: Collection[Key], out: Path) -> None:
        """Write the labels of one picture to the folder of the run, without the dropped ones."""

    def lists(self, results: Sequence["Result"]) -> tuple[dict[str, bytes], list[str]]:
        """Files of all pictures together, by their names in the folder of the run; and notes."""
        return {}, []


@dataclass(frozen=True, eq=False)
class PerPicture(Labels):
    """Labels with a file for each picture: "images" in a picture's path is "labels" in theirs."""

    end: ClassVar[str]  # of the files that are written
    of: Mapping[str, Path]

    @classmethod
    def of_rows(cls, rows: Sequence["Row"]) -> Self:
        """The labels that rows name. Refuses pictures that differ in their endings alone: they
        would share a file of labels.
        """
        labels = cls({row.name: row.labels for row in rows if row.labels is not None})
        takers: dict[Path, str] = {}
        for row in rows:
            (file,) = labels.files(labels.place(row.name), Path())
            if (other := takers.setdefault(file, row.name)) != row.name:
                got = f"{other} and {row.name} would both have the labels {file}"
                raise ValueError(f"labels: {got}: rename one, or leave it out")
        return labels

    def sampled(self, read: Callable[[Path], _Content]) -> list[_Content]:
        """What some of the files hold, spread over all. Those that cannot be read are left to the
        run, unless none can.
        """
        contents, errors = [], []
        for file in [*self.of.values()][:: -(-len(self.of) // _SAMPLE_FILES)]:
            try:
                contents.append(read(file))
            except (ValueError, OSError) as error:
                errors.append(error)
        if not contents:
            raise errors[0]
        return contents

    def without(self, dropped: Collection[Key], source: Path) -> bytes:
        """Content of a label file without the dropped objects."""
        raise NotImplementedError

    def place(self, name: str) -> str:
        return name if "images" in name.split("/")[:-1] else f"images/{name}"

    def files(self, place: str, out: Path) -> list[Path]:
        # as Ultralytics, which looks for the last folder of this name
        above, _, below = f"/{place}".rpartition("/images/")
        return [(out / above.removeprefix("/") / "labels" / below).with_suffix(self.end)]

    def write(self, name: str, place: str, dropped: Collection[Key], out: Path) -> None:
        if source := self.of.get(name):
            (path,) = self.files(place, out)
            write_whole(path, self.without(dropped, source))


def judged(labels: Labels, name: str, contrast: "Tensor", limit: float | None) -> list[Judged]:
    """Judge each object of a picture by a map of contrast (1xHxW, 0…1): the mean over its pixels, 0
    without any. Labels below the limit are not kept.
    """
    values = contrast[0].detach().cpu().numpy()
    objects = []
    for key, pixels in labels.objects(name, values.shape) if name in labels.of else ():
        inside = values[pixels]
        share = round(float(inside.mean(dtype="float64")), 4) if inside.size else 0.0
        objects.append(Judged(key, share, limit is None or share >= limit))
    return objects


def require_size(file: Path, stated: "Size", size: "Size") -> None:
    """Refuse labels whose stated size (height, width) is not that of the picture."""
    if tuple(stated) == tuple(size):
        return
    turned = ": EXIF turns it; turn its pixels instead" * (tuple(stated) == tuple(size[::-1]))
    got = f"{file}: is of {stated[1]}×{stated[0]} px, its picture of {size[1]}×{size[0]} px"
    raise ValueError(got + turned)


def normal(name: str) -> str:
    """The normal form of a file's name, by which names are compared: accents are composed, and the
    ending is in small letters.
    """
    stem, end = os.path.splitext(unicodedata.normalize("NFC", name))
    return f"{stem}{end.lower()}"
