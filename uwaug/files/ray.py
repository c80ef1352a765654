"""Work on many pictures by Ray, on this machine or on a cluster."""

import logging
import os
import pickle
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from typing import Any

import torch
from threadpoolctl import threadpool_limits

from uwaug._support.extras import require
from uwaug.files.pool import alone

_MAX_BLOCK = 16  # jobs that are handed to a process at once
# Share of a core that each process asks for. It uses a whole one; but if processes asked for all
# cores, the reader of the jobs would wait for ever.
_CORE_SHARE = 0.5

_SETTINGS = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # else a picture for which memory does not suffice is begun again for ever
    "RAY_task_oom_retries": "3",
}


def on_ray(work: Any, jobs: Sequence[Any], address: str, workers: int) -> Iterator[Any]:
    """Results of jobs, in their order, as of `uwaug.files.pool.on_processes`.

    A Ray of this process is used first. Else the address "local" starts one with so many `workers`,
    and ends it with the run; "auto" finds a cluster that this machine is part of; or host:port. An
    OSError tells that nothing answers there, or that Ray fails.
    """
    ray, data, pa = require("ray", "ray", "ray.data", "pyarrow")
    logging.getLogger("ray.data").setLevel(logging.ERROR)
    with _connected(ray, address, workers):
        cores = max(1, int(ray.cluster_resources().get("CPU", 1)))
        # some blocks for each process, so that none of them works alone at the end
        size = max(1, min(_MAX_BLOCK, len(jobs) // (8 * cores)))
        remaining, blocks = iter(jobs), []
        while block := list(islice(remaining, size)):
            pickled = pa.array([pickle.dumps(block)], pa.large_binary())
            blocks.append(pa.table({"jobs": pickled}))
        dataset = data.from_arrow(blocks)
        dataset.context.execution_options.preserve_order = True
        dataset.context.enable_progress_bars = False
        mapped = dataset.map_batches(
            _Process,
            fn_constructor_args=(work, os.getcwd()),
            compute=data.ActorPoolStrategy(size=cores),
            batch_size=1,
            batch_format="pyarrow",
            num_cpus=_CORE_SHARE if cores > 1 else 0,
        )
        try:
            for row in mapped.iter_rows():
                yield from pickle.loads(row["results"])
        except ray.exceptions.RayError as error:
            raise OSError(f"Ray: {error}") from None


@contextmanager
def _connected(ray: Any, address: str, workers: int) -> Iterator[None]:
    """Start Ray or connect to it, unless this process has, and end that after use."""
    if ray.is_initialized():
        yield
        return
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
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


class _Process:
    """A Ray actor, which works in the folder that the run was started in."""

    def __init__(self, work: Any, folder: str) -> None:
        import ray

        torch.set_num_threads(1)
        threadpool_limits(1)
        os.chdir(folder)  # where paths are from
        self._work = work
        # the job that it died over may come again: from now on, each job has a separate process
        self._careful = bool(ray.get_runtime_context().was_current_actor_reconstructed)

    def __call__(self, batch: Any) -> Any:
        import pyarrow as pa

        results = []
        for row in batch["jobs"].to_pylist():
            jobs = pickle.loads(row)
            block = [alone(self._work, job) if self._careful else self._work(job) for job in jobs]
            results.append(pickle.dumps(block))
        return pa.table({"results": pa.array(results, pa.large_binary())})
