"""What `uwaug degrade` does once it knows what is wanted: a run, a rehearsal, one picture again."""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import typer

from uwaug.commands.console import fail, refuse
from uwaug.commands.progress import counted
from uwaug.files import remove_left
from uwaug.jobs.cluster import connected, run_on_ray
from uwaug.jobs.one import Outcome, degrade_file, reason_of, repeated
from uwaug.jobs.recipe import Recipe
from uwaug.jobs.record import read_record
from uwaug.jobs.report import index_of
from uwaug.jobs.rows import Rows
from uwaug.jobs.run import run
from uwaug.jobs.sheet import SHOWN, draw_sheet
from uwaug.labels import LabelSource
from uwaug.picture_files import FORMATS

__all__ = ["INTERRUPTED", "LISTED", "Manner", "carry_out", "rehearse", "repeat", "require_free"]

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
    """Refuse a run that would write over files, before it begins; or its sheet over a picture."""
    if not (manner.resume or manner.force):
        for path in (row.output for row in rows):
            _require_none(path, "--resume to go on, --force to write over it, or another folder")
        labels = recipe.labels
        if labels is not None and Path(labels).is_file():
            _require_none(
                rows.out / Path(labels).name, "--force to write over it, or another folder"
            )
    if not manner.sheet:
        return
    sheet = _sheet(rows.out)
    if not (manner.resume or manner.force):
        _require_none(sheet, "--force to write over it, or another folder")
    for row in rows:
        if row.output == sheet:
            refuse(f"{row.input} would be written to {sheet}, as the sheet: leave out --sheet")


def _require_none(path: Path, cure: str) -> None:
    if path.exists():
        refuse(f"{path} exists: {cure}")


def carry_out(rows: Rows, recipe: Recipe, count: int, manner: Manner) -> None:
    """Degrade all pictures; write an index if they go to a folder; end with 1 if any failed."""
    start = time.perf_counter()
    summary, labels = _Summary(max(1, count // SHOWN)), _Labels(recipe.label_source())
    problems = []
    try:
        rows.out.mkdir(parents=True, exist_ok=True)
        if manner.resume:
            _clean(rows.out)
        if rows.name is not None:
            _go(rows, recipe, count, manner, [summary.add, labels.add])
        else:
            with index_of(rows.out) as index:
                _go(rows, recipe, count, manner, [summary.add, index.add, labels.add])
        labels.write(rows.out)
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
        more = summary.failed - len(summary.reasons)
        lines = [*summary.reasons, *([f"and {more} more, see index.csv"] if more else [])]
        problems.append("\n  ".join([f"{summary.failed} of {count} pictures failed:", *lines]))
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
        self.seen = self.failed = self.kept = 0
        self.reasons: list[str] = []
        self.notes: list[str] = []
        self.shown: list[Outcome] = []

    def add(self, outcome: Outcome) -> None:
        """One more picture."""
        if outcome.status == "failed":
            self.failed += 1
            if len(self.reasons) < LISTED:
                self.reasons.append(_named(outcome, str(outcome.reason)))
        elif self.seen % self._step == 0:
            self.shown.append(outcome)
        self.kept += outcome.status == "kept"
        self.seen += 1
        for note in outcome.record.notes if outcome.record else ():
            if len(self.notes) < LISTED:
                self.notes.append(_named(outcome, note))

    def said(self, count: int) -> str:
        """How many."""
        done = self.seen - self.failed - self.kept
        kept = f", {self.kept} were there" if self.kept else ""
        return f"{done} of {count} pictures{kept}"


class _Labels:
    """Collects labels that have one file for the whole run."""

    def __init__(self, source: LabelSource | None) -> None:
        self._source = source
        self._records: list[Any] = []

    def add(self, outcome: Outcome) -> None:
        """Those of one more picture."""
        if outcome.record is not None and outcome.record.labels is not None:
            self._records.append(outcome.record.labels)

    def write(self, out: Path) -> None:
        """Write the file."""
        if self._source is not None and self._records:
            self._source.write_run(self._records, out)


def _named(outcome: Outcome, text: str) -> str:
    name = str(outcome.row.input)
    return text if name in text else f"{name}: {text}"


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
            moved = row._replace(output=Path(folder) / row.output.name)
            outcomes = [degrade_file(moved, recipe, force=True) for _ in range(2)]
    if outcomes[1].status == "failed":
        fail(_named(outcomes[1], str(outcomes[1].reason)))
    seconds = outcomes[1].seconds * count / manner.workers
    workers = f"{manner.workers} worker{'s' if manner.workers > 1 else ''}"
    print(f"{count} pictures, about {seconds:.3g} s with {workers}. Nothing was written.")


def repeat(path: Path, out: Path, force: bool) -> None:
    """Make the picture of a record again."""
    try:
        record = read_record(path)
        alone = out.suffix.lower() in FORMATS and not out.is_dir()
        output = out if alone else out / record.output
        if output.resolve() == (path.parent / record.output).resolve():
            refuse(f"--out: {output} is the first one: choose another folder")
        made = repeated(record, output, force=force)
    except Exception as error:
        if isinstance(error, typer.Exit):
            raise
        fail(reason_of(error))
    same = "the same bytes" if made.sha256 == record.sha256 else "in another format"
    print(f"{output}: {same}")
