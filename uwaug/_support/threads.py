"""Work on one thread."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_thread() -> Iterator[None]:
    """Run on one thread, the linear algebra of NumPy and SciPy too: the same numbers on any number
    of cores, and less time. (Two threads that wait for each other take 3 to 6 times as long for
    matrices of a dozen columns where other processes run as well.)
    """
    from threadpoolctl import threadpool_limits

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        torch.set_num_threads(threads)
