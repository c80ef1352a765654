"""Functions on small arrays, written once for NumPy and for numba of the extra `fast`."""

import os
from collections.abc import Callable
from functools import cached_property, wraps
from types import FunctionType
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

# what may be fused is fused; sums keep their order, NaN and infinity their meaning
OPTIONS = {"fastmath": {"contract", "nsz"}, "nogil": True, "error_model": "numpy"}

_loops = [False]  # one flag: true once the compiled loops are loaded


def loops_are_loaded() -> None:
    """Let numba compile all `compiled` functions. Until then nobody waits for a compiler."""
    _loops[0] = True


def are_loaded() -> bool:
    return _loops[0]


def wanted() -> bool:
    disabled = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")
    return os.environ.get("UWAUG_FAST") != "0" and not disabled


def kept(function: F, **options: Any) -> F:
    """Compile a function with numba, and keep it on disk where a folder can be written to."""
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
    """Let numba compile a function once the loops are loaded. Compiled functions that it calls must
    stand in the same file, as numba looks for changes nowhere else.
    """
    either: F = wraps(function)(_Compiled(function))  # type: ignore[assignment]
    return either
