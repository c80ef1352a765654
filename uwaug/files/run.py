"""Runs over folders, by processes or Ray, with a record beside each result and an index of all."""

import os
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwaug import __version__
from uwaug._support.atomic import remove_left
from uwaug._support.compiled import wanted
from uwaug.fast import load
from uwaug.files.films import Frame
from uwaug.files.items import Item
from uwaug.files.labels import Judged, Labels
from uwaug.files.pictures import read_picture
from uwaug.files.pool import on_processes
from uwaug.files.record import (
    digest,
    is_written,
    places_of,
    reason_of,
    record_of,
    record_path,
    write_record,
)
from uwaug.files.sheet import write_sheet
from uwaug.files.summary import Result, Summary
from uwaug.transforms.random_water import Reached

Progress = Callable[[int, int], None]
"""Function of the numbers of finished and of all pictures, called first and after each picture."""

_FORCE = "force=True (--force) writes over it"
_OWN = "was not written by a run: move it, or choose another folder"


class Job(NamedTuple):
    """A picture of a run; `place` is the path of its result below the folder of the run."""

    item: Item
    place: str
    variant: int = 0
    labels: Labels | None = None
    frame: Frame | None = None


class Work:
    """The work of a run on a picture, in any process. A failure is a result, too: nothing raises. A
    subclass says what a result follows from, makes it, and writes it.

    Args:
        out: folder of the run.
        resume: keep results of the same sources, and refuse to write over others.
        force: write over them. Files that no run has written stay in any case.
    """

    def __init__(self, out: Path, *, resume: bool, force: bool) -> None:
        self.out, self.resume, self.force = out, resume, force

    def made_of(self, job: Job) -> dict[str, Any]:
        """Sources of a result, as its record has them."""
        return {
            **versions(),
            "name": job.item.name,
            "variant": job.variant,
            "picture": _source(job.item.picture),
            "distance": job.item.distance and _source(job.item.distance),
        }

    def make(self, job: Job) -> tuple[Any, dict[str, Any]]:
        """Make a result, and the other entries of its record."""
        raise NotImplementedError

    def write(self, path: Path, result: Any, item: Item) -> None:
        """Write the result of an item, whole or not at all."""
        raise NotImplementedError

    def files(self, job: Job) -> list[Path]:
        """Files that are written beside a result and its record."""
        if job.labels is None or job.item.name not in job.labels.of:
            return []
        return job.labels.files(job.place, self.out)

    def vouched(self, job: Job, record: dict[str, Any]) -> list[Path]:
        """Files beside a result of which its record says that a run has written them."""
        if job.labels is None or record.get("labels") is None:
            return []
        return job.labels.files(job.place, self.out)

    def read(self, path: Path) -> Tensor:
        """Read a result as a picture (3xHxW), for the sheet."""
        return read_picture(path)

    def caption(self, path: Path) -> str:
        """Caption of a result on the sheet, two lines at most."""
        return ""

    def __call__(self, job: Job) -> Result:
        """The result of a job."""
        try:
            with warnings.catch_warnings():
                # the summary tells it of all; each process would warn once
                warnings.simplefilter("ignore")
                return self._done(job)
        except Exception as error:  # decoders raise whatever they like over a damaged file
            return self._failed(job, reason_of(error))

    def died(self, job: Job) -> Result:
        """The result of a job that a process has died over."""
        return self._failed(job, "the process died over it: out of memory, or a damaged file")

    def _failed(self, job: Job, reason: str) -> Result:
        path = self.out / job.place
        if self.force and (record := record_of(path)):  # old files would pass for the result
            for file in (*self.vouched(job, record), path, record_path(path)):
                with suppress(OSError):
                    file.unlink(missing_ok=True)
        return Result(job.item, job.variant, job.place, "failed", reason=reason)

    def _done(self, job: Job) -> Result:
        path, sources = self.out / job.place, self.made_of(job)
        before = self._before(job)
        if self.resume and before and path.exists():
            changes = [name for name, value in sources.items() if before.get(name) != value]
            if not changes and all(map(Path.exists, self.vouched(job, before))):
                return _of_record(job, "skipped", before)
            if changes and not self.force:
                got = f"{path} was made with another {' and '.join(changes)}"
                raise FileExistsError(f"{got}: choose another folder, or {_FORCE}")
        result, entries = self.make(job)
        record = {**sources, **entries}
        # the result goes first and comes last: its labels are there wherever it is, and its record
        # says of both that they are a run's
        path.parent.mkdir(parents=True, exist_ok=True)
        for file in (path, *self.vouched(job, before)):
            file.unlink(missing_ok=True)
        write_record(record_path(path), record)
        if job.labels is not None:
            dropped = {entry["key"] for entry in record["objects"] if not entry["kept"]}
            job.labels.write(job.item.name, job.place, dropped, self.out)
        self.write(path, result, job.item)
        return _of_record(job, "written", record)

    def _before(self, job: Job) -> dict[str, Any]:
        """Record of the result that a run has written before, empty without one. Refuses files that
        no run has written.
        """
        path = self.out / job.place
        record = record_of(path) or {}
        files = [] if record else [path, record_path(path)]
        vouched = self.vouched(job, record)
        files += [file for file in self.files(job) if file not in vouched]
        for file in filter(os.path.lexists, files):
            raise FileExistsError(f"{file} {_OWN}")
        return record


