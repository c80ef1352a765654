"""What `uwaug degrade` does once it knows what is wanted: a run, a rehearsal, one picture again."""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import typer

from uwaug._support.atomic import remove_left
from uwaug.cli.console import fail, refuse
from uwaug.cli.progress import counted
from uwaug.figures.run_sheet import SHOWN, draw_sheet
from uwaug.io.write import FORMATS
from uwaug.jobs.cluster import connected, run_on_ray
from uwaug.jobs.one import Outcome, degrade_file, named, reason_of, repeated
from uwaug.jobs.recipe import Recipe
from uwaug.jobs.record import Record, Source, read_record, record_of
from uwaug.jobs.report import index_of, written_outputs
from uwaug.jobs.rows import Rows
from uwaug.jobs.run import run

__all__ = [
    "INTERRUPTED",
    "LISTED",
    "Manner",
    "carry_out",
    "failures",
    "rehearse",
    "repeat",
    "require_free",
]

LISTED = 20
"""Reasons, or pictures of a rehearsal, at most."""

INTERRUPTED = 130
"""Exit code of what Ctrl-C has ended."""


Taker = Callable[[Outcome], None]


class Manner(NamedTuple):
    """How a run is done, see `uwaug.jobs.run`; `ray`: by Ray at this address, if not None."""

    workers: int
    resume: bool
    force: bool
    sheet: bool = False
    ray: str | None = None


def require_free(rows: Rows, recipe: Recipe, manner: Manner) -> None:
    """Refuse a run that would write over files, or go on with what was made otherwise, before it
    begins; or its sheet over a picture.
    """
    if not manner.force:
        _require_none_there(rows, recipe, manner)
    if not manner.sheet:
        return
    sheet = _sheet(rows.out)
    if not (manner.resume or manner.force):
        _require_none(sheet, "--force to write over it, or another folder")
    for row in rows:
        if row.output == sheet:
            refuse(f"{row.input} would be written to {sheet}, as the sheet: leave out --sheet")


def _require_none_there(rows: Rows, recipe: Recipe, manner: Manner) -> None:
    labels = recipe.labels
    if labels is not None and Path(labels).is_file() and not (rows.out / "index.csv").exists():
        _require_none(rows.out / Path(labels).name, "--force to write over it, or another folder")
    for row in rows:
        if not row.output.exists():
            continue
        if not manner.resume:
            cure = "--resume to go on, --force to write over it, or another folder"
            refuse(f"{row.output} exists: {cure}")
        apart = _apart(row.output, recipe)
        if apart:
            cure = "give the same ones, --force, or another folder"
            refuse(f"{row.output} was made with other options ({', '.join(apart)}): {cure}")
        return


def _apart(output: Path, recipe: Recipe) -> list[str]:
    """The options in which a picture's record differs from a recipe."""
    record, mine = record_of(output), recipe.to_json()
    if record is None:
        return []
    return [name for name in mine if mine[name] != record.recipe.get(name) and name != "content"]


def _require_none(path: Path, cure: str) -> None:
    if path.exists():
        refuse(f"{path} exists: {cure}")


