"""Labels of pictures as COCO, YOLO and masks have them: found, judged by what can still be seen of
each object, and written where trainers look.

A format is a class of `Labels` and a line in `open_labels`; nothing else knows formats. Positions
of objects are continuous, from the picture's upper left corner: the pixel in row i and column j
covers j ≤ x < j + 1, i ≤ y < i + 1.
"""

import io
import json
import math
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from uwaug._support.atomic import written_whole

Key = int | str
"""Of an object in its picture: the id of a COCO annotation, a line of a YOLO file counted from 1, a
value of a mask.
"""

Pixels = NDArray[np.bool_] | tuple[slice, slice]
"""What selects the pixels of an object from a map (HxW)."""

Entry = dict[str, Any]
"""An object of JSON."""

Size = tuple[int, int]
"""Height and width, px."""

_SPLIT = re.compile(r"(train|val|test)(?:ing|id|idation)?[\d_]*")
"""A folder that says which split its pictures are of."""

_PLACES = re.compile(
    r"^(?:path|train|val|validation|test|download)\s*:.*\n(?:(?:[ \t-].*)?\n)*", re.MULTILINE
)
"""Keys of a data.yaml that say where pictures are, with the lines that belong to them."""


class Judged(NamedTuple):
    """An object, the share of contrast that is left of it, and whether its label is kept."""

    key: Key
    contrast: float
    kept: bool


class Labelled(NamedTuple):
    """A picture that was written: its name, its place in the folder of the run, its objects."""

    name: str
    place: str
    objects: Sequence[Judged]


class Labels:
    """The labels of the pictures of a run; `name` is a picture's path below the folder of all."""

    def only(self, name: str) -> "Labels":
        """The labels of one picture, in little memory, for the process that degrades it.

        Raises:
            ValueError: if the picture must have labels and has none.
        """
        return self

    def objects(self, name: str, size: Size) -> Iterator[tuple[Key, Pixels]]:
        """The objects of a picture of a size, in the file's order.

        Raises:
            ValueError: if a label is malformed; names the file and the object.
        """
        raise NotImplementedError

    def place(self, name: str) -> str:
        """Where a picture belongs in the folder of the run, so that trainers find its labels."""
        return name

    def write(self, name: str, place: str, dropped: Collection[Key], out: Path) -> None:
        """Write the labels of one picture to the folder of the run, but for the dropped ones."""

    def finish(self, pictures: Sequence[Labelled], out: Path) -> None:
        """Write what the format has one file of for all pictures."""


def open_labels(path: str | Path) -> Labels:
    """Labels in a COCO file (.json), or in a folder of YOLO's files (.txt) or masks (.png).

    Raises:
        ValueError: if it is none of them.
        OSError: if it cannot be read.
    """
    path = Path(path)
    if path.is_file():
        return _Coco.read(path)
    for format in (_Yolo, _Masks):  # a data set in YOLO's format may hold pictures, too
        if next(path.rglob(f"*{format.end}"), None) is not None:
            return format(path)
    expected = "a COCO file, or a folder of YOLO's .txt or of .png masks"
    raise ValueError(f"labels must be {expected}, got {path}")


def judged(labels: Labels, name: str, contrast: Tensor, least: float | None) -> list[Judged]:
    """What is left of each object of a picture: the mean over its pixels of a map of contrast
    (1xHxW, 0…1), 0 of an object without any in the picture. Below `least` no label is kept.
    """
    values = contrast[0].detach().cpu().numpy()
    found = []
    for key, pixels in labels.objects(name, values.shape):
        chosen = values[pixels]
        share = round(float(chosen.mean(dtype=np.float64)), 4) if chosen.size else 0.0
        found.append(Judged(key, share, least is None or share >= least))
    return found


def aliases(name: str) -> list[str]:
    """Paths at which a folder beside that of the pictures may have what belongs to a picture:
    images/train/1.png may have train/1.txt, or its own path with "labels" for "images".
    """
    folders, found = name.split("/"), [name]
    if "images" in folders[:-1]:
        last = len(folders) - 2 - folders[-2::-1].index("images")
        found.append("/".join([*folders[:last], *folders[last + 1 :]]))
        found.append("/".join([*folders[:last], "labels", *folders[last + 1 :]]))
    return found


@dataclass(frozen=True)
class _Folder(Labels):
    """Labels in a folder with a file for each picture. Ultralytics puts "labels" in place of the
    last "images" of a picture's path: pictures are written below such a folder.
    """

    folder: Path
    end: ClassVar[str]

    def file(self, name: str) -> Path | None:
        """The label file of a picture; None if it has none, and so shows no object."""
        paths = [(self.folder / alias).with_suffix(self.end) for alias in aliases(name)]
        return next((path for path in paths if path.is_file()), None)

    def place(self, name: str) -> str:
        return name if "images" in name.split("/")[:-1] else f"images/{name}"

    def write(self, name: str, place: str, dropped: Collection[Key], out: Path) -> None:
        source = self.file(name)
        if source is None:
            return
        target = (out / aliases(place)[-1]).with_suffix(self.end)
        target.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(_not(target, source)) as part:
            part.write_bytes(self.without(dropped, source) if dropped else source.read_bytes())

    def without(self, dropped: Collection[Key], source: Path) -> bytes:
        """A label file, but for the labels of some objects."""
        raise NotImplementedError


