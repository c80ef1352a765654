"""Which pictures a run degrades, where their distances are, what it writes, and whether it may.

A manifest is a list of pictures, CSV or Parquet, with a column `input` and, if it likes, `id`,
`distance` and `output`; paths are from its own folder, outputs from the folder of the run. A
distance may be a number of metres.
"""

import csv
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from uwaug._support import checks
from uwaug._support.atomic import is_part, require_regular
from uwaug._support.extras import require
from uwaug.io.write import FORMATS
from uwaug.jobs.recipe import Recipe, changes
from uwaug.jobs.sidecar import TERMS, sidecar_of, terms_path
from uwaug.labels import Labels, LabelSource, label_paths
from uwaug.labels.layout import DESCRIPTION, is_as_described, label_place, parted, picture_place

MANIFESTS = (".csv", ".parquet")
"""Ends of their names."""

_COLUMNS = ("input", "id", "distance", "output")

_INDEX_BEGINS = "id,variant,input,distance,output,"
"""The header of an index."""

_NUMBER = re.compile(
    r"[+-]?((0|[1-9][0-9]*)(\.[0-9]*)?|\.[0-9]+)(e[+-]?[0-9]+)?|[+-]?(nan|inf)", re.IGNORECASE
)
"""As people write metres: `float` would take folders called 01 or 2024_01 for numbers too."""

_PASSED_OVER = (".avif", ".bmp", ".dng", ".gif", ".heic", ".jp2", ".ppm", ".tga")
"""Ends of the names of pictures that are not written, and not taken from folders."""

_MAPS = (".npy", ".npz", ".png", ".tif", ".tiff", ".exr", ".pfm")
"""Ends of the names of distance files, in a folder of them."""


class Item(NamedTuple):
    """A picture of a run.

    Attributes:
        id: what its randomness follows from: its path from the folder that was given, or the id of
            a manifest.
        input: its file; open files, with a name, are for data sets that hold pictures.
        distance: the file of its distances; metres; or None, for a depth network, and for metres
            that are drawn.
        output: the file to write.
        variant: which of several of one picture, from 0.
        problem: why it cannot be done; None if nothing is known against it.
        name: path of the picture from the folder that was given, which labels know it by.
        out: the folder that is written to; None: the output's own.
        labels: of the picture; None if none are asked for.
    """

    id: str
    input: Path | BinaryIO
    distance: Path | BinaryIO | float | None
    output: Path
    variant: int = 0
    problem: str | None = None
    name: str = ""
    out: Path | None = None
    labels: Labels | None = None

    @property
    def place(self) -> Path:
        """Path of the output from the folder that is written to."""
        return self.output.relative_to(self.out or self.output.parent)

    @property
    def labels_path(self) -> Path:
        """Where labels of the output would be, were they a picture: where trainers look, by the
        last "images" of its whole path; without one, below "labels" in the folder that is written
        to.
        """
        for path in (os.path.normpath(self.output), os.path.abspath(self.output)):
            if parted(Path(path)) is not None:
                return label_place(Path(path))
        return (self.out or self.output.parent) / label_place(self.place)

    def moved(self, out: Path) -> "Item":
        """The same item, written to another folder."""
        return self._replace(output=out / self.place, out=out)


class _Picture(NamedTuple):
    """An input, in little memory; `place`: of its output, from the folder that is written to."""

    id: str
    input: str
    name: str
    place: str
    distance: str | float | None
    problem: str | None


