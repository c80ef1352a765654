"""Runs over folders, whatever is made of each picture: by processes or Ray, resumed after a stop,
with a record beside each result and an index of all.
"""

import os
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwaug import __version__
from uwaug._support.atomic import remove_left
from uwaug.files.films import Frame
from uwaug.files.items import Item
from uwaug.files.labels import Judged, Labels
from uwaug.files.pictures import read_picture
from uwaug.files.pool import on_processes
from uwaug.files.record import (
    digest,
    is_written,
    places_of,
    read_record,
    reason_of,
    record_path,
    write_record,
)
from uwaug.files.sheet import write_sheet
from uwaug.files.summary import Result, Summary
from uwaug.transforms.random_water import Reached

Progress = Callable[[int, int], None]
"""Is told at the beginning, and after each picture, how many are done, and of how many."""

_FORCE = "force=True (--force) writes over it"


class Job(NamedTuple):
    """A picture of a run; the place of what is made of it is from the folder of the run."""

    item: Item
    place: str
    variant: int = 0
    labels: Labels | None = None
    frame: Frame | None = None


class Work:
    """What a run makes of a picture, in any process; over a file it raises nothing. A subclass says
    what a result follows from, makes it, and writes it.

    Args:
        out: the folder of the run.
        resume: leave what was made of the same as it is, and refuse to write over anything else.
        force: write over it.
    """

    def __init__(self, out: Path, *, resume: bool, force: bool) -> None:
        self.out, self.resume, self.force = out, resume, force

    def made_of(self, job: Job) -> dict[str, Any]:
        """All that a result follows from, as its record has it."""
        return {
            **versions(),
            "name": job.item.name,
            "variant": job.variant,
            "picture": _source(job.item.picture),
            "distance": job.item.distance and _source(job.item.distance),
        }

    def make(self, job: Job) -> tuple[Any, dict[str, Any]]:
        """A result, and what its record holds besides."""
        raise NotImplementedError

    def write(self, path: Path, result: Any, item: Item) -> None:
        """Write the result of an item, whole or not at all."""
        raise NotImplementedError

    def read(self, path: Path) -> Tensor:
        """A result as a picture (3xHxW), for the sheet."""
        return read_picture(path)

    def caption(self, path: Path) -> str:
        """What the sheet says of a result, in two lines at most."""
        return ""

    def __call__(self, job: Job) -> Result:
        """What becomes of a job."""
        try:
            with warnings.catch_warnings():
                # each process would warn once of what the summary tells of all
                warnings.simplefilter("ignore")
                return self._done(job)
        except Exception as error:  # decoders raise whatever they like over a damaged file
            return self._failed(job, reason_of(error))

    def died(self, job: Job) -> Result:
        """What becomes of a job that a process has died over."""
        return self._failed(job, "the process died over it: out of memory, or a damaged file")

    def _failed(self, job: Job, reason: str) -> Result:
        path = self.out / job.place
        if self.force:  # what was there would pass for the result
            with suppress(OSError):
                path.unlink(missing_ok=True)
                record_path(path).unlink(missing_ok=True)
        return Result(job.item, job.variant, job.place, "failed", reason=reason)

    def _done(self, job: Job) -> Result:
        path, made_of = self.out / job.place, self.made_of(job)
        if self.resume and path.exists() and (not self.force or is_written(path)):
            record = read_record(record_path(path))
            changed = [name for name, value in made_of.items() if record.get(name) != value]
            if not changed:
                return _of_record(job, "skipped", record)
            if not self.force:
                got = f"{path} was made with another {' and '.join(changed)}"
                raise FileExistsError(f"{got}: choose another folder, or {_FORCE}")
        result, about = self.make(job)
        record = {**made_of, **about}
        # the result goes first and comes last: where it is, all that belongs to it is
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        write_record(record_path(path), record)
        self.write(path, result, job.item)
        return _of_record(job, "written", record)


def versions() -> dict[str, str]:
    """Those that a result follows from."""
    return {"uwaug": __version__, "torch": str(torch.__version__)}


def _source(path: Path) -> dict[str, Any]:
    return {"path": os.path.abspath(path), "sha256": digest(path)}


