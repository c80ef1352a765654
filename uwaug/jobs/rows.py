"""Which pictures a run degrades, where their distances are, and what it writes."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import NamedTuple

from uwaug._support.atomic import is_part, require_regular
from uwaug.io.write import FORMATS
from uwaug.jobs.index import INDICES, number_of, read_index
from uwaug.jobs.record import record_of
from uwaug.jobs.row import Row

__all__ = ["Rows", "hash_of"]

_MAPS = (".npy", ".npz", ".png", ".tif", ".tiff", ".exr", ".pfm")
"""Ends of the names of distance files, in a folder of them."""


class _Found(NamedTuple):
    """A picture before its distance is known.

    Attributes:
        id, input, distance: as of `Row`.
        name: path of the picture from the folder that was given.
        place: path of the output from the folder that is written to.
    """

    id: str
    input: Path
    distance: Path | float | None
    name: Path
    place: Path


@dataclass(frozen=True)
class Rows:
    """The pictures of a run; each pass over them looks them up anew, so that memory does not grow
    with their number.

    Attributes:
        inputs: pictures, folders of pictures (with all that is in them), and indices, see
            `uwaug.jobs.index`.
        distance: metres, the same for every pixel; a file; a folder of files of the pictures'
            names; or a pattern with {stem} or {name} (the path from the folder that was given,
            without its end), of files beside each picture if it has no folder. None: the indices
            name them.
        out: the folder to write to.
        variants: of each picture.
        ending: of the files to write, such as ".png"; None: as of each picture.
        network: whether a depth network gives the distances.
        name: of the one file to write, in place of the picture's own.
    """

    inputs: Sequence[Path]
    distance: str | None
    out: Path
    variants: int = 1
    ending: str | None = None
    network: bool = False
    name: str | None = None

    def __iter__(self) -> Iterator[Row]:
        """The rows, in the order of inputs and names.

        Raises:
            ValueError: if nothing says where the distances are.
            OSError: if an input does not exist.
        """
        for given in self.inputs:
            for one in self._expanded(given):
                where, problem = None, _unnamed(one)
                if not (self.network or problem):
                    where, problem = self._distance_of(one)
                for variant in range(self.variants):
                    output, name = self.out / self._place(one, variant), one.name.as_posix()
                    yield Row(one.id, one.input, where, output, variant, problem, name, self.out)

    def _place(self, one: _Found, variant: int) -> Path:
        place = one.place if self.name is None else Path(self.name)
        if self.ending is not None:
            place = place.with_suffix(self.ending)
        if self.variants == 1:
            return place
        return place.with_name(f"{place.stem}_{variant + 1}{place.suffix}")

    def _expanded(self, given: Path) -> Iterator[_Found]:
        """The pictures of an input."""
        if given.is_dir():
            for path in self._inside(given):
                name = path.relative_to(given)
                yield _Found(name.as_posix(), path, None, name, name)
        elif given.suffix.lower() in INDICES:
            for line in read_index(given):
                picture = Path(line.input)
                # what lies elsewhere keeps its name alone
                inside = not picture.is_absolute() and ".." not in picture.parts
                name = picture if inside else Path(picture.name)
                place = Path(line.output) if line.output else name
                if place.is_absolute() or ".." in place.parts:
                    raise ValueError(
                        f"{given}: output must lie in the folder of the run, got {name}"
                    )
                where = line.distance_from(given.parent)
                own = line.id or picture.as_posix()
                yield _Found(own, given.parent / picture, where, name, place)
        else:
            require_regular(given)
            yield _Found(given.name, given, None, Path(given.name), Path(given.name))

    def _inside(self, folder: Path) -> Iterator[Path]:
        """The pictures in a folder and in those inside it, but for maps of distances and for what a
        run has written. Links to folders are not followed, as they may lead back.
        """
        others = {os.path.realpath(self.out)}
        if self.distance is not None and os.path.isdir(self.distance):
            others.add(os.path.realpath(self.distance))
        for here, folders, files in os.walk(folder):
            kept = []
            for name in sorted(folders):
                if os.path.realpath(os.path.join(here, name)) not in others:
                    kept.append(name)
            folders[:] = kept
            for name in sorted(files):
                path = Path(here, name)
                suffix = path.suffix.lower()
                if suffix not in FORMATS or suffix == ".npy" or is_part(name):
                    continue
                if not (self._is_map(name) or record_of(path)):
                    yield path

    def _is_map(self, name: str) -> bool:
        """Whether a file beside the pictures is one of the maps that a pattern asks for."""
        pattern = self.distance
        if pattern is None or "{stem}" not in pattern or Path(pattern).parent != Path():
            return False
        before, _, after = pattern.partition("{stem}")
        return name.startswith(before) and name.endswith(after) and name != before + after

    def _distance_of(self, one: _Found) -> tuple[Path | float | None, str | None]:
        """The distances of a picture, and what is wrong with them."""
        if one.distance is not None:
            return one.distance, None
        if self.distance is None:
            cure = "give --distance, or a column distance in an index"
            raise ValueError(f"{one.input} has no distances: {cure}")
        metres = number_of(self.distance)
        if metres is not None:
            return metres, None
        if "{" in self.distance:
            return self._by_pattern(one, self.distance), None
        given = Path(self.distance)
        if not given.is_dir():
            require_regular(given)
            return given, None
        base = given / one.name.parent / one.input.stem
        matches = []
        for suffix in _MAPS:
            candidate = base.with_name(base.name + suffix)
            if candidate.is_file():
                matches.append(candidate)
        if len(matches) == 1:
            return matches[0], None
        names = ", ".join(str(match) for match in matches) or "none"
        return None, f"{one.input}: expected one of {base}{{{','.join(_MAPS)}}}, found {names}"

    def _by_pattern(self, one: _Found, pattern: str) -> Path:
        known = {"stem": one.input.stem, "name": one.name.with_suffix("").as_posix()}
        try:
            found = Path(pattern.format(**known))
        except (KeyError, IndexError, ValueError):
            raise ValueError(f"distance: expected {{stem}} or {{name}}, got {pattern!r}") from None
        beside = found.parent == Path() and "{name}" not in pattern
        return one.input.parent / found if beside else found


def _unnamed(one: _Found) -> str | None:
    """What is wrong with a picture's name: text files could not hold it."""
    try:
        f"{one.input}{one.place}".encode()
    except UnicodeEncodeError:
        shown = str(one.input).encode("utf-8", "backslashreplace").decode()
        return f"{shown}: its name is not UTF-8: rename it"
    return None


def hash_of(text: str) -> int:
    """64 bits: of a billion names, two are alike with a chance of 3 %, and then compared."""
    digest = blake2b(text.encode("utf-8", "surrogateescape"), digest_size=8).digest()
    return int.from_bytes(digest, signed=True)
