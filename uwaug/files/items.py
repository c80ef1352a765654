"""The pictures of a run, with the files of their distances."""

import math
import os
import re
from bisect import bisect
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

from uwaug._support.atomic import read_text
from uwaug.files.folder import manifest_of
from uwaug.files.paths import Files, aliases, matched, parts_of, time_of
from uwaug.files.pictures import ENDINGS, MAP_ENDINGS, holds_picture
from uwaug.files.record import record_of

_PICTURE_ENDINGS = tuple(end for end in ENDINGS if end != ".npy")
_LISTED_ENDINGS = (*ENDINGS, *MAP_ENDINGS)
# cures for pictures that are neither read nor written, with the ends of their names
_UNREAD = {
    "convert them first, as by magick mogrify -format png": ".avif .bmp .dds .gif .hdr .heic .heif "
    ".hif .insp .jfif .jp2 .jpe .jpf .jpx .j2k .jxl .mpo .pgm .pnm .ppm .psd .qoi .tga .webp",
    "develop them first, as by darktable-cli": ".3fr .arw .cr2 .cr3 .crw .dcr .dng .erf .gpr .iiq "
    ".kdc .mef .mos .mrw .nef .nrw .orf .ori .pef .raf .raw .rw2 .rwl .sr2 .srf .srw .x3f",
    "make frames of it, as by ffmpeg -i FILM frames/%05d.png, and give --sequence": ".3gp .360 "
    ".avi .flv .hevc .insv .m2ts .m4v .mkv .mov .mp4 .mpeg .mpg .mts .mxf .ts .vob .webm .wmv",
}

_OF_DISKS = ("@eaDir", "@Recycle", "@Recently-Snapshot", "@tmp")  # folders of network disks
_MAX_DELAY_S = 0.02  # between a picture and its map, as in TUM's own tool
# maps of x.png may be called x_depth.png, too
_MARKED_ENDS = tuple(
    f"{mark}{end}" for mark in ("_depth", "_distance", "_disp", "-depth") for end in MAP_ENDINGS
)
_STEM = re.compile(r"\{stem(?::([^=}]*)=([^}]*))?\}")