class _Yolo(_Folder):
    """Text files with one object a line: `class cx cy w h`, or `class x1 y1 x2 y2 x3 y3 …` of a
    polygon; all but the class are shares of the picture's width or height. Where the data.yaml has
    `kpt_shape`, keypoints follow the box.
    """

    end = ".txt"

    @cached_property
    def description(self) -> str:
        """The text of the data.yaml beside the labels or above them; empty without any."""
        for folder in (self.folder, self.folder.parent, self.folder.parent.parent):
            if (folder / "data.yaml").is_file():
                return (folder / "data.yaml").read_text(encoding="utf-8") + "\n"
        return ""

    def objects(self, name: str, size: Size) -> Iterator[tuple[Key, Pixels]]:
        file = self.file(name)
        for number, line in enumerate(_lines(file), 1):
            if not line.strip():
                continue
            try:
                shares = np.array(line.split()[1:], dtype=float)
                shares = shares[:4] if "kpt_shape:" in self.description else shares
                points = shares.reshape(-1, 2) * (size[1], size[0])
                if len(points) < 2 or not np.abs(shares).max() <= 2:
                    raise ValueError("expected a class, and shares of width and height, 0…1")
                if len(points) == 2:
                    middle, half = points[0], points[1] / 2
                    yield number, _box(np.stack([middle - half, middle + half]), size)
                else:
                    yield number, _polygons([points], size)
            except ValueError as error:
                raise ValueError(f"{file}, line {number}: {error}") from error

    def without(self, dropped: Collection[Key], source: Path) -> bytes:
        lines = enumerate(_lines(source), 1)
        return "".join(f"{line}\n" for number, line in lines if number not in dropped).encode()

    def finish(self, pictures: Sequence[Labelled], out: Path) -> None:
        """Write data.yaml: the classes as the labels' own has them, or how many there are; and the
        pictures of each split in a file, as one folder may hold another's.
        """
        splits: dict[str, list[str]] = {"train": [], "val": []}
        for picture in pictures:
            named = (_SPLIT.fullmatch(folder) for folder in picture.place.split("/")[:-1])
            split = next((match[1] for match in named if match), "train")
            splits.setdefault(split, []).append(f"./{picture.place}\n")
        splits["val"] = splits["val"] or splits["train"]  # trainers insist on it
        for split, lines in splits.items():
            with written_whole(out / f"{split}.txt") as part:
                part.write_text("".join(lines), encoding="utf-8")
        classes = _PLACES.sub("", self.description)
        if not re.search(r"^(names|nc)\s*:", classes, re.MULTILINE):
            files = {self.file(picture.name) for picture in pictures}
            objects = [line.split() for file in files for line in _lines(file)]
            largest = max((int(words[0]) for words in objects if words), default=0)
            classes += f"nc: {largest + 1}\n"
        with written_whole(out / "data.yaml") as part:
            places = "".join(f"{split}: {split}.txt\n" for split in splits)
            part.write_text(places + classes, encoding="utf-8")


class _Masks(_Folder):
    """Masks of one channel, 8 or 16 bits, with a value above 0 for each object or class."""

    end = ".png"

    def objects(self, name: str, size: Size) -> Iterator[tuple[Key, Pixels]]:
        file = self.file(name)
        if file is None:
            return
        values = _mask(file)
        if values.shape != tuple(size):
            raise ValueError(f"{file}: is {values.shape} but its picture {tuple(size)} px")
        for value in np.unique(values[values > 0]).tolist():
            yield value, values == value

    def without(self, dropped: Collection[Key], source: Path) -> bytes:
        values, file = _mask(source), io.BytesIO()
        values[np.isin(values, list(dropped))] = 0
        Image.fromarray(values).save(file, "PNG")
        return file.getvalue()


