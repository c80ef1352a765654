"""Labels of pictures: found, judged by the contrast left of each object, and written where trainers
look. A format is a class of `Labels` in a file of its own, named in `formats.py`.

This file loads neither NumPy nor PyTorch, as command lines ask formats what they read.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

from uwaug._support.atomic import write_whole
from uwaug.files.paths import Files
from uwaug.files.record import digest

if TYPE_CHECKING:
    from torch import Tensor

    from uwaug._support.pixels import Pixels, Size
    from uwaug.files.items import Item
    from uwaug.files.summary import Result

# of an object in its picture: the id of a COCO annotation, a line of a YOLO file or an object of a
# VOC file counted from 1, a value of a mask
Key = int | str
Entry = dict[str, Any]  # an object of JSON or YAML
STEM = "{stem}"  # in a pattern of files, the name of a picture without its end
_SAMPLE_FILES = 16  # files of labels by which a format is recognised


class Judged(NamedTuple):
    """An object with the share of contrast that is left of it, 0…1."""

    key: Key
    contrast: float
    kept: bool


@dataclass(frozen=True, eq=False)
class Labels:
    """Labels of the pictures of a run."""

    reads: ClassVar[str]  # files or folders of the format, in words
    path: Path  # file or folder
    of: Mapping[str, Any]  # entry of each picture that has labels, by the name of its `Item`

    @classmethod
    def opened(cls, path: Path, items: Sequence["Item"]) -> "Labels | str":
        """Open the labels at a path if they are of this format and belong to any of the pictures;
        else return the reason in words, or "". A ValueError if they cannot be read.
        """
        raise NotImplementedError

    def only(self, name: str) -> Self:
        """Labels of one picture, small enough to be sent to another process."""
        return replace(self, of={name: self.of[name]} if name in self.of else {})

    def digest(self, name: str) -> str | None:
        """Digest of the labels of a picture, which changes with them; None without labels."""
        raise NotImplementedError

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

    def lists(self, pictures: Sequence["Result"]) -> tuple[dict[str, bytes], list[str]]:
        """Files of all pictures together, by their names in the folder of the run; and notes."""
        return {}, []


@dataclass(frozen=True, eq=False)
class Folder(Labels):
    """Labels in a folder with a file for each picture."""

    end: ClassVar[str]  # of the files' names
    folders: ClassVar[tuple[str, ...]] = ("labels",)  # beside the pictures'; the first is written
    pictures: ClassVar[str] = "images"  # folder that pictures are written to
    of: Mapping[str, Path]

    @classmethod
    def opened(cls, path: Path, items: Sequence["Item"]) -> "Labels | str":
        of, files, ends = {}, Files(), cls.ends()
        if path.name.startswith(STEM):
            path, end = path.parent, path.name.removeprefix(STEM)
            ends = (end,) if end.lower().endswith(ends) else ()
        for item in items:
            if file := files.of(item.picture, item.name, path, ends, cls.folders):
                of[item.name] = file
        if not of:
            expected = (path / items[0].name).with_suffix(cls.end)
            return f"no file such as {expected}" if path.is_dir() else ""
        reasons = []
        samples = list(of.values())[:: -(-len(of) // _SAMPLE_FILES)]
        for file in list(samples):
            try:
                cls.require(file)
            except (ValueError, OSError) as error:
                samples.remove(file)
                reasons.append(str(error))
        return cls(path, of).described(samples) if samples else reasons[0]

    @classmethod
    def ends(cls) -> tuple[str, ...]:
        """Ends of the names of files that are read, the likeliest first."""
        return (cls.end,)

    @staticmethod
    def require(file: Path) -> None:
        """Refuse a file of another format."""
        raise NotImplementedError

    def described(self, samples: Sequence[Path]) -> Self:
        """The same labels, with what sample files tell of all of them; raises as `opened`."""
        return self

    def without(self, dropped: Collection[Key], source: Path, place: str) -> bytes:
        """Content of a label file for a picture at a place, without the dropped objects."""
        raise NotImplementedError

    def digest(self, name: str) -> str | None:
        return digest(self.of[name]) if name in self.of else None

    def place(self, name: str) -> str:
        return name if self.pictures in name.split("/")[:-1] else f"{self.pictures}/{name}"

    def parted(self, place: str) -> tuple[str, str]:
        """Parts of a picture's place above the last folder of pictures, and below it."""
        above, _, below = f"/{place}".rpartition(f"/{self.pictures}/")
        return above.removeprefix("/"), below.removeprefix("/")

    def files(self, place: str, out: Path) -> list[Path]:
        above, below = self.parted(place)
        return [(out / above / self.folders[0] / below).with_suffix(self.end)]

    def write(self, name: str, place: str, dropped: Collection[Key], out: Path) -> None:
        if source := self.of.get(name):
            (path,) = self.files(place, out)
            if path.exists() and path.samefile(source):
                raise ValueError(f"{path} is read, and would be written over: another folder?")
            write_whole(path, self.without(dropped, source, place))


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
    got = f"{file}: is of {stated[1]}×{stated[0]} px, its picture of {size[1]}×{size[0]} px"
    if tuple(stated) == tuple(size[::-1]):
        cure = "exchange width and height there, if its objects are upright; else turn the pixels"
        got = f"{got}, as EXIF has turned it: {cure} of the picture and take EXIF from it"
    raise ValueError(got)
