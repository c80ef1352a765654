"""Which pictures a run degrades, where their distances are, and what it writes."""

import os
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import NamedTuple

import numpy as np

from uwaug.files import is_part, require_regular
from uwaug.jobs.index import INDICES, number_of, read_index
from uwaug.picture_files import FORMATS

__all__ = ["Row", "Rows", "hash_of", "terms_path"]

_MAPS = (".npy", ".npz", ".png", ".tif", ".tiff", ".exr", ".pfm")
"""Ends of the names of distance files, in a folder of them."""


class Row(NamedTuple):
    """A picture of a run.

    Attributes:
        id: what its randomness follows from: its path from the folder that was given, or the id of
            an index.
        input: its file.
        distance: the file of its distances; metres; or None, for a depth network.
        output: the file to write.
        variant: which of several of one picture, from 0.
        problem: why it cannot be done; None if nothing is known against it.
        name: path of the picture from the folder that was given, which labels know it by.
        place: path of the output from the folder that is written to.
    """

    id: str
    input: Path
    distance: Path | float | None
    output: Path
    variant: int = 0
    problem: str | None = None
    name: str = ""
    place: str = ""

    @property
    def labels(self) -> Path:
        """Where labels of the output would be, were they a picture."""
        place = Path(self.place or self.output.name)
        return self.output.parents[len(place.parts) - 1] / "labels" / place


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
                where, problem = None, None
                if not self.network:
                    where, problem = self._distance_of(one)
                for variant in range(self.variants):
                    place = self._place(one, variant)
                    output, name = self.out / place, one.name.as_posix()
                    yield Row(
                        one.id, one.input, where, output, variant, problem, name, place.as_posix()
                    )

    def check(self, terms: Sequence[str] = ()) -> int:
        """Look all of them through before anything is done, and count them.

        Args:
            terms: that are written beside each picture, see `terms_path`.

        Raises:
            ValueError: if there are none, a picture has no distance, two have one id or would be
                written to one file, or one would be written over itself; names them.
            OSError: if an input does not exist.
        """
        self._require_own_folder()
        count = 0
        ids, outputs = array("q"), array("q")
        for row in self:
            count += 1
            if os.path.realpath(row.output) == os.path.realpath(row.input):
                raise ValueError(f"{row.input} would be written over: choose another folder")
            ids.append(hash_of(f"{row.id}/{row.variant}"))
            outputs.extend(hash_of(name) for name in _written(row, terms))
        if not count:
            known = ", ".join(FORMATS)
            raise ValueError(f"no pictures in {', '.join(map(str, self.inputs))}: expected {known}")
        self._require_apart(ids, lambda row: [f"{row.id}/{row.variant}"], "id", _Cure.ID)
        self._require_apart(outputs, lambda row: _written(row, terms), "output", _Cure.OUTPUT)
        return count

    def _require_own_folder(self) -> None:
        """Else the next run would take what this one has written for pictures."""
        for given in self.inputs:
            if given.is_dir() and os.path.realpath(given) == os.path.realpath(self.out):
                cure = "expected a folder of its own to write to"
                raise ValueError(f"{given} would be written into: {cure}")

    def _require_apart(
        self, hashes: "array[int]", keys: Callable[[Row], list[str]], what: str, cure: str
    ) -> None:
        values, counts = np.unique(np.frombuffer(hashes, dtype=np.int64), return_counts=True)
        twice = set(values[counts > 1].tolist())
        seen: dict[str, Path] = {}
        for row in self if twice else ():
            for key in keys(row):
                if hash_of(key) not in twice:
                    continue
                before = seen.setdefault(key, row.input)
                if before is not row.input:
                    got = row.id if what == "id" else key
                    raise ValueError(f"{before} and {row.input} have one {what}, {got}: {cure}")

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
        """The pictures in a folder and in those inside it; links to folders are not followed, as
        they may lead back, and what an earlier run has written is no input.
        """
        out = os.path.realpath(self.out)
        for here, folders, files in os.walk(folder):
            kept = []
            for name in sorted(folders):
                if os.path.realpath(os.path.join(here, name)) != out:
                    kept.append(name)
            folders[:] = kept
            for name in sorted(files):
                suffix = Path(name).suffix.lower()
                if suffix in FORMATS and suffix != ".npy" and not is_part(name):
                    yield Path(here, name)

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


def terms_path(output: Path, term: str) -> Path:
    """The file of one of a picture's terms."""
    return output.with_name(f"{output.stem}_{term}{output.suffix}")


def _written(row: Row, terms: Sequence[str]) -> list[str]:
    """The pictures that a row makes; some file systems know no difference between A and a."""
    paths = [row.output, *(terms_path(row.output, term) for term in terms)]
    return [str(path).casefold() for path in paths]


class _Cure:
    ID = "give an index with a column id"
    OUTPUT = "give an index with a column output"


def hash_of(text: str) -> int:
    """64 bits: of a billion names, two are alike with a chance of 3 %, and then compared."""
    digest = blake2b(text.encode("utf-8", "surrogateescape"), digest_size=8).digest()
    return int.from_bytes(digest, signed=True)
