"""The compiled loops, loaded at first use."""

import logging
import os
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import reload
from threading import Lock
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from uwaug.fused import switch
from uwaug.fused.tables import Coarse, Stack, Water

__all__ = ["Loops", "get", "ready"]

_log = logging.getLogger(__name__)


class Loops(NamedTuple):
    """The modules of the loops."""

    grids: ModuleType
    pixels: ModuleType
    slopes: ModuleType


_loops: Loops | None = None
_lock = Lock()


def ready() -> bool:
    """Load the loops, and compile what no earlier process has left on disk; whether they work."""
    if _loops is not None:
        return True
    with _lock:
        if _loops is None and switch.path() == "fused":
            _load()
    return _loops is not None


def get() -> Loops:
    """The loops, which are ready."""
    assert _loops is not None
    return _loops


def _load() -> None:
    global _loops  # noqa: PLW0603  (they are of the process)
    try:
        with _told():
            found = _imported()
    except Exception as error:
        # a numba that does not suit numpy, say: whatever it is, PyTorch can do without
        switch.disable()
        said = f"numba is installed but does not work, so PyTorch computes alone: {error}"
        warnings.warn(said, stacklevel=2)
        return
    _loops = found


def _imported() -> Loops:
    from uwaug.fused import compiling, grids, pixels, slopes

    found = Loops(grids, pixels, slopes)
    try:
        _run_once(found)
    except OSError:  # a full disk, or one that is not shared as it should be
        compiling.kept = False
        found = Loops(reload(grids), reload(pixels), reload(slopes))
        _run_once(found)
    return found


@contextmanager
def _told() -> Iterator[None]:
    """Say so when loops are being compiled."""
    from numba.core import event

    class Told(event.Listener):  # type: ignore[misc]
        said = False

        def on_start(self, event: Any) -> None:
            if not Told.said:
                Told.said = True
                _log.info("compiling the fused loops, which takes some seconds once")

        def on_end(self, event: Any) -> None: ...

    began = time.perf_counter()
    with event.install_listener("numba:compile", Told()):
        yield
    if Told.said:
        _log.info("fused loops compiled in %.0f s", time.perf_counter() - began)


def _run_once(loops: Loops) -> None:
    """A picture of one pixel, so that all types are compiled."""
    one, none = np.ones((3, 1, 1), np.float32), np.zeros(1, np.int64)
    four = np.ones((1, 4), np.float32)
    # its one row and column, mirrored three times on either side; a grid of four cells
    mirrored, cells = np.zeros(7, np.int64), np.zeros(4, np.int64)
    across = np.ones((4, 4), np.float32)
    coarse = Coarse(mirrored, 3, none, four, mirrored, 3, cells, across, none, four)
    grid = np.ones((12, 1), np.float32)
    loops.grids.coarse_lines(one, grid, coarse, 0, 0, 3)
    stack = Stack(
        series=np.ones((2, 4), np.float32),
        taps=np.ones((1, 3), np.float32),
        pairs=np.full(1, 2),
        margin=3,
        rows=mirrored,
        columns=mirrored,
        starts=none,
        back_first=none[None],
        back=four[None],
    )
    plane = np.ones((3, 1), np.float32)
    rates, law = np.ones(2, np.float32), np.ones(7, np.float32)
    water = Water(rates, plane, np.ones((3, 2), np.float32), plane, law)
    most, nothing = np.float32(1), np.zeros((3, 1, 0), np.uint8)
    loops.pixels.form_rows(one, one[0], water, stack, grid, True, most, one, nothing, 0, 1)
    byte = np.zeros((1, 1), np.uint8)
    loops.pixels.look_up(byte, np.ones(256, np.float32), one[0], 0, 1)
    loops.pixels.decode_rows(one[0], one[1], True, 0, 1)
    blurs = np.array([one.ctypes.data] * 2, np.int64)
    maps = (one, one[0], one[0], water, stack)
    outs = (one.copy(), one[0].copy(), one[0].copy(), np.ones((2, 1, 3, 1), np.float32))
    loops.slopes.recorded_rows(*maps, blurs, 3, 0, outs[0], 0, 1)
    sums = np.zeros((1, 7 * rates.size * loops.pixels.TILE), np.float32)
    loops.slopes.slope_rows(one, *maps, stack.series, blurs, 3, 0, (*outs, sums), 0, 1)


def _forget() -> None:
    """A thread of the parent may have held the lock."""
    global _lock  # noqa: PLW0603
    _lock = Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
