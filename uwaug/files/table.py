"""The table that a run reads: a row for each picture, with its map, labels, split and film."""

import csv
import io
import itertools
import math
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

from uwaug._support.atomic import read_text, write_whole
from uwaug.files import formats
from uwaug.files.labels import normal
from uwaug.files.pictures import ENDINGS, MAP_ENDINGS
from uwaug.files.search import Exclude, pictures_in

SPLITS = {
    **dict.fromkeys(("train", "training"), "train"),
    **dict.fromkeys(("val", "valid", "validation"), "val"),
    **dict.fromkeys(("test", "testing"), "test"),
}
_SYNONYMS = {"depth": "distance", "map": "distance", "mask": "labels", "boxes": "labels"}

_FIELD = re.compile(r"\{(\w*)\}")
_NUMBER = re.compile(r"(\d+\.\d{3,}|\d+)")  # a whole one, or a time in seconds


class Row(NamedTuple):
    """A picture of a run, and what belongs to it.

    Attributes:
        name: path of the result below the folder of the run; its end is the format. Random numbers
            follow from it.
        picture: file of the picture.
        distance: file of its distances; None unless the transform needs none.
        labels: file of its labels, or a COCO file that labels others, too; None for a background.
        split: "train", "val" or "test"; or "".
        film: name of the film that it is a frame of, with one draw for all; "" without one.
        time: when the frame was taken, in any unit; None: the frames follow as the rows do. The
            cameras of a rig have one clock, and a folder each or equal times.
    """

    name: str
    picture: Path
    distance: Path | None = None
    labels: Path | None = None
    split: str = ""
    film: str = ""
    time: float | None = None


def read_table(path: str | Path) -> list[Row]:
    """Read the table of a run from a CSV file.

    Args:
        path: a file with commas or semicolons. Its first line names the columns, in any order:
            picture (or file_name), and the others of `Row`, which may be empty or absent. Paths
            are relative to the file. Other columns are left alone. Without a name, it is the
            picture's path below the file's folder, else below the folder that holds all pictures.

    Raises:
        ValueError: if it is no such table; the error names the line.
        OSError: if it cannot be read.
    """
    path = Path(path)
    text = read_text(path)
    first = text.partition("\n")[0]
    mark = ";" if first.count(";") > first.count(",") else ","
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=mark, strict=True)
    try:
        lines = [(reader.line_num, cells) for cells in reader if any(cells)]
    except csv.Error as error:
        raise ValueError(f"{path}: line {reader.line_num} is no line of CSV: {error}") from None
    header = [cell.strip().lower() for cell in lines[0][1]] if lines else []
    if "picture" not in header and "file_name" in header:
        header[header.index("file_name")] = "picture"
    if "picture" not in header or len(lines) < 2:
        got = ", ".join(header)
        raise ValueError(f"{path}: expected a column picture, and rows below it, got {got}")
    synonyms = {word: name for word, name in _SYNONYMS.items() if name not in header}
    for column in {*header} - {*Row._fields}:
        if near := get_close_matches(column, [*Row._fields, *synonyms], 1, 0.8):
            meant = synonyms.get(near[0], near[0])
            raise ValueError(f"{path}: expected a column {meant}, or another name, got {column}")
    rows = []
    for number, cells in lines[1:]:
        try:
            rows.append(_row(header, cells, path.parent))
        except ValueError as error:
            raise ValueError(f"{path}: line {number}: {error}") from None
    root, paths = Path(os.path.realpath(path.parent)), [absolute(row.picture) for row in rows]
    if not all(picture.is_relative_to(root) for picture in paths):
        root = Path(os.path.commonpath([picture.parent for picture in paths]))
    names = [picture.relative_to(root).as_posix() for picture in paths]
    return [row if row.name else row._replace(name=n) for row, n in zip(rows, names, strict=True)]


def write_table(path: str | Path, rows: Sequence[Row]) -> None:
    """Write the table of a run as a CSV file, whole or not at all, with paths relative to it."""
    write_whole(Path(path), table_in(Path(path).parent, rows))


def table_in(folder: Path, rows: Sequence[Row]) -> bytes:
    """The content of a table's file in a folder, with paths relative to it."""
    return as_csv(rows, os.path.realpath(folder)).encode(errors="backslashreplace")


