"""Which pictures a run degrades, and where their distances are."""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from uwaug.files.labels import aliases
from uwaug.files.pictures import ENDINGS
from uwaug.files.record import is_written

_MAPS = tuple(end for end in ENDINGS if end not in (".jpg", ".jpeg"))
_PICTURES = tuple(end for end in ENDINGS if end not in (".npy", ".exr"))


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
    pictures: str | Path, distance: str | Path | None = None, *, apart: Iterable[str | Path] = ()
) -> list[Item]:
    """The pictures in a file or a folder, with the files of their distances.

    Args:
        pictures: a picture; or a folder of PNG, JPEG and TIFF files, with all that is in it.
            What a run has written there is left out, by its records.
        distance: a file, for all pictures; a folder with files of the pictures' names; or a pattern
            with {stem}, such as "{stem}_depth.png", of files beside each picture. None: no files.
        apart: folders whose files are no pictures, such as that of the run and of its labels.

    Returns:
        In the order of their names. A map that is missing is named without its end: reading it
        fails, and nothing else.

    Raises:
        ValueError: if there are no pictures, or not one of them has distances.
        OSError: if there is no such file or folder.
    """
    source = Path(pictures)
    pattern = str(distance) if "{stem}" in str(distance) else None
    distances = None if distance is None or pattern else Path(distance)
    if source.is_file():
        paths = [source]
        source = source.parent
    else:
        places = [*apart, *([distances] if distances is not None else [])]
        paths = sorted(_inside(source, {os.path.realpath(place) for place in places}))
    if pattern is not None:
        beside = {path: path.with_name(pattern.format(stem=path.stem)) for path in paths}
        maps = set(beside.values())
        paths = [path for path in paths if path not in maps]
    items = []
    for path in paths:
        name = path.relative_to(source).as_posix()
        where = beside[path] if pattern else None if distances is None else _map(distances, name)
        items.append(Item(name, path, where))
    if not items:
        raise ValueError(f"no pictures in {pictures}: expected {', '.join(_PICTURES)}")
    if distance is not None and not any(item.distance.is_file() for item in items if item.distance):
        expected = f"such as {items[0].distance}, ending in {', '.join(_MAPS)}"
        raise ValueError(f"distance: {distance} has no map for any picture: expected {expected}")
    return items


def _inside(folder: Path, apart: set[str]) -> Iterator[Path]:
    """The pictures in a folder and those inside it; links to folders are not followed."""
    for here, folders, files in os.walk(folder, onerror=_refuse):
        kept = [name for name in folders if os.path.realpath(Path(here, name)) not in apart]
        folders[:] = kept
        for path in (Path(here, name) for name in files):
            if path.suffix.lower() in _PICTURES and not is_written(path):
                yield path


def _refuse(error: OSError) -> None:
    raise error


def _map(place: Path, name: str) -> Path:
    """The distances of a picture, in a folder or a file."""
    if place.is_file():
        return place
    bases = [(place / alias).with_suffix("") for alias in aliases(name)]
    paths = [base.with_name(base.name + end) for base in bases for end in _MAPS]
    return next((path for path in paths if path.is_file()), bases[0])
