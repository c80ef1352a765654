"""Which path computes a picture: the compiled loops or eager PyTorch."""

import os
import warnings
from contextlib import AbstractContextManager
from importlib.util import find_spec
from types import TracebackType
from typing import Literal

__all__ = ["VARIABLE", "Path", "disable", "followed", "path", "use"]

Path = Literal["fused", "eager"]

VARIABLE = "UWAUG_FUSED"
"""Of the environment: 0 for eager PyTorch, 1 for the compiled loops, or an error without them."""

_INSTALL = 'install numba, with pip install "uwaug[fast]"'

_forced: bool | None = None
_found: bool | None = None  # None: not looked yet


class use(AbstractContextManager[None]):  # noqa: N801  (called like a function)
    """Choose the path: at once and for good, or while a `with` block lasts; for all threads.

    Args:
        fused: True for the compiled loops wherever they can be used; False for eager PyTorch; None
            for what the environment variable UWAUG_FUSED says (0 or 1), or the loops if numba is
            installed.

    Raises:
        TypeError: if `fused` is neither.
        ModuleNotFoundError: if it is True and numba is not installed.

    Examples:
        >>> from uwaug import fused
        >>> with fused.use(False):
        ...     fused.path()
        'eager'
    """

    def __init__(self, fused: bool | None) -> None:
        global _forced  # noqa: PLW0603  (it is of the process)
        if fused is not None and not isinstance(fused, bool):
            raise TypeError(f"fused must be True, False or None, got {fused!r}")
        if fused and not _is_found():
            raise ModuleNotFoundError(f"fused: {_INSTALL}")
        self._before = _forced
        _forced = fused

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        global _forced  # noqa: PLW0603
        _forced = self._before


def path() -> Path:
    """What pictures without gradients are computed by, on a CPU in float32."""
    wanted = _wanted() if _forced is None else _forced
    return "fused" if wanted and _is_found() else "eager"


def followed(wanted: Path | None) -> Path:
    """The path that a record names, or that at hand if it names none."""
    if wanted != "fused":
        return wanted or path()
    if path() == "eager":
        why = "is switched off" if _is_found() else "needs numba (uwaug[fast])"
        said = f"the record is of the fused path, which {why}: pictures differ in the last bits"
        warnings.warn(said, stacklevel=2)
    return path()


def disable() -> None:
    """Take numba for missing: it is there but does not work."""
    global _found  # noqa: PLW0603
    _found = False


def _wanted() -> bool:
    said = os.environ.get(VARIABLE, "")
    if said not in ("", "0", "1"):
        raise ValueError(f"environment variable {VARIABLE} must be 0 or 1, got {said!r}")
    if said == "1" and not _is_found():
        raise ModuleNotFoundError(f"{VARIABLE}=1: {_INSTALL}")
    return said != "0"


def _is_found() -> bool:
    global _found  # noqa: PLW0603
    if _found is None:
        _found = find_spec("numba") is not None
    return _found
