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

from uwaug.formation.loops import switch
from uwaug.formation.loops.tables import Coarse, Floats, Stack, Water
from uwaug.formation.loops.transposed import Back, Cells

__all__ = ["Loops", "get", "ready"]

_log = logging.getLogger(__name__)


class Loops(NamedTuple):
    """The modules of the loops, and whether those for gradients are compiled."""

    grids: ModuleType
    pixels: ModuleType
    blurs: ModuleType
    slopes: ModuleType
    looks: ModuleType
    widths: ModuleType
    gradients: bool


_loops: Loops | None = None
_lock = Lock()


def ready(gradients: bool = False) -> bool:
    """Load the loops, and compile what no earlier process has left on disk; whether they work.

    Args:
        gradients: load those for gradients too, which takes a third as long again.
    """
    if _loops is not None and (_loops.gradients or not gradients):
        return True
    with _lock:
        if switch.path() == "fused" and (_loops is None or gradients):
            _load(gradients)
    return _loops is not None and (_loops.gradients or not gradients)


def get() -> Loops:
    """The loops, which are ready."""
    assert _loops is not None
    return _loops


def _load(gradients: bool) -> None:
    global _loops  # noqa: PLW0603  (they are of the process)
    try:
        with _told():
            found = _imported(gradients)
    except Exception as error:
        # a numba that does not suit numpy, say: whatever it is, PyTorch can do without
        switch.disable()
        said = f"numba is installed but does not work, so PyTorch computes alone: {error}"
        warnings.warn(said, stacklevel=2)
        return
    _loops = found


def _imported(gradients: bool) -> Loops:
    from uwaug.formation.loops import blurs, compiling, grids, looks, pixels, slopes, widths

    found = Loops(grids, pixels, blurs, slopes, looks, widths, gradients)
    try:
        _run_once(found)
    except OSError:  # a full disk, or one that is not shared as it should be
        compiling.kept = False
        for module in (grids, pixels, blurs, slopes, looks, widths):
            reload(module)
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
    one, grid = np.ones((3, 1, 1), np.float32), np.ones((12, 1), np.float32)
    water, stack = _tables()
    places, weights = np.zeros(7, np.int64), np.ones((4, 4), np.float32)
    ends = (places[:1], weights[:1])
    coarse = Coarse(places, 3, *ends, places, 3, places[:4], weights, *ends)
    loops.grids.coarse_lines(one, grid, coarse, 0, 0, 3)
    most, nothing = np.float32(1), np.zeros((3, 1, 0), np.uint8)
    loops.pixels.form_rows(one, one[0], water, stack, grid, True, most, one, nothing, 0, 1)
    byte = np.zeros((1, 1), np.uint8)
    loops.pixels.look_up(byte, np.ones(256, np.float32), one[0], 0, 1)
    loops.pixels.decode_rows(one[0], one[1], True, 0, 1)
    loops.looks.add_up(one[:, 0], one[0, 0], places[:1], water.rates, np.ones((2, 4)))
    if loops.gradients:
        _run_back(loops, water, stack, grid)


def _run_back(loops: Loops, water: Water, stack: Stack, grid: Floats) -> None:
    """The same with gradients."""
    one, blurred = np.ones((3, 1, 1), np.float32), np.ones((2, 1, 3, 1), np.float32)
    places, weights = np.zeros((3, 7), np.int64), np.ones((1, 4), np.float32)
    ends = (places[0, :1], weights)
    cells = Cells(places[:1, :4].copy(), weights, *ends, *ends)
    back = Back(places, np.zeros((1, 1, 4), np.int64), weights[None])
    loops.widths.width_rows(one[0], water.law, one[1], 0, 1)
    sums = np.zeros((1, 3 * loops.pixels.TILE), np.float32)
    loops.widths.width_slope_rows(one[0], one[1], water.law, one[2], sums, 1, 0, 1)
    loops.blurs.blurred_rows(one, stack, grid, blurred, 0, 1)
    loops.blurs.cell_lines(one[0], grid, cells, 0, 1)
    loops.blurs.gathered_rows(blurred.reshape(2, 3, 1), stack, grid, back, one, 0, 1)
    outs = (one.copy(), one[0].copy(), one[0].copy())
    sums = np.zeros((1, 7 * water.rates.size * loops.pixels.TILE), np.float32)
    maps = (one, one, one[0], one[0], water, stack, stack.series)
    loops.slopes.slope_rows(*maps, blurred, (*outs, sums), 0, 1)


def _tables() -> tuple[Water, Stack]:
    """A narrow blur and one on a grid, and a medium of two rates."""
    none, mirrored = np.zeros(1, np.int64), np.zeros(7, np.int64)
    stack = Stack(
        series=np.ones((2, 4), np.float32),
        taps=np.ones((1, 3), np.float32),
        pairs=np.full(1, 2),
        margin=3,
        rows=mirrored,
        columns=mirrored,
        starts=none,
        back_first=none[None],
        back=np.ones((1, 1, 4), np.float32),
    )
    plane, rates, law = np.ones((3, 1), np.float32), np.ones(2, np.float32), np.ones(7, np.float32)
    return Water(rates, plane, np.ones((3, 2), np.float32), plane, law), stack


def _forget() -> None:
    """A thread of the parent may have held the lock."""
    global _lock  # noqa: PLW0603
    _lock = Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
