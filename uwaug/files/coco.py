"""Labels of COCO: a JSON file for many pictures."""

import json
import os
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from uwaug._support.atomic import read_text
from uwaug.files.labels import Entry, Key, Labels, normal, require_size

if TYPE_CHECKING:
    from uwaug._support.pixels import Pixels, Size
    from uwaug.files.summary import Result
    from uwaug.files.table import Row


class _Image(NamedTuple):
    file: Path
    place: str  # path below the folder of the run that the file is written to
    image: Entry
    annotations: list[Entry]


@dataclass(frozen=True, eq=False)
class Coco(Labels):
    """Labels in JSON files, of which each is written again. An image is that of the picture whose
    path ends in its file_name.
    """

    of: Mapping[str, _Image]
    rests: Mapping[str, Entry] = field(default_factory=dict)  # of files by place: all but the above
    told: Sequence[str] = ()

    reads = "COCO's files"
    endings = (".json",)

    @classmethod
    def opened(cls, rows: Sequence["Row"], classes: Path | None = None) -> Self:
        rows_of: dict[Path, list[Row]] = defaultdict(list)
        for row in rows:
            if row.labels is not None:
                rows_of[Path(os.path.abspath(row.labels))].append(row)
        # each is written at its path below the folder that names of pictures begin at
        root = Path(os.path.abspath(rows[0].picture).removesuffix(rows[0].name))
        if not all(file.is_relative_to(root) for file in rows_of):
            root = Path(os.path.commonpath([file.parent for file in rows_of]))
        of: dict[str, _Image] = {}
        rests, told = {}, []
        for file, own in rows_of.items():
            place = file.relative_to(root).as_posix()
            images, annotations, rests[place] = _read(file)
            image_of = _matches(file, images, own)
            for name, image in image_of.items():
                of[name] = _Image(file, place, image, annotations[image["id"]])
            if bare := [row.name for row in own if row.name not in image_of]:
                told.append(f"{len(bare)} pictures have no image in {file}, such as {bare[0]}")
            if missing := len(images) - len({image["id"] for image in image_of.values()}):
                told.append(f"{missing} of {len(images)} images of {file} have no picture here")
        return cls(of, rests, told)

    def only(self, name: str) -> Self:
        return replace(super().only(name), rests={}, told=())

    def objects(self, name: str, size: "Size") -> Iterator["tuple[Key, Pixels]"]:
        file, _, image, annotations = self.of[name]
        stated = image.get("height") or size[0], image.get("width") or size[1]
        require_size(file, stated, size)
        for entry in annotations:
            try:
                yield entry["id"], _pixels(entry, size)
            except (ValueError, TypeError, KeyError, IndexError) as error:
                raise ValueError(f"{file}, annotation {entry.get('id')}: {error!r}") from error

    def lists(self, results: Sequence["Result"]) -> tuple[dict[str, bytes], list[str]]:
        """The files, with the images of the results, and a "contrast" in each annotation. Images
        and annotations of several variants get new numbers.
        """
        results_of: dict[str, list[Result]] = {place: [] for place in self.rests}
        for result in results:
            if result.row.name in self.of:
                results_of[self.of[result.row.name].place].append(result)
        contents = {place: self._content(place, own) for place, own in results_of.items()}
        return contents, [*self.told]

    def _content(self, place: str, results: Sequence["Result"]) -> bytes:
        ids = {self.of[result.row.name].image["id"] for result in results}
        are_anew = len(ids) < len(results)
        names = self._file_names(results)
        images: list[Entry] = []
        annotations: list[Entry] = []
        for result, name in zip(results, names, strict=True):
            file, _, image, entries = self.of[result.row.name]
            if [entry["id"] for entry in entries] != [judged.key for judged in result.objects]:
                raise ValueError(f"{file} has changed since {result.place} was written")
            image_id = len(images) + 1 if are_anew else image["id"]
            images.append({**image, "id": image_id, "file_name": name})
            for entry, judged in zip(entries, result.objects, strict=True):
                if judged.kept:
                    number = len(annotations) + 1 if are_anew else entry["id"]
                    changes = {"id": number, "image_id": image_id, "contrast": judged.contrast}
                    annotations.append({**entry, **changes})
        content = {**self.rests[place], "images": images, "annotations": annotations}
        return json.dumps(content, ensure_ascii=False).encode()

    def _file_names(self, results: Sequence["Result"]) -> list[str]:
        """Paths of results, from the folder on that those of the source begin at, if it is one for
        all, else from that of the run on.
        """
        places = [result.place.split("/") for result in results]
        counts = [len(_parts(self.of[result.row.name].image["file_name"])) for result in results]
        folders = {(*parts[:-n],) for parts, n in zip(places, counts, strict=True)}
        depth = len(folders.pop()) if len(folders) == 1 else 0
        return ["/".join(parts[depth:]) for parts in places]


def _read(file: Path) -> tuple[list[Entry], dict[Any, list[Entry]], Entry]:
    """Images of a file; annotations of each, by its id; and the rest."""
    try:
        rest = json.loads(read_text(file))
        images = list(rest.pop("images"))
        annotations: dict[Any, list[Entry]] = {image["id"]: [] for image in images}
        are_named = all(_parts(image.get("file_name", "")) for image in images)
        if len(annotations) < len(images) or not are_named:
            raise ValueError(
                "expected a file_name (LVIS has none), and an id of its own, of each image"
            )
        for entry in rest.pop("annotations"):
            annotations[entry["image_id"]].append(entry)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise ValueError(f"{file}: is no COCO file: {error!r}") from None
    return images, annotations, rest


def _matches(file: Path, images: Sequence[Entry], rows: Sequence["Row"]) -> dict[str, Entry]:
    """The image of each row that has one, by the row's name; refuses what may be two."""
    candidates: dict[str, list[tuple[list[str], Entry]]] = defaultdict(list)
    for image in images:
        parts = _parts(image["file_name"])
        candidates[parts[-1]].append((parts, image))
    image_of: dict[str, Entry] = {}
    picture_of: dict[Any, Path] = {}
    for row in rows:
        path = _parts(os.path.abspath(row.picture))
        fits = [image for parts, image in candidates[path[-1]] if path[-len(parts) :] == parts]
        if len(fits) > 1:
            got = " or ".join(str(image["file_name"]) for image in fits[:2])
            raise ValueError(f"{file}: {row.picture} may be {got}: write longer paths as file_name")
        for image in fits:
            other = picture_of.setdefault(image["id"], row.picture)
            if other != row.picture:
                got = f"{image['file_name']} may be {other} or {row.picture}"
                raise ValueError(f"{file}: {got}: write in the column labels whose it is")
            image_of[row.name] = image
    if not image_of:
        expected = f"no file_name is the end of a path such as {rows[0].picture}"
        raise ValueError(f"{file}: {expected}, got {images and images[0]['file_name']}")
    return image_of


def _parts(path: str) -> list[str]:
    """Folders and name of a file, on any system, in normal form."""
    return [part for part in normal(path.replace("\\", "/")).split("/") if part not in ("", ".")]


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
