"""Paths and times that files and their names tell, also of other machines."""

import os
import re
import unicodedata
from collections import defaultdict
from collections.abc import Iterable, Sequence
from itertools import takewhile
from pathlib import Path
from urllib.parse import unquote

PICTURES = ("images", "JPEGImages")  # folders, beside which data sets have labels or distances
_SPLIT = re.compile(r"(?:obj_)?(train|val|test)(?:ing|id|idation)?(?:_?(?:data|set|images))?[\d_]*")
_NUMBER = re.compile(r"\d{2,}")
_ABSOLUTE = re.compile(r"[/\\]|\w:")
_TIMES = r"\d+\.\d{3,9}|\d{10}\.\d{1,2}|\d{13}|\d{16}|\d{19}"  # s; s since 1970; ms, µs or ns
_TIME = re.compile(rf"({_TIMES})(?:\.[a-zA-Z]\w*)?")


def split_of(folders: Iterable[str]) -> str | None:
    """The split, "train", "val" or "test", that the first of the folders is named after, if any."""
    words = ({"dev": "val", "minival": "val"}.get(f.lower(), f.lower()) for f in folders)
    return next((match[1] for match in map(_SPLIT.fullmatch, words) if match), None)


def time_of(name: str) -> float | None:
    """The time that a file's name is, s; None if it is more, or something else."""
    if not (match := _TIME.fullmatch(os.path.basename(name))):
        return None
    return float(match[1]) / ("." in match[1] or 10.0 ** (len(match[1]) - 10))


def parts_of(path: str) -> list[str]:
    """Folders and name of a file, on any system."""
    return [p for p in path.strip().replace("\\", "/").split("/") if p not in ("", ".", "..")]


def normal(name: str) -> str:
    """The normal form of a file's name, by which names are compared: accents are composed, percent
    signs decoded, and the ending is in small letters.
    """
    stem, end = os.path.splitext(
        unicodedata.normalize("NFC", unquote(name, errors="surrogateescape"))
    )
    return f"{stem}{end.lower()}"


def aliases(name: str, *folders: str) -> list[str]:
    """Paths of a picture in a folder of labels or distances, beside the folder of pictures or above
    both. images/train/1.png may be train/1.png there, or have one of `folders` for "images".
    """
    parts = name.split("/")
    paths = [name, *(f"{folder}/{name}" for folder in folders)]
    last = max((i for i, folder in enumerate(parts[:-1]) if folder in PICTURES), default=None)
    if last is not None:
        for middle in ([], *([folder] for folder in folders)):
            paths.append("/".join([*parts[:last], *middle, *parts[last + 1 :]]))
    return paths


class Files:
    """Files by their names in normal form; each folder is listed once."""

    def __init__(self) -> None:
        self._listings: dict[Path, dict[str, Path]] = {}

    def at(self, path: Path, ends: Iterable[str] = ("",)) -> Path | None:
        """The file at a path with one of the ends, the first first; None without any."""
        listing = self._listing(path.parent)
        for name in (f"{path.name}{end}" for end in ends):
            file = listing.get(name) or listing.get(normal(name))
            if file is not None and file.is_file():
                return file
        return None

    def of(
        self, picture: Path, name: str, folder: Path, ends: Sequence[str], folders: Iterable[str]
    ) -> Path | None:
        """The file of a picture in a folder of such: that of its name, or an alias, with one of the
        ends; but not the picture itself.
        """
        stems = (os.path.splitext(alias)[0] for alias in aliases(name, *folders))
        files = (self.at(folder / stem, (end,)) for stem in stems for end in ends)
        own = os.path.realpath(picture)
        return next((f for f in files if f is not None and os.path.realpath(f) != own), None)

    def below(self, folder: Path, path: str) -> Path | None:
        """The file in a folder whose path ends as another does, in as many parts as it can."""
        parts = parts_of(path)
        files = (self.at(folder.joinpath(*parts[i:])) for i in range(len(parts)))
        return next(filter(None, files), None)

    def _listing(self, folder: Path) -> dict[str, Path]:
        if folder not in self._listings:
            there = folder
            if not folder.is_dir() and folder.parent != folder:
                there = self._listing(folder.parent).get(normal(folder.name), folder)
            try:
                files = sorted(there.iterdir())
            except OSError:
                files = []
            exact = {file.name: file for file in files}
            self._listings[folder] = {normal(name): file for name, file in exact.items()} | exact
        return self._listings[folder]