class Item(NamedTuple):
    """A picture of a run, with the file of its distances unless the transform makes them. Its name
    is the path below the folder of pictures, from which random numbers follow.
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
    """Find the pictures in a file or a folder, with the files of their distances.

    Args:
        pictures: a picture; or a folder of PNG, JPEG, TIFF and EXR files, searched with its
            subfolders. Pictures that a run has written are left out.
        distance: a file for all pictures; a folder with files of the pictures' names, or of times
            within 20 ms of theirs; a .txt file with a picture and its map in each line; or a
            pattern with {stem}, the name of a picture without its end: "{stem}_depth.png" beside
            each picture, "depth/{stem}_z.png" in a folder. {stem:rgb=depth} replaces a part.
        exclude: folders whose files are no pictures, such as those of the run and of its labels.

    Returns:
        The pictures in the order of their names. A missing map fails when it is read.

    Raises:
        ValueError: if there are no pictures, or none of them has distances.
        OSError: if there is no such file or folder.
    """
    source = Path(pictures)
    if cure := cure_of(source.suffix):
        raise ValueError(f"{source}: {cure}")
    if source.is_file():
        folder, paths = source.parent, [source]
    else:
        folder, paths = source, sorted(_inside(source, [*exclude, distance], _PICTURE_ENDINGS))
    items, files = [], Files()
    place = Path(distance or ".")
    listed = _listed(place, paths, files) if place.suffix.lower() == ".txt" else {}
    for path in paths:
        name = path.relative_to(folder).as_posix()
        file = listed[path] if path in listed else _map(distance, path, name, files)
        shown = os.fsencode(name).decode(errors="backslashreplace")
        items.append(Item(shown, path, file))
    if distance and place.is_dir():
        items = _with_nearest(items)
    own = set()
    for item in items:  # an EXR may hold its distances, too
        if item.distance != item.picture or item.picture.suffix.lower() != ".exr":
            own.add(item.distance and os.path.abspath(item.distance))
    items = [
        item
        for item in items
        if os.path.abspath(item.picture) not in own and holds_picture(item.picture)
    ]
    if not items:
        unread = left_out(source, distance, exclude=exclude)
        got = f"{', '.join(_PICTURE_ENDINGS)}{unread and f'; there are {unread}'}"
        raise ValueError(f"no pictures in {pictures}: expected {got}")
    if distance and not place.is_file():
        takers: dict[tuple[Path | None, str], Path] = {}
        for _, picture, file in items:
            other = takers.setdefault((file, os.path.splitext(picture)[0]), picture)
            if file and file.is_file() and other != picture:
                raise ValueError(f"distance: {file} may be of {other} or {picture}")
    maps = [item.distance for item in items if item.distance is not None]
    if maps and not any(map(Path.is_file, maps)):
        expected = f"such as {maps[0]}, ending in {', '.join(MAP_ENDINGS)}; {there(maps[0])}"
        raise ValueError(f"distance: {distance} has no map for any picture: expected {expected}")
    return items


def delay_of(items: Iterable[Item]) -> str:
    """A sentence on maps that are of another time than their pictures; "" without any."""
    pairs = [(time_of(i.picture.name), time_of(i.distance.name)) for i in items if i.distance]
    delays = [abs(time - other) for time, other in pairs if time and other and time != other]
    got = f"{len(delays)} pictures have the maps of the nearest times"
    return f"{got}, {1000 * max(delays):.0f} ms away at most" if delays else ""


def there(path: Path) -> str:
    """What lies where a map is missing, in words."""
    if path.parent.is_file():
        return f"no line of {path.parent} has it and a map"
    ends = Counter(file.suffix for file in path.parent.glob("*.*") if file.is_file())
    if not ends:
        return f"there are no files in {path.parent}"
    delay, nearest = _nearest(path, _times_in(path.parent))
    if delay < math.inf:
        return f"found {nearest}, {1000 * delay:.0f} ms away"
    ((end, count),) = ends.most_common(1)
    return f"found {count} files ending in {end}"


def left_out(
    pictures: Path, distance: str | Path | None = None, *, exclude: Iterable[str | Path | None] = ()
) -> str:
    """Numbers and cures of pictures in formats that are not read, in words; as `find_items`."""
    endings = tuple(" ".join(_UNREAD.values()).split())
    paths = _inside(pictures, [*exclude, distance], endings) if pictures.is_dir() else ()
    counts = Counter(path.suffix.lower() for path in paths)
    return "; ".join(f"{n} {end}: {cure_of(end)}" for end, n in sorted(counts.items()))


def cure_of(end: str) -> str:
    """Cure for files whose names end so; "" where they can be read."""
    return next((cure for cure, ends in _UNREAD.items() if end.lower() in ends.split()), "")


def _inside(
    folder: Path, exclude: Iterable[str | Path | None], endings: tuple[str, ...]
) -> Iterator[Path]:
    excluded = (os.path.realpath(place) for place in exclude if place is not None)
    manifest = manifest_of(folder) or {"files": (), "lists": ()}
    written = {folder / name for name in (*manifest["files"], *manifest["lists"])}
    for path in _files(folder, folder.iterdir(), frozenset(excluded)):
        if path.suffix.lower() in endings and path not in written and record_of(path) is None:
            yield path


def _files(folder: Path, paths: Iterable[Path], excluded: frozenset[str]) -> Iterator[Path]:
    """Files of the paths in a folder and of its subfolders, but for excluded ones, those of runs,
    and names that begin with a dot. A link is followed, unless to a folder that it lies in.
    """
    excluded |= {os.path.realpath(folder)}
    for path in paths:
        if path.name.startswith(".") or path.name in _OF_DISKS:
            continue
        if path.name.startswith("Segmentation") and (folder / "JPEGImages").is_dir():
            continue  # Pascal VOC's masks
        if not path.is_dir():
            yield path
        elif os.path.realpath(path) not in excluded and manifest_of(path) is None:
            with suppress(PermissionError):  # such as lost+found of a disk
                inner = [*path.iterdir()]
                yield from _files(path, inner, excluded)


def _times_in(folder: Path) -> list[tuple[float, Path]]:
    files = [file for file in folder.glob("*.*") if file.suffix.lower() in MAP_ENDINGS]
    return sorted((time, file) for file in files if (time := time_of(file.name)) is not None)


def _nearest(path: Path, maps: Sequence[tuple[float, Path]]) -> tuple[float, Path]:
    """The map whose time is nearest to that of a missing one, and how far away it is, s."""
    if (time := time_of(path.name)) is None:
        return math.inf, path
    place = bisect(maps, (time, path))
    near = maps[max(0, place - 1) : place + 1]
    return min(((abs(other - time), file) for other, file in near), default=(math.inf, path))


def _with_nearest(items: Sequence[Item]) -> list[Item]:
    """The items with maps of the nearest times, where no map in a folder has a picture's name."""
    times_in, nearest = cache(_times_in), []
    maps = (item.distance for item in items)
    named = {file.parent for file in maps if file and file.is_file()}
    for item in items:
        file = item.distance
        if file and file.parent not in named:
            delay, other = _nearest(file, times_in(file.parent))
            file = other if delay <= _MAX_DELAY_S and other.parent != item.picture.parent else file
        nearest.append(item._replace(distance=file))
    return nearest