class Items:
    """The pictures of a run: folders and manifests are gone through once, here.

    Takes some 400 bytes of memory for each picture.

    Args:
        inputs: pictures, folders of pictures (with all that is in them), and manifests.
        distance: metres, the same for every pixel; a file; a folder of files of the pictures'
            names; or a pattern with {stem} or {name} (the path from the folder that was given,
            without its end), of files beside each picture if it has no folder. None: manifests
            name them.
        out: the folder to write to.
        variants: of each picture.
        ending: of the files to write, such as ".png"; None: as of each picture.
        unmapped: whether pictures need no maps: a depth network guesses them, or each picture is
            put on a plane whose distance is drawn.
        name: of the one file to write, in place of the picture's own.
        labels: of the run. Masks in a folder of them are no pictures; beside a folder of labels
            pictures are written below "images", where trainers look for them.

    Attributes:
        passed_over: how many pictures of a folder are of kinds that are not written, by the ends of
            their names.
        for_trainers: whether they are written so.

    Raises:
        ValueError: if nothing says where the distances are, a manifest is none, or a folder is
            that of a run.
        OSError: if an input does not exist.
    """

    def __init__(
        self,
        inputs: Sequence[Path],
        distance: str | None,
        out: Path,
        *,
        variants: int = 1,
        ending: str | None = None,
        unmapped: bool = False,
        name: str | None = None,
        labels: str | os.PathLike[str] | None = None,
    ) -> None:
        self.inputs, self.distance, self.out, self.labels = inputs, distance, out, labels
        self.variants, self.ending, self.unmapped, self.name = variants, ending, unmapped, name
        self.passed_over = Counter[str]()
        self.for_trainers = name is None and labels is not None and os.path.isdir(labels)
        self._pictures = [picture for path in inputs for picture in self._expanded(path)]

    def __len__(self) -> int:
        return self.variants * len(self._pictures)

    def __iter__(self) -> Iterator[Item]:
        """In the order of inputs and names."""
        for picture in self._pictures:
            where = picture.distance
            distance = Path(where) if isinstance(where, str) else where
            for variant in range(self.variants):
                place = Path(picture.place if self.name is None else self.name)
                if self.for_trainers:
                    place = picture_place(place)
                if self.ending is not None:
                    place = place.with_suffix(self.ending)
                if self.variants > 1:
                    place = place.with_name(f"{place.stem}_{variant + 1}{place.suffix}")
                yield Item(
                    picture.id,
                    Path(picture.input),
                    distance,
                    self.out / place,
                    variant,
                    picture.problem,
                    picture.name,
                    self.out,
                )

    def _expanded(self, source: Path) -> Iterator[_Picture]:
        """The pictures of an input."""
        if source.is_dir():
            if is_index(source / "index.csv"):
                cure = "give the folder of its pictures, or a list of files with a column input"
                raise ValueError(f"{source} holds what a run has written: {cure}")
            for path in self._inside(source):
                name = path.relative_to(source).as_posix()
                yield self._picture(name, path, name, name, None)
        elif is_manifest(source):
            for line in _read_manifest(source):
                path = Path(str(line["input"]))
                # what lies elsewhere keeps its name alone
                inside = not path.is_absolute() and ".." not in path.parts
                name = path.as_posix() if inside else path.name
                place = Path(line["output"] or name)
                if place.is_absolute() or ".." in place.parts:
                    got = f"got {place}"
                    raise ValueError(f"{source}: output must lie in the folder of the run, {got}")
                where: Any = line["distance"]
                if where is not None:
                    metres = metres_in(where, source.parent)
                    where = str(source.parent / where) if metres is None else metres
                id = line["id"] or path.as_posix()
                yield self._picture(id, source.parent / path, name, place.as_posix(), where)
        else:
            require_regular(source)
            yield self._picture(source.name, source, source.name, source.name, None)

    def _picture(
        self, id: str, path: Path, name: str, place: str, distance: str | float | None
    ) -> _Picture:
        problem = None
        try:
            f"{path}{place}".encode()
        except UnicodeEncodeError:
            # text files could not hold it
            shown = str(path).encode("utf-8", "backslashreplace").decode()
            problem = f"{shown}: its name is not UTF-8: rename it"
        if distance is None and not self.unmapped and problem is None:
            distance, problem = self._distance_of(path, Path(name))
        return _Picture(id, str(path), name, place, distance, problem)

    def _inside(self, folder: Path) -> Iterator[Path]:
        """The pictures in a folder and in those inside it, but for maps of distances, masks, and
        what a run has written. Links to folders are not followed, as they may lead back.
        """
        others = {os.path.realpath(self.out)}
        if self.distance is not None and os.path.isdir(self.distance):
            others.add(os.path.realpath(self.distance))
        masks, map_pattern = self.masks, self._map_pattern()
        for here, folders, files in os.walk(folder):
            place = os.path.realpath(here)
            if here != str(folder) and (place in others or is_index(Path(here, "index.csv"))):
                folders.clear()
                continue
            folders.sort()
            in_masks = masks is not None and Path(place).is_relative_to(masks)
            there = set(files)
            for name in sorted(files):
                suffix = os.path.splitext(name)[1].lower()
                if suffix in _PASSED_OVER:
                    self.passed_over[suffix] += 1
                if suffix not in FORMATS or suffix == ".npy" or is_part(name):
                    continue
                is_mask = in_masks and suffix == ".png"
                is_map = map_pattern is not None and map_pattern.search(f"{place}{os.sep}{name}")
                path = Path(here, name)
                if not (is_mask or is_map or _is_written(path, there)):
                    yield path

    @cached_property
    def masks(self) -> Path | None:
        """The folder of masks, where labels are a folder, and not of YOLO's files."""
        if self.labels is None or not os.path.isdir(self.labels):
            return None
        folder = Path(os.path.realpath(self.labels))
        return None if any(folder.rglob("*.txt")) else folder

    def _map_pattern(self) -> re.Pattern[str] | None:
        """What ends the paths of the maps that a pattern asks for; None if there is no pattern."""
        if self.distance is None or "{" not in self.distance:
            return None
        beside = _is_beside(self.distance)
        path = f"{os.sep}{self.distance}" if beside else os.path.realpath(self.distance)
        escaped = re.escape(path).replace(r"\{stem\}", f"[^{re.escape(os.sep)}]+")
        return re.compile(escaped.replace(r"\{name\}", ".+") + "$")

    def _distance_of(self, path: Path, name: Path) -> tuple[str | float | None, str | None]:
        """The distances of a picture, and what is wrong with them."""
        if self.distance is None:
            expected = "files, metres, or a list with a column distance"
            raise ValueError(f"distance is missing: {path} has no distances: expected {expected}")
        metres = metres_in(self.distance)
        if metres is not None:
            return metres, None
        if "{" in self.distance:
            words = {"stem": path.stem, "name": name.with_suffix("").as_posix()}
            try:
                filled = Path(self.distance.format(**words))
            except (KeyError, IndexError, ValueError):
                got = f"got {self.distance!r}"
                raise ValueError(f"distance: expected {{stem}} or {{name}}, {got}") from None
            return str(path.parent / filled if _is_beside(self.distance) else filled), None
        if not os.path.isdir(self.distance):
            require_regular(self.distance)
            return self.distance, None
        base = Path(self.distance) / name.parent / path.stem
        matches = _maps_called(base)
        folders = parted(name)
        if folders is not None and not matches:
            # images/train/1.png and depth/train/1.npy lie side by side, as labels do
            base = Path(self.distance).joinpath(*folders[0], *folders[1], path.stem)
            matches = _maps_called(base)
        if len(matches) == 1:
            return matches[0], None
        names = ", ".join(matches) or "none"
        return None, f"{path}: expected one of {base}{{{','.join(_MAPS)}}}, found {names}"


