"""Warnings that a process gives once: a loader makes thousands of pictures."""

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar


class Once:
    """A warning that a process gives once, of what shows in one of its first pictures.

    Args:
        looks: how many pictures are looked at for it.
    """

    every: ClassVar[list["Once"]] = []
    muted: ClassVar[bool] = False

    def __init__(self, looks: float = math.inf) -> None:
        self.looks = looks
        self.renew()
        Once.every.append(self)

    def renew(self) -> None:
        """As in a process that has seen and said nothing yet."""
        self.looks_left, self.said = self.looks, False

    def due(self) -> bool:
        """Whether to look at one more picture, which counts."""
        if Once.muted or self.said or self.looks_left < 1:
            return False
        self.looks_left -= 1
        return True

    def warn(self, message: str, stacklevel: int = 2) -> None:
        """Warn as `warnings.warn` does, unless that was done."""
        if not (Once.muted or self.said):
            self.said = True
            warnings.warn(message, UserWarning, stacklevel + 1)


@contextmanager
def muted() -> Iterator[None]:
    """Pictures made within are trials: none counts as looked at, and nothing is said of them."""
    before, Once.muted = Once.muted, True
    try:
        yield
    finally:
        Once.muted = before
