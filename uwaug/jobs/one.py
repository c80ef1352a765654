"""One picture of a run: read, degraded, written whole or not at all, with its record."""

import glob
import os
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch

from uwaug._support.atomic import written_whole
from uwaug._support.deterministic import reproducible
from uwaug.formation.loops import switch
from uwaug.formation.strips import Strips
from uwaug.io.pictures import Source as Picture
from uwaug.io.pictures import read_source
from uwaug.io.write import fill, lost, require_format, write_picture
from uwaug.jobs.model import TERMS, Degraded, terms_of
from uwaug.jobs.recipe import Recipe, sha256_of
from uwaug.jobs.record import (
    Record,
    Source,
    record_of,
    source_of,
    versions,
    write_record,
)
from uwaug.jobs.row import Row, record_path, terms_path
from uwaug.labels import Labels, with_contrast
from uwaug.transforms.prepare import Whole
from uwaug.transforms.samples import key_of

__all__ = ["Outcome", "begun_again", "degrade_file", "named", "reason_of", "repeated"]


@dataclass(frozen=True)
class Outcome:
    """What became of a picture.

    Attributes:
        row: which picture.
        status: "done"; "kept", as it was there already; "failed".
        reason: why it failed; None if it did not.
        record: what stands beside the picture; None if it failed.
        seconds: that it took.
    """

    row: Row
    status: Literal["done", "kept", "failed"]
    reason: str | None
    record: Record | None
    seconds: float

    @property
    def named_reason(self) -> str:
        """The reason, with the picture's name."""
        return named(str(self.row.input), str(self.reason))


def named(name: str, text: str) -> str:
    """A text with the name of what it is about."""
    return text if name in text else f"{name}: {text}"


def begun_again(outcome: Outcome, resume: bool) -> Outcome:
    """Of a picture that may have been written before its process died, and not reported: it was
    kept then, and is done.
    """
    return replace(outcome, status="done") if outcome.status == "kept" and not resume else outcome


def degrade_file(row: Row, recipe: Recipe, *, resume: bool = False, force: bool = False) -> Outcome:
    """Degrade a picture in a file. The same row and recipe give the same files, in any process.

    Args:
        row: which picture, and where to.
        recipe: what is done to it.
        resume: keep what this recipe has made of these files before.
        force: write over what is there.

    Returns:
        What became of it: what is wrong with a file is a reason, and not raised.
    """
    start = time.perf_counter()
    try:
        known = _known(row, recipe) if resume else None
        if known is not None:
            return Outcome(row, "kept", None, known, time.perf_counter() - start)
        with warnings.catch_warnings():
            # what is worth knowing stands in the record
            warnings.simplefilter("ignore")
            record = _degrade_file(row, recipe, None, force=force)
    except Exception as error:
        return Outcome(row, "failed", reason_of(error), None, time.perf_counter() - start)
    return Outcome(row, "done", None, record, time.perf_counter() - start)


def repeated(record: Record, output: Path, *, force: bool = False) -> Record:
    """Make a picture again from its record.

    Args:
        record: of the picture.
        output: the file to write.
        force: write over what is there.

    Raises:
        ValueError: if a file that it was made of has changed, or, with the picture written, if it
            has come out differently: another version of uwaug or PyTorch, another kind of CPU, no
            numba where its loops made the first.
        OSError: if a file cannot be read or written.
    """
    for one in (record.input, record.distance):
        if isinstance(one, Source) and sha256_of(one.path) != one.sha256:
            raise ValueError(f"{one.path} has changed since the record was written")
    recipe = Recipe.from_json(record.recipe)
    recipe.require_content()
    made = _degrade_file(record.row(output), recipe, record.drawn, force=force)
    if made.sha256 != record.sha256 and output.suffix == Path(record.output).suffix:
        theirs = f"uwaug {record.uwaug} and torch {record.torch} ({_path_of(record.drawn)})"
        mine = f"here are {made.uwaug} and {made.torch} ({switch.path()})"
        raise ValueError(f"{output} differs from the first one, by {theirs}: {mine}")
    return made


def _path_of(drawn: Mapping[str, Any]) -> str:
    """What has made a picture, see `uwaug.fused`."""
    (one,) = drawn.get("samples", [drawn])
    return str(one.get("path", "eager"))


def _known(row: Row, recipe: Recipe) -> Record | None:
    """The record of a picture that is finished."""
    record = record_of(row.output)
    return record if record is not None and record.is_of(row, recipe) else None


