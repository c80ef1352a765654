"""Work on many pictures by Ray, on this machine or on a cluster."""

import os
import pickle
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from uwaug._support.extras import require
from uwaug._support.threads import one_thread

_JOBS_AHEAD = 4  # jobs for each core that are handed out before the first of them is done


def on_ray(work: Any, jobs: Sequence[Any], address: str, workers: int) -> Iterator[Any]:
    """Results of jobs, in their order, as of `uwaug.files.pool.on_processes`.

    A Ray of this process is used first. Else the address "local" starts one with so many `workers`,
    and ends it with the run; "auto" finds a cluster that this machine is part of; or host:port. An
    OSError tells that nothing answers there, or that Ray fails.
    """
    (ray,) = require("ray", "ray")
    with _connected(ray, address, workers):
        ahead = _JOBS_AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
        # once more if its process dies, or memory does not suffice
        do = ray.remote(max_retries=1)(_do)
        pickled, folder = ray.put(pickle.dumps(work)), os.getcwd()
        under_way: deque[tuple[Any, Any]] = deque()

        def first() -> Any:
            job, result = under_way.popleft()
            try:
                return ray.get(result)
            except (ray.exceptions.WorkerCrashedError, ray.exceptions.OutOfMemoryError):
                return work.died(job)
            except ray.exceptions.RayError as error:
                raise OSError(f"Ray: {error}") from None

        for job in jobs:
            under_way.append((job, do.remote(pickled, folder, job)))
            if len(under_way) == ahead:
                yield first()
        while under_way:
            yield first()


@contextmanager
def _connected(ray: Any, address: str, workers: int) -> Iterator[None]:
    """Start Ray or connect to it, unless this process has, and end that after use."""
    if ray.is_initialized():
        yield
        return
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # else a picture for which memory does not suffice is begun again for ever
    os.environ.setdefault("RAY_task_oom_retries", "3")
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "error"}
    if address == "local":
        options |= {"num_cpus": workers, "include_dashboard": False}
    try:
        ray.init(address, **options)
    except (OSError, RuntimeError, ValueError) as error:
        raise ConnectionError(f"no Ray at {address}: {error}: local starts it here") from None
    try:
        yield
    finally:
        ray.shutdown()


def _do(pickled: bytes, folder: str, job: Any) -> Any:
    os.chdir(folder)  # where paths are from
    with one_thread():
        return _work(pickled)(job)


@lru_cache(maxsize=1)  # work settles each film once
def _work(pickled: bytes) -> Any:
    return pickle.loads(pickled)
