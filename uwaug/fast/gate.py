"""The gate to the compiled loops: which pictures they form, and how they are compiled.

numba is imported at first use. Without it, and for pictures that the loops cannot form, PyTorch
computes the same to 2e-6. UWAUG_FAST=0 in the environment keeps to PyTorch.
"""

import logging
import warnings
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from typing import Any, TypeVar

import torch
from torch import Tensor

from uwaug._support.compiled import OPTIONS, are_loaded, kept, loops_are_loaded, wanted
from uwaug.formation.development import Development
from uwaug.formation.sensor import Sensor
from uwaug.formation.setting import Setting
from uwaug.light import Lamp, Light
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.snow import MarineSnow
from uwaug.optics.view import View

_log = logging.getLogger(__name__)
# what the loops compute, but no subclasses of it
_CLASSES = {Development, Sensor, Light, Lamp, View, MarineSnow, type(None)}
_F = TypeVar("_F", bound=Callable[..., Any])


def can(image: Tensor, z: Tensor, setting: Setting) -> bool:
    """True if the loops form these pictures: in float32 or bytes on a CPU, without gradients.
    Arguments as for `uwaug.formation.image.form`.
    """
    if torch.compiler.is_compiling() or not (wanted() and _has_numba()):
        return False
    if torch._C._are_functorch_transforms_active():
        return False
    if z.dtype != torch.float32 or torch.jit.is_tracing():  # type: ignore[attr-defined, no-untyped-call]
        return False
    medium, light, development = setting.medium, setting.light, setting.development
    lamps = () if light is None else getattr(light, "lamps", ())
    parts = (development, development.noise, light, *lamps, setting.view, *medium.snow)
    if not set(map(type, parts)) <= _CLASSES or not _has_its_sums(medium):
        return False
    if Tensor in map(type, vars(development).values()):
        return False
    records = torch.is_grad_enabled()
    tensors = () if medium.is_of_arrays else medium.tensors()
    for value in (image, z, *tensors, None if light is None else light.pitch):
        if isinstance(value, Tensor):
            is_plain = type(value) in (Tensor, torch.nn.Parameter) and value.is_cpu
            if not is_plain or (records and value.requires_grad):
                return False
    return _works()


def _has_its_sums(medium: Medium) -> bool:
    """True if the curves of a medium, which may be of a subclass, are its sums."""
    kind = type(medium)
    names = ("sums", "curves", "image", "brightened", "under_lamp", "width", "weights")
    return kind is Medium or all(getattr(kind, n) is getattr(Medium, n) for n in names)


def load() -> bool:
    """Load the loops, and with them other compiled functions; False if they cannot be loaded."""
    return are_loaded() or (wanted() and _has_numba() and _works())


def warm_up() -> None:
    """Compile all loops, so that no picture waits for the compiler. They are kept on disk, beside
    the package or in NUMBA_CACHE_DIR. Without numba it is a ModuleNotFoundError.
    """
    if not (wanted() and load()):
        raise ModuleNotFoundError("the compiled loops need numba: pip install 'uwaug[fast]'")
    from uwaug.fast.render import form

    z = torch.full((1, 1, 8, 8), 3.0)
    for surfaces in ("grey", "spectral"):
        # a wide blur, so that the loops of coarse grids are compiled, too
        medium = Medium.from_water("7C", surfaces=surfaces, point_spread=PointSpread(30.0))
        medium = medium.with_snow(MarineSnow(seed=0))
        for image in (torch.full((1, 3, 8, 8), 0.5), torch.zeros(1, 3, 8, 8, dtype=torch.uint8)):
            form(image, z, Setting(medium))


@cache
def _has_numba() -> bool:
    return find_spec("numba") is not None


@cache
def _works() -> bool:
    """Load the loops; False if that fails, as with a numba that does not suit numpy."""
    try:
        from uwaug.fast import kernels  # noqa: F401
    except Exception as error:
        warnings.warn(f"numba does not work, so PyTorch computes alone: {error}", stacklevel=2)
        return False
    _tell_of_compiling()
    loops_are_loaded()
    return True


def _tell_of_compiling() -> None:
    """Log a warning when loops are compiled, as the program seems to hang for 10 s or more."""
    from numba.core import event

    class Listener(event.Listener):  # type: ignore[misc]
        told = False

        def on_start(self, event: Any) -> None:
            if not Listener.told:
                Listener.told = True
                _log.warning("uwaug compiles its loops, once: 10 s to a minute")

        def on_end(self, event: Any) -> None: ...

    event.register("numba:compile", Listener())


def inner(function: _F) -> _F:
    """Compile a function so that it is inlined into the loops that call it."""
    import numba

    compiled: _F = numba.njit(forceinline=True, **OPTIONS)(function)
    return compiled


kernel = kept  # compiles loops that Python calls, once, and keeps them on disk
