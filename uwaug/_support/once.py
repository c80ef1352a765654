"""Warnings that a process gives once, as a loader makes thousands of pictures."""

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar


class Once:
    """Warning that a process gives once, about one of its first pictures, `looks` in all."""

    every: ClassVar[list["Once"]] = []
    muted: ClassVar[bool] = False

    def __init__(self, looks: float = math.inf) -> None:
        self.looks = looks
        self.renew()
        Once.every.append(self)

    def renew(self) -> None:
        """Return to the state of a new process."""
        self.looks_left, self.said = self.looks, False

    def due(self) -> bool:
        """True if one more picture is to be examined; it is counted."""
        if Once.muted or self.said or self.looks_left < 1:
            return False
        self.looks_left -= 1
        return True

    def warn(self, message: str, stacklevel: int = 2) -> None:
        """Warn as `warnings.warn` does, unless this process has warned already."""
        if not (Once.muted or self.said):
            self.said = True
            warnings.warn(message, UserWarning, stacklevel + 1)


@contextmanager
def muted() -> Iterator[None]:
    """Open a context for trials: their pictures are not counted, and nothing is warned of."""
    before, Once.muted = Once.muted, True
    try:
        yield
    finally:
        Once.muted = before