def _degrade_file(
    row: Row, recipe: Recipe, drawn: Mapping[str, Any] | None, *, force: bool
) -> Record:
    if row.problem is not None:
        raise ValueError(row.problem)
    kind = require_format(row.output)
    if not force:
        _require_free(row, recipe)
    source = read_source(row.input)
    mapped = recipe.depth.read(row.distance, source.picture, turned=source.turned)
    model = recipe.model()
    if drawn is None:
        generator = torch.Generator().manual_seed(key_of(recipe.seed, row.variant, row.id))
        drawn = model.draw(source.picture, generator)
    try:
        made = model.degrade(source.picture, mapped.values, drawn)
    except ValueError as error:
        raise ValueError(f"{_names(row)}: {error}") from error
    row.output.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(row.output) as part:
        fill(part, kind, made.image, source)
        judged = _judged(row, recipe, made)
        record = _record_of(row, recipe, made, part)
        losses = [f"{kind} does not keep: {what}" for what in lost(source, kind)]
        record = replace(record, notes=[*mapped.notes, *losses])
        if judged is not None:
            record = replace(record, labels=judged[1], label_file=_label_file(judged[0]))
        if force:
            # what was there goes when all else is written; a new record beside an old picture
            # would pass for its own
            _remove_beside(row, judged)
            _write_beside(row, recipe, made, source, judged)
            Path(os.path.realpath(row.output)).unlink(missing_ok=True)
            write_record(record, record_path(row.output))
        else:
            write_record(record, record_path(row.output))
            _write_beside(row, recipe, made, source, judged)
    return record


Judged = tuple[Labels, dict[str, Any]]
"""Labels, and how much contrast is left of each."""


def _write_beside(
    row: Row, recipe: Recipe, made: Degraded, source: Picture, judged: Judged | None
) -> None:
    """Terms and labels."""
    if recipe.keep_terms and made.seen is not None:
        for name, term in terms_of(made.seen).items():
            write_picture(terms_path(row.output, name), term, source)
    label_source = recipe.label_source()
    if judged is not None and label_source is not None:
        label_source.write_picture(*judged, row.labels)


def _remove_beside(row: Row, judged: Judged | None) -> None:
    """Terms and labels that an earlier run has written, which are not those of the new picture."""
    before = record_of(row.output)
    if before is None:
        return
    written = _terms(row) if before.recipe["keep_terms"] else []
    if before.labels is not None:
        written += _labels(row)
    read = None if judged is None else judged[0].file
    for path in written:
        if read is None or path.resolve() != Path(read).resolve():
            path.unlink(missing_ok=True)


def _terms(row: Row) -> list[Path]:
    """Where its terms are."""
    return [terms_path(row.output, name) for name in TERMS]


def _labels(row: Row) -> list[Path]:
    """The files in the folder of labels that have its name."""
    return list(row.labels.parent.glob(f"{glob.escape(row.labels.stem)}.*"))


def _label_file(labels: Labels) -> Source | None:
    return None if labels.file is None else source_of(Path(labels.file))


def _judged(row: Row, recipe: Recipe, made: Degraded) -> Judged | None:
    """The labels of a picture; None if none are wanted."""
    source = recipe.label_source()
    if source is None:
        return None
    size = (made.image.shape[-2], made.image.shape[-1])
    labels = source.labels_of(row.name or row.input.name, size)
    left = torch.ones(1, *size) if made.seen is None else made.seen.contrast()
    judged = with_contrast(labels, left, recipe.min_contrast)
    return labels, {**judged, "output": row.place.as_posix()}


def _names(row: Row) -> str:
    return f"{row.input} with {row.distance}" if isinstance(row.distance, Path) else str(row.input)


def _require_free(row: Row, recipe: Recipe) -> None:
    """Refuse to write over files, but for what a run has left that was stopped."""
    cure = "choose another folder, or --force to write over it"
    beside = record_path(row.output)
    if row.output.exists():
        raise FileExistsError(f"{row.output} exists: {cure}")
    if record_of(row.output) is not None:
        return
    if beside.exists():
        raise FileExistsError(f"{beside} exists, and is no record of uwaug: {cure}")
    others = _terms(row) if recipe.keep_terms else []
    if recipe.labels is not None:
        others += _labels(row)
    for path in others:
        if path.exists():
            raise FileExistsError(f"{path} exists: {cure}")


def _record_of(row: Row, recipe: Recipe, made: Degraded, part: Path) -> Record:
    uwaug, pytorch = versions()
    where = row.distance
    return Record(
        uwaug=uwaug,
        torch=pytorch,
        id=row.id,
        variant=row.variant,
        input=source_of(row.input),
        distance=source_of(where) if isinstance(where, Path) else where,
        output=row.output.name,
        sha256=sha256_of(part),
        bytes=part.stat().st_size,
        recipe=recipe.to_json(),
        drawn=made.record,
        water=made.water,
        visibility=made.visibility,
        contrast=1.0 if made.seen is None else _mean_contrast(made.seen),
        notes=[],
    )


def _mean_contrast(seen: Whole | Strips) -> float:
    """Of some pixels, spread over the picture: all of them would take a tenth of its time."""
    with reproducible():  # a record is the same on any number of threads
        left = seen.some_contrast()
    # and wherever in memory it lies, which its last bits follow from
    return round(float(left.double().mean()), 6)


def reason_of(error: Exception) -> str:
    """An error in words; those that no check of ours has raised with their kind."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, MemoryError):
        return f"out of memory: {error}" if str(error) else "out of memory"
    if isinstance(error, (ValueError, OSError, ImportError)) and str(error):
        return str(error)
    return f"{type(error).__name__}: {error}"
