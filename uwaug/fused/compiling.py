"""How the loops are compiled. numba is imported here, at first use."""

from collections.abc import Callable
from typing import Any, TypeVar

import numba

__all__ = ["inner", "kernel"]

kept = True
"""Whether what is compiled is kept on disk."""

_F = TypeVar("_F", bound=Callable[..., Any])

# what may be fused is fused; sums keep their order, NaN and infinity their meaning
_OPTIONS = {"fastmath": {"contract", "nsz"}, "nogil": True, "error_model": "numpy"}


def inner(function: _F) -> _F:
    """A part of loops."""
    made: _F = numba.njit(forceinline=True, **_OPTIONS)(function)
    return made


def kernel(function: _F) -> _F:
    """Loops that Python calls: compiled once, and kept on disk where there is room."""
    try:
        made: _F = numba.njit(cache=kept, **_OPTIONS)(function)
    except RuntimeError:  # no folder can be written to
        made = numba.njit(**_OPTIONS)(function)
    return made
