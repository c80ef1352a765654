"""Deterministic mode, in which a record replays bit for bit: one thread, full float32 products."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import torch

_lock = threading.Lock()
_inside = 0
_threads = 1
_precision = "highest"


@contextmanager
def reproducible() -> Iterator[None]:
    """Run on one thread and in full precision, as a DataLoader worker does.

    The split between threads decides which elements take the scalar path of a kernel, where exp2
    and pow differ in the last bit. Both settings belong to the process: the first thread in saves
    them, the last out restores them, and each leaves itself with as many threads as there were.
    """
    global _inside, _threads, _precision  # noqa: PLW0603  (they are of the process)
    with _lock:
        if _inside == 0:
            _threads, _precision = torch.get_num_threads(), torch.get_float32_matmul_precision()
            torch.set_float32_matmul_precision("highest")
        _inside += 1
        torch.set_num_threads(1)
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            torch.set_num_threads(_threads)
            if _inside == 0:
                torch.set_float32_matmul_precision(_precision)
