"""Several threads for the loops, where the caller allows them."""

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Lock

import torch
from torch.utils.data import get_worker_info

__all__ = ["in_bands"]

_LEAST = 1 << 15
"""Pixels for each thread: with fewer, to wake one takes longer than it saves."""

_pool: ThreadPoolExecutor | None = None
_workers = 0
_lock = Lock()


def in_bands(run: Callable[[int, int], None], count: int, width: int, multiple: int = 1) -> None:
    """Call `run(start, stop)` for all of `count` lines of `width` px, in bands on several threads.

    Args:
        multiple: bands begin at multiples of so many lines.
    """
    threads = 1 if get_worker_info() else torch.get_num_threads()
    threads = min(threads, count * width // _LEAST)
    if threads < 2:
        run(0, count)
        return
    # several for each thread: one that is held up does not hold up all
    each = multiple * -(-count // (4 * threads * multiple))
    bands = deque(range(0, count, each))

    def work() -> None:
        while bands:
            try:
                at = bands.popleft()
            except IndexError:  # another thread has taken the last
                return
            run(at, min(at + each, count))

    pool = _executor(threads - 1)
    helpers = [pool.submit(work) for _ in range(threads - 1)]
    work()  # this thread need not wait for the others to wake
    for helper in helpers:
        if not helper.cancel():
            helper.result()


def _executor(threads: int) -> ThreadPoolExecutor:
    global _pool, _workers
    with _lock:
        if _pool is None or _workers < threads:
            # the smaller one ends with its last task
            _pool, _workers = ThreadPoolExecutor(threads, "uwaug"), threads
        return _pool


def _forget() -> None:
    """In a child process there are no threads but its own."""
    global _pool, _lock
    _pool, _lock = None, Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
