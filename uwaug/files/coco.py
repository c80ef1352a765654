"""Labels of COCO: a JSON file for all pictures."""

import hashlib
import json
import os
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uwaug.files.labels import (
    PICTURES,
    Entry,
    Key,
    Labels,
    require_size,
    split_of,
    write_other,
)

if TYPE_CHECKING:
    from uwaug.files.items import Item
    from uwaug.files.pixels import Pixels, Size
    from uwaug.files.summary import Result


@dataclass(frozen=True, eq=False)
class Coco(Labels):
    """One JSON file: images by file name, annotations by the id of their image, and what else it
    holds. `of` has the image of each picture, and its annotations; `count` images there are.
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
            if len(annotations) < len(images) or not all(map(_parts, images)):
                raise ValueError("expected a file_name and an id of its own for each image")
            for entry in rest.pop("annotations"):
                annotations[entry["image_id"]].append(entry)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            return f"{path}: is no COCO file: {error!r}"
        matched = _matched(path, images, items)
        of = {name: (image, annotations[image["id"]]) for name, image in matched.items()}
        some = ", ".join(str(image["file_name"]) for image in images[:3])
        expected = f"no image has the file_name {items[0].name} in its split (there are {some})"
        return cls(path, of, rest, len(images)) if of else f"{path}: {expected}"

    def only(self, name: str) -> "Coco":
        return Coco(self.path, super().only(name).of)

    def digest(self, name: str) -> str | None:
        own = json.dumps(self.of.get(name)).encode()
        return hashlib.sha256(own).hexdigest() if name in self.of else None

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

    def finish(self, pictures: Sequence["Result"], out: Path) -> list[str]:
        """Write a file of the same name, of the pictures that have an image there, with a
        "contrast" in each annotation. Where a picture was written more than once, images and
        annotations are numbered anew.
        """
        own = [picture for picture in pictures if picture.item.name in self.of]
        names = {picture.item.name for picture in own}
        anew = len(names) < len(own)
        images: list[Entry] = []
        annotations: list[Entry] = []
        for picture in own:
            image, entries = self.of[picture.item.name]
            if [entry["id"] for entry in entries] != [judged.key for judged in picture.objects]:
                raise ValueError(f"{self.path} has changed since {picture.place} was written")
            id = len(images) + 1 if anew else image["id"]
            images.append({**image, "id": id, "file_name": picture.place})
            for entry, judged in zip(entries, picture.objects, strict=True):
                if judged.kept:
                    number = len(annotations) + 1 if anew else entry["id"]
                    changed = {"id": number, "image_id": id, "contrast": judged.contrast}
                    annotations.append({**entry, **changed})
        content = {**self.rest, "images": images, "annotations": annotations}
        text = json.dumps(content, ensure_ascii=False)
        write_other(out / self.path.name, text.encode(), self.path)
        lost = self.count - len(self.of)
        note = f"{lost} of {self.count} images of {self.path} have no picture here"
        return [note] if lost else []


def _parts(image: Entry) -> list[str]:
    """The folders and the name of an image's file, whatever system wrote them."""
    words = str(image["file_name"]).replace("\\", "/").split("/")
    return [word for word in words if word not in ("", ".", "..")]


def _matched(path: Path, images: Sequence[Entry], items: Sequence["Item"]) -> dict[str, Entry]:
    """The image of each picture that has one: whose path is the end of the picture's, as it is or
    without "images"; of an absolute path, a folder and the name do. An image is of one picture.

    Raises:
        ValueError: if two pictures may be one image.
    """
    called: dict[str, list[Entry]] = defaultdict(list)
    for image in images:
        parts = _parts(image)
        plain = [part for part in parts if part not in PICTURES]
        moved = parts[-2:] if re.match(r"[/\\]|\w:", str(image["file_name"])) else parts
        for end in {"/".join(own) for own in (parts, plain, moved)}:
            called[end].append(image)
    here = Path(os.path.abspath(path))
    names: dict[Any, str] = {}
    matched = {}
    for item in items:
        picture = Path(os.path.abspath(item.picture))
        common = len(Path(os.path.commonpath([here, picture])).parts)
        words = [*here.parts[common:-1], *re.split(r"[\W_]+", here.stem)]
        splits = {split_of(words), split_of(picture.parts[common:-1])} - {None}
        ends = ("/".join(picture.parts[i:]) for i in range(len(picture.parts)))
        own = next((called[end] for end in ends if end in called), [])
        if len(own) != 1 or len(splits) > 1:
            continue
        other = names.setdefault(own[0]["id"], item.name)
        if other != item.name:
            got = f"{own[0]['file_name']} may be {other} or {item.name}"
            raise ValueError(f"{path}: {got}: give the pictures of one folder")
        matched[item.name] = own[0]
    return matched


def _pixels(entry: Entry, size: "Size") -> "Pixels":
    """By segmentation, else by box."""
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
