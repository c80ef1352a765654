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
from uwaug.io.read import name_of
from uwaug.io.write import FORMATS
from uwaug.jobs.index import index_of, write_labels
from uwaug.jobs.items import Items, labelled, preflight
from uwaug.jobs.picture import Degrader, Result, named, reason_of, replay
from uwaug.jobs.pool import run
from uwaug.jobs.ray import connected, run_on_ray
from uwaug.jobs.recipe import Recipe
from uwaug.jobs.sidecar import Sidecar
from uwaug.labels import LabelSource

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


Taker = Callable[[Result], None]


class Manner(NamedTuple):
    """How a run is done, see `uwaug.jobs.pool`; `ray`: by Ray at this address, if not None."""

    workers: int
    resume: bool
    force: bool
    sheet: bool = False
    ray: str | None = None


def require_free(items: Items, recipe: Recipe, manner: Manner, *, in_files: bool = True) -> None:
    """Refuse a run that would write over files, or go on with what was made otherwise, before it
    begins; or its sheet over a picture.
    """
    cure = "--force to write over it, or another folder"
    try:
        preflight(items, recipe, resume=manner.resume, force=manner.force or not in_files)
    except FileExistsError as error:
        refuse(f"{error}: --resume to go on, {cure}")
    except (ValueError, OSError) as error:
        refuse(error)
    if not manner.sheet:
        return
    sheet = _sheet(items.out)
    if sheet.exists() and not (manner.resume or manner.force):
        refuse(f"{sheet} exists: {cure}")
    for item in items:
        if item.output == sheet:
            refuse(f"{item.input} would be written to {sheet}, as the sheet: leave out --sheet")


def carry_out(items: Items, recipe: Recipe, manner: Manner, source: LabelSource | None) -> None:
    """Degrade all pictures; write an index if they go to a folder; end with 1 if any failed."""
    start, count = time.perf_counter(), len(items)
    summary = _Summary(max(1, count // SHOWN))
    problems = []
    try:
        items.out.mkdir(parents=True, exist_ok=True)
        if manner.resume:
            _clean(items.out)
        if items.name is not None:
            _go(items, recipe, manner, source, [summary.add])
        else:
            with index_of(items.out) as index:
                _go(items, recipe, manner, source, [summary.add, index.add])
        if source is not None:
            write_labels(items, recipe, source)
        if manner.sheet and summary.shown:
            draw_sheet(_pairs(summary.shown), _sheet(items.out))
    except (KeyboardInterrupt, SystemExit) as stop:
        print(f"Stopped: {summary.said(count)}; --resume goes on.", file=sys.stderr)
        code = stop.code if isinstance(stop, SystemExit) else INTERRUPTED
        raise typer.Exit(int(code or 0)) from None
    except (OSError, ValueError) as error:
        problems.append(reason_of(error))
    for line in summary.notes:
        print(f"Note: {line}")
    print(f"{summary.said(count)} in {items.out}, {time.perf_counter() - start:.1f} s")
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


def _pairs(results: list[Result]) -> list[tuple[str, Path]]:
    """Titles and pictures of a sheet, before and after."""
    pairs = []
    for result in results[:SHOWN]:
        sidecar = result.sidecar
        if sidecar is not None:
            visibility = sidecar.visibility
            title = "" if visibility is None else f", visibility {visibility:.2g} m"
            pairs.append((result.item.id, Path(name_of(result.item.input))))
            pairs.append((f"{sidecar.water}{title}", result.item.output))
    return pairs


def _go(
    items: Items, recipe: Recipe, manner: Manner, source: LabelSource | None, takers: list[Taker]
) -> None:
    with _engine(manner) as go, counted(len(items)) as counter:
        for result in go(items, recipe, resume=manner.resume, force=manner.force, labels=source):
            for take in takers:
                take(result)
            counter.advance()


@contextmanager
def _engine(manner: Manner) -> Iterator[Callable[..., Iterator[Result]]]:
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
        self.shown: list[Result] = []

    def add(self, result: Result) -> None:
        """One more picture."""
        if result.status == "failed":
            self.failed += 1
            if len(self.reasons) < LISTED:
                self.reasons.append(result.named_reason)
        elif self.seen % self._step == 0:
            self.shown.append(result)
        self.kept += result.status == "kept"
        self.seen += 1
        self.labelled += result.sidecar is not None and result.sidecar.label_file is not None
        for note in result.sidecar.notes if result.sidecar else ():
            if len(self.notes) < LISTED:
                self.notes.append(named(name_of(result.item.input), note))

    def said(self, count: int) -> str:
        """How many."""
        done = self.seen - self.failed - self.kept
        kept = f", {self.kept} were there" if self.kept else ""
        return f"{done} of {count} pictures{kept}"


def failures(failed: int, count: int, reasons: list[str], rest: str) -> str:
    """How many pictures failed, and why; `rest`: where the reasons stand that are not named."""
    more = failed - len(reasons)
    lines = [*reasons, *([f"and {more} more{rest}"] if more else [])]
    return "\n  ".join([f"{failed} of {count} pictures failed:", *lines])


def _clean(out: Path) -> None:
    """Remove what a killed run was writing."""
    for folder, _, _ in os.walk(out):
        remove_left(Path(folder))


def rehearse(items: Items, recipe: Recipe, manner: Manner, source: LabelSource | None) -> None:
    """Say what a run would read and write, and how long it would take by its first picture."""
    count = len(items)
    for item in islice(items, LISTED):
        print(f"{item.input} + {item.problem or item.distance} → {item.output}")
    if count > LISTED:
        print(f"… and {count - LISTED} more")
    with tempfile.TemporaryDirectory() as folder:
        (item,) = labelled((item.moved(Path(folder)) for item in islice(items, 1)), source)
        degrader = Degrader(recipe, force=True)
        first = [degrader(item) for _ in range(2)][1]
    if first.status == "failed":
        fail(first.named_reason)
    seconds = first.seconds * count / manner.workers
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
        sidecar = Sidecar.read(path)
        if moved:
            file = sidecar.input._replace(path=str(moved[0].absolute()))
            sidecar = replace(sidecar, input=file)
        if distance is not None and isinstance(sidecar.distance, tuple):
            file = sidecar.distance._replace(path=str(Path(distance).absolute()))
            sidecar = replace(sidecar, distance=file)
        alone = out.suffix.lower() in FORMATS and not out.is_dir()
        output = out if alone else out / sidecar.output
        if output.resolve() == (path.parent / sidecar.output).resolve():
            refuse(f"--out: {output} is the first one: choose another folder")
        again = replay(sidecar, output, force=force)
    except FileNotFoundError as error:
        cure = "if it was moved, name it: uwaug degrade PICTURE --distance MAP --from RECORD"
        fail(f"{reason_of(error)}: {cure}")
    except Exception as error:
        if isinstance(error, typer.Exit):
            raise
        fail(reason_of(error))
    same = "the same bytes" if again.sha256 == sidecar.sha256 else "in another format"
    print(f"{output}: {same}")
