"""A run of `uwaug degrade`, its rehearsal, and one picture again."""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from uwaug._support.atomic import held, remove_left
from uwaug._support.hashing import FileHash
from uwaug.cli.console import counted, fail, in_flags, refuse, reported_errors
from uwaug.figures.run_sheet import draw_sheet, shown_of
from uwaug.io.read import name_of
from uwaug.io.write import FORMATS
from uwaug.jobs.index import index_of, require_alike, write_labels
from uwaug.jobs.items import Items, is_index, labelled, labels_file, preflight
from uwaug.jobs.maps import require_explained
from uwaug.jobs.picture import Degrader, Result, file_names, reason_of, replay
from uwaug.jobs.pool import run
from uwaug.jobs.ray import Shards, Tally, connected, run_on_ray
from uwaug.jobs.recipe import Recipe
from uwaug.jobs.remarks import Remarks
from uwaug.jobs.sidecar import Sidecar
from uwaug.jobs.waters import LEFT
from uwaug.labels import LabelSource
from uwaug.labels.layout import DESCRIPTION

_LISTED = 20
"""Different reasons, or pictures of a rehearsal, at most."""

_INTERRUPTED = 130
"""Exit code of what Ctrl-C has ended."""


@dataclass(frozen=True)
class Run:
    """Pictures, what is done to them, and how.

    Attributes:
        items: the pictures.
        recipe: what is done to each.
        labels: of the pictures, or None.
        workers: processes.
        resume, force: go on with, or write over, what is there.
        sheet: whether some of the results are drawn on one.
        ray: address of Ray, in place of processes of this machine.
    """

    items: Items
    recipe: Recipe
    labels: LabelSource | None
    workers: int
    resume: bool = False
    force: bool = False
    sheet: bool = False
    ray: str | None = None

    @property
    def _sheet(self) -> Path:
        return self.items.out / "sheet.jpg"

    def require_free(self, *, in_files: bool) -> None:
        """Refuse a run that would write over files, or go on with what was made otherwise, before
        it begins; or its sheet over a picture.
        """
        cure = "--force to write over it, or another folder"
        with reported_errors():
            try:
                force = self.force or not in_files
                preflight(self.items, self.recipe, resume=self.resume, force=force)
                if self.labels is not None and in_files:
                    require_alike(self.items, self.recipe)
            except FileExistsError as error:
                refuse(f"{error}: --resume to go on, {cure}")
        try:
            require_explained(self.items, self.recipe.distance)
        except ValueError as error:
            fail(error)  # as the other commands, where a file is not what was said of it
        if not self.sheet:
            return
        of_a_run = is_index(self.items.out / "index.csv")
        if self._sheet.exists() and not (self.force or (self.resume and of_a_run)):
            refuse(f"{self._sheet} exists: {cure}")
        for item in self.items:
            if item.output == self._sheet:
                written = f"{item.input} would be written to {item.output}"
                refuse(f"{written}, as the sheet: leave out --sheet")

    def rehearse(self) -> None:
        """Say what would be read and written, and how long it would take by the first picture."""
        count = len(self.items)
        for item in islice(self.items, _LISTED):
            print(f"{item.input} + {item.problem or item.distance} → {item.output}")
        if count > _LISTED:
            print(f"… and {count - _LISTED} more")
        with tempfile.TemporaryDirectory() as folder:
            moved = (item.moved(Path(folder)) for item in islice(self.items, 1))
            (item,) = labelled(moved, self.labels)
            degrade = Degrader(self.recipe, force=True)
            # the second time nothing is loaded any more
            _, result = (degrade(item) for _ in range(2))
        if result.status == "failed":
            fail(in_flags(result.named_reason))
        seconds = result.seconds * count / self.workers
        workers = f"{self.workers} worker{'s' if self.workers > 1 else ''}"
        print(f"{count} pictures, about {seconds:.3g} s with {workers}. Nothing was written.")

    def carry_out(self) -> None:
        """Degrade all pictures; write an index if they go to a folder; end with 1 if any failed."""
        with ExitStack() as stack:
            with reported_errors():
                self.items.out.mkdir(parents=True, exist_ok=True)
                # single pictures have no index, and do not get in each other's way
                stack.enter_context(held(self.items.out, shared=self.items.name is not None))
            self._carry_out()

    def _carry_out(self) -> None:
        start, out = time.perf_counter(), self.items.out
        summary = _Summary(len(self.items), self.items.variants)
        problems = []
        try:
            if self.resume and self.items.name is None:
                # what a killed run was writing; beside a single picture others may be at work
                for folder, _, _ in os.walk(out):
                    remove_left(Path(folder))
            if self.items.name is not None:
                self._go(summary.add)
            else:
                with index_of(out, self.items if self.force else None) as index:
                    self._go(summary.add, index.add)
            if self.labels is not None:
                write_labels(self.items, self.recipe, self.labels)
            if self.sheet and summary.shown:
                count = len(self.items) // self.items.variants
                draw_sheet(_before_and_after(summary.shown), self._sheet, count)
        except (KeyboardInterrupt, SystemExit) as stop:
            print(f"Stopped: {summary.counts()}; --resume goes on.", file=sys.stderr)
            code = stop.code if isinstance(stop, SystemExit) else _INTERRUPTED
            raise typer.Exit(int(code or 0)) from None
        except (OSError, ValueError) as error:
            problems.append(reason_of(error))
        for suffix, number in sorted(self.items.passed_over.items()):
            print(f"Note: {number} {suffix} passed over: save them as .png to have them degraded")
        _print_notes(summary.notes)
        if self.recipe.min_contrast is not None:
            left_out = labels_file(self.items, self.recipe) == out / DESCRIPTION
            fate = "left out" if left_out else "marked as ignored"
            least = f"below --min-contrast {self.recipe.min_contrast:g}"
            print(f"{summary.hidden} of {summary.objects} objects {fate}, {least}")
        place = out if self.items.name is None else out / self.items.name
        done = summary.of_one() or f"{summary.counts()} in {place}"
        print(f"{done}, {time.perf_counter() - start:.1f} s")
        if summary.failed:
            problems.append(_failures(len(self.items), summary, ", see index.csv"))
        labels = self.recipe.labels
        if labels is not None and summary.seen > summary.failed and not summary.labelled:
            problems.append(f"none of the pictures has labels in {labels}: the right folder?")
        if problems:
            fail("\n".join(problems))

    def _go(self, *takers: Callable[[Result], None]) -> None:
        how = {"resume": self.resume, "force": self.force, "labels": self.labels}
        with self._engine() as degraded, counted(len(self.items)) as counter:
            for result in degraded(self.items, self.recipe, **how):
                for take in takers:
                    take(result)
                counter.advance()

    @contextmanager
    def _engine(self) -> Iterator[Any]:
        """What carries the run out: processes of this machine, or Ray."""
        if self.ray is None:
            yield partial(run, workers=self.workers)
            return
        with connected(self.ray, self.workers):
            yield run_on_ray

    def carry_out_in_shards(self, place: str) -> None:
        """Degrade all pictures into shards; end with 1 if any failed."""
        with ExitStack() as stack:
            with reported_errors():
                shards = Shards(place)
                stack.enter_context(shards.held())
                try:
                    shards.prepare(self.recipe, resume=self.resume, force=self.force)
                except FileExistsError as error:
                    refuse(f"{error}: --resume to go on, --force to remove them, or another place")
            self._write(shards, place)

    def _write(self, shards: Shards, place: str) -> None:
        start = time.perf_counter()
        assert self.ray is not None
        try:
            with reported_errors(), connected(self.ray, self.workers):
                is_terminal = Console(stderr=True).is_terminal
                shards.write(self.items, self.recipe, labels=self.labels, progress=is_terminal)
                tally = shards.tally(_LISTED, in_flags)
        except KeyboardInterrupt:
            print("Stopped; --resume goes on.", file=sys.stderr)
            raise typer.Exit(_INTERRUPTED) from None
        seconds = time.perf_counter() - start
        _print_notes(tally.notes)
        count = len(self.items)
        print(f"{tally.rows - tally.failed} of {count} pictures in {place}, {seconds:.1f} s")
        problems = []
        if tally.rows < count:
            # such as fsspec+memory://, which each process has of its own
            got = f"{count - tally.rows} of {count} pictures are not there"
            problems.append(f"{place}: {got}: is it the same place on all machines?")
        if tally.failed:
            problems.append(_failures(tally.rows, tally, ": rows whose status is failed"))
        if problems:
            fail("\n".join(problems))


