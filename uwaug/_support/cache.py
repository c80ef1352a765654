"""Caches of the process: one that is bounded by memory, as what it holds differs in size a
thousandfold; and one call that lists and empties all, those of `functools.lru_cache` included.

Other state of a process: the switch and the threads of `uwaug.formation.loops`, the counters of
`uwaug._support.deterministic`, the sessions that `uwaug._support.onnx_session` has inherited from a
parent process, and whether `uwaug.distance` has warned of unknown pixels.
"""

import sys
from collections import OrderedDict
from collections.abc import Hashable
from threading import Lock
from typing import Any, Generic, TypeVar

Value = TypeVar("Value")


class Cache(Generic[Value]):
    """Values by key, as many of those used last as fit into a budget of bytes. Safe with threads.

    Args:
        budget: bytes. The value put last is kept even if it alone is larger.
    """

    def __init__(self, budget: int) -> None:
        self.budget = budget
        self.held = 0
        self._values: OrderedDict[Hashable, tuple[Value, int]] = OrderedDict()
        self._lock = Lock()

    def get(self, key: Hashable) -> Value | None:
        """The value, or None."""
        with self._lock:
            if key not in self._values:
                return None
            self._values.move_to_end(key)
            return self._values[key][0]

    def put(self, key: Hashable, value: Value, size: int) -> None:
        """Keep a value of `size` bytes."""
        with self._lock:
            if key in self._values:
                self.held -= self._values.pop(key)[1]
            self._values[key] = (value, size)
            self.held += size
            while self.held > self.budget and len(self._values) > 1:
                _, (_, freed) = self._values.popitem(last=False)
                self.held -= freed

    def cache_clear(self) -> None:
        """Forget all."""
        with self._lock:
            self._values.clear()
            self.held = 0


def caches() -> dict[str, Any]:
    """Every cache of the modules of uwaug that are loaded, by its full name."""
    return {
        f"{module}.{name}": value
        for module, members in list(sys.modules.items())
        if module.partition(".")[0] == "uwaug"
        for name, value in list(vars(members).items())
        if hasattr(value, "cache_clear") and not isinstance(value, type)
    }


def clear() -> None:
    """Empty every cache of the process."""
    for cache in caches().values():
        cache.cache_clear()