def _delay(pair: Sequence[str]) -> float:
    """Time between two files, s; 0 if their names are no times."""
    times = [time for name in pair if (time := time_of(name)) is not None]
    return max(times) - min(times) if times else 0.0


def _listed(file: Path, pictures: Sequence[Path], files: Files) -> dict[Path, Path]:
    """The maps of pictures in a list, of which a line names both, the map first or last in all."""
    pairs = []
    for line in read_text(file).splitlines():
        words = [w for w in re.split(r"[\s,;]+", line) if w.lower().endswith(_LISTED_ENDINGS)]
        pairs += [words] if len(words) == 2 else []
    if not (places := matched([first for first, _ in pairs], pictures)):
        pairs = [words[::-1] for words in pairs]
        places = matched([first for first, _ in pairs], pictures)
    maps = {picture: file / picture.name for picture in pictures}
    for picture, lines in places.items():
        first, path = min((pairs[line] for line in lines), key=_delay)
        # paths may count from a folder above the list
        root = os.path.abspath(picture).removesuffix("/".join(parts_of(first)))
        candidates = file.parent / path, Path(os.path.relpath(root), *parts_of(path))
        beside = next(filter(None, map(files.at, candidates)), None)
        maps[picture] = beside or files.below(file.parent, path) or candidates[0]
    return maps


def _map(distance: str | Path | None, path: Path, name: str, files: Files) -> Path | None:
    if distance is None or Path(distance).is_file():
        return None if distance is None else Path(distance)
    pattern = str(distance)
    if not _STEM.search(pattern):
        is_exr = path.suffix.lower() == ".exr"  # which may be its own map
        ends = (*MAP_ENDINGS, *_MARKED_ENDS)
        file = files.of(Path() if is_exr else path, name, Path(distance), ends, ())
        return file or Path(distance) / os.path.splitext(aliases(name)[0])[0]
    stems, folder = [os.path.splitext(alias)[0] for alias in aliases(name)], Path()
    if not os.path.dirname(pattern):
        stems, folder = [path.stem], path.parent
    bases = [folder / _filled(pattern, stem) for stem in stems]
    # any picture but an EXR matches where the part to replace is not there
    words = [re.escape(new) for _, new in _STEM.findall(pattern) if new]
    is_map = any(re.search(rf"(?<![^\W_]){word}(?![^\W_])", stems[0]) for word in words)
    picture = None if is_map or path.suffix.lower() == ".exr" else os.path.realpath(path)
    paths = (files.at(base, (end,)) for base in bases for end in ("", *MAP_ENDINGS))
    maps = (file for file in paths if file is not None and os.path.realpath(file) != picture)
    return next(maps, bases[0].with_suffix("") if bases[0].suffix in MAP_ENDINGS else bases[0])


def _filled(pattern: str, stem: str) -> str:
    return _STEM.sub(lambda m: stem.replace(m[1], m[2]) if m[1] else stem, pattern)
