"""A run of `uwaug degrade`, its rehearsal, and one picture again."""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from uwaug._support.atomic import remove_left
from uwaug.cli.console import counted, fail, refuse, reported_errors
from uwaug.figures.run_sheet import SHOWN, draw_sheet
from uwaug.io.write import FORMATS
from uwaug.jobs.cluster import connected, run_on_ray
from uwaug.jobs.one import Outcome, degrade_file, named, reason_of, repeated
from uwaug.jobs.recipe import Recipe
from uwaug.jobs.record import Record, Source, read_record, record_of
from uwaug.jobs.report import index_of, written_outputs
from uwaug.jobs.rows import Rows
from uwaug.jobs.run import run
from uwaug.jobs.shards import Shards

_LISTED = 20
"""Reasons, or pictures of a rehearsal, at most."""

_INTERRUPTED = 130
"""Exit code of what Ctrl-C has ended."""


@dataclass(frozen=True)
class Run:
    """Pictures, what is done to them, and how.

    Attributes:
        rows: which pictures.
        recipe: what is done to each.
        count: of the pictures.
        workers: processes.
        resume, force: go on with, or write over, what is there.
        sheet: whether some of the results are drawn on one.
        ray: address of Ray, in place of processes of this machine.
    """

    rows: Rows
    recipe: Recipe
    count: int
    workers: int
    resume: bool = False
    force: bool = False
    sheet: bool = False
    ray: str | None = None

    @property
    def _sheet(self) -> Path:
        return self.rows.out / "sheet.jpg"

    def require_free(self) -> None:
        """Refuse a run that would write over files, or go on with what was made otherwise, before
        it begins; or its sheet over a picture.
        """
        if not self.force:
            self._require_none_there()
        if not self.sheet:
            return
        if not self.resume:
            self._require_none(self._sheet)
        for row in self.rows:
            if row.output == self._sheet:
                refuse(f"{row.input} would be written to {row.output}, as the sheet: leave it out")

    def _require_none(self, path: Path) -> None:
        if path.exists() and not self.force:
            refuse(f"{path} exists: --force to write over it, or another folder")

    def _require_none_there(self) -> None:
        labels, out = self.recipe.labels, self.rows.out
        if labels is not None and Path(labels).is_file() and not (out / "index.csv").exists():
            self._require_none(out / Path(labels).name)
        for row in self.rows:
            if not row.output.exists():
                continue
            if not self.resume:
                cure = "--resume to go on, --force to write over it, or another folder"
                refuse(f"{row.output} exists: {cure}")
            record, mine = record_of(row.output), self.recipe.to_json()
            if record is None:
                return
            others = [n for n in mine if mine[n] != record.recipe.get(n) and n != "content"]
            if others:
                cure = "give the same ones, --force, or another folder"
                refuse(f"{row.output} was made with other options ({', '.join(others)}): {cure}")
            return

    def rehearse(self) -> None:
        """Say what would be read and written, and how long it would take by the first picture."""
        for row in islice(self.rows, _LISTED):
            print(f"{row.input} + {row.problem or row.distance} → {row.output}")
        if self.count > _LISTED:
            print(f"… and {self.count - _LISTED} more")
        with tempfile.TemporaryDirectory() as folder:
            first = next(iter(self.rows)).moved(Path(folder))
            # the second time nothing is loaded any more
            _, outcome = (degrade_file(first, self.recipe, force=True) for _ in range(2))
        if outcome.status == "failed":
            fail(outcome.named_reason)
        seconds = outcome.seconds * self.count / self.workers
        workers = f"{self.workers} worker{'s' if self.workers > 1 else ''}"
        print(f"{self.count} pictures, about {seconds:.3g} s with {workers}. Nothing was written.")

    def carry_out(self) -> None:
        """Degrade all pictures; write an index if they go to a folder; end with 1 if any failed."""
        start, out = time.perf_counter(), self.rows.out
        summary = _Summary(self.count)
        problems = []
        try:
            out.mkdir(parents=True, exist_ok=True)
            if self.resume:
                # what a killed run was writing
                for folder, _, _ in os.walk(out):
                    remove_left(Path(folder))
            if self.rows.name is not None:
                self._go(summary.add)
            else:
                with index_of(out) as index:
                    self._go(summary.add, index.add)
            self._write_labels()
            if self.sheet and summary.shown:
                draw_sheet(summary.shown, self._sheet)
        except (KeyboardInterrupt, SystemExit) as stop:
            print(f"Stopped: {summary.counts()}; --resume goes on.", file=sys.stderr)
            code = stop.code if isinstance(stop, SystemExit) else _INTERRUPTED
            raise typer.Exit(int(code or 0)) from None
        except (OSError, ValueError) as error:
            problems.append(reason_of(error))
        for note in summary.notes:
            print(f"Note: {note}")
        print(f"{summary.counts()} in {out}, {time.perf_counter() - start:.1f} s")
        if summary.failed:
            problems.append(
                _failures(summary.failed, self.count, summary.reasons, ", see index.csv")
            )
        labels = self.recipe.labels
        if labels is not None and summary.seen > summary.failed and not summary.labelled:
            problems.append(f"none of the pictures has labels in {labels}: the right folder?")
        if problems:
            fail("\n".join(problems))

    def _go(self, *takers: Callable[[Outcome], None]) -> None:
        with self._engine() as degraded, counted(self.count) as counter:
            for outcome in degraded(self.rows, self.recipe, resume=self.resume, force=self.force):
                for take in takers:
                    take(outcome)
                counter.advance()

    @contextmanager
    def _engine(self) -> Iterator[Any]:
        """What carries the run out: processes of this machine, or Ray."""
        if self.ray is None:
            yield partial(run, workers=self.workers)
            return
        with connected(self.ray, self.workers):
            yield run_on_ray

    def _write_labels(self) -> None:
        """Write what labels have one file of for all pictures in the folder: this run's, and those
        of earlier ones with the same labels.
        """
        source, out = self.recipe.label_source(), self.rows.out
        if source is None:
            return
        name = self.rows.name
        outputs = written_outputs(out) if name is None else [out / name]
        records: list[Record] = [record for path in outputs if (record := record_of(path))]
        labels = [
            record.labels
            for record in records
            if record.labels is not None and record.recipe["labels"] == self.recipe.labels
        ]
        if labels:
            source.write_run(labels, out)

    def carry_out_in_shards(self, place: str) -> None:
        """Degrade all pictures into shards; end with 1 if any failed."""
        start = time.perf_counter()
        assert self.ray is not None
        with reported_errors():
            shards = Shards(place)
            shards.prepare(self.recipe, resume=self.resume, force=self.force)
        try:
            with reported_errors(), connected(self.ray, self.workers):
                is_terminal = Console(stderr=True).is_terminal
                shards.write(self.rows, self.recipe, self.count, progress=is_terminal)
            tally = shards.tally(_LISTED)
        except KeyboardInterrupt:
            print("Stopped; --resume goes on.", file=sys.stderr)
            raise typer.Exit(_INTERRUPTED) from None
        seconds = time.perf_counter() - start
        print(f"{tally.rows - tally.failed} of {self.count} pictures in {place}, {seconds:.1f} s")
        if tally.failed:
            rest = ": rows whose status is failed"
            fail(_failures(tally.failed, tally.rows, tally.reasons, rest))


