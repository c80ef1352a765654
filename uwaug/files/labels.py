"""Labels of pictures: found, judged by what can still be seen of each object, and written where
trainers look.

A format is a class of `Labels`, named in `FORMATS`; nothing else knows formats. Command lines ask
it what it reads, and wait for neither NumPy nor PyTorch.
"""

import hashlib
import json
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from uwaug._support.atomic import written_whole
from uwaug.files.record import digest

if TYPE_CHECKING:
    from torch import Tensor

    from uwaug.files.pixels import Pixels, Size

Key = int | str
"""Of an object in its picture: the id of a COCO annotation, a line of a YOLO file counted from 1, a
value of a mask.
"""

Entry = dict[str, Any]
"""An object of JSON or YAML."""

_SPLIT = re.compile(r"(train|val|test)(?:ing|id|idation)?[\d_]*")
"""A folder that says which split its pictures are of."""

_PLACES = ("path", "train", "val", "validation", "test", "download")
"""Keys of a data.yaml that say where pictures are."""


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
    """The labels of the pictures of a run; `name` is a picture's path below the folder of all.

    Attributes:
        reads: in words, the file or folder that the format is.
        path: of it.
    """

    reads: ClassVar[str]
    path: Path

    @classmethod
    def opened(cls, path: Path) -> "Labels | None":
        """The labels at a path; None if they are of another format.

        Raises:
            ValueError: if they are malformed; names the file.
        """
        raise NotImplementedError

    def require_some(self, names: Sequence[str]) -> None:
        """Refuse labels that belong to none of these pictures.

        Raises:
            ValueError: says what was looked for.
        """
        if all(map(self.missing, names)):
            raise ValueError(f"labels belong to no picture: {self.missing(names[0])}")

    def missing(self, name: str) -> str:
        """In words, what was looked for where a picture has no labels; "" if it has some."""
        raise NotImplementedError

    def digest(self, name: str) -> str | None:
        """By which labels of a picture that have changed are told; None if it has none."""
        raise NotImplementedError

    def only(self, name: str) -> "Labels":
        """The labels of one picture, in little memory, for the process that degrades it.

        Raises:
            ValueError: if the picture must have labels and has none.
        """
        return self

    def objects(self, name: str, size: "Size") -> Iterator["tuple[Key, Pixels]"]:
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


def judged(labels: Labels, name: str, contrast: "Tensor", least: float | None) -> list[Judged]:
    """What is left of each object of a picture: the mean over its pixels of a map of contrast
    (1xHxW, 0…1), 0 of an object without any in the picture. Below `least` no label is kept.
    """
    values = contrast[0].detach().cpu().numpy()
    objects = []
    for key, pixels in labels.objects(name, values.shape):
        chosen = values[pixels]
        share = round(float(chosen.mean(dtype="float64")), 4) if chosen.size else 0.0
        objects.append(Judged(key, share, least is None or share >= least))
    return objects


def aliases(name: str) -> list[str]:
    """Paths at which a folder beside that of the pictures may have what belongs to a picture:
    images/train/1.png may have train/1.txt, or its own path with "labels" for "images".
    """
    folders, paths = name.split("/"), [name]
    if "images" in folders[:-1]:
        last = len(folders) - 2 - folders[-2::-1].index("images")
        paths.append("/".join([*folders[:last], *folders[last + 1 :]]))
        paths.append("/".join([*folders[:last], "labels", *folders[last + 1 :]]))
    return paths


@dataclass(frozen=True)
class _Folder(Labels):
    """Labels in a folder with a file for each picture. Ultralytics puts "labels" in place of the
    last "images" of a picture's path: pictures are written below such a folder.
    """

    path: Path
    end: ClassVar[str]

    @classmethod
    def opened(cls, path: Path) -> "Labels | None":
        return cls(path) if next(path.rglob(f"*{cls.end}"), None) is not None else None

    def file(self, name: str) -> Path | None:
        """The label file of a picture; None if it has none, and so shows no object."""
        paths = [(self.path / alias).with_suffix(self.end) for alias in aliases(name)]
        return next((path for path in paths if path.is_file()), None)

    def missing(self, name: str) -> str:
        expected = (self.path / name).with_suffix(self.end)
        return "" if self.file(name) else f"{self.path}: expected files such as {expected}"

    def digest(self, name: str) -> str | None:
        file = self.file(name)
        return None if file is None else digest(file)

    def place(self, name: str) -> str:
        return name if "images" in name.split("/")[:-1] else f"images/{name}"

    def write(self, name: str, place: str, dropped: Collection[Key], out: Path) -> None:
        source = self.file(name)
        if source is None:
            return
        target = (out / aliases(place)[-1]).with_suffix(self.end)
        target.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(_require_other(target, source)) as part:
            part.write_bytes(self.without(dropped, source) if dropped else source.read_bytes())

    def without(self, dropped: Collection[Key], source: Path) -> bytes:
        """A label file, but for the labels of some objects."""
        raise NotImplementedError


