"""Many pictures on the cores of one machine."""

import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import wait
from multiprocessing.context import BaseContext

import torch
from threadpoolctl import threadpool_limits

from uwaug._support.atomic import remove_left
from uwaug.jobs.one import Outcome, begun_again, degrade_file
from uwaug.jobs.recipe import Recipe
from uwaug.jobs.row import Row

__all__ = ["AHEAD", "alone", "cores", "died", "run", "use_one_thread"]

AHEAD = 4
"""Pictures for each worker that are handed out before the first of them is done."""

Waiting = deque[tuple[Row, "Future[Outcome]"]]


def cores() -> int:
    """How many this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run(
    rows: Iterable[Row],
    recipe: Recipe,
    *,
    workers: int = 1,
    resume: bool = False,
    force: bool = False,
) -> Iterator[Outcome]:
    """Degrade pictures in files, and say in the order of `rows` what became of each.

    A worker that dies, as decoders of damaged files and a full memory can make it, takes no other
    picture with it: those that were under way are done once more, one at a time. Workers end when
    the process that has started them does.

    Args:
        rows: which pictures.
        recipe: what is done to them.
        workers: processes; 1: this one.
        resume, force: as for `degrade_file`.
    """
    job = partial(degrade_file, recipe=recipe, resume=resume, force=force)
    if workers == 1:
        yield from map(job, rows)
        return
    remaining = iter(rows)
    left: list[Row] = []
    while True:
        with _pool(workers) as pool:
            waiting: Waiting = deque()
            try:
                for row in remaining:
                    left = [row]
                    waiting.append((row, pool.submit(_in_worker, job, row)))
                    left = []
                    if len(waiting) >= AHEAD * workers:
                        yield waiting[0][1].result()
                        waiting.popleft()
                while waiting:
                    yield waiting[0][1].result()
                    waiting.popleft()
            except BrokenProcessPool:
                # a pool that breaks between two pictures does not take the next one
                left = [*(row for row, _ in waiting), *left]
            else:
                return
        for folder in {row.output.parent for row in left}:
            remove_left(folder)
        for row in left:
            yield _again(job, row)


def _again(job: "partial[Outcome]", row: Row) -> Outcome:
    """A picture whose worker has died: it may have been written, and its outcome been lost."""
    given = job.keywords
    outcome = alone(partial(job, resume=given["resume"] or not given["force"]), row)
    return begun_again(outcome, given["resume"])


def alone(job: "partial[Outcome]", row: Row) -> Outcome:
    """A picture in a process of its own."""
    try:
        with _pool(1) as pool:
            return pool.submit(_in_worker, job, row).result()
    except BrokenProcessPool:
        return died(row)


def died(row: Row) -> Outcome:
    """Of a picture that takes its process with it."""
    reason = f"{row.input}: the process died over it: out of memory, or a damaged file"
    return Outcome(row, "failed", reason, None, 0.0)


def _in_worker(job: "partial[Outcome]", row: Row) -> Outcome:
    try:
        return job(row)
    except SystemExit:
        # a signal; the pool would take it for the picture's fault, and this process would go on
        os._exit(128 + signal.SIGTERM)


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes; if something is raised, what is under way is finished and the rest dropped."""
    pool = ProcessPoolExecutor(workers, mp_context=_context(), initializer=_begin)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _context() -> BaseContext:
    """A server that has imported everything once and forks; fork alone would copy torch's locks."""
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["uwaug.jobs.one"])
    return context


def _begin() -> None:
    """What each worker does first."""
    use_one_thread()
    # Ctrl-C is for the process that started it, which lets the pictures under way be finished
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # ended by a signal, Python would not remove the file that it is writing
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    threading.Thread(target=_end_with_parent, daemon=True).start()


def use_one_thread() -> None:
    """In this process: threads of several workers would wait for each other's cores."""
    torch.set_num_threads(1)
    threadpool_limits(1)


def _end_with_parent() -> None:
    """A worker would else wait for ever for the next picture of a process that was killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
