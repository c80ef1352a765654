"""Which pictures a run degrades, and where their distances are."""

import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from uwaug.files.labels import aliases
from uwaug.files.pictures import ENDINGS
from uwaug.files.record import is_written

_MAP_ENDINGS = tuple(end for end in ENDINGS if end not in (".jpg", ".jpeg"))
_PICTURE_ENDINGS = tuple(end for end in ENDINGS if end not in (".npy", ".exr"))

OTHERS = {
    "convert them first, as by magick mogrify -format png": (
        *(".avif", ".bmp", ".gif", ".heic", ".heif", ".jp2", ".jxl", ".webp"),
    ),
    "develop them first, as by darktable-cli": (
        *(".arw", ".cr2", ".cr3", ".dng", ".nef", ".orf", ".raf", ".rw2"),
    ),
    "make frames of it, as by ffmpeg -i FILM frames/%05d.png, and give --sequence": (
        *(".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpg", ".webm"),
    ),
}
"""What to do with pictures that are neither read nor written; and the ends of their names."""

_STEM = re.compile(r"\{stem(?::([^=}]*)=([^}]*))?\}")


class Item(NamedTuple):
    """A picture of a run.

    Attributes:
        name: its path below the folder of pictures, with forward slashes, which is its place in the
            folder of the run, too. What is random follows from it.
        picture: its file.
        distance: the file of its distances; None where the transform makes them.
    """

    name: str
    picture: Path
    distance: Path | None = None


def find_items(
    pictures: str | Path,
    distance: str | Path | None = None,
    *,
    exclude: Iterable[str | Path | None] = (),
) -> list[Item]:
    """The pictures in a file or a folder, with the files of their distances.

    Args:
        pictures: a picture; or a folder of PNG, JPEG and TIFF files, with all that is in it.
            What a run has written there is left out, by its records.
        distance: a file, for all pictures; a folder with files of the pictures' names; or a pattern
            with {stem}, the name of a picture without its end: "{stem}_depth.png" of files beside
            each picture, "depth/{stem}.png" of those in a folder, {stem:rgb=depth} with a part of
            the name replaced. None: no files.
        exclude: folders whose files are no pictures, such as that of the run and of its labels.

    Returns:
        In the order of their names. A map that is missing is named without its end: reading it
        fails, and nothing else.

    Raises:
        ValueError: if there are no pictures, or not one of them has distances.
        OSError: if there is no such file or folder.
    """
    source = Path(pictures)
    if cure := cure_of(source.suffix):
        raise ValueError(f"{source}: {cure}")
    if source.is_file():
        folder, paths = source.parent, [source]
    else:
        folder, paths = source, sorted(_inside(source, [*exclude, distance], _PICTURE_ENDINGS))
    items = []
    for path in paths:
        name = path.relative_to(folder).as_posix()
        items.append(Item(name, path, _map(distance, path, name)))
    maps = {item.distance for item in items}
    items = [item for item in items if item.picture not in maps]
    if not items:
        raise ValueError(f"no pictures in {pictures}: expected {', '.join(_PICTURE_ENDINGS)}")
    if distance is not None and not any(item.distance.is_file() for item in items if item.distance):
        expected = f"such as {items[0].distance}, ending in {', '.join(_MAP_ENDINGS)}"
        raise ValueError(f"distance: {distance} has no map for any picture: expected {expected}")
    return items


def left_out(
    pictures: Path, distance: str | None = None, *, exclude: Iterable[str | Path | None] = ()
) -> str:
    """How many pictures of a folder are of formats that are not read, in words; "" for none.
    Arguments as for `find_items`.
    """
    ends = tuple(end for some in OTHERS.values() for end in some)
    paths = _inside(pictures, [*exclude, distance], ends) if pictures.is_dir() else ()
    counts = Counter(path.suffix.lower() for path in paths)
    return "; ".join(f"{n} {end}: {cure_of(end)}" for end, n in sorted(counts.items()))


def cure_of(end: str) -> str:
    """What to do with files whose names end so; "" where they can be read."""
    return next((cure for cure, ends in OTHERS.items() if end.lower() in ends), "")


def _inside(
    folder: Path, exclude: Iterable[str | Path | None], endings: tuple[str, ...]
) -> Iterator[Path]:
    """The pictures in a folder and those inside it."""
    places = (os.path.realpath(place) for place in exclude if place is not None)
    for path in _files(folder, frozenset(places)):
        if path.suffix.lower() in endings and not is_written(path):
            yield path


def _files(folder: Path, apart: frozenset[str]) -> Iterator[Path]:
    """The files in a folder and those inside it, but for some folders and for names that begin
    with a dot; a link is followed, unless it leads to a folder in which it lies.
    """
    apart |= {os.path.realpath(folder)}
    for path in folder.iterdir():
        if path.name.startswith("."):
            continue
        if not path.is_dir():
            yield path
        elif os.path.realpath(path) not in apart:
            yield from _files(path, apart)


def _map(distance: str | Path | None, path: Path, name: str) -> Path | None:
    """The distances of a picture: beside it, in a folder or a file."""
    if distance is None:
        return None
    if _STEM.search(str(distance)):
        # a pattern with a folder counts from where one stands, and knows the folders of pictures
        stem = os.path.splitext(name)[0] if os.path.dirname(distance) else path.stem
        file = _STEM.sub(lambda m: stem.replace(m[1], m[2]) if m[1] else stem, str(distance))
        return Path(file) if os.path.dirname(distance) else path.with_name(file)
    place = Path(distance)
    if place.is_file():
        return place
    bases = [(place / alias).with_suffix("") for alias in aliases(name)]
    paths = [base.with_name(base.name + end) for base in bases for end in _MAP_ENDINGS]
    return next((path for path in paths if path.is_file()), bases[0])
