"""How the loops are compiled. numba is imported here, at first use."""

from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
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
    folder = made.stats.cache_path  # type: ignore[attr-defined]
    if folder:
        with suppress(OSError):
            _drop_older(Path(folder))
    return made


@lru_cache
def _drop_older(folder: Path, sources: Path = Path(__file__).parent) -> None:
    """Remove from a folder what is kept of other versions of the loops: numba looks at the file of
    a kernel, and not at those of what the kernel calls.
    """
    digest = sha256()
    for source in sorted(sources.glob("*.py")):
        digest.update(source.read_bytes())
    stamp = folder / "loops.sha256"
    if stamp.exists() and stamp.read_text() == digest.hexdigest():
        return
    for kept in folder.glob("*.nbi"):
        kept.unlink(missing_ok=True)
    stamp.write_text(digest.hexdigest())
