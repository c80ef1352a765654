"""Which files of a folder are pictures."""

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from uwaug.files.folder import manifest_of
from uwaug.files.pictures import ENDINGS
from uwaug.files.record import record_of

PICTURE_ENDINGS = tuple(end for end in ENDINGS if end != ".npy")
# ends of names of pictures and films that are not read
_UNREAD = (
    *(".arw", ".avi", ".avif", ".bmp", ".cr2", ".cr3", ".dng", ".gif", ".gpr", ".heic", ".heif"),
    *(".insv", ".jp2", ".jxl", ".m2ts", ".mkv", ".mov", ".mp4", ".mpg", ".mpo", ".mts", ".nef"),
    *(".orf", ".pgm", ".ppm", ".psd", ".raf", ".rw2", ".srw", ".tga", ".webm", ".webp", ".wmv"),
)
_CURE = "make PNG of them; of a film, by ffmpeg -i FILM frames/%05d.png, and give --sequence"
_OF_DISKS = ("@eaDir", "@Recycle", "@Recently-Snapshot", "@tmp")  # folders of network disks

Exclude = Iterable[str | Path | None]


def pictures_in(source: Path, exclude: Exclude = ()) -> list[Path]:
    """The pictures in a folder and its subfolders, in the order of their names; or a picture.

    Raises:
        ValueError: if there are none.
        OSError: if there is no such file or folder.
    """
    if source.suffix.lower() in _UNREAD:
        raise ValueError(f"{source}: {_CURE}")
    paths = [source]
    if not source.is_file():
        paths = sorted(_inside(source, exclude, PICTURE_ENDINGS))
    if not paths:
        unread = left_out(source, exclude)
        got = f"{', '.join(PICTURE_ENDINGS)}{unread and f'; there are {unread}'}"
        raise ValueError(f"no pictures in {source}: expected {got}")
    return paths


def left_out(source: Path, exclude: Exclude = ()) -> str:
    """Numbers of pictures in formats that are not read, and the cure; "" without any."""
    paths = _inside(source, exclude, _UNREAD) if source.is_dir() else ()
    counts = Counter(path.suffix.lower() for path in paths)
    numbers = ", ".join(f"{n} {end}" for end, n in sorted(counts.items()))
    return numbers and f"{numbers}: {_CURE}"


def _inside(folder: Path, exclude: Exclude, endings: tuple[str, ...]) -> Iterator[Path]:
    excluded = (os.path.realpath(place) for place in exclude if place is not None)
    manifest = manifest_of(folder) or {"files": ()}
    written = {folder / name for name in manifest["files"]}
    for path in _files(folder, [*os.scandir(folder)], frozenset(excluded)):
        if path.suffix.lower() in endings and path not in written:
            yield path


def _files(
    folder: Path, entries: Sequence[os.DirEntry[str]], excluded: frozenset[str]
) -> Iterator[Path]:
    """Files of the entries of a folder and of its subfolders, but for excluded ones, those of runs,
    and names that begin with a dot. A link is followed, unless to a folder that it lies in.
    """
    excluded |= {os.path.realpath(folder)}
    names = {entry.name for entry in entries}
    for entry in entries:
        path = folder / entry.name
        if entry.name.startswith(".") or entry.name in _OF_DISKS:
            continue
        if not entry.is_dir():
            if f"{entry.name}.json" not in names or record_of(path) is None:
                yield path
        elif os.path.realpath(path) not in excluded and manifest_of(path) is None:
            with suppress(PermissionError):  # such as lost+found of a disk
                inner = [*os.scandir(path)]
                yield from _files(path, inner, excluded)