def as_csv(rows: Sequence[Row], folder: str | None = None) -> str:
    """A table as CSV, with paths as they are, or relative to a folder."""

    def cell(value: str | Path | float | None) -> str | int | float | None:
        if isinstance(value, Path):
            return value.as_posix() if folder is None else _relative(value, folder)
        return int(value) if isinstance(value, float) and value.is_integer() else value

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Row._fields)
    writer.writerows(map(cell, row) for row in rows)
    return text.getvalue()


def propose(
    source: str | Path,
    distance: str | Path | None = None,
    labels: str | Path | None = None,
    *,
    sequence: bool = False,
    exclude: Exclude = (),
) -> list[Row]:
    """Propose the table of a folder of pictures.

    The map and the labels of a picture have its path below the folder, with another ending. Names
    must be equal, but for the case of the ending and the Unicode form of accents. The split is that
    of the folder, in the picture's path, that is called train, val, valid, test, or so: val2017.

    Args:
        source: a folder of PNG, JPEG, TIFF and EXR files, searched with its subfolders; or a
            picture. What a run has written is left out.
        distance, labels: a folder; or a file for all pictures; or a pattern, a path with {stem},
            the picture's name without its ending, {folder}, that of the picture below `source`, or
            {split}: "depth/{folder}/{stem}_z.png". As all paths, it begins where the process is.
        sequence: the pictures of a folder are the frames of one film. Their times are the number
            that varies in their names, else their order.
        exclude: folders whose files are no pictures, such as that of the run.

    Raises:
        ValueError: if there are no pictures; if none has a map, or labels; or two have the same.
        OSError: if there is no such file or folder.
    """
    source = Path(source)
    paths = pictures_in(source, [*exclude, distance, labels])
    folder = source.parent if source.is_file() else source
    files = _Files()
    columns = ("distance", distance, MAP_ENDINGS), ("labels", labels, formats.ENDINGS)
    patterns = [_Pattern(c, given, ends, files) for c, given, ends in columns if given is not None]
    rows = []
    for path in paths:
        place = path.relative_to(folder)
        split = next(filter(_split_of, reversed(path.parts[:-1])), "")
        shown = os.fsencode(place.as_posix()).decode(errors="backslashreplace")
        film = os.path.dirname(shown) or "." if sequence else ""
        own: Any = {pattern.column: pattern.of(path, place, split) for pattern in patterns}
        rows.append(Row(shown, path, split=_split_of(split), film=film, **own))
    # files beside the pictures, but for an EXR that holds its own distances
    cells = ((row.picture, file) for row in rows for file in (row.distance, row.labels) if file)
    taken = {os.path.abspath(file) for picture, file in cells if file != picture}
    rows = [row for row in rows if os.path.abspath(row.picture) not in taken]
    for pattern in patterns:
        pattern.require_found(rows)
    return _timed(rows) if sequence else rows


def _split_of(folder: str) -> str:
    """The split that a folder's name means, with a year or without; "" if it means none."""
    return SPLITS.get(re.sub(r"\d{4}$", "", folder.lower()), "")


def require_rows(rows: Sequence[Row], *, with_maps: bool = False) -> None:
    """Refuse a table with a name twice or none that a result can have, with files that are not
    there, or with a map or labels of one picture that are of another picture, too; and without a
    map for each picture, if `with_maps`.
    """
    names: set[str] = set()
    for row in rows:
        parts = row.name.split("/")
        is_format = os.path.splitext(row.name)[1].lower() in ENDINGS
        if row.name in names:
            raise ValueError(f"name: two rows are called {row.name}: write another in that column")
        if ".." in parts or "" in parts or not is_format:
            expected = f"a path below the folder of the run, ending in {', '.join(ENDINGS)}"
            raise ValueError(f"name: expected {expected}, got {row.name}")
        names.add(row.name)
    for column in ("picture", "distance", "labels"):
        rows_of: dict[Path, list[Row]] = {}
        for row in rows:
            if (file := getattr(row, column)) is not None:
                rows_of.setdefault(file, []).append(row)
        if absent := [file for file in rows_of if not file.is_file()]:
            got = f"{len(absent)} of its files are not there, such as {absent[0]}"
            raise ValueError(f"column {column}: {got}")
        if column != "picture":
            _require_own(column, rows_of, len(rows))
    bare = [row.name for row in rows if row.distance is None]
    if bare and with_maps:
        got = f"{len(bare)} of {len(rows)} pictures have no map, such as {bare[0]}"
        cure = "write it in the column distance of a table (.csv), or give --distance"
        raise ValueError(f"distance is missing: {got}: {cure} metres, or made-up (MadeUp())")


