"""Many pictures in files on Ray: on the cores of this machine, or of a cluster whose machines all
see the same folders.
"""

import os
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from typing import Any

from uwaug.jobs.one import Outcome, begun_again, degrade_file
from uwaug.jobs.recipe import Recipe
from uwaug.jobs.row import Row
from uwaug.jobs.run import AHEAD, cores, died, use_one_thread

__all__ = ["LOCAL", "begin_on", "connected", "require_ray", "run_on_ray"]

LOCAL = "local"
"""In place of an address: Ray is started on this machine, and ended with the run."""

_RETRIES = 3
"""Times that a picture is begun again whose process, or machine, has died."""

_SETTINGS = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # else a picture for which memory does not suffice is begun again for ever
    "RAY_task_oom_retries": str(_RETRIES),
}


def require_ray() -> None:
    """Refuse what needs Ray where it is not installed.

    Raises:
        ImportError: names the extra.
    """
    try:
        import ray.data  # noqa: F401
    except ImportError:
        cure = 'pip install ".[ray]" in a checkout of uwaug'
        raise ImportError(f"Ray is not installed: {cure}") from None


@contextmanager
def connected(address: str, workers: int | None = None) -> Iterator[int]:
    """Ray, for as long as it is needed; gives the number of its cores.

    Args:
        address: "local" starts it on this machine; "auto" finds a cluster that this machine is
            part of; or host:port. Where Ray has been started in this process, that is taken.
        workers: cores, of "local"; None: all that this process may use.

    Raises:
        ImportError: if Ray is not installed.
        OSError: if nothing answers there.
    """
    require_ray()
    import ray

    mine = not ray.is_initialized()
    if mine:
        for name, value in _SETTINGS.items():
            os.environ.setdefault(name, value)
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": "error"}
        if address == LOCAL:
            options |= {"num_cpus": workers or cores(), "include_dashboard": False}
        try:
            ray.init(address, **options)
        except (OSError, RuntimeError, ValueError) as error:
            cure = f"is Ray running there? {LOCAL} starts it on this machine"
            raise ConnectionError(f"no Ray at {address}: {error}: {cure}") from None
    try:
        yield max(1, int(ray.cluster_resources().get("CPU", 1)))
    finally:
        if mine:
            ray.shutdown()


def run_on_ray(
    rows: Iterable[Row], recipe: Recipe, *, resume: bool = False, force: bool = False
) -> Iterator[Outcome]:
    """Degrade pictures in files, and say in the order of `rows` what became of each.

    The same files as of `uwaug.jobs.run.run`. A picture whose process or machine dies is begun
    again on another, a few times.

    Args:
        rows: which pictures.
        recipe: what is done to them. Files that it names must be there on every machine.
        resume, force: as for `degrade_file`.

    Raises:
        OSError: if Ray itself fails.
    """
    import ray

    ahead = AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
    task = ray.remote(_degrade).options(max_retries=_RETRIES, num_cpus=1)
    # what is begun again may have been written by then, but not reported
    keep = resume or not force
    shared, folder = ray.put(recipe), os.getcwd()
    waiting: deque[tuple[Row, Any]] = deque()
    try:
        for row in rows:
            waiting.append((row, task.remote(row, shared, folder, keep, force)))
            if len(waiting) >= ahead:
                yield _outcome(*waiting[0], resume)
                waiting.popleft()
        while waiting:
            yield _outcome(*waiting[0], resume)
            waiting.popleft()
    finally:
        for _, answer in waiting:
            ray.cancel(answer)


def _degrade(row: Row, recipe: Recipe, folder: str, resume: bool, force: bool) -> Outcome:
    begin_on(folder)
    return degrade_file(row, recipe, resume=resume, force=force)


@lru_cache(maxsize=1)
def begin_on(folder: str) -> None:
    """What each process of Ray does first, once: paths are from the folder of the run."""
    use_one_thread()
    with suppress(OSError):
        os.chdir(folder)


def _outcome(row: Row, answer: Any, resume: bool) -> Outcome:
    import ray

    try:
        outcome: Outcome = ray.get(answer)
    except (ray.exceptions.WorkerCrashedError, ray.exceptions.OutOfMemoryError):
        return died(row)
    except ray.exceptions.RayError as error:
        raise OSError(f"Ray: {error}") from None
    return begun_again(outcome, resume)