def _is_beside(pattern: str) -> bool:
    """Whether a pattern is that of maps beside their pictures."""
    return Path(pattern).parent == Path() and "{name}" not in pattern


def _is_written(path: Path, there: set[str]) -> bool:
    """Whether a run has written a picture, a mask, or one of the terms of a picture; `there`: the
    names in its folder.
    """
    if f"{path.stem}.contrast.json" in there:
        return True
    stem, _, term = path.stem.rpartition("_")
    pictures = [path, path.with_name(stem + path.suffix)] if stem and term in TERMS else [path]
    return any(f"{one.name}.json" in there and sidecar_of(one) is not None for one in pictures)


def is_manifest(path: Path) -> bool:
    """Whether a file is a list of pictures, by the end of its name."""
    return path.suffix.lower() in MANIFESTS


def is_index(path: Path) -> bool:
    """Whether a file is the index of a run."""
    if not os.path.isfile(path):
        return False
    with path.open(encoding="utf-8", errors="replace", newline="") as file:
        return file.read(len(_INDEX_BEGINS)) == _INDEX_BEGINS


def _maps_called(base: Path) -> list[str]:
    """The maps of a path without its end."""
    candidates = [base.with_name(base.name + suffix) for suffix in _MAPS]
    # a name may be too long to be one
    return [str(candidate) for candidate in candidates if os.path.isfile(candidate)]


