"""Several threads for the loops, where the caller allows them."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Lock

import torch
from torch.utils.data import get_worker_info

__all__ = ["in_bands"]

_LEAST = 1 << 15
"""Pixels of a band: with fewer, waking a thread takes longer than it saves."""

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
    bands = range(0, count, each)
    tasks = [_executor(threads).submit(run, at, min(at + each, count)) for at in bands]
    for task in tasks:
        task.result()


def _executor(threads: int) -> ThreadPoolExecutor:
    global _pool, _workers
    with _lock:
        if _pool is None or _workers < threads:
            _pool, _workers = ThreadPoolExecutor(threads, "uwaug"), threads
        return _pool


def _forget() -> None:
    """In a child process there are no threads but its own."""
    global _pool, _lock
    _pool, _lock = None, Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