class _Yolo(_Folder):
    """Text files with one object a line: `class cx cy w h`, or `class x1 y1 x2 y2 x3 y3 …` of a
    polygon; all but the class are shares of the picture's width or height. Where the data.yaml has
    `kpt_shape`, keypoints follow the box.
    """

    reads = "a folder of YOLO's .txt"
    end = ".txt"

    @cached_property
    def description(self) -> Entry:
        """What the data.yaml beside the labels or above them says; nothing without any."""
        import yaml

        folders = (self.path, self.path.parent, self.path.parent.parent)
        file = next((f / "data.yaml" for f in folders if (f / "data.yaml").is_file()), None)
        if file is None:
            return {}
        try:
            content = yaml.safe_load(file.read_bytes()) or {}
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise ValueError(f"{file}: is no YAML file: {error}") from None
        if not isinstance(content, dict):
            raise ValueError(f"{file}: expected names and values, got {content!r:.80}")
        return content

    def objects(self, name: str, size: "Size") -> Iterator["tuple[Key, Pixels]"]:
        from uwaug.files.pixels import of_box, of_polygons

        file = self.file(name)
        for number, line in enumerate(_lines(file), 1):
            if not line.strip():
                continue
            try:
                shares = [float(word) for word in line.split()[1:]]
                shares = shares[:4] if "kpt_shape" in self.description else shares
                few = len(shares) < 4 or len(shares) % 2
                if few or not all(abs(share) <= 2 for share in shares):
                    raise ValueError("expected a class, and shares of width and height, 0…1")
            except ValueError as error:
                raise ValueError(f"{file}, line {number}: {error}") from error
            corners = [share * side for share, side in zip(shares, cycle(size[::-1]), strict=False)]
            if len(corners) == 4:
                x, y, width, height = corners
                box = x - width / 2, y - height / 2, x + width / 2, y + height / 2
                yield number, of_box(*box, size)
            else:
                yield number, of_polygons([corners], size)

    def without(self, dropped: Collection[Key], source: Path) -> bytes:
        lines = enumerate(_lines(source), 1)
        return "".join(f"{line}\n" for number, line in lines if number not in dropped).encode()

    def finish(self, pictures: Sequence[Labelled], out: Path) -> None:
        """Write data.yaml: the classes as the labels' own has them, or how many there are; and the
        pictures of each split in a file, as one folder may hold another's.
        """
        import yaml

        splits: dict[str, list[str]] = {"train": [], "val": []}
        for picture in pictures:
            named = (_SPLIT.fullmatch(folder) for folder in picture.place.split("/")[:-1])
            split = next((match[1] for match in named if match), "train")
            splits.setdefault(split, []).append(f"./{picture.place}\n")
        splits["val"] = splits["val"] or splits["train"]  # trainers insist on it
        for split, lines in splits.items():
            with written_whole(out / f"{split}.txt") as part:
                part.write_text("".join(lines), encoding="utf-8")
        classes = {key: own for key, own in self.description.items() if key not in _PLACES}
        if not {"names", "nc"} & classes.keys():
            files = {self.file(picture.name) for picture in pictures}
            objects = [line.split() for file in files for line in _lines(file)]
            classes["nc"] = max((int(words[0]) for words in objects if words), default=0) + 1
        content = {split: f"{split}.txt" for split in splits} | classes
        with written_whole(out / "data.yaml") as part:
            text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
            part.write_text(text, encoding="utf-8")


class _Masks(_Folder):
    """Masks of one channel, 8 or 16 bits, with a value above 0 for each object or class."""

    reads = "a folder of .png masks"
    end = ".png"

    def objects(self, name: str, size: "Size") -> Iterator["tuple[Key, Pixels]"]:
        from uwaug.files.pixels import of_mask, read_mask

        file = self.file(name)
        if file is None:
            return
        mask = read_mask(file)
        if mask.shape != tuple(size):
            raise ValueError(f"{file}: is {mask.shape} but its picture {tuple(size)} px")
        yield from of_mask(mask)

    def without(self, dropped: Collection[Key], source: Path) -> bytes:
        from uwaug.files.pixels import read_mask, without

        return without(read_mask(source), dropped)