class _Summary:
    """What is said of a run when it ends; it does not grow with the number of pictures."""

    def __init__(self, count: int) -> None:
        self._count = count
        self.seen = self.failed = self.kept = self.labelled = 0
        self.reasons: list[str] = []
        self.notes: list[str] = []
        self.shown: list[Outcome] = []

    def add(self, outcome: Outcome) -> None:
        """Take one more picture into account."""
        if outcome.status == "failed":
            self.failed += 1
            if len(self.reasons) < _LISTED:
                self.reasons.append(outcome.named_reason)
        elif self.seen % max(1, self._count // SHOWN) == 0:
            self.shown.append(outcome)
        self.kept += outcome.status == "kept"
        self.seen += 1
        self.labelled += outcome.record is not None and outcome.record.label_file is not None
        for note in outcome.record.notes if outcome.record else ():
            if len(self.notes) < _LISTED:
                self.notes.append(named(str(outcome.row.input), note))

    def counts(self) -> str:
        """How many pictures were done, and how many were there."""
        kept = f", {self.kept} were there" if self.kept else ""
        return f"{self.seen - self.failed - self.kept} of {self._count} pictures{kept}"


def _failures(failed: int, count: int, reasons: list[str], rest: str) -> str:
    """How many pictures failed, and why; `rest`: where the reasons stand that are not listed."""
    lines = [f"{failed} of {count} pictures failed:", *reasons]
    if failed > len(reasons):
        lines.append(f"and {failed - len(reasons)} more{rest}")
    return "\n  ".join(lines)


def repeat(path: Path, out: Path, force: bool, moved: list[Path], distance: str | None) -> None:
    """Make the picture of a record again.

    Args:
        path: of the record.
        out: folder, or file.
        force: write over what is there.
        moved: the picture that it was made of, if it has another place now; or nothing.
        distance: the map that it was made with, if it has another place now.
    """
    try:
        record = read_record(path)
        if moved:
            record = replace(record, input=replace(record.input, path=str(moved[0].absolute())))
        if distance is not None and isinstance(record.distance, Source):
            source = replace(record.distance, path=str(Path(distance).absolute()))
            record = replace(record, distance=source)
        alone = out.suffix.lower() in FORMATS and not out.is_dir()
        output = out if alone else out / record.output
        if output.resolve() == (path.parent / record.output).resolve():
            refuse(f"--out: {output} is the first one: choose another folder")
        again = repeated(record, output, force=force)
    except FileNotFoundError as error:
        cure = "if it was moved, name it: uwaug degrade PICTURE --distance MAP --replay RECORD"
        fail(f"{reason_of(error)}: {cure}")
    except typer.Exit:
        raise
    except Exception as error:
        fail(reason_of(error))
    same = "the same bytes" if again.sha256 == record.sha256 else "in another format"
    print(f"{output}: {same}")
