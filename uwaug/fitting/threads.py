"""One thread for many small steps."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from uwaug._support.deterministic import reproducible

__all__ = ["one_thread"]


@contextmanager
def one_thread() -> Iterator[None]:
    """Run on one thread, NumPy's and SciPy's linear algebra too: the same numbers on any machine,
    and less time. (Two threads that wait for each other take 3 to 6 times as long for matrices of a
    dozen columns where other processes run as well.)
    """
    from threadpoolctl import threadpool_limits

    # slopes need what inference mode leaves out
    with (
        reproducible(),
        threadpool_limits(1, user_api="blas"),
        torch.inference_mode(False),
        torch.enable_grad(),
        torch.device("cpu"),
    ):
        yield
