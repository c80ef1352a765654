"""Labels of COCO: a JSON file for all pictures."""

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from uwaug._support.atomic import read_text
from uwaug.files.folder import MANIFEST
from uwaug.files.labels import Entry, Key, Labels, require_size
from uwaug.files.paths import matched, parts_of, split_of

if TYPE_CHECKING:
    from uwaug._support.pixels import Pixels, Size
    from uwaug.files.items import Item
    from uwaug.files.summary import Result


_OTHERS = (
    "in LVIS write the end of coco_url as file_name; of YouTube-VIS, SA-1B, labelme, jsonl, CSV or "
    "MOT's gt.txt make a COCO file with an image for each frame or picture"
)
_MOST_FILES = 64  # of the splits of a data set


@dataclass(frozen=True, eq=False)
class Coco(Labels):
    """Labels in one JSON file; `of` has the image and the annotations of each picture."""

    rest: Entry = field(default_factory=dict)  # all other entries of the file
    count: int = 0  # of images in the file
    is_split: bool = False  # if it is one of several

    reads = "a COCO file (.json)"

    @classmethod
    def opened(cls, path: Path, items: Sequence["Item"]) -> "Labels | str":
        if not path.is_file():
            return ""
        try:
            rest = json.loads(read_text(path))
            images = list(rest.pop("images"))
            annotations: dict[Any, list[Entry]] = {image["id"]: [] for image in images}
            are_named = all(parts_of(str(image["file_name"])) for image in images)
            if len(annotations) < len(images) or not are_named:
                raise ValueError("expected a file_name and an id of its own for each image")
            for entry in rest.pop("annotations"):
                if "segments_info" in entry:
                    cure = "give the folder of its PNGs, and strike from it what they lose"
                    return f"{path}: is a panoptic file: {cure}"
                annotations[entry["image_id"]].append(entry)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            return f"{path}: is no COCO file: {error!r}: {_OTHERS}"
        matches = _matches(path, images, items)
        of = {name: (image, annotations[image["id"]]) for name, image in matches.items()}
        names = ", ".join(str(image["file_name"]) for image in images[:3])
        expected = f"no image has the file_name {items[0].name} in its split (there are {names})"
        return cls(path, of, rest, len(images)) if of else f"{path}: {expected}"

    def only(self, name: str) -> Self:
        return replace(super().only(name), rest={})

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
                place = f"{self.path}, annotation {entry.get('id')}"
                raise ValueError(f"{place}: {error!r}") from error

    def lists(self, pictures: Sequence["Result"]) -> tuple[dict[str, bytes], list[str]]:
        """A file of the same name, with the images of the pictures, and a "contrast" in each
        annotation. Images and annotations of several variants get new numbers.
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
            place = picture.place
            if self.is_split:  # pictures lie below its folder, or another, as they did
                above = parts_of(picture.item.name)[: -len(parts_of(str(image["file_name"])))]
                place = place.removeprefix("".join(f"{folder}/" for folder in above))
            images.append({**image, "id": image_id, "file_name": place})
            for entry, judged in zip(entries, picture.objects, strict=True):
                if judged.kept:
                    number = len(annotations) + 1 if renumber else entry["id"]
                    changes = {"id": number, "image_id": image_id, "contrast": judged.contrast}
                    annotations.append({**entry, **changes})
        content = {**self.rest, "images": images, "annotations": annotations}
        missing = self.count - len(self.of)
        note = f"{missing} of {self.count} images of {self.path} have no picture here"
        text = json.dumps(content, ensure_ascii=False)
        return {self.path.name: text.encode()}, [note] * bool(missing)


@dataclass(frozen=True, eq=False)
class CocoSplits(Coco):
    """COCO files in a folder, one for each split."""

    splits: Mapping[str, Coco] = field(default_factory=dict)  # by their paths in the folder

    reads = "a folder of COCO files"

    @classmethod
    def opened(cls, path: Path, items: Sequence["Item"]) -> "Labels | str":
        runs = {file.parent for file in path.rglob(MANIFEST)} - {path}
        paths = [file for file in sorted(path.rglob("*.json")) if runs.isdisjoint(file.parents)]
        if len(paths) > _MOST_FILES:
            return f"{len(paths)} .json files, as of SA-1B or labelme: gather them in one of COCO"
        opened = {file: Coco.opened(file, items) for file in paths if file.name != MANIFEST}
        of: dict[str, Any] = {}
        splits = {}
        for file, labels in opened.items():
            if isinstance(labels, Coco):
                if twice := labels.of.keys() & of.keys():
                    raise ValueError(f"{file} is one of two that label {min(twice)}: give one")
                of |= labels.of
                splits[file.relative_to(path).as_posix()] = replace(labels, is_split=True)
            elif split_of(re.split(r"[\W_]+", str(file.relative_to(path).with_suffix("")))):
                raise ValueError(f"{file} {labels}")
        return cls(path, of, splits=splits) if of else "; ".join(map(str, [*opened.values()][:1]))

    def only(self, name: str) -> Self:
        paths = (file.path for file in self.splits.values() if name in file.of)
        return replace(super().only(name), path=next(paths, self.path), splits={})

    def lists(self, pictures: Sequence["Result"]) -> tuple[dict[str, bytes], list[str]]:
        lists = {place: file.lists(pictures) for place, file in self.splits.items()}
        contents = {place: content for place, (of, _) in lists.items() for content in of.values()}
        return contents, [note for _, notes in lists.values() for note in notes]


def _matches(path: Path, images: Sequence[Entry], items: Sequence["Item"]) -> dict[str, Entry]:
    """The image of each picture that has one, by the picture's name. A file of one split has none
    for pictures of another.
    """
    labels, pictures = Path(os.path.abspath(path)), {}
    for item in items:
        picture = Path(os.path.abspath(item.picture))
        common = len(Path(os.path.commonpath([labels, picture])).parts)
        words = [*labels.parts[common:-1], *re.split(r"[\W_]+", labels.stem)]
        if len({split_of(words), split_of(picture.parts[common:-1])} - {None}) < 2:
            pictures[item.picture] = item.name
    try:
        places = matched([str(image["file_name"]) for image in images], [*pictures], whole=True)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return {pictures[p]: images[n[0]] for p, n in places.items() if len(n) == 1}


def _pixels(entry: Entry, size: "Size") -> "Pixels":
    from uwaug._support.pixels import of_box, of_polygons, of_runs

    segmentation = entry.get("segmentation")
    if isinstance(segmentation, dict):
        if tuple(segmentation["size"]) != tuple(size):
            raise ValueError(f"run lengths of {segmentation['size']} px")
        return of_runs(segmentation["counts"], size)
    if segmentation and any(segmentation):
        return of_polygons(segmentation, size)
    x, y, width, height = entry["bbox"]
    return of_box(x, y, x + width, y + height, size)
