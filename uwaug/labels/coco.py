"""Labels as COCO has them: one JSON file for many pictures."""

import hashlib
import os
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from uwaug._support.atomic import require_regular
from uwaug._support.hashing import FileHash
from uwaug._support.parse import from_json
from uwaug.labels.regions import Region, Size, box_region, polygon_region, runs_region
from uwaug.labels.source import (
    Labels,
    Object,
    Record,
    plain_name,
    refuse_source,
    write_json,
)

Entry = dict[str, Any]


@dataclass(frozen=True)
class CocoLabels:
    """A COCO file. A large one takes seconds to read and memory of its own: open it once, and hand
    the `Labels` of each picture to those who work.

    Attributes:
        hash: of the file.
        content: all that is in it.
        images: by file name as the file has it.
        annotations: by image id.
        stems: file names as the file has them, by their stem.
    """

    hash: FileHash
    content: Entry
    images: Mapping[str, Entry]
    annotations: Mapping[Any, list[Entry]]
    stems: Mapping[str, list[str]]

    @staticmethod
    def read(path: str | os.PathLike[str]) -> "CocoLabels":
        """From a file.

        Raises:
            ValueError: if it is no JSON, lacks images or annotations, or an id is missing, used
                twice or of no image.
            OSError: if it cannot be read.
        """
        require_regular(path)
        data = Path(path).read_bytes()
        try:
            content = from_json(data.decode("utf-8-sig"))
        except ValueError as error:
            raise ValueError(f"{path}: expected JSON: {error}") from None
        images, annotations = (_listed(content, name, path) for name in ("images", "annotations"))
        by_image: dict[Any, list[Entry]] = {entry["id"]: [] for entry in images}
        for entry in annotations:
            image_id = entry.get("image_id")
            if not isinstance(image_id, (int, str)) or image_id not in by_image:
                got = f"image_id {image_id!r:.80}, which no image has"
                raise ValueError(f"{path}, annotation {entry['id']}: {got}")
            by_image[image_id].append(entry)
        by_name: dict[str, Entry] = {}
        stems: dict[str, list[str]] = {}
        for entry in images:
            name = _file_name(entry, path)
            if name in by_name:
                raise ValueError(f"{path}: two images have the file_name {name!r}")
            by_name[name] = entry
            stems.setdefault(PurePosixPath(name).stem, []).append(name)
        digest = hashlib.sha256(data).hexdigest()
        file = FileHash(os.path.abspath(path), digest, len(data))
        return CocoLabels(file, content, by_name, by_image, stems)

    @property
    def path(self) -> Path:
        """Of the file."""
        return Path(self.hash.path)

    def labels_of(self, picture: str | os.PathLike[str]) -> Labels:
        """See `LabelSource`. A picture is found by its path, or by the end of it where one of the
        two paths begins in another folder; another suffix does no harm.
        """
        name = self._name_of(plain_name(picture))
        image = self.images[name]
        entries = tuple(self.annotations[image["id"]])
        stated = image.get("height"), image.get("width")
        return _CocoImage(name, self.hash.path, self.hash, stated, entries)

    def _name_of(self, picture: str) -> str:
        """The file name, as the file has it, of a picture."""
        if picture in self.images:
            return picture
        near = [
            name for name in self.stems.get(PurePosixPath(picture).stem, ()) if _meet(name, picture)
        ]
        alike = [name for name in near if PurePosixPath(name).name == PurePosixPath(picture).name]
        names = alike or near
        if len(names) > 1:
            several = ", ".join(names[:3])
            raise ValueError(f"{self.path}: {picture!r} may be any of {several}: use its path")
        if names:
            return names[0]
        some = ", ".join(sorted(self.images)[:3])
        cure = "take the picture out, or give it an image entry without annotations"
        raise ValueError(f"{self.path}: no image {picture!r} (there are {some}, …): {cure}")

    def write_run(self, records: Iterable[Record], folder: str | os.PathLike[str]) -> list[Path]:
        """See `LabelSource`. The file has the name of the one that was read."""
        target = Path(folder) / self.path.name
        refuse_source(target, str(self.path))
        return [write_json(target, self.assembled(records))]

    def assembled(self, records: Iterable[Record]) -> Entry:
        """The content of a COCO file of what was written; all other keys are kept.

        Where a picture was written more than once, images and annotations are numbered anew, in the
        order of their outputs, and "source_id" is the number that they had.

        Raises:
            ValueError: if a record is of other labels.
        """
        ordered = sorted(records, key=lambda record: str(record["output"]))
        counts = Counter(record["picture"] for record in ordered)
        anew = any(count > 1 for count in counts.values())
        images: list[Entry] = []
        annotations: list[Entry] = []
        for record in ordered:
            if record["picture"] not in self.images:
                got = f"a record of {record['picture']!r}"
                raise ValueError(f"{self.path}: {got}, which is no image of it: run anew")
            image = self.images[record["picture"]]
            judged = {entry["key"]: entry for entry in record["objects"]}
            number = len(images) + 1 if anew else image["id"]
            for entry in self.annotations[image["id"]]:
                if entry["id"] not in judged:
                    where = f"{self.path}, annotation {entry['id']}"
                    raise ValueError(
                        f"{where}: {record['output']!r} was judged without it: run anew"
                    )
                judgement = judged[entry["id"]]
                changed = {**entry, "image_id": number, "contrast": judgement["contrast"]}
                if judgement["ignored"]:
                    changed["iscrowd"] = 1
                annotations.append(_numbered(changed, len(annotations) + 1, anew=anew))
            renamed = {**image, "file_name": plain_name(record["output"])}
            images.append(_numbered(renamed, number, anew=anew))
        return {**self.content, "images": images, "annotations": annotations}


