"""One picture of a run: read, degraded, written whole or not at all, with its sidecar."""

import io
import os
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple

import torch

from uwaug._support.atomic import written_whole
from uwaug._support.deterministic import reproducible
from uwaug._support.hashing import FileHash
from uwaug.distance.network import DepthNetwork
from uwaug.formation.contrast import faintness
from uwaug.formation.scene import Scene
from uwaug.io.distances import finer_unit
from uwaug.io.read import File, PictureFile, name_of, opened, read_picture_file
from uwaug.io.write import encode, format_of, lost, write_picture
from uwaug.jobs.items import Item, labelled
from uwaug.jobs.recipe import Recipe, changes
from uwaug.jobs.sidecar import (
    TERMS,
    Sidecar,
    sidecar_of,
    sidecar_path,
    terms_path,
    versions,
)
from uwaug.jobs.waters import LEFT, InWater
from uwaug.labels import label_paths, with_contrast
from uwaug.transforms.prepare import deterministic
from uwaug.transforms.samples import key_of

_ROOM = 8.0
"""m: a map whose median is farther may be in another unit, if next to nothing is left to see."""


@dataclass(frozen=True)
class Result:
    """What became of a picture.

    Attributes:
        item: which picture, without its labels.
        status: "done"; "kept", as it was there already; "failed".
        reason: why it failed; None if it did not.
        sidecar: what stands beside the picture; None if it failed.
        seconds: that it took.
        content: of the picture's file, where it is not written to one.
    """

    item: Item
    status: Literal["done", "kept", "failed"]
    reason: str | None = None
    sidecar: Sidecar | None = None
    seconds: float = 0.0
    content: bytes | None = None

    @property
    def named_reason(self) -> str:
        """The reason, with the picture's name."""
        return named(name_of(self.item.input), str(self.reason))


class _Degraded(NamedTuple):
    """A picture before it is written; `sidecar`: but for the hash and the size of its file."""

    original: PictureFile
    formed: InWater
    format: str
    sidecar: Sidecar