def carry_out(rows: Rows, recipe: Recipe, count: int, manner: Manner) -> None:
    """Degrade all pictures; write an index if they go to a folder; end with 1 if any failed."""
    start = time.perf_counter()
    summary = _Summary(max(1, count // SHOWN))
    problems = []
    try:
        rows.out.mkdir(parents=True, exist_ok=True)
        if manner.resume:
            _clean(rows.out)
        if rows.name is not None:
            _go(rows, recipe, count, manner, [summary.add])
        else:
            with index_of(rows.out) as index:
                _go(rows, recipe, count, manner, [summary.add, index.add])
        _write_labels(rows, recipe)
        if manner.sheet and summary.shown:
            draw_sheet(summary.shown, _sheet(rows.out))
    except (KeyboardInterrupt, SystemExit) as stop:
        print(f"Stopped: {summary.said(count)}; --resume goes on.", file=sys.stderr)
        code = stop.code if isinstance(stop, SystemExit) else INTERRUPTED
        raise typer.Exit(int(code or 0)) from None
    except (OSError, ValueError) as error:
        problems.append(reason_of(error))
    for line in summary.notes:
        print(f"Note: {line}")
    print(f"{summary.said(count)} in {rows.out}, {time.perf_counter() - start:.1f} s")
    if summary.failed:
        failed, rest = (summary.failed, count, summary.reasons), ", see index.csv"
        problems.append(failures(*failed, rest))
    if recipe.labels is not None and summary.seen > summary.failed and not summary.labelled:
        problems.append(f"none of the pictures has labels in {recipe.labels}: the right folder?")
    if problems:
        fail("\n".join(problems))


def _sheet(out: Path) -> Path:
    """The sheet of a run."""
    return out / "sheet.jpg"


def _go(rows: Rows, recipe: Recipe, count: int, manner: Manner, takers: list[Taker]) -> None:
    with _engine(manner) as go, counted(count) as counter:
        for outcome in go(rows, recipe, resume=manner.resume, force=manner.force):
            for take in takers:
                take(outcome)
            counter.advance()


@contextmanager
def _engine(manner: Manner) -> Iterator[Callable[..., Iterator[Outcome]]]:
    """What carries a run out: processes of this machine, or Ray."""
    if manner.ray is None:
        yield partial(run, workers=manner.workers)
        return
    with connected(manner.ray, manner.workers):
        yield run_on_ray


class _Summary:
    """What is said of a run when it ends; it does not grow with the number of pictures."""

    def __init__(self, step: int) -> None:
        self._step = step
        self.seen = self.failed = self.kept = self.labelled = 0
        self.reasons: list[str] = []
        self.notes: list[str] = []
        self.shown: list[Outcome] = []

    def add(self, outcome: Outcome) -> None:
        """One more picture."""
        if outcome.status == "failed":
            self.failed += 1
            if len(self.reasons) < LISTED:
                self.reasons.append(outcome.named_reason)
        elif self.seen % self._step == 0:
            self.shown.append(outcome)
        self.kept += outcome.status == "kept"
        self.seen += 1
        self.labelled += outcome.record is not None and outcome.record.label_file is not None
        for note in outcome.record.notes if outcome.record else ():
            if len(self.notes) < LISTED:
                self.notes.append(named(str(outcome.row.input), note))

    def said(self, count: int) -> str:
        """How many."""
        done = self.seen - self.failed - self.kept
        kept = f", {self.kept} were there" if self.kept else ""
        return f"{done} of {count} pictures{kept}"


def _write_labels(rows: Rows, recipe: Recipe) -> None:
    """Write what labels have one file of for all pictures in the folder: this run's, and those of
    earlier ones with the same labels.
    """
    source = recipe.label_source()
    if source is None:
        return
    found = []
    for record in _records(rows):
        if record.labels is not None and record.recipe["labels"] == recipe.labels:
            found.append(record.labels)
    if found:
        source.write_run(found, rows.out)


def _records(rows: Rows) -> Iterator[Record]:
    """Of the pictures in the folder that a run writes to."""
    outputs = written_outputs(rows.out) if rows.name is None else [rows.out / rows.name]
    for output in outputs:
        record = record_of(output)
        if record is not None:
            yield record


def failures(failed: int, count: int, reasons: list[str], rest: str) -> str:
    """How many pictures failed, and why; `rest`: where the reasons stand that are not named."""
    more = failed - len(reasons)
    lines = [*reasons, *([f"and {more} more{rest}"] if more else [])]
    return "\n  ".join([f"{failed} of {count} pictures failed:", *lines])


def _clean(out: Path) -> None:
    """Remove what a killed run was writing."""
    for folder, _, _ in os.walk(out):
        remove_left(Path(folder))


def rehearse(rows: Rows, recipe: Recipe, count: int, manner: Manner) -> None:
    """Say what a run would read and write, and how long it would take by its first picture."""
    for row in islice(rows, LISTED):
        print(f"{row.input} + {row.problem or row.distance} → {row.output}")
    if count > LISTED:
        print(f"… and {count - LISTED} more")
    with tempfile.TemporaryDirectory() as folder:
        for row in islice(rows, 1):
            moved = row.moved(Path(folder))
            outcomes = [degrade_file(moved, recipe, force=True) for _ in range(2)]
    if outcomes[1].status == "failed":
        fail(outcomes[1].named_reason)
    seconds = outcomes[1].seconds * count / manner.workers
    workers = f"{manner.workers} worker{'s' if manner.workers > 1 else ''}"
    print(f"{count} pictures, about {seconds:.3g} s with {workers}. Nothing was written.")


def repeat(path: Path, out: Path, force: bool, moved: list[Path], distance: str | None) -> None:
    """Make the picture of a record again.

    Args:
        path: of the record.
        out: folder, or file.
        force: write over what is there.
        moved: the picture that it was made of, if it has another place now; or nothing.
        distance: the same of its distances.
    """
    try:
        record = read_record(path)
        if moved:
            record = replace(record, input=replace(record.input, path=str(moved[0].absolute())))
        if distance is not None and isinstance(record.distance, Source):
            where = replace(record.distance, path=str(Path(distance).absolute()))
            record = replace(record, distance=where)
        alone = out.suffix.lower() in FORMATS and not out.is_dir()
        output = out if alone else out / record.output
        if output.resolve() == (path.parent / record.output).resolve():
            refuse(f"--out: {output} is the first one: choose another folder")
        made = repeated(record, output, force=force)
    except FileNotFoundError as error:
        cure = "if it was moved, name it: uwaug degrade PICTURE --distance MAP --from RECORD"
        fail(f"{reason_of(error)}: {cure}")
    except Exception as error:
        if isinstance(error, typer.Exit):
            raise
        fail(reason_of(error))
    same = "the same bytes" if made.sha256 == record.sha256 else "in another format"
    print(f"{output}: {same}")