def metres_in(distance: str, folder: Path | None = Path()) -> float | None:
    """The metres that a text says; None if it is something else, such as a path from `folder`;
    `folder`: None where no path can be meant.

    Raises:
        ValueError: if they are not finite and > 0; or if something in the folder is called so.
    """
    if not _NUMBER.fullmatch(distance.strip()):
        return None
    if folder is not None and (folder / distance).exists():
        longer = f"{distance}0" if "." in distance else f"{distance}.0"
        got = f"{distance} is a number of metres, and something in {folder} is called so"
        raise ValueError(f"distance: {got}: write ./{distance} for it, or {longer} for metres")
    metres = float(distance)
    checks.positive("distance", metres, "m")
    return metres


def labelled(items: Iterable[Item], source: LabelSource | None) -> Iterator[Item]:
    """Items with their labels, for those who degrade and do not hold the source."""
    for item in items:
        if source is None or item.problem is not None:
            yield item
            continue
        try:
            yield item._replace(labels=source.labels_of(item.name or Path(item.id)))
        except (ValueError, OSError) as error:
            yield item._replace(problem=str(error))


def preflight(items: Items, recipe: Recipe, *, resume: bool = False, force: bool = False) -> None:
    """Refuse, before anything is done, a run in which pictures would get in each other's way or
    write over something.

    Args:
        items: of the run.
        recipe: what is done to them.
        resume: outputs may be there, if the same recipe has made the first of them.
        force: they may be there.

    Raises:
        ValueError: if there are no pictures; if variants of one would be alike; if two have one id,
            or would be written to one file; if a file that is read would be written over; if two
            get one map by their names; or if what is there was made by another recipe. Names them.
        FileExistsError: if an output is there already.
    """
    if not len(items):
        ends = ", ".join(end for end in FORMATS if end != ".npy")
        raise ValueError(f"no pictures in {', '.join(map(str, items.inputs))}: expected {ends}")
    for source in items.inputs:
        # else the next run would take what this one has written for pictures
        if source.is_dir() and os.path.realpath(source) == os.path.realpath(items.out):
            raise ValueError(f"{source} would be written into: expected a folder of its own")
    if items.variants > 1 and not recipe.open().varies:
        got = f"variants={items.variants} would be the same picture each time: nothing is drawn"
        cure = "give a range, such as visibility=(3, 10), or another water, or one variant"
        raise ValueError(f"{got}: {cure}")
    # a map that is found by the name of its picture may be that of another too
    by_name = items.distance is not None and (
        "{" in items.distance or os.path.isdir(items.distance)
    )
    inputs = {_real(path) for item in items for path in (item.input, item.distance)}
    label_ends = (".txt", ".png") if os.path.isdir(recipe.labels or "") else ()

    def outputs_of(item: Item) -> list[str]:
        terms = TERMS if recipe.keep_terms else ()
        written = [item.output, *(terms_path(item.output, term) for term in terms)]
        for end in label_ends:
            written += label_paths(end, item.labels_path)
        places = list({_real(path): None for path in written})
        if not inputs.isdisjoint(places):
            got = f"{item.output}, made of {item.input}"
            raise ValueError(f"{got}, would be written over what is read: another folder?")
        return places

    _require_apart(items, "id", lambda item: [f"{item.id}/{item.variant}"])
    _require_apart(items, "output", outputs_of)
    if by_name:
        first = [item for item in items if item.variant == 0 and isinstance(item.distance, Path)]
        _require_apart(first, "map", lambda item: [str(item.distance)])
    alone = None if items.name is None else Path(os.path.abspath(items.out / items.name))
    in_images = items.for_trainers or (alone is not None and parted(alone) is not None)
    if recipe.keep_terms and label_ends and in_images:
        got = "there is a folder of labels, and trainers would take terms for pictures"
        raise ValueError(f"keep_terms must be left out: {got}")
    if force:
        return
    target = labels_file(items, recipe)
    if target is not None and os.path.lexists(target):
        if not (items.out / "index.csv").exists():
            raise FileExistsError(f"{target} exists")
        if target.name == DESCRIPTION and not is_as_described(target):
            got = f"{target} is not as a run has written it, and would be written over"
            raise ValueError(f"{got}: give it another name, or --force")
    for item in items:
        if not os.path.lexists(item.output):
            continue
        if not resume:
            raise FileExistsError(f"{item.output} exists")
        sidecar, mine = sidecar_of(item.output), recipe.to_json()
        before = mine if sidecar is None else sidecar.recipe
        other = changes(mine, before)
        if other:
            got = f"was made with other options ({'; '.join(other)})"
            cure = "give the same ones, or another folder, or make all with --force"
            raise ValueError(f"{item.output} {got}: {cure}")
        for path, sha256 in before.get("content", {}).items():
            if mine["content"].get(path) != sha256:
                got = f"{path} has changed since {item.output} was made of it"
                raise ValueError(f"{got}: put it back, or choose another folder")
        return