def in_words(rows: Sequence[Row]) -> str:
    """How many pictures, maps, labels, splits and films a table has."""
    words = [f"{len(rows)} pictures"]
    for column, what in (("distance", "maps"), ("labels", "labels")):
        bare = [row.name for row in rows if getattr(row, column) is None]
        if len(bare) < len(rows):
            names = f"{', '.join(bare[:2])}{' and others' * (len(bare) > 2)}"
            rest = f", {len(bare)} have none: {names}" if bare else ""
            words.append(f"{len(rows) - len(bare)} have {what}{rest}")
    splits = Counter(row.split for row in rows)
    if splits.keys() - {""}:
        words.append(", ".join(f"{n} are of {split or 'no split'}" for split, n in splits.items()))
    if films := {row.film for row in rows} - {""}:
        words.append("1 film" if len(films) == 1 else f"{len(films)} films, each in its own water")
    wet = [f"\n{split} gets wet, too" for split in ("val", "test") if splits[split]]
    return "; ".join(words) + "".join(wet)


def absolute(file: Path) -> Path:
    """The absolute path of a file, by folders that are no links."""
    return Path(os.path.realpath(file.parent), file.name)


class _Files:
    """Files by their names in normal form; each folder is listed once."""

    def __init__(self) -> None:
        self._listings: dict[str, dict[str, os.DirEntry[str]]] = {}

    def at(self, path: str) -> Path | None:
        """The file at a path; None without one."""
        folder, name = os.path.split(path)
        listing = self._listing(folder)
        entry = listing.get(name) or listing.get(normal(name))
        return Path(entry) if entry is not None and entry.is_file() else None

    def _listing(self, folder: str) -> dict[str, os.DirEntry[str]]:
        if folder not in self._listings:
            there, (above, name) = folder or ".", os.path.split(folder)
            if not os.path.isdir(there) and name:
                there = getattr(self._listing(above).get(normal(name)), "path", there)
            entries = []
            if os.path.isdir(there):
                entries = sorted(os.scandir(there), key=lambda entry: entry.name)
            exact = {entry.name: entry for entry in entries}
            self._listings[folder] = {normal(name): entry for name, entry in exact.items()} | exact
        return self._listings[folder]


class _Pattern:
    """The files that a folder, a pattern or a file for all gives to pictures, in one column."""

    def __init__(
        self, column: str, given: str | Path, endings: Sequence[str], files: _Files
    ) -> None:
        self.column, self.given, self.files = column, str(given), files
        self.text, self.ends = self.given, [""]
        fields = _FIELD.findall(self.given)
        if unknown := {*fields} - {"stem", "folder", "split"}:
            expected = "expected {stem}, {folder} or {split}"
            raise ValueError(f"{column}: {given} has {{{min(unknown)}}}: {expected}")
        if not fields and os.path.isdir(given):
            self.text, self.ends = f"{given}/{{folder}}/{{stem}}", [*endings]
        elif not fields:
            os.stat(given)
            accepted = endings if column == "distance" else (*endings, *formats.SHARED)
            if Path(given).suffix.lower() not in accepted:
                raise ValueError(f"{column}: expected {', '.join(accepted)}, got {given}")

    def of(self, path: Path, place: Path, split: str) -> Path | None:
        """The file of a picture, by its path, its path below the folder of pictures, and the folder
        that its split is named by.
        """
        name = self._named(place, split)
        there = [file for end in self.ends if (file := self.files.at(f"{name}{end}")) is not None]
        if path.suffix.lower() != ".exr":  # which may be its own map
            there = [file for file in there if os.path.abspath(file) != os.path.abspath(path)]
        if len(there) > 1:
            cure = f"give a pattern, such as {self.given}/{{stem}}.png"
            raise ValueError(f"{self.column}: {path} may have {there[0]} or {there[1]}: {cure}")
        return there[0] if there else None

    def require_found(self, rows: Sequence[Row]) -> None:
        """Refuse a folder or a pattern by which no picture has a file, or two have the same."""
        files = [getattr(row, self.column) for row in rows]
        if not any(files):
            expected = self._named(Path(rows[0].name), rows[0].split)
            expected += f", ending in {', '.join(self.ends)}" if self.ends[1:] else ""
            got = f"{self.given} has a file for no picture: expected such as {expected}"
            cure = f"give a pattern with {{stem}}, or a table (.csv) with a column {self.column}"
            raise ValueError(f"{self.column}: {got}: {cure}")
        takers: dict[Path, str] = {}
        for row, file in zip(rows, files, strict=True):
            is_of_one = file is not None and "{stem}" in self.text
            if is_of_one and takers.setdefault(file, row.name) != row.name:
                got = f"{file} may be of {takers[file]} or {row.name}"
                raise ValueError(
                    f"{self.column}: {got}: write a table with the column {self.column}"
                )

    def _named(self, place: Path, split: str) -> str:
        values = {"stem": place.stem, "folder": str(place.parent), "split": split}
        return str(Path(_FIELD.sub(lambda match: values[match[1]], self.text)))


