"""Runs over folders, by processes, with a record beside each result and an index of all."""

import json
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import torch

from uwaug import __version__
from uwaug._support.atomic import remove_left
from uwaug._support.compiled import wanted
from uwaug.fast import load
from uwaug.files.films import Frame
from uwaug.files.folder import NOT_OURS, RunFolder, held
from uwaug.files.labels import Judged, Labels
from uwaug.files.pool import on_processes
from uwaug.files.record import digest, reason_of, record_of, record_path, write_record
from uwaug.files.sheet import drawn_sheet
from uwaug.files.summary import Result, Summary
from uwaug.files.table import Row, absolute

_DIED = "the process died over it: out of memory, or a damaged file"
Progress = Callable[[int, int], None]  # of the numbers of finished and of all pictures


class Job(NamedTuple):
    """A picture of a run."""

    row: Row
    place: str  # path of its result below the folder of the run
    variant: int = 0
    labels: Labels | None = None
    frame: Frame | None = None


class Work:
    """The work of a run on a picture, in any process. A failure is a result, too: nothing raises.
    `made_with` is what all results follow from, as records and the manifest have it.
    """

    def __init__(self, out: Path, made_with: Mapping[str, Any]) -> None:
        self.out, self.made_with = out, made_with

    def made_of(self, job: Job) -> dict[str, Any]:
        """What a result follows from, but for the content of its files, as its record has it."""
        cells = job.row._asdict()
        files = {
            name: str(absolute(cell)) for name, cell in cells.items() if isinstance(cell, Path)
        }
        json.dumps(files, ensure_ascii=False).encode()  # refuses names that records cannot hold
        return {**versions(), **self.made_with, "row": {**cells, **files}, "variant": job.variant}

    def make(self, job: Job) -> tuple[Any, dict[str, Any]]:
        """Make a result, and the other entries of its record."""
        raise NotImplementedError

    def write(self, path: Path, result: Any, row: Row) -> None:
        """Write the result of a row, whole or not at all."""
        raise NotImplementedError

    def files(self, job: Job) -> list[Path]:
        """Files that are written beside a result and its record."""
        if job.labels is None or job.row.name not in job.labels.of:
            return []
        return job.labels.files(job.place, self.out)

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
            return self.died(job, reason_of(error))

    def died(self, job: Job, reason: str = _DIED) -> Result:
        """The result of a job that has failed for a reason, or that a process has died over."""
        return Result(job.row, job.variant, job.place, "failed", reason=reason)

    def _done(self, job: Job) -> Result:
        path, sources = self.out / job.place, self.made_of(job)
        files = [path, *self.files(job)]
        before = record_of(path) or {}
        is_same = all(before.get(name) == value for name, value in sources.items())
        if is_same and all(map(Path.exists, files)):
            return _of_record(job, "skipped", before)
        if not record_path(path).exists():  # which goes first
            for file in filter(os.path.lexists, files):
                raise FileExistsError(f"{file} {NOT_OURS}")
        result, entries = self.make(job)
        files_read = {"picture": job.row.picture, "distance": job.row.distance}
        digests = {name: file and digest(file) for name, file in files_read.items()}
        record = {**sources, "sha256": digests, **entries}
        # the result comes last: its labels are there wherever it is, and its record says of both
        # that they are a run's
        for file in files:
            file.unlink(missing_ok=True)
        write_record(record_path(path), record)
        if job.labels is not None:
            dropped = {entry["key"] for entry in record["objects"] if not entry["kept"]}
            job.labels.write(job.row.name, job.place, dropped, self.out)
        self.write(path, result, job.row)
        return _of_record(job, "written", record)


def versions() -> dict[str, str]:
    """Versions that a result follows from; numba's is "none" where PyTorch forms pictures alone."""
    numba = version("numba") if wanted() and load() else "none"
    return {"uwaug": __version__, "torch": str(torch.__version__), "numba": numba}


def _of_record(job: Job, status: Any, record: dict[str, Any]) -> Result:
    objects = [Judged(**entry) for entry in record.get("objects", [])]
    entries = record.get("contrast"), objects, record.get("odd", ""), record.get("asked", ())
    return Result(job.row, job.variant, job.place, status, *entries)


def run(
    work: Work,
    jobs: Sequence[Job],
    *,
    labels: Labels | None = None,
    workers: int = 1,
    resume: bool = False,
    force: bool = False,
    sheet: bool = False,
    beside: Sequence[Path] = (),
    lists: Mapping[str, bytes] | None = None,
    progress: Progress | None = None,
) -> Summary:
    """Do the work on each job, in a folder that is the run's own, with the options of `degrade`,
    and with lists of all that are written at once.
    """
    out, inputs = work.out, require_apart(work, jobs, sheet=sheet)
    workers = max(1, min(workers or os.cpu_count() or 1, len(jobs)))
    files: list[str] = []
    for job in jobs:
        own = (out / job.place, record_path(out / job.place), *work.files(job))
        files += [file.relative_to(out).as_posix() for file in own]
    with held(out):
        folder = RunFolder(out, work.made_with, files, inputs, resume=resume, force=force)
        for parent in {out, *((out / file).parent for file in files)}:
            remove_left(parent)  # parts of files of a killed run
        notes = folder.write_lists(lists or {})
        results: list[Result] = []
        say = progress or (lambda count, total: None)
        say(0, len(jobs))
        for result in on_processes(work, jobs, workers):
            results.append(result)
            say(len(results), len(jobs))
        made = [result for result in results if result.status != "failed"]
        lists = {"index.csv": Summary(results).index()}
        if labels is not None and made:  # else those of before stay
            lists_of_labels, more = labels.lists(made)
            lists |= lists_of_labels
            notes += more
        if sheet and made:
            lists["sheet.jpg"] = drawn_sheet(made, work, labels, beside)
        return Summary(results, [*notes, *folder.write_lists(lists)])


def require_apart(work: Work, jobs: Sequence[Job], *, sheet: bool = False) -> set[str]:
    """Refuse two results in one file, and to write over files that are read: their real paths."""
    read = [file for job in jobs for file in (job.row.picture, job.row.distance, job.row.labels)]
    inputs = {os.path.realpath(file) for file in read if file is not None}
    outputs = {os.path.realpath(work.out / "sheet.jpg"): Path("--sheet")} if sheet else {}
    for job in jobs:
        for file in (work.out / job.place, *work.files(job)):
            output = os.path.realpath(file)
            if output in inputs:
                raise ValueError(f"{output} is read, and would be written over: another folder?")
            if output in outputs:
                pair = f"{outputs[output]} and {job.row.picture}"
                raise ValueError(f"{pair} would both be written to {output}: rename one")
            outputs[output] = job.row.picture
    return inputs
