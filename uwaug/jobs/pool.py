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
from dataclasses import replace
from multiprocessing.connection import wait
from multiprocessing.context import BaseContext

import torch
from threadpoolctl import threadpool_limits

from uwaug._support.atomic import remove_left
from uwaug.io.read import name_of
from uwaug.jobs.items import Item, labelled
from uwaug.jobs.picture import Degrader, Result
from uwaug.jobs.recipe import Recipe
from uwaug.labels import LabelSource

AHEAD = 4
"""Pictures for each worker that are handed out before the first of them is done."""

_degrader: Degrader | None = None
"""Of a worker's process."""


def cores() -> int:
    """How many this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run(
    items: Iterable[Item],
    recipe: Recipe,
    *,
    workers: int = 1,
    resume: bool = False,
    force: bool = False,
    labels: LabelSource | None = None,
) -> Iterator[Result]:
    """Degrade pictures in files, and say in the order of `items` what became of each.

    A worker that dies, as decoders of damaged files and a full memory can make it, takes no other
    picture with it: those that were under way are done once more, one at a time. Workers end when
    the process that has started them does.

    Args:
        items: which pictures.
        recipe: what is done to them.
        workers: processes; 1: this one.
        resume, force: as for `Degrader`.
        labels: what `recipe.open_labels` returns, if it is open already. Workers get the labels of
            their pictures.
    """
    source = recipe.open_labels() if labels is None else labels
    remaining = labelled(items, source)
    if workers == 1:
        yield from map(Degrader(recipe, resume=resume, force=force), remaining)
        return
    waiting: deque[tuple[Item, Future[Result]]] = deque()
    taken: list[Item] = []  # from `remaining`, and not yet handed over
    while True:
        pool = _pool(workers, recipe, {"resume": resume, "force": force})
        try:
            for item in remaining:
                taken = [item]
                waiting.append((item, pool.submit(_degrade, item)))
                taken = []
                if len(waiting) >= AHEAD * workers:
                    yield waiting[0][1].result()
                    waiting.popleft()
            while waiting:
                yield waiting[0][1].result()
                waiting.popleft()
            return
        except BrokenProcessPool:
            pass
        finally:
            # if something is raised, what is under way is finished and the rest dropped
            with _deaf_to_interrupts():
                pool.shutdown(wait=True, cancel_futures=True)
        left = [*(item for item, _ in waiting), *taken]
        waiting.clear()
        for folder in {item.output.parent for item in left}:
            remove_left(folder)
        for item in left:
            # it may have been written, and its result been lost
            result = alone(item, recipe, resume=resume or not force, force=force)
            kept = result.status == "kept" and not resume
            yield replace(result, status="done") if kept else result


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """A second Ctrl-C would leave a pool half shut down, and the process would never end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


def alone(item: Item, recipe: Recipe, **options: bool) -> Result:
    """A picture in a process of its own, which may die over it; options of `Degrader`."""
    try:
        with _pool(1, recipe, options) as pool:
            return pool.submit(_degrade, item).result()
    except BrokenProcessPool:
        got = "the process died over it: out of memory, or a damaged file"
        return Result(item, "failed", f"{name_of(item.input)}: {got}")


def use_one_thread() -> None:
    """In this process: threads of several workers would wait for each other's cores."""
    torch.set_num_threads(1)
    threadpool_limits(1)


def _pool(workers: int, recipe: Recipe, options: dict[str, bool]) -> ProcessPoolExecutor:
    arguments = (recipe, options)
    return ProcessPoolExecutor(workers, _context(), initializer=_begin, initargs=arguments)


def _context() -> BaseContext:
    """A server that has imported everything once and forks; fork alone would copy torch's locks."""
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["uwaug.jobs.picture"])
    return context


def _begin(recipe: Recipe, options: dict[str, bool]) -> None:
    """What each worker does first."""
    global _degrader  # noqa: PLW0603  (it is of the process)
    use_one_thread()
    # Ctrl-C is for the process that started it, which lets the pictures under way be finished
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # ended by a signal, Python would not remove the file that it is writing
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _degrader = Degrader(recipe, **options)


def _degrade(item: Item) -> Result:
    assert _degrader is not None
    try:
        return _degrader(item)
    except SystemExit:
        # a signal; the pool would take it for the picture's fault, and this process would go on
        os._exit(128 + signal.SIGTERM)


def _end_with_parent() -> None:
    """A worker would else wait for ever for the next picture of a process that was killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