def _require_own(column: str, rows_of: Mapping[Path, Sequence[Row]], count: int) -> None:
    """Refuse files that several of so many rows name, but not all, and that are of no one film."""
    takers: dict[str, list[Row]] = {}
    for file, those in rows_of.items():
        if file.suffix.lower() not in formats.SHARED:
            takers.setdefault(os.path.realpath(file), []).extend(those)
    for name, those in takers.items():
        is_of_film = len({row.film for row in those}) == 1 and those[0].film
        if len(those) in (1, count) or is_of_film:
            continue
        if len({os.path.realpath(row.picture) for row in those}) > 1:
            got = f"{name} is of {those[0].name} and {those[1].name}"
            raise ValueError(f"column {column}: {got}, but neither of all rows nor of one film")


def _row(header: Sequence[str], cells: Sequence[str], folder: Path) -> Row:
    if len(cells) != len(header):
        raise ValueError(f"has {len(cells)} cells and the first line {len(header)}")
    texts = {name: cell.strip() for name, cell in zip(header, cells, strict=True)}
    if not texts["picture"]:
        raise ValueError("picture is empty")
    distance, labels = (folder / texts[n] if texts.get(n) else None for n in ("distance", "labels"))
    split, time = texts.get("split", ""), texts.get("time", "")
    if split and split not in SPLITS:
        raise ValueError(f"split must be one of {', '.join(SPLITS)}, got {split}")
    try:
        moment = float(time) if time else None
    except ValueError:
        moment = math.nan
    if moment is not None and not math.isfinite(moment):
        raise ValueError(f"time must be a number, got {time}")
    name, film, picture = texts.get("name", ""), texts.get("film", ""), folder / texts["picture"]
    return Row(name, picture, distance, labels, SPLITS.get(split, ""), film, moment)


def _relative(file: Path, folder: str) -> str:
    try:
        return Path(os.path.relpath(absolute(file), folder)).as_posix()
    except ValueError:  # on another drive of Windows
        return absolute(file).as_posix()


def _timed(rows: Sequence[Row]) -> list[Row]:
    """Frames of films, in the order of their times."""
    films: dict[str, list[Row]] = {}
    for row in rows:
        films.setdefault(row.film, []).append(row)
    timed = []
    for film in films.values():
        frames = sorted(film, key=lambda row: _split(row.picture.stem))
        parts = [_split(row.picture.stem) for row in frames]
        columns = [{*column} for column in itertools.zip_longest(*parts)]
        varied = [place for place, column in enumerate(columns) if len(column) > 1]
        times = [float(number) for number in range(len(frames))]
        # every second part is a number
        if len(varied) == 1 and varied[0] % 2 and len(columns[varied[0]]) == len(frames):
            times = [float(part[varied[0]]) for part in parts]
        timed += [row._replace(time=time) for row, time in zip(frames, times, strict=True)]
    return timed


def _split(name: str) -> list[str | float]:
    """Words and numbers of a name in turn, by which 2.png comes before 10.png."""
    parts: list[str | float] = [*_NUMBER.split(name)]
    parts[1::2] = [float(part) for part in parts[1::2]]
    return parts
