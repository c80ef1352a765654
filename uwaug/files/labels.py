"""Labels of pictures: found, judged by what can still be seen of each object, and written where
trainers look.

A format is a class of `Labels` in a file of its own, named in `formats.py`; nothing else knows
formats. Command lines ask it what it reads, and wait for neither NumPy nor PyTorch.
"""

import os
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

from uwaug._support.atomic import written_whole
from uwaug.files.record import digest

if TYPE_CHECKING:
    from torch import Tensor

    from uwaug.files.items import Item
    from uwaug.files.pixels import Pixels, Size
    from uwaug.files.summary import Result

Key = int | str
"""Of an object in its picture: the id of a COCO annotation, a line of a YOLO file or an object of a
VOC file counted from 1, a value of a mask.
"""

Entry = dict[str, Any]
"""An object of JSON or YAML."""

PICTURES = ("images", "JPEGImages")
"""Folders of pictures, beside which data sets have others of labels, or of distances."""

_SPLIT = re.compile(r"(?:obj_)?(train|val|test)(?:ing|id|idation)?(?:_?(?:data|set))?[\d_]*")
"""A folder that says which split its pictures are of."""

_SAMPLES = 16
"""Files of labels by which a format is known."""


class Judged(NamedTuple):
    """An object, the share of contrast that is left of it, and whether its label is kept."""

    key: Key
    contrast: float
    kept: bool


@dataclass(frozen=True, eq=False)
class Labels:
    """The labels of the pictures of a run; `name` is a picture's path below the folder of all.

    Attributes:
        reads: in words, the file or folder that the format is.
        path: of it.
        of: what each picture that has labels has, by its name.
    """

    reads: ClassVar[str]
    path: Path
    of: Mapping[str, Any]

    @classmethod
    def opened(cls, path: Path, items: Sequence["Item"]) -> "Labels | str":
        """The labels at a path, if they are of this format and belong to some of these pictures; or
        in words why not.

        Raises:
            ValueError: if they are, and cannot be read without more; says what is missing.
        """
        raise NotImplementedError

    def only(self, name: str) -> Self:
        """The labels of one picture, in little memory, for the process that degrades it."""
        return replace(self, of={name: self.of[name]} if name in self.of else {})

    def digest(self, name: str) -> str | None:
        """By which labels of a picture that have changed are told; None if it has none."""
        raise NotImplementedError

    def objects(self, name: str, size: "Size") -> Iterator["tuple[Key, Pixels]"]:
        """The objects of a picture that has labels, of a size, in the file's order.

        Raises:
            ValueError: if a label is malformed; names the file and the object.
        """
        raise NotImplementedError

    def place(self, name: str) -> str:
        """Where a picture belongs in the folder of the run, so that trainers find its labels."""
        return name

    def write(self, name: str, place: str, dropped: Collection[Key], out: Path) -> None:
        """Write the labels of one picture to the folder of the run, but for the dropped ones."""

    def finish(self, pictures: Sequence["Result"], out: Path) -> list[str]:
        """Write what the format has one file of for all pictures that were written. Returns what is
        to be told.
        """
        return []