@dataclass(frozen=True)
class _Coco(Labels):
    """One JSON file for all pictures: images by file name, annotations by the id of their image,
    and what else it holds.
    """

    path: Path
    content: Entry
    images: dict[str, Entry]
    annotations: dict[Any, list[Entry]]

    reads = "a COCO file (.json)"

    @classmethod
    def opened(cls, path: Path) -> "Labels | None":
        if not path.is_file():
            return None
        try:
            content = json.loads(path.read_text(encoding="utf-8-sig"))
            images = {image["file_name"]: image for image in content.pop("images")}
            annotations: dict[Any, list[Entry]] = {image["id"]: [] for image in images.values()}
            for entry in content.pop("annotations"):
                annotations[entry["image_id"]].append(entry)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise ValueError(f"{path}: is no COCO file: {error!r}") from None
        return cls(path, content, images, annotations)

    def _image(self, name: str) -> Entry:
        """The image of a picture, by its path or by the name of its file."""
        if why := self.missing(name):
            raise ValueError(why)
        return self.images.get(name) or self.images[name.rpartition("/")[2]]

    def missing(self, name: str) -> str:
        if name in self.images or name.rpartition("/")[2] in self.images:
            return ""
        some = ", ".join(list(self.images)[:3])
        return f"{self.path}: no image has the file_name {name} (there are {some})"

    def digest(self, name: str) -> str | None:
        image = self._image(name)
        own = json.dumps([image, self.annotations[image["id"]]])
        return hashlib.sha256(own.encode()).hexdigest()

    def only(self, name: str) -> "_Coco":
        image = self._image(name)
        id = image["id"]
        return _Coco(self.path, {}, {image["file_name"]: image}, {id: self.annotations[id]})

    def objects(self, name: str, size: "Size") -> Iterator["tuple[Key, Pixels]"]:
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
            objects = {judged.key: judged for judged in picture.objects}
            for entry in self.annotations[image["id"]]:
                judged = objects.get(entry["id"])
                if judged is None:
                    raise ValueError(f"{self.path} has changed since {picture.place} was written")
                if judged.kept:
                    own = len(annotations) + 1 if anew else entry["id"]
                    changed = {"id": own, "image_id": id, "contrast": judged.contrast}
                    annotations.append({**entry, **changed})
        content = {**self.content, "images": images, "annotations": annotations}
        with written_whole(_require_other(out / self.path.name, self.path)) as part:
            part.write_text(json.dumps(content, ensure_ascii=False), encoding="utf-8")


FORMATS: tuple[type[Labels], ...] = (_Coco, _Yolo, _Masks)
"""In this order: a data set in YOLO's format may hold pictures, too."""


def formats() -> str:
    """What labels may be, in words."""
    *others, last = (format.reads for format in FORMATS)
    return f"{', '.join(others)}, or {last}"


def open_labels(path: str | Path) -> Labels:
    """The labels in a file or a folder, of one of `FORMATS`.

    Raises:
        ValueError: if it is none of them; says what they are.
        OSError: if it cannot be read.
    """
    for format in FORMATS:
        labels = format.opened(Path(path))
        if labels is not None:
            return labels
    raise ValueError(f"labels must be {formats()}, got {path}")


def _coco_pixels(entry: Entry, size: "Size") -> "Pixels":
    """By segmentation, else by box."""
    from uwaug.files.pixels import of_box, of_polygons, of_runs

    segmentation = entry.get("segmentation")
    if isinstance(segmentation, dict):
        if tuple(segmentation["size"]) != tuple(size):
            raise ValueError(f"run lengths of {segmentation['size']} px")
        return of_runs(segmentation["counts"], size)
    if segmentation:
        return of_polygons(segmentation, size)
    x, y, width, height = entry["bbox"]
    return of_box(x, y, x + width, y + height, size)


def _lines(file: Path | None) -> list[str]:
    return [] if file is None else file.read_text(encoding="utf-8-sig").splitlines()


def _require_other(target: Path, source: Path) -> Path:
    """Refuse to write over the labels that are read."""
    if target.exists() and target.samefile(source):
        raise ValueError(f"{target} is read, and would be written over: choose another folder")
    return target