class Degrader:
    """A recipe with its water and its depth network opened: made once in each process.

    The same item and recipe give the same files, in any process. Called with an item, it writes the
    picture and returns a `Result`; it never raises over a file.

    Args:
        recipe: what is done to pictures.
        resume: keep what this recipe has made of the same files before.
        force: write over what is there.
        in_memory: put pictures into `Result.content`, and write no file.

    Raises:
        TypeError, ValueError, OSError: as `Recipe.open`.
    """

    def __init__(
        self,
        recipe: Recipe,
        *,
        resume: bool = False,
        force: bool = False,
        in_memory: bool = False,
    ) -> None:
        self.recipe, self.resume, self.force, self.in_memory = recipe, resume, force, in_memory
        self._recipe = recipe.to_json()
        self._waters = recipe.open()
        network = recipe.distance.network
        self._network = None if network is None else DepthNetwork(network)

    def __call__(self, item: Item) -> Result:
        """Degrade a picture."""
        start, content, about = time.perf_counter(), None, item._replace(labels=None)
        try:
            kept = self._kept(item) if self.resume else None
            if kept is not None:
                return Result(about, "kept", None, kept, time.perf_counter() - start)
            if self.in_memory:
                file = io.BytesIO()
                sidecar = _encoded(file, self._degraded(item, None))
                content = file.getvalue()
            else:
                sidecar = self.write(item)
        except Exception as error:
            return Result(about, "failed", reason_of(error), None, time.perf_counter() - start)
        return Result(about, "done", None, sidecar, time.perf_counter() - start, content)

    def write(self, item: Item, drawn: Mapping[str, Any] | None = None) -> Sidecar:
        """Degrade a picture into a file.

        Args:
            item: which picture.
            drawn: what a sidecar holds of what is random; None to draw it anew.

        Raises:
            ValueError: if a file does not suit.
            OSError: if one cannot be read or written, or is there already.
        """
        if not self.force:
            self._require_free(item)
        degraded, beside = self._degraded(item, drawn), sidecar_path(item.output)
        item.output.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(item.output) as part:
            with part.open("w+b") as file:
                sidecar = _encoded(file, degraded)
            before = sidecar_of(item.output) if self.force else None
            if not self.force:
                # if this is stopped, what lies there is known as a run's
                sidecar.write(beside)
            written = self._write_beside(item, degraded)
            if written:
                hashes = {path.name: FileHash.of(path).sha256 for path in written}
                sidecar = replace(sidecar, beside=hashes)
            if self.force:
                # what was there goes when all else is written; a new sidecar beside an old picture
                # would pass for its own
                _remove_others(item, before, written)
                Path(os.path.realpath(item.output)).unlink(missing_ok=True)
            if self.force or written:
                sidecar.write(beside)
        return sidecar

    def _kept(self, item: Item) -> Sidecar | None:
        """The sidecar of a picture that is there, as this recipe would make it again.

        Raises:
            FileExistsError: if it is there and something is otherwise; says what.
            OSError: if a file cannot be read.
        """
        sidecar = sidecar_of(item.output)
        if sidecar is None or not os.path.lexists(item.output):
            return None
        changed = self._changed(item, sidecar)
        if changed is None:
            made_by = sidecar.uwaug, sidecar.torch
            if made_by != versions():
                note = "made by uwaug {} and torch {}: not by those of this run".format(*made_by)
                sidecar = replace(sidecar, notes=[*sidecar.notes, note])
            return sidecar
        if self.force:
            return None
        raise FileExistsError(
            f"{item.output} exists, but {changed}: remove the picture to make it anew"
        )

    def _changed(self, item: Item, sidecar: Sidecar) -> str | None:
        """What is otherwise than when a picture was made, in words; None if nothing is."""
        if other := changes(self._recipe, sidecar.recipe):
            return f"was made with other options ({'; '.join(other)})"
        if sidecar.recipe.get("content") != self._recipe["content"]:
            return "was made with other files of the recipe"
        if (sidecar.id, sidecar.variant) != (item.id, item.variant):
            return f"was made of {sidecar.id}, variant {sidecar.variant}"
        labels = None if item.labels is None else item.labels.file_hash()
        made_of = {
            "picture": (sidecar.input, _hash_of(item.input)),
            "distance": (sidecar.distance, _hash_of(item.distance)),
            "label file": (sidecar.label_file, labels),
        }
        for what, (then, now) in made_of.items():
            if then != now:
                return f"was made of another {what}"
        file = FileHash.of(item.output)
        if (file.sha256, file.bytes) != (sidecar.sha256, sidecar.bytes):
            return "its bytes are not those that its record tells of"
        for path in _written_beside(item, sidecar):
            if not path.exists():
                return f"{path} is gone"
            sha256 = sidecar.beside.get(path.name)
            if sha256 is not None and FileHash.of(path).sha256 != sha256:
                return f"{path} is not as it was written with it"
        return None

    def _degraded(self, item: Item, drawn: Mapping[str, Any] | None) -> _Degraded:
        if item.problem is not None:
            raise ValueError(item.problem)
        format = format_of(item.output)
        with warnings.catch_warnings():
            # what is worth knowing stands in the sidecar
            warnings.simplefilter("ignore")
            with opened(item.input) as file:
                input_hash = FileHash.of_stream(file, _path_of(item.input))
                original = read_picture_file(file)
            image = original.image
            distance, distance_hash, notes = self._distance(item.distance, original)
            key = key_of(self.recipe.seed, item.variant, item.id)
            try:
                formed = self._waters.degrade(image, distance, drawn, key)
            except ValueError as error:
                raise ValueError(f"{file_names(item)[-1]}: {error}") from error
            labels = None
            if item.labels is not None:
                contrast = torch.ones(1, *image.shape[-2:])
                if formed.scene is not None:
                    contrast = formed.scene.contrast()
                labels = with_contrast(item.labels, contrast, self.recipe.min_contrast)
                labels["output"] = item.place.as_posix()
        contrast_left, faint = _contrast_left(formed.scene)
        hidden = [] if faint is None else [f"{faint}: {self._cure(item, distance)}?"]
        losses = [f"{format} does not keep: {what}" for what in lost(original, format)]
        losses += [f"not kept: {what}" for what in original.left_out]
        uwaug, pytorch = versions()
        sidecar = Sidecar(
            uwaug=uwaug,
            torch=pytorch,
            id=item.id,
            variant=item.variant,
            input=input_hash,
            distance=distance_hash,
            output=item.output.name,
            sha256="",
            bytes=0,
            recipe=self._recipe,
            drawn=formed.drawn,
            water=formed.water,
            visibility=formed.visibility,
            contrast=contrast_left,
            notes=[*notes, *hidden, *losses],
            labels=labels,
            label_file=None if item.labels is None else item.labels.file_hash(),
        )
        return _Degraded(original, formed, format, sidecar)

    def _cure(self, item: Item, distance: torch.Tensor | None) -> str:
        """Of a picture in which next to nothing is left to see."""
        recipe = self.recipe
        if recipe.random:
            cure = "other draws, such as contrast=(0.3, 0.8)"
        elif recipe.water is not None:
            cure = "clearer water, such as visibility=10 or contrast=0.3"
        else:
            cure = "less distance"
        in_file = not (item.distance is None or isinstance(item.distance, (int, float)))
        if in_file and distance is not None and recipe.distance.kind == "metric":
            known = distance[(distance > 0) & distance.isfinite()]
            if known.numel() and float(known.median()) > _ROOM:
                return f"unit={finer_unit(recipe.distance.unit)!r}, or {cure}"
        return cure

    def _distance(
        self, where: File | float | None, original: PictureFile
    ) -> tuple[torch.Tensor | None, FileHash | float | None, list[str]]:
        """The map of a picture, None where its distance is drawn; what its sidecar says of it; and
        notes.
        """
        image = original.image
        size = (image.shape[-2], image.shape[-1])
        if where is None:
            if "distance" in self.recipe.options:
                return None, None, []
            if self._network is None:
                raise ValueError("no distances: give a file, metres, or a depth network")
            shown = image / 255 if image.dtype == torch.uint8 else image
            return self._network(shown), None, []
        if isinstance(where, (int, float)):
            kind = self.recipe.distance.kind
            if self.recipe.distance.map_kind != "metric":
                cure = "give a file of that kind, or metres without distance_kind"
                got = f"distance={where:g} is metres, but distance_kind is {kind!r}"
                raise ValueError(f"{got}: {cure}")
            return torch.full((1, *size), float(where)), where, []
        with opened(where) as file:
            hash = FileHash.of_stream(file, _path_of(where))
            values, notes = self.recipe.distance.read(file, size, turned=original.turned)
        return values, hash, notes

    def _require_free(self, item: Item) -> None:
        """Refuse to write over files, but for what a run has left that was stopped."""
        beside = sidecar_path(item.output)
        # a link that points nowhere is somebody's too: it would be written through
        if os.path.lexists(item.output):
            raise FileExistsError(f"{item.output} exists")
        if sidecar_of(item.output) is not None:
            return
        if os.path.lexists(beside):
            raise FileExistsError(f"{beside} exists, and is no record of uwaug")
        label_file = None if item.labels is None else item.labels.file
        for path in _beside(item, self.recipe.keep_terms, label_file):
            if os.path.lexists(path):
                raise FileExistsError(f"{path} exists")

    def _write_beside(self, item: Item, degraded: _Degraded) -> list[Path]:
        """Terms and labels; returns their files."""
        written = []
        if self.recipe.keep_terms and degraded.formed.scene is not None:
            with deterministic(degraded.original.image):
                terms = degraded.formed.scene.term_pictures()
            for name, term in terms.items():
                write_picture(terms_path(item.output, name), term, degraded.original)
                written.append(terms_path(item.output, name))
        if item.labels is not None:
            written += item.labels.write(degraded.sidecar.labels, item.labels_path)
        return written