def matched(
    lines: Sequence[str], pictures: Sequence[Path], *, whole: bool = False
) -> dict[Path, list[int]]:
    """The places of the lines that are paths of pictures, also on another machine; refuses a line
    that may be two pictures, and a picture that may be two lines.

    A line is of the picture with which it has the longest end in common, the name and a folder at
    least, and a picture takes its longest line. What comes before is not of another split, nor of
    another number, as in scene0000_00 and scene0001_00; nor does it differ in folders that other
    lines name right. `whole`: they share all of a path that is not absolute, but for folders of
    pictures.
    """
    left_out = PICTURES if whole else ()
    named = defaultdict(list)
    for picture in pictures:
        parts = _reversed_parts(os.path.abspath(picture), left_out)
        named[parts[0]].append((picture, parts))
    best_of: list[tuple[int, list[Path]]] = []
    longest: dict[Path, int] = {}
    for line in lines:
        parts, lengths = _reversed_parts(line, left_out), {}
        is_whole = whole and not _ABSOLUTE.match(line)
        least = len(parts) if is_whole else min(2, len(parts))
        for picture, others in named.get(parts[0], ()):
            pairs = zip(parts, others, strict=False)
            length = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
            before = [folder for p in (parts, others) for folder in p[length : length + 1]]
            splits = {split_of([folder]) for folder in before} - {None}
            is_other = len(splits) == 2 or len(before) > len({_NUMBER.sub("", f) for f in before})
            if length >= least and not is_other:
                lengths[picture] = length
                longest[picture] = max(length, longest.get(picture, 0))
        most = max(lengths.values(), default=0)
        best_of.append((most, [p for p, length in lengths.items() if length == most]))
    matches: dict[Path, list[tuple[int, int]]] = defaultdict(list)
    for place, (length, best) in enumerate(best_of):
        if len(best) > 1:  # some may have a longer line
            best = [picture for picture in best if longest[picture] == length]
        if len(best) > 1:
            got = f"{lines[place]} may be {best[0]} or {best[1]}"
            raise ValueError(f"{got}: give the pictures of one folder")
        for picture in best:
            matches[picture].append((length, place))
    lengths_of = {picture: max(ends)[0] for picture, ends in matches.items()}
    roots = {picture: picture.absolute().parents[n - 1] for picture, n in lengths_of.items()}
    places, outer = {}, {*roots.values()}
    for picture, ends in matches.items():
        numbers = [place for length, place in ends if length == lengths_of[picture]]
        if not whole and not outer.isdisjoint(roots[picture].parents):
            numbers = [n for n in numbers if len(parts_of(lines[n])) == lengths_of[picture]]
        rivals = [*{tuple(parts_of(lines[n])): lines[n] for n in numbers}.values()]
        if len(rivals) > 1:
            raise ValueError(f"{picture} may be {rivals[0]} or {rivals[1]}")
        if numbers:
            places[picture] = numbers
    return places


def _reversed_parts(path: str, left_out: Iterable[str]) -> list[str]:
    """Name and folders of a file in normal form, the name first, without some folders."""
    # Label Studio's paths are queries: /data/local-files/?d=reef%2F1.jpg
    path = unquote(path).rpartition("?d=")[2]
    name, *folders = [*map(normal, parts_of(path))][::-1] or [""]
    return [name, *(folder for folder in folders if folder not in left_out)]
