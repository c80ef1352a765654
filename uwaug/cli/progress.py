"""How far a long run is: a bar on a terminal, else a line now and then."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

__all__ = ["Counter", "counted"]

_PAUSE = 10.0
"""Seconds between two lines."""


class Counter:
    """Counts what is done."""

    def __init__(self, total: int, progress: Progress | None) -> None:
        self._total, self._progress = total, progress
        self._task = None if progress is None else progress.add_task("", total=total, rate="")
        self._start = self._said = time.monotonic()
        self.done = 0

    def advance(self) -> None:
        """One more."""
        self.done += 1
        now = time.monotonic()
        rate = self.done / max(now - self._start, 1e-9)
        if self._progress is not None and self._task is not None:
            self._progress.update(self._task, advance=1, rate=f"{rate:.3g}/s")
        elif now - self._said > _PAUSE:
            self._said = now
            left = (self._total - self.done) / rate
            said = f"{self.done} of {self._total}, {rate:.3g}/s, {left:.0f} s left"
            print(said, file=sys.stderr, flush=True)


@contextmanager
def counted(total: int) -> Iterator[Counter]:
    """A counter of `total` things, shown on standard error."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield Counter(total, None)
        return
    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        yield Counter(total, progress)