def _beside(item: Item, terms: bool, label_file: str | None) -> list[Path]:
    """Files of terms and of labels that a picture has beside it."""
    paths = [terms_path(item.output, term) for term in TERMS] if terms else []
    if label_file is not None:
        paths += label_paths(Path(label_file).suffix, item.labels_path)
    return paths


def _written_beside(item: Item, sidecar: Sidecar) -> list[Path]:
    """Files of terms and of labels that were written with a sidecar."""
    # a picture that is left as it is has no terms
    terms = bool(sidecar.recipe.get("keep_terms")) and sidecar.water != LEFT
    return _beside(item, terms, None if sidecar.label_file is None else sidecar.label_file.path)


def _remove_others(item: Item, before: Sidecar | None, written: list[Path]) -> None:
    """Remove what an earlier run has written of terms and labels and the new picture has not."""
    if before is None:
        return
    read = None if item.labels is None else item.labels.file
    kept = {path.resolve() for path in (*written, *([] if read is None else [Path(read)]))}
    for path in _written_beside(item, before):
        if path.resolve() not in kept:
            path.unlink(missing_ok=True)


def replay(sidecar: Sidecar, output: Path, *, force: bool = False) -> Sidecar:
    """Make a picture again from its sidecar.

    Args:
        sidecar: of the picture.
        output: the file to write.
        force: write over what is there.

    Raises:
        ValueError: if it would be written over a file that it was made of; if such a file has
            changed, or, with the picture written, if it has come out differently: another version
            of uwaug or PyTorch, another kind of CPU, no numba where its loops made the first.
        OSError: if a file cannot be read or written.
    """
    recipe = Recipe.from_json(sidecar.recipe)
    recipe.require_content()
    for hash in (sidecar.input, sidecar.distance, sidecar.label_file):
        if not isinstance(hash, FileHash):
            continue
        if os.path.realpath(hash.path) == os.path.realpath(output):
            raise ValueError(f"{output} is read, and would be written over: another folder?")
        if FileHash.of(hash.path).sha256 != hash.sha256:
            raise ValueError(f"{hash.path} has changed since the record was written")
    where = sidecar.distance
    distance = Path(where.path) if isinstance(where, FileHash) else where
    name = sidecar.labels["picture"] if sidecar.labels else ""
    item = Item(sidecar.id, Path(sidecar.input.path), distance, output, sidecar.variant, name=name)
    (item,) = labelled([item], recipe.open_labels() if name else None)
    again = Degrader(recipe, force=force).write(item, sidecar.drawn)
    if again.sha256 != sidecar.sha256 and output.suffix == Path(sidecar.output).suffix:
        theirs = f"uwaug {sidecar.uwaug} and torch {sidecar.torch} ({_path_in(sidecar)})"
        mine = f"here are {again.uwaug} and {again.torch} ({_path_in(again)})"
        raise ValueError(f"{output} differs from the first one, by {theirs}: {mine}")
    return again