def versions() -> dict[str, str]:
    """Versions that a result follows from; numba's is "none" where PyTorch forms pictures alone."""
    numba = version("numba") if wanted() and load() else "none"
    return {"uwaug": __version__, "torch": str(torch.__version__), "numba": numba}


def _source(path: Path) -> dict[str, Any]:
    absolute = os.path.abspath(path)
    absolute.encode()  # refuses names that records cannot hold
    return {"path": absolute, "sha256": digest(path)}


def _of_record(job: Job, status: Any, record: dict[str, Any]) -> Result:
    objects = [Judged(**entry) for entry in record.get("objects", [])]
    reached = Reached(**record["reached"]) if record.get("reached") else None
    contrast, questions = record.get("contrast"), record.get("asked", ())
    return Result(job.item, job.variant, job.place, status, contrast, objects, reached, questions)


def run(
    work: Work,
    jobs: Sequence[Job],
    *,
    workers: int = 1,
    ray: str | None = None,
    index: bool = True,
    sheet: bool = False,
    beside: Sequence[Path] = (),
    progress: Progress | None = None,
) -> Summary:
    """Do the work on each job.

    Args:
        work, jobs: the work, and the pictures.
        workers, ray, sheet, beside, progress: as for `degrade`.
        index: write index.csv.
    """
    require_apart(work, jobs, sheet=sheet)
    notes = []
    if index:
        if stale := _require_folder_of_run(jobs, work.out, sheet=sheet):
            got = f"{len(stale)} pictures of an earlier run, such as {stale[0]}, stay in {work.out}"
            notes.append(f"{got}, and are not in its index.csv any more")
        for folder in {(work.out / job.place).parent for job in jobs}:
            remove_left(folder)  # parts of files of a killed run
    work.out.mkdir(parents=True, exist_ok=True)
    workers = max(1, min(workers or os.cpu_count() or 1, len(jobs)))
    if ray is None:
        stream = on_processes(work, jobs, workers)
    else:
        from uwaug.files.ray import on_ray

        stream = on_ray(work, jobs, ray, workers)
    results: list[Result] = []
    say = progress or (lambda count, total: None)
    say(0, len(jobs))
    for result in stream:
        results.append(result)
        say(len(results), len(jobs))
    summary = Summary(results, notes)
    if index:
        summary.write_index(work.out / "index.csv")
    variants: dict[Path, list[Path]] = {}
    for result in results:
        if result.status != "failed":
            variants.setdefault(result.item.picture, []).append(work.out / result.place)
    if sheet and variants:
        groups = list(variants.items())
        write_sheet(work.out / "sheet.jpg", groups, work.read, work.caption, beside)
    return summary


def require_free(out: Path, *, resume: bool, force: bool) -> None:
    """Refuse an existing file, or a folder that is not empty, without `resume` or `force`."""
    if resume or force:
        return
    cure = f"resume=True (--resume) goes on, or {_FORCE}"
    if out.is_file():
        raise FileExistsError(f"{out} exists: {cure}")
    of_run = set() if places_of(out) is None else {"index.csv"}
    if out.is_dir() and set(os.listdir(out)) - of_run:
        raise FileExistsError(f"{out} is not empty: choose another folder; {cure}")


def _require_folder_of_run(jobs: Sequence[Job], out: Path, *, sheet: bool) -> list[str]:
    """Refuse files that no run has written where those of all pictures go, the folder of a run of
    other pictures, whose labels would be lost, and one with labels where there shall be none.
    Returns the pictures of an earlier run that this one does not make.
    """
    labels = next((job.labels for job in jobs if job.labels is not None), None)
    places = places_of(out)
    records = (record_of(out / place) or {} for place in places or ())
    names = ["index.csv"] if places is None else []
    names += ["sheet.jpg"] if sheet and not is_written(out / "sheet.jpg") else []
    others = {*(places or ())} - {job.place for job in jobs}
    stale = sorted(place for place in others if (out / place).exists())
    if labels is not None:
        if stale:
            got = f"{out} holds {len(stale)} pictures that this run does not make"
            cure = "remove them, or choose another folder"
            raise FileExistsError(f"{got}, such as {stale[0]}: {cure}")
        if not any("labels" in record for record in records):
            names += labels.shared
    elif any(record.get("labels") for record in records):
        cure = "give --labels, or choose another folder"
        raise FileExistsError(f"{out} holds labels of an earlier run, which would stay: {cure}")
    for file in (file for name in names for file in out.glob(name)):
        raise FileExistsError(f"{file} {_OWN}")
    return stale


def require_apart(work: Work, jobs: Sequence[Job], *, sheet: bool = False) -> None:
    """Refuse two results in one file, and to write over a file that is read."""
    read = [file for job in jobs for file in (job.item.picture, job.item.distance)]
    inputs = {os.path.realpath(file) for file in read if file is not None}
    outputs = {os.path.realpath(work.out / "sheet.jpg"): Path("--sheet")} if sheet else {}
    for job in jobs:
        for file in (work.out / job.place, *work.files(job)):
            output = os.path.realpath(file)
            if output in inputs:
                raise ValueError(f"{output} is read, and would be written over: another folder?")
            if output in outputs:
                pair = f"{outputs[output]} and {job.item.picture}"
                raise ValueError(f"{pair} would both be written to {output}: rename one")
            outputs[output] = job.item.picture
