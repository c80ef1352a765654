"""Labels of COCO: a JSON file for all pictures."""

import glob
import hashlib
import json
import os
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uwaug.files.labels import Entry, Key, Labels, require_size, write_labels
from uwaug.files.paths import PICTURES, parts_of, split_of

if TYPE_CHECKING:
    from uwaug.files.items import Item
    from uwaug.files.pixels import Pixels, Size
    from uwaug.files.summary import Result


_DIGEST = "uwaug_sha256"  # key of the digest of all other entries of a file that is written


@dataclass(frozen=True, eq=False)
class Coco(Labels):
    """Labels in one JSON file: images by file name, and annotations by the id of their image.

    Attributes:
        of: image and annotations of each picture, by its name.
        rest: all other entries of the file.
        count: number of images in the file.
    """

    rest: Entry = field(default_factory=dict)
    count: int = 0

    reads = "a COCO file (.json)"

    @classmethod
    def opened(cls, path: Path, items: Sequence["Item"]) -> "Labels | str":
        if not path.is_file():
            return ""
        try:
            rest = json.loads(path.read_text(encoding="utf-8-sig"))
            images = list(rest.pop("images"))
            annotations: dict[Any, list[Entry]] = {image["id"]: [] for image in images}
            if len(annotations) < len(images) or not all(
                parts_of(str(image["file_name"])) for image in images
            ):
                raise ValueError("expected a file_name and an id of its own for each image")
            for entry in rest.pop("annotations"):
                if "segments_info" in entry:
                    cure = "give the folder of its PNGs, and strike from it what they lose"
                    return f"{path}: is a panoptic file: {cure}"
                annotations[entry["image_id"]].append(entry)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            return f"{path}: is no COCO file: {error!r}"
        matches = _matches(path, images, items)
        of = {name: (image, annotations[image["id"]]) for name, image in matches.items()}
        names = ", ".join(str(image["file_name"]) for image in images[:3])
        expected = f"no image has the file_name {items[0].name} in its split (there are {names})"
        return cls(path, of, rest, len(images)) if of else f"{path}: {expected}"

    @property
    def shared(self) -> tuple[str, ...]:
        return (glob.escape(self.path.name),)

    def only(self, name: str) -> "Coco":
        return Coco(self.path, super().only(name).of)

    def digest(self, name: str) -> str | None:
        text = json.dumps(self.of.get(name)).encode()
        return hashlib.sha256(text).hexdigest() if name in self.of else None

    def objects(self, name: str, size: "Size") -> Iterator["tuple[Key, Pixels]"]:
        image, annotations = self.of[name]
        stated = image.get("height") or size[0], image.get("width") or size[1]
        require_size(self.path, stated, size)
        for entry in annotations:
            try:
                yield entry["id"], _pixels(entry, size)
            except (ValueError, TypeError, KeyError, IndexError) as error:
                got = f"annotation {entry.get('id')}: {error!r}"
                raise ValueError(f"{self.path}, {got}") from error

    def finish(self, pictures: Sequence["Result"], out: Path, force: bool = False) -> list[str]:
        """Write a file of the same name, with the images of the pictures, and a "contrast" in each
        annotation. Images and annotations of several variants get new numbers. A digest tells
        later whether somebody has edited the file.
        """
        labelled = [picture for picture in pictures if picture.item.name in self.of]
        renumber = len({picture.item.name for picture in labelled}) < len(labelled)
        images: list[Entry] = []
        annotations: list[Entry] = []
        for picture in labelled:
            image, entries = self.of[picture.item.name]
            if [entry["id"] for entry in entries] != [judged.key for judged in picture.objects]:
                raise ValueError(f"{self.path} has changed since {picture.place} was written")
            image_id = len(images) + 1 if renumber else image["id"]
            images.append({**image, "id": image_id, "file_name": picture.place})
            for entry, judged in zip(entries, picture.objects, strict=True):
                if judged.kept:
                    number = len(annotations) + 1 if renumber else entry["id"]
                    changes = {"id": number, "image_id": image_id, "contrast": judged.contrast}
                    annotations.append({**entry, **changes})
        content = {**self.rest, "images": images, "annotations": annotations}
        missing = self.count - len(self.of)
        note = f"{missing} of {self.count} images of {self.path} have no picture here"
        notes = [note] if missing else []
        file = out / self.path.name
        if file.exists() and not (force or file.samefile(self.path) or _is_written(file)):
            return [*notes, f"{file} stays, as it was edited: force=True (--force) replaces it"]
        content[_DIGEST] = _digest(content)
        write_labels(file, json.dumps(content, ensure_ascii=False).encode(), self.path)
        return notes


def _digest(content: Entry) -> str:
    """Digest of all entries of a file but the digest itself."""
    rest = {key: value for key, value in content.items() if key != _DIGEST}
    return hashlib.sha256(json.dumps(rest).encode()).hexdigest()


def _is_written(file: Path) -> bool:
    """True if a file is as a run has written it."""
    try:
        content = json.loads(file.read_bytes())
        return bool(content.get(_DIGEST) == _digest(content))
    except (ValueError, AttributeError):
        return False


def _matches(path: Path, images: Sequence[Entry], items: Sequence["Item"]) -> dict[str, Entry]:
    """The image of each picture that has one, by the picture's name.

    The path of an image is the end of its picture's path, as it is or without "images". Of an
    absolute path, a folder and the name are enough. Refuses an image that may be of two pictures.
    """
    by_end: dict[str, list[Entry]] = defaultdict(list)
    for image in images:
        parts = parts_of(str(image["file_name"]))
        plain = [part for part in parts if part not in PICTURES]
        is_absolute = re.match(r"[/\\]|\w:", str(image["file_name"]))
        for end in {"/".join(x) for x in (parts, plain, parts[-2:] if is_absolute else parts)}:
            by_end[end].append(image)
    labels = Path(os.path.abspath(path))
    names: dict[Any, str] = {}
    matches = {}
    for item in items:
        picture = Path(os.path.abspath(item.picture))
        common = len(Path(os.path.commonpath([labels, picture])).parts)
        words = [*labels.parts[common:-1], *re.split(r"[\W_]+", labels.stem)]
        splits = {split_of(words), split_of(picture.parts[common:-1])} - {None}
        ends = ("/".join(picture.parts[i:]) for i in range(len(picture.parts)))
        candidates = next((by_end[end] for end in ends if end in by_end), [])
        if len(candidates) != 1 or len(splits) > 1:
            continue
        image = candidates[0]
        rival = names.setdefault(image["id"], item.name)
        if rival != item.name:
            got = f"{image['file_name']} may be {rival} or {item.name}"
            raise ValueError(f"{path}: {got}: give the pictures of one folder")
        matches[item.name] = image
    return matches


def _pixels(entry: Entry, size: "Size") -> "Pixels":
    """Pixels of an annotation, by its segmentation, else by its box."""
    from uwaug.files.pixels import of_box, of_polygons, of_runs

    segmentation = entry.get("segmentation")
    if isinstance(segmentation, dict):
        if tuple(segmentation["size"]) != tuple(size):
            raise ValueError(f"run lengths of {segmentation['size']} px")
        return of_runs(segmentation["counts"], size)
    if segmentation and any(segmentation):
        return of_polygons(segmentation, size)
    x, y, width, height = entry["bbox"]
    return of_box(x, y, x + width, y + height, size)
