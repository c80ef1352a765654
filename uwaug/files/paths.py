"""Paths and times that files and their names tell, also of other machines."""

import os
import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from itertools import takewhile
from pathlib import Path

PICTURES = ("images", "JPEGImages")
"""Folders of pictures, beside which data sets have folders of labels or distances."""

# names of folders for a split
_SPLIT = re.compile(r"(?:obj_)?(train|val|test)(?:ing|id|idation)?(?:_?(?:data|set))?[\d_]*")
_NUMBER = re.compile(r"\d{2,}")
_TIME = re.compile(r"(\d+\.\d{3,9}|\d{13}|\d{16}|\d{19})(?:\.[a-zA-Z]\w*)?")  # s; ms, µs or ns


def split_of(folders: Iterable[str]) -> str | None:
    """The split, "train", "val" or "test", that the first of the folders is named after, if any."""
    words = (folder.lower() for folder in folders)
    return next((match[1] for match in map(_SPLIT.fullmatch, words) if match), None)


def time_of(name: str) -> float | None:
    """The time that a file's name is, s; None if it is more, or something else."""
    if not (match := _TIME.fullmatch(os.path.basename(name))):
        return None
    return float(match[1]) / ("." in match[1] or 10.0 ** (len(match[1]) - 10))


def parts_of(path: str) -> list[str]:
    """Folders and name of a file, on any system."""
    return [p for p in path.strip().replace("\\", "/").split("/") if p not in ("", ".", "..")]


def below(folder: Path, path: str) -> Path | None:
    """The file in a folder whose path ends as another does, in as many parts as it can."""
    parts = parts_of(path)
    files = (folder.joinpath(*parts[i:]) for i in range(len(parts)))
    return next(filter(Path.is_file, files), None)


def matched(lines: Sequence[str], pictures: Sequence[Path]) -> dict[Path, list[int]]:
    """The places of the lines that are paths of pictures, also on another machine: the ends are the
    same, in the name and a folder at least. What comes before is not of another split, nor of
    another number, as in scene0000_00 and scene0001_00; nor does it differ in folders that other
    lines name right.

    Raises:
        ValueError: if a line may be two pictures.
    """
    named = defaultdict(list)
    for picture in pictures:
        parts = Path(os.path.abspath(picture)).parts[::-1]
        named[parts[0]].append((picture, parts))
    matches: dict[Path, list[tuple[int, int]]] = defaultdict(list)
    for place, line in enumerate(lines):
        parts, lengths = tuple(parts_of(line)[::-1]), {}
        for picture, others in named.get(parts[0], ()) if parts else ():
            pairs = zip(parts, others, strict=False)
            length = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
            before = [folder for p in (parts, others) for folder in p[length : length + 1]]
            splits = {split_of([folder]) for folder in before} - {None}
            is_other = len(splits) == 2 or len(before) > len({_NUMBER.sub("", f) for f in before})
            if length >= min(2, len(parts)) and not is_other:
                lengths[picture] = length
        best = [picture for picture in lengths if lengths[picture] == max(lengths.values())]
        if len(best) > 1:
            raise ValueError(f"{line} may be {best[0]} or {best[1]}: give pictures of one folder")
        for picture in best:
            matches[picture].append((lengths[picture], place))
    lengths_of = {picture: max(ends)[0] for picture, ends in matches.items()}
    roots = {picture: picture.absolute().parents[n - 1] for picture, n in lengths_of.items()}
    places, outer = {}, {*roots.values()}
    for picture, ends in matches.items():
        numbers = [place for length, place in ends if length == lengths_of[picture]]
        if not outer.isdisjoint(roots[picture].parents):
            numbers = [n for n in numbers if len(parts_of(lines[n])) == lengths_of[picture]]
        rivals = [*{tuple(parts_of(lines[n])): lines[n] for n in numbers}.values()]
        if len(rivals) > 1:
            raise ValueError(f"{picture} may be {rivals[0]} or {rivals[1]}")
        if numbers:
            places[picture] = numbers
    return places