@dataclass(frozen=True)
class _CocoImage(Labels):
    """An image of a COCO file with its annotations.

    Attributes:
        hash: of the file.
        stated: height and width, as the file has them; None where it says nothing.
        annotations: of the image.
    """

    hash: FileHash
    stated: tuple[int | None, int | None]
    annotations: tuple[Entry, ...]

    def objects(self, size: Size) -> list[Object]:
        """As of `Labels`."""
        stated = tuple(
            actual if side is None else side for side, actual in zip(self.stated, size, strict=True)
        )
        if stated != tuple(size):
            got = f"image {self.picture!r} is {stated} there but {tuple(size)} px in its file"
            cure = "height and width must agree; was it resized, or turned by its EXIF orientation?"
            raise ValueError(f"{self.file}: {got}: {cure}")
        objects = []
        for entry in self.annotations:
            where = f"{self.file}, annotation {entry['id']}"
            objects.append(Object(entry["id"], _region(entry, where, size)))
        return objects

    def write(self, record: Record, path: str | os.PathLike[str]) -> list[Path]:
        """None: one file holds those of the whole run."""
        return []

    def file_hash(self) -> FileHash:
        """The COCO file as it was when it was opened."""
        return self.hash


def _meet(name: str, other: str) -> bool:
    """Whether one path, without suffix, is the end of the other."""
    parts = [PurePosixPath(path).with_suffix("").parts for path in (name, other)]
    shorter, longer = sorted(parts, key=len)
    return longer[-len(shorter) :] == shorter


def _numbered(entry: Entry, number: Any, *, anew: bool) -> Entry:
    return {**entry, "id": number, "source_id": entry["id"]} if anew else entry


def _listed(content: Any, name: str, path: Any) -> list[Entry]:
    """Images or annotations: dicts of different ids."""
    entries = content.get(name) if isinstance(content, dict) else None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise ValueError(f"{path}: expected COCO's format, with a list of {name!r}")
    seen = set()
    for number, entry in enumerate(entries):
        key = entry.get("id")
        if not isinstance(key, (int, str)):
            wrong = "is missing" if key is None else "must be a whole number or a name"
        else:
            wrong = "is used twice" if key in seen else ""
        if wrong:
            raise ValueError(f"{path}: the id {key!r:.80} of {name}[{number}] {wrong}")
        seen.add(key)
    return entries


def _file_name(entry: Entry, path: Any) -> str:
    name = entry.get("file_name")
    if not isinstance(name, str) or not name:
        raise ValueError(f"{path}, image {entry['id']}: expected a file_name, got {name!r}")
    return PurePosixPath(name.replace("\\", "/")).as_posix()


def _region(entry: Entry, where: str, size: Size) -> Region | None:
    """The pixels of the segmentation, or of the box where there is none."""
    segmentation = entry.get("segmentation")
    if isinstance(segmentation, dict):
        return runs_region(_runs(segmentation, where, size), size)
    if isinstance(segmentation, list) and segmentation:
        return polygon_region([_polygon(row, where) for row in segmentation], size)
    box = _numbers(entry.get("bbox"), f"{where}: bbox")
    if len(box) != 4:
        raise ValueError(f"{where}: expected a bbox [x, y, width, height], got {len(box)} numbers")
    x, y, width, height = map(float, box)
    return box_region((x, y, x + width, y + height), size)


def _polygon(row: Any, where: str) -> Any:
    values = _numbers(row, f"{where}: segmentation")
    if len(values) < 6 or len(values) % 2:
        expected = "three corners or more, [x1, y1, x2, y2, x3, y3, …]"
        raise ValueError(f"{where}: expected {expected}, got {len(values)} numbers")
    return values.reshape(-1, 2)


def _numbers(row: Any, where: str) -> Any:
    try:
        values = np.array(row, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{where}: expected a list of numbers, got {row!r:.80}") from None
    if values.ndim != 1 or not np.isfinite(values).all():
        raise ValueError(f"{where}: expected a list of finite numbers, got {row!r:.80}")
    return values


def _runs(segmentation: Entry, where: str, size: Size) -> tuple[int, ...]:
    """Run lengths, plain or compressed."""
    counts = segmentation.get("counts")
    if isinstance(counts, str):
        counts = _decompressed(counts)
    if not isinstance(counts, list) or not all(isinstance(c, int) and c >= 0 for c in counts):
        raise ValueError(f"{where}: expected run lengths in 'counts', got {counts!r:.80}")
    if segmentation.get("size") != list(size) or sum(counts) != size[0] * size[1]:
        got = f"{sum(counts)} px of {segmentation.get('size')}"
        raise ValueError(f"{where}: expected run lengths of {list(size)} px, got {got}")
    return tuple(counts)


def _decompressed(text: str) -> list[int]:
    """COCO's compressed run lengths: numbers of 5 bits a letter, least first, with their sign; from
    the fourth on, differences to the number before the last (Lin et al., maskApi.c).
    """
    counts: list[int] = []
    value = shift = 0
    for letter in text:
        bits = ord(letter) - 48
        value |= (bits & 31) << shift
        shift += 5
        if bits & 32:
            continue
        if bits & 16:
            value -= 1 << shift
        counts.append(value + counts[-2] if len(counts) > 2 else value)
        value = shift = 0
    return counts