class _Summary:
    """What is said of a run when it ends; it does not grow with the number of pictures."""

    def __init__(self, count: int, variants: int) -> None:
        self._count, self._variants = count, variants
        self._on_sheet = shown_of(count // variants, variants)
        self.seen = self.failed = self.kept = self.labelled = self.objects = self.hidden = 0
        self.reasons, self.notes = (Remarks(_LISTED, in_flags) for _ in range(2))
        self.shown: list[Result] = []

    def add(self, result: Result) -> None:
        """Take one more picture into account."""
        if result.status == "failed":
            self.failed += 1
            self.reasons.add(str(result.reason), file_names(result.item))
        elif self.seen in self._on_sheet or not self.shown:
            self.shown.append(result)
        self.kept += result.status == "kept"
        self.seen += 1
        if result.sidecar is None:
            return
        self.labelled += result.sidecar.label_file is not None
        for entry in result.sidecar.labels["objects"] if result.sidecar.labels else ():
            self.objects += 1
            self.hidden += entry["ignored"]
        names = file_names(result.item)
        if self._variants > 1:
            names.insert(0, result.item.output.name)  # which of them it is
        for note in result.sidecar.notes:
            self.notes.add(note, names)

    def counts(self) -> str:
        """How many pictures were done, and how many were there."""
        kept = f", {self.kept} were there" if self.kept else ""
        return f"{self.seen - self.failed - self.kept} of {self._count} pictures{kept}"

    def of_one(self) -> str | None:
        """What was written of a single picture, and what it looks like; None of several."""
        if self._count != 1 or not self.shown or self.kept:
            return None
        (result,) = self.shown
        assert result.sidecar is not None
        item, sidecar = result.item, result.sidecar
        written = f"wrote {item.output}"
        if self.labelled and sidecar.beside:
            written += f", labels in {item.labels_path.parent}"
        if sidecar.water == LEFT:
            return f"{written}: left as it is"
        look = [sidecar.water]
        if sidecar.visibility is not None:
            look.append(f"visibility {sidecar.visibility:.2g} m")
        if sidecar.contrast is not None:
            look.append(f"fine detail keeps {100 * sidecar.contrast:.2g} % of its contrast")
        return f"{written}: {', '.join(look)}"


def _failures(count: int, run: "_Summary | Tally", rest: str) -> str:
    """How many of `count` pictures failed, and why; `rest`: where to find the other reasons."""
    lines = [f"{run.failed} of {count} pictures failed:", *run.reasons]
    if run.reasons.dropped:
        lines.append(f"and {run.reasons.dropped} more{rest}")
    return "\n  ".join(lines)


def _print_notes(notes: Remarks) -> None:
    for note in notes:
        print(f"Note: {note}")
    if notes.dropped:
        print(f"and {notes.dropped} notes more, see the records")


def _before_and_after(results: list[Result]) -> list[list[tuple[str, Path]]]:
    """Titles and pictures of a sheet: each picture with what was made of it."""
    groups: dict[str, list[tuple[str, Path]]] = {}
    for result in results:
        if (sidecar := result.sidecar) is not None:
            before = name_of(result.item.input)
            sight = sidecar.visibility
            title = sidecar.water if sight is None else f"{sight:.2g} m\n{sidecar.water}"
            group = groups.setdefault(result.item.id, [(result.item.id, Path(before))])
            group.append((title, result.item.output))
    return list(groups.values())


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
        sidecar = Sidecar.read(path)
        if moved:
            file = replace(sidecar.input, path=str(moved[0].absolute()))
            sidecar = replace(sidecar, input=file)
        if distance is not None:
            if not isinstance(sidecar.distance, FileHash):
                refuse("--distance would do nothing: the picture was made with no map in a file")
            file = replace(sidecar.distance, path=str(Path(distance).absolute()))
            sidecar = replace(sidecar, distance=file)
        alone = out.suffix.lower() in FORMATS and not out.is_dir()
        output = out if alone else out / sidecar.output
        if output.resolve() == (path.parent / sidecar.output).resolve():
            refuse(f"--out: {output} is the first one: choose another folder")
        again = replay(sidecar, output, force=force)
    except FileNotFoundError as error:
        cure = "if it was moved, name it: uwaug degrade PICTURE --distance MAP --replay RECORD"
        fail(f"{reason_of(error)}: {cure}")
    except typer.Exit:
        raise
    except Exception as error:
        fail(reason_of(error))
    same = "the same bytes" if again.sha256 == sidecar.sha256 else "in another format"
    print(f"{output}: {same}")