@dataclass(frozen=True)
class _Coco(Labels):
    """One JSON file for all pictures: images by file name, annotations by the id of their image,
    and what else it holds.
    """

    path: Path
    content: Entry
    images: dict[str, Entry]
    annotations: dict[Any, list[Entry]]

    @staticmethod
    def read(path: Path) -> "_Coco":
        try:
            content = json.loads(path.read_text(encoding="utf-8-sig"))
            images = {image["file_name"]: image for image in content.pop("images")}
            annotations: dict[Any, list[Entry]] = {image["id"]: [] for image in images.values()}
            for entry in content.pop("annotations"):
                annotations[entry["image_id"]].append(entry)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise ValueError(f"{path}: is no COCO file: {error!r}") from None
        return _Coco(path, content, images, annotations)

    def _image(self, name: str) -> Entry:
        """The image of a picture, by its path or by the name of its file."""
        image = self.images.get(name) or self.images.get(name.rpartition("/")[2])
        if image is None:
            some = ", ".join(list(self.images)[:3])
            raise ValueError(f"{self.path}: no image has the file_name {name} (there are {some})")
        return image

    def only(self, name: str) -> "_Coco":
        image = self._image(name)
        id = image["id"]
        return _Coco(self.path, {}, {image["file_name"]: image}, {id: self.annotations[id]})

    def objects(self, name: str, size: Size) -> Iterator[tuple[Key, Pixels]]:
        image = self._image(name)
        stated = (image.get("height", size[0]), image.get("width", size[1]))
        if stated != tuple(size):
            raise ValueError(f"{self.path}: {name} is {stated} there but {tuple(size)} px")
        for entry in self.annotations[image["id"]]:
            try:
                yield entry["id"], _coco_pixels(entry, size)
            except (ValueError, TypeError, KeyError, IndexError) as error:
                got = f"annotation {entry.get('id')}: {error!r}"
                raise ValueError(f"{self.path}, {got}") from error

    def finish(self, pictures: Sequence[Labelled], out: Path) -> None:
        """Write a file of the same name, with a "contrast" in each annotation. Where a picture was
        written more than once, images and annotations are numbered anew.
        """
        ids = [self._image(picture.name)["id"] for picture in pictures]
        anew = len(set(ids)) < len(ids)
        images: list[Entry] = []
        annotations: list[Entry] = []
        for picture in pictures:
            image = self._image(picture.name)
            id = len(images) + 1 if anew else image["id"]
            images.append({**image, "id": id, "file_name": picture.place})
            objects = {one.key: one for one in picture.objects}
            for entry in self.annotations[image["id"]]:
                one = objects.get(entry["id"])
                if one is None:
                    raise ValueError(f"{self.path} has changed since {picture.place} was written")
                if one.kept:
                    own = len(annotations) + 1 if anew else entry["id"]
                    changed = {"id": own, "image_id": id, "contrast": one.contrast}
                    annotations.append({**entry, **changed})
        content = {**self.content, "images": images, "annotations": annotations}
        with written_whole(_not(out / self.path.name, self.path)) as part:
            part.write_text(json.dumps(content, ensure_ascii=False), encoding="utf-8")


def _coco_pixels(entry: Entry, size: Size) -> Pixels:
    """By segmentation, else by box."""
    segmentation = entry.get("segmentation")
    if isinstance(segmentation, dict):
        counts = segmentation["counts"]
        if tuple(segmentation["size"]) != tuple(size):
            raise ValueError(f"run lengths of {segmentation['size']} px")
        runs = _decompressed(counts) if isinstance(counts, str) else counts
        # down the columns, beginning outside
        inside = np.repeat(np.arange(len(runs)) % 2 == 1, runs)
        return inside.reshape(size[::-1]).T
    if segmentation:
        return _polygons([np.reshape(corners, (-1, 2)) for corners in segmentation], size)
    x, y, width, height = entry["bbox"]
    return _box(np.array([[x, y], [x + width, y + height]], dtype=float), size)


def _decompressed(text: str) -> list[int]:
    """COCO's compressed run lengths: numbers of 5 bits a letter, least first, with their sign; from
    the fourth on, differences to the number before the last (Lin et al., maskApi.c).
    """
    counts: list[int] = []
    for letters in re.findall("[P-o]*[0-O]", text):  # the last one lacks the bit of 32
        value = sum((ord(letter) - 48 & 31) << 5 * i for i, letter in enumerate(letters))
        if letters[-1] >= "@":  # the bit of 16
            value -= 1 << 5 * len(letters)
        counts.append(value + counts[-2] if len(counts) > 2 else value)
    return counts


def _box(corners: NDArray[Any], size: Size) -> Pixels:
    """All pixels of a picture that a box ((x1, y1), (x2, y2)) touches."""
    (x1, y1), (x2, y2) = corners.tolist()
    rows = slice(max(0, math.floor(y1)), max(0, min(size[0], math.ceil(y2))))
    return rows, slice(max(0, math.floor(x1)), max(0, min(size[1], math.ceil(x2))))


def _polygons(polygons: Sequence[NDArray[Any]], size: Size) -> Pixels:
    """The pixels whose centres lie in any of some polygons (each Nx2); of a sliver without any
    centre, those of its box.
    """
    from skimage.draw import polygon

    mask = np.zeros(size, bool)
    for corners in polygons:
        mask[polygon(corners[:, 1] - 0.5, corners[:, 0] - 0.5, size)] = True
    if mask.any():
        return mask
    points = np.concatenate(list(polygons))
    return _box(np.stack([points.min(0), points.max(0)]), size)


def _lines(file: Path | None) -> list[str]:
    return [] if file is None else file.read_text(encoding="utf-8-sig").splitlines()


def _mask(file: Path) -> NDArray[Any]:
    """Values (HxW); of a mask with a palette, their places in it."""
    with Image.open(file) as image:
        if image.mode not in ("L", "P", "1", "I;16"):
            raise ValueError(f"{file}: expected a mask of one channel, got {image.mode}")
        values = np.array(image)
    return values.astype(np.uint8) if values.dtype == bool else values


def _not(target: Path, source: Path) -> Path:
    """Refuse to write over the labels that are read."""
    if target.exists() and target.samefile(source):
        raise ValueError(f"{target} is read, and would be written over: choose another folder")
    return target