def _of_record(job: Job, status: Any, record: dict[str, Any]) -> Result:
    objects = [Judged(**entry) for entry in record.get("objects", [])]
    reached = Reached(**record["reached"]) if record.get("reached") else None
    contrast, asked = record.get("contrast"), record.get("asked", ())
    return Result(job.item, job.variant, job.place, status, contrast, objects, reached, asked)


def run(
    work: Work,
    jobs: Sequence[Job],
    *,
    workers: int = 1,
    ray: str | None = None,
    index: bool = True,
    sheet: bool = False,
    progress: Progress | None = None,
) -> Summary:
    """Do some work on each of many pictures.

    Args:
        work, jobs: what to do, and on which pictures.
        workers: processes; 1: this one, 0: one for each core.
        ray: address of a Ray cluster, see `on_ray`.
        index: write index.csv.
        sheet: draw some of the results on sheet.jpg.
        progress: see `Progress`.

    Raises:
        ValueError, OSError: as `require_apart`; if the folder holds what another run has written,
            or cannot be written.
    """
    require_apart(jobs, work.out)
    if index:
        _require_own(jobs, work.out)
        for folder in {(work.out / job.place).parent for job in jobs}:
            remove_left(folder)  # what a killed run was writing
    work.out.mkdir(parents=True, exist_ok=True)
    workers = max(1, min(workers or os.cpu_count() or 1, len(jobs)))
    if ray is None:
        under_way = on_processes(work, jobs, workers)
    else:
        from uwaug.files.ray import on_ray

        under_way = on_ray(work, jobs, ray, workers)
    results: list[Result] = []
    say = progress or (lambda done, of: None)
    say(0, len(jobs))
    for result in under_way:
        results.append(result)
        say(len(results), len(jobs))
    summary = Summary(results)
    if index:
        summary.write_index(work.out / "index.csv")
    made: dict[Path, list[Path]] = {}
    for result in results:
        if result.status != "failed":
            made.setdefault(result.item.picture, []).append(work.out / result.place)
    if sheet and made:
        write_sheet(work.out / "sheet.jpg", list(made.items()), work.read, work.caption)
    return summary


def require_free(out: Path, *, resume: bool, force: bool) -> None:
    """Refuse a file that is there, or a folder that holds something, without `resume` or `force`.

    Raises:
        FileExistsError: says what to do.
    """
    if resume or force:
        return
    cure = f"resume=True (--resume) goes on, or {_FORCE}"
    if out.is_file():
        raise FileExistsError(f"{out} exists: {cure}")
    if out.is_dir() and set(os.listdir(out)) - {"index.csv"}:
        raise FileExistsError(f"{out} is not empty: choose another folder; {cure}")


def _require_own(jobs: Sequence[Job], out: Path) -> None:
    """Refuse, with labels, the folder of a run of other pictures: its labels would be lost.

    Raises:
        FileExistsError: says what to do.
    """
    if all(job.labels is None for job in jobs):
        return
    others = {*(places_of(out) or ())} - {job.place for job in jobs}
    if stale := sorted(place for place in others if (out / place).exists()):
        got = f"{out} holds {len(stale)} pictures that this run does not make, such as {stale[0]}"
        raise FileExistsError(f"{got}: remove them and index.csv, or choose another folder")


def require_apart(jobs: Sequence[Job], out: Path) -> None:
    """Refuse two results in one file, and to write over what is read.

    Raises:
        ValueError: names the files.
    """
    read = {os.path.realpath(job.item.picture) for job in jobs}
    read |= {os.path.realpath(job.item.distance) for job in jobs if job.item.distance is not None}
    written: dict[str, Path] = {}
    for job in jobs:
        output = os.path.realpath(out / job.place)
        if output in read:
            raise ValueError(f"{output} is read, and would be written over: another folder?")
        # files of labels are found by a picture's name without its end
        key = output if job.labels is None else os.path.splitext(output)[0]
        if key in written:
            both = f"{written[key]} and {job.item.picture}"
            raise ValueError(f"{both} would both be written to {key}: rename one")
        written[key] = job.item.picture