def _path_in(sidecar: Sidecar) -> str:
    """What has formed a picture, see `uwaug.fused`."""
    (drawn,) = sidecar.drawn.get("samples", [sidecar.drawn])
    return str(drawn.get("path", "eager"))


def named(name: str, text: str) -> str:
    """A text with the name of what it is about."""
    return text if name in text else f"{name}: {text}"


def reason_of(error: Exception) -> str:
    """An error in words; those that no check of ours has raised with their kind."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, MemoryError):
        return f"out of memory: {error}" if str(error) else "out of memory"
    if isinstance(error, (ValueError, OSError, ImportError)) and str(error):
        return str(error)
    return f"{type(error).__name__}: {error}"


def _encoded(file: BinaryIO, degraded: _Degraded) -> Sidecar:
    """Write a picture into an open file; its sidecar is then complete."""
    encode(file, degraded.format, degraded.formed.image, degraded.original)
    hash = FileHash.of_stream(file, "")
    return replace(degraded.sidecar, sha256=hash.sha256, bytes=hash.bytes)


def _path_of(file: File) -> str:
    """How sidecars name a file: absolute, but for what is in no file."""
    return os.path.abspath(file) if isinstance(file, (str, os.PathLike)) else name_of(file)


def _hash_of(where: File | float | None) -> FileHash | float | None:
    """What a sidecar says of a file, or of metres."""
    if where is None or isinstance(where, (int, float)):
        return where
    with opened(where) as file:
        return FileHash.of_stream(file, _path_of(where))


def file_names(item: Item) -> list[str]:
    """What reasons begin with: the picture's name, its map's, or both."""
    where = item.distance
    if where is None or isinstance(where, (int, float)):
        return names_together(name_of(item.input), None)
    return names_together(name_of(item.input), name_of(where))


def names_together(picture: str, distance: str | None) -> list[str]:
    """Of the files of a picture, one by one and together."""
    return [picture] if distance is None else [picture, distance, f"{picture} with {distance}"]


def _contrast_left(scene: Scene | None) -> tuple[float, str | None]:
    """The mean share of contrast that is left, and a word if it is next to nothing. Of some pixels,
    spread over the picture: all of them would take a tenth of its time.
    """
    if scene is None:
        return 1.0, None
    with reproducible():  # a sidecar is the same on any number of threads
        contrast, is_surface = scene.contrast_at_points()
    faint = faintness(contrast[is_surface])
    # and wherever in memory it lies, which its last bits follow from
    return round(float(contrast.double().mean()), 6), faint