def labels_file(items: Items, recipe: Recipe) -> Path | None:
    """What labels have one file of for all pictures of a folder; None if there is none."""
    if recipe.labels is not None and os.path.isfile(recipe.labels):
        return items.out / os.path.basename(recipe.labels)
    return items.out / DESCRIPTION if items.for_trainers and items.masks is None else None


def _real(path: Any) -> str:
    """Where a file is; some file systems know no difference between A and a."""
    return os.path.realpath(path).casefold() if isinstance(path, Path) else ""


def _require_apart(items: Iterable[Item], what: str, keys_of: Callable[[Item], list[str]]) -> None:
    """Refuse two pictures that have a key in common."""
    seen: set[str] = set()
    for item in items:
        for key in keys_of(item):
            if key in seen:
                before = next(other for other in items if key in keys_of(other))
                if (before.input, before.variant) != (item.input, item.variant):
                    column = "distance" if what == "map" else what
                    got = f"{before.input} and {item.input} have one {what}, {key}"
                    raise ValueError(f"{got}: give a manifest with a column {column}")
                if before.output == item.output:
                    raise ValueError(f"{item.input} was given twice")
            seen.add(key)


def _read_manifest(path: Path) -> Iterator[dict[str, str | None]]:
    """The lines of a manifest, None where they say nothing.

    Raises:
        ValueError: if it has no column input, or a line none; names it.
        ImportError: if it is Parquet and pyarrow is not installed.
        OSError: if it cannot be read.
    """
    require_regular(path)
    lines = _parquet(path) if path.suffix.lower() == ".parquet" else _csv(path)
    for place, line in lines:
        values = {}
        for name in _COLUMNS:
            # names to the letter: one may begin or end with a space
            text = "" if line.get(name) is None else str(line[name])
            if "\0" in text:
                raise ValueError(f"{path}: {place} is no text")
            values[name] = text if text.strip() else None
        if values["input"] is None:
            raise ValueError(f"{path}: {place} has no input")
        yield values


def _require_input(path: Path, columns: Sequence[str]) -> None:
    if "input" not in columns:
        raise ValueError(f"{path}: expected a column input, got {', '.join(columns) or 'none'}")


def _csv(path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    # some spreadsheets begin a file with a mark
    with path.open(encoding="utf-8-sig", newline="") as file:
        # people write a space behind a comma; an index has only those of names
        reader = csv.DictReader(file, skipinitialspace=not is_index(path))
        try:
            _require_input(path, reader.fieldnames or [])
            for line in reader:
                yield f"line {reader.line_num}", line
        except (csv.Error, UnicodeDecodeError) as error:
            raise ValueError(f"{path}: is no CSV: {error}") from None


def _parquet(path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    pa, pq = require("parquet", "pyarrow", "pyarrow.parquet")
    try:
        table = pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise ValueError(f"{path}: is no Parquet file, or damaged: {error}") from None
    _require_input(path, table.column_names)
    lines = table.select([name for name in _COLUMNS if name in table.column_names]).to_pylist()
    yield from ((f"row {number}", line) for number, line in enumerate(lines, 1))
