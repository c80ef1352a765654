"""Functions on small arrays, compiled where the extra `fast` is there: written once, in what of
NumPy numba knows.
"""

import os
from collections.abc import Callable
from functools import cached_property, wraps
from types import FunctionType
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

# what may be fused is fused; sums keep their order, NaN and infinity their meaning
OPTIONS = {"fastmath": {"contract", "nsz"}, "nogil": True, "error_model": "numpy"}

_loops = [False]
"""Whether the compiled loops are loaded."""


def loops_are_loaded() -> None:
    """From now on `compiled` functions are. Before, who makes one medium waits for no compiler."""
    _loops[0] = True


def are_loaded() -> bool:
    """Whether the compiled loops are loaded."""
    return _loops[0]


def wanted() -> bool:
    """Whether the environment allows for compiled functions."""
    switches = os.environ.get("UWAUG_FAST"), os.environ.get("NUMBA_DISABLE_JIT", "0")
    return switches[0] != "0" and switches[1] in ("", "0")


def kept(function: F, **options: Any) -> F:
    """`function` as numba compiles it, kept on disk where there is room."""
    import numba

    try:
        loop: F = numba.njit(cache=True, **OPTIONS, **options)(function)
    except RuntimeError:  # no folder can be written to
        loop = numba.njit(**OPTIONS, **options)(function)
    return loop


class _Compiled:
    def __init__(self, function: Callable[..., Any]) -> None:
        self.function: Any = function

    def __call__(self, *args: Any) -> Any:
        return (self.loop if _loops[0] else self.function)(*args)

    @cached_property
    def loop(self) -> Callable[..., Any]:
        code, names = self.function.__code__, self.function.__globals__
        called = {n: names[n].loop for n in code.co_names if isinstance(names.get(n), _Compiled)}
        linked = FunctionType(code, {**names, **called}, None, self.function.__defaults__)
        linked.__qualname__ = self.function.__qualname__
        return kept(linked)


def compiled(function: F) -> F:
    """A function that numba compiles once the loops are loaded; those that it calls and that are
    compiled, too, must stand in the same file, as numba looks at no other for what has changed.
    """
    either: F = wraps(function)(_Compiled(function))  # type: ignore[assignment]
    return either
