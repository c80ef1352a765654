"""Work on many pictures in processes of one machine."""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from multiprocessing.context import BaseContext
from typing import Any

import torch
from threadpoolctl import threadpool_limits

from uwaug._support.threads import one_thread

_JOBS_AHEAD = 2  # jobs for each process that are handed out before the first of them is done
_work: Callable[[Any], Any] | None = None  # the work of this process, if it is of a pool


def on_processes(work: Any, jobs: Iterable[Any], workers: int) -> Iterator[Any]:
    """Results of jobs, in their order; with one worker, by this process.

    Decoders of damaged files and a full memory can make a process die. Then each job under way is
    done once more, in a process for it alone; `work.died(job)` gives the result if that dies, too.
    """
    if workers == 1:
        with one_thread():
            yield from map(work, jobs)
        return
    remaining = iter(jobs)
    under_way: deque[Any] = deque()
    while True:
        pool = _pool(work, workers)
        futures: deque[Future[Any]] = deque()
        try:
            for job in remaining:
                under_way.append(job)
                futures.append(pool.submit(_call, job))
                if len(futures) == _JOBS_AHEAD * workers:
                    yield futures.popleft().result()
                    under_way.popleft()
            while futures:
                yield futures.popleft().result()
                under_way.popleft()
            return
        except BrokenProcessPool:
            pass
        finally:
            pool.shutdown(cancel_futures=True)
        for job in under_way:
            try:
                with _pool(work, 1) as pool:
                    yield pool.submit(_call, job).result()
            except BrokenProcessPool:
                yield work.died(job)
        under_way.clear()


def _pool(work: Any, workers: int) -> ProcessPoolExecutor:
    if "forkserver" in multiprocessing.get_all_start_methods():
        # imports once, and forks without torch's threads, whose locks a fork would copy
        context: BaseContext = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([type(work).__module__])
    else:
        context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers, context, initializer=_begin, initargs=(work,))


def _begin(work: Any) -> None:
    global _work  # noqa: PLW0603  (it is of the process)
    _work = work
    torch.set_num_threads(1)
    threadpool_limits(1)
    # Ctrl-C is for the parent, which lets the jobs under way be finished
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _call(job: Any) -> Any:
    assert _work is not None
    return _work(job)


def _end_with_parent() -> None:
    """End with the parent: this process would wait for ever for jobs of one that was killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