@dataclass(frozen=True, eq=False)
class Folder(Labels):
    """Labels in a folder with a file for each picture.

    Attributes:
        end: of their names.
        folders: beside one of pictures, where they may lie; the first is where they are written.
        pictures: the folder in which pictures are written.
    """

    end: ClassVar[str]
    folders: ClassVar[tuple[str, ...]] = ("labels",)
    pictures: ClassVar[str] = "images"
    of: Mapping[str, Path]

    @classmethod
    def opened(cls, path: Path, items: Sequence["Item"]) -> "Labels | str":
        of = {}
        for item in items:
            own, names = os.path.realpath(item.picture), aliases(item.name, *cls.folders)
            files = [(path / name).with_suffix(cls.end) for name in names]
            file = next((f for f in files if f.is_file() and os.path.realpath(f) != own), None)
            if file is not None:
                of[item.name] = file
        if not of:
            expected = (path / items[0].name).with_suffix(cls.end)
            return f"no file such as {expected}" if path.is_dir() else ""
        reasons = []
        samples = list(of.values())[:: -(-len(of) // _SAMPLES)]
        for file in list(samples):
            try:
                cls.require(file)
            except (ValueError, OSError) as error:
                samples.remove(file)
                reasons.append(str(error))
        return cls(path, of).described(samples) if samples else reasons[0]

    @staticmethod
    def require(file: Path) -> None:
        """Refuse a file that holds anything else."""
        raise NotImplementedError

    def described(self, samples: Sequence[Path]) -> Self:
        """The same labels, with what is known of all by some files; refuses as `opened`."""
        return self

    def without(self, dropped: Collection[Key], source: Path, place: str) -> bytes:
        """A label file of a picture at a place, but for the labels of some objects."""
        raise NotImplementedError

    def digest(self, name: str) -> str | None:
        return digest(self.of[name]) if name in self.of else None

    def place(self, name: str) -> str:
        return name if self.pictures in name.split("/")[:-1] else f"{self.pictures}/{name}"

    def parted(self, place: str) -> tuple[str, str]:
        """What of a picture's place is above the last folder of pictures, and what below."""
        above, _, below = f"/{place}".rpartition(f"/{self.pictures}/")
        return above.removeprefix("/"), below.removeprefix("/")

    def write(self, name: str, place: str, dropped: Collection[Key], out: Path) -> None:
        if name in self.of:
            above, below = self.parted(place)
            path = (out / above / self.folders[0] / below).with_suffix(self.end)
            write_other(path, self.without(dropped, self.of[name], place), self.of[name])


def judged(labels: Labels, name: str, contrast: "Tensor", least: float | None) -> list[Judged]:
    """What is left of each object of a picture: the mean over its pixels of a map of contrast
    (1xHxW, 0…1), 0 of an object without any in the picture. Below `least` no label is kept.
    """
    values = contrast[0].detach().cpu().numpy()
    objects = []
    for key, pixels in labels.objects(name, values.shape) if name in labels.of else ():
        chosen = values[pixels]
        share = round(float(chosen.mean(dtype="float64")), 4) if chosen.size else 0.0
        objects.append(Judged(key, share, least is None or share >= least))
    return objects


def aliases(name: str, *folders: str) -> list[str]:
    """Paths at which a folder beside that of the pictures, or above both, may have what belongs to
    a picture: images/train/1.png may have train/1.txt, or one of some folders in place of "images".
    """
    parts = name.split("/")
    paths = [name, *(f"{folder}/{name}" for folder in folders)]
    last = max((i for i, folder in enumerate(parts[:-1]) if folder in PICTURES), default=None)
    if last is not None:
        for instead in ([], *([folder] for folder in folders)):
            paths.append("/".join([*parts[:last], *instead, *parts[last + 1 :]]))
    return paths


def split_of(folders: Iterable[str]) -> str | None:
    """The split, "train", "val" or "test", that the first of some folders says, if one does."""
    words = (folder.lower() for folder in folders)
    return next((match[1] for match in map(_SPLIT.fullmatch, words) if match), None)


def require_size(file: Path, stated: "Size", size: "Size") -> None:
    """Refuse labels of a picture of another size (height, width)."""
    if tuple(stated) == tuple(size):
        return
    got = f"{file}: is of {stated[1]}×{stated[0]} px, its picture of {size[1]}×{size[0]} px"
    if tuple(stated) == tuple(size[::-1]):
        cure = "exchange width and height there, if its objects are upright; else turn the pixels"
        got = f"{got}, as EXIF has turned it: {cure} of the picture and take EXIF from it"
    raise ValueError(got)


def write_other(path: Path, content: bytes, source: Path | None = None) -> None:
    """Write a file, whole or not at all, but not over the labels that are read."""
    if source is not None and path.exists() and path.samefile(source):
        raise ValueError(f"{path} is read, and would be written over: choose another folder")
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as part:
        part.write_bytes(content)
