"""The backend of compiled loops: who may use it, what it can compute, how it is compiled.

numba is imported at first use. Without it, and for all that the loops cannot compute, PyTorch
computes the same to 2e-6.
"""

import logging
import os
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from functools import lru_cache
from hashlib import sha256
from importlib import import_module, reload
from importlib.util import find_spec
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import Any, Literal, TypeVar

import torch
from torch import Tensor

from uwaug._support.extras import install
from uwaug._support.torch_func import transformed

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_log = logging.getLogger(__name__)

# ------------------------------------------------------------------------------ the switch

RecordedEngine = Literal["fused", "fused-rows", "eager"]
"""What a record says of who computed its picture, under the key "path": "fused-rows" of a large one
by the loops, as older records call "fused" what PyTorch made of large ones.
"""

VARIABLE = "UWAUG_FUSED"
"""Of the environment: 0 for eager PyTorch, 1 for the compiled loops, or an error without them."""

_DISABLED = "NUMBA_DISABLE_JIT"
"""numba's own variable: 1 to run what would be compiled in Python."""

_switched: bool | None = None
_numba: bool | None = None  # whether it is installed and works; None: not looked yet
_failure = ""  # why it does not work


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
        global _switched  # noqa: PLW0603  (it is of the process)
        if fused is not None and not isinstance(fused, bool):
            raise TypeError(f"fused must be True, False or None, got {fused!r}")
        if fused and not has_numba():
            raise ModuleNotFoundError(f"fused: {_cure()}")
        self._before = _switched
        _switched = fused

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        global _switched  # noqa: PLW0603
        _switched = self._before


def path() -> RecordedEngine:
    """What computes pictures in float32 on a CPU."""
    if _switched is not None:
        return "fused" if _switched and has_numba() else "eager"
    value = os.environ.get(VARIABLE, "")
    if value not in ("", "0", "1"):
        raise ValueError(f"environment variable {VARIABLE} must be 0 or 1, got {value!r}")
    if value == "1" and not has_numba():
        raise ModuleNotFoundError(f"{VARIABLE}=1: {_cure()}")
    return "fused" if value != "0" and has_numba() else "eager"


def engine_for(recorded: RecordedEngine | None) -> RecordedEngine:
    """The engine that a record asks for, or that at hand if it names none; a warning where the
    record's is not to be had.
    """
    if recorded not in (None, "eager") and path() == "eager":
        why = "is switched off" if has_numba() else f"cannot be used ({_cure()})"
        warnings.warn(
            f"the record is of the fused path, which {why}: pictures differ in the last bits",
            stacklevel=2,
        )
    return "eager" if recorded == "eager" else path()


def has_numba() -> bool:
    """Whether numba is installed, may compile, and has not failed in this process."""
    global _numba  # noqa: PLW0603
    if _numba is None:
        _numba = find_spec("numba") is not None and not _is_jit_disabled()
    return _numba


def _is_jit_disabled() -> bool:
    """Whether numba leaves Python as it is: a picture would take hours."""
    return os.environ.get(_DISABLED, "0") not in ("", "0")


def _cure() -> str:
    """What to do about loops that cannot be used."""
    if _failure:
        return _failure
    if _is_jit_disabled():
        return f"unset {_DISABLED}, which keeps numba from compiling"
    return f"install numba, with {install('fast')}"


# ------------------------------------------------------------------------------ what is computed


def can_render(maps: Sequence[Tensor], numbers: Sequence[Tensor], *, gradients: bool) -> bool:
    """Whether the loops form these pictures, in the line of sight and by daylight; they are loaded
    then.

    Args:
        maps: the picture (Bx3xHxW or 3xHxW), and all maps of its pixels, as they were given.
        numbers: of the medium.
        gradients: whether there will be gradients.
    """
    if not all(map(_is_plain, (*maps, *numbers))) or not all(map(Tensor.numel, maps)):
        return False
    image = maps[0]
    single = torch.promote_types(image.dtype, torch.float32) == torch.float32
    return single and image.shape[-3] == 3 and _is_at_hand(gradients)


def can_read(*tensors: Tensor) -> bool:
    """Whether the loops decode these tensors as they are: bytes or float32, of which no
    gradients are recorded.
    """
    kinds = (torch.float32, torch.uint8)
    recorded = torch.is_grad_enabled() and any(t.requires_grad for t in tensors)
    plain = all(_is_plain(t) and t.dtype in kinds and t.numel() for t in tensors)
    return plain and not recorded and _is_at_hand(gradients=False)


def _is_plain(value: Tensor) -> bool:
    """Whether a tensor has memory that numba can read."""
    return type(value) in (Tensor, torch.nn.Parameter) and value.is_cpu


def _is_at_hand(gradients: bool) -> bool:
    """Whether the loops may be used, and work."""
    if torch.compiler.is_compiling() or path() == "eager":
        return False
    tracing = torch.jit.is_tracing()  # type: ignore[attr-defined, no-untyped-call]
    return not (tracing or transformed()) and ready(gradients)


# ------------------------------------------------------------------------------ loading

_KERNELS = ("kernels", "adjoint")
_ready: set[str] = set()  # of these modules
_lock = Lock()


def ready(gradients: bool = False) -> bool:
    """Load the loops, and compile what no earlier process has left on disk; whether they work.

    Args:
        gradients: load those for gradients too, which takes as long again.
    """
    modules = _KERNELS if gradients else _KERNELS[:1]
    if not _ready.issuperset(modules):
        with _lock:
            for name in modules:
                if name not in _ready and path() == "fused":
                    _load(name)
    return _ready.issuperset(modules)


def loaded(name: Literal["kernels", "adjoint"]) -> Any:
    """The module of kernels, or of those for gradients."""
    return import_module(f"uwaug.formation.loops.{name}")


def warm_up() -> Path | None:
    """Compile all loops, those for gradients too, so that no picture waits for the compiler.

    Returns:
        The folder where they are kept; None if none can be written to, so that every process
        compiles for itself.

    Raises:
        ModuleNotFoundError: if numba is missing, or does not work.
    """
    with use(True):
        if not ready(gradients=True):
            raise ModuleNotFoundError(f"fused: {_cure()}")
    return _folder() if _on_disk else None


def _load(name: str) -> None:
    global _numba, _failure
    try:
        import_module("numba")  # before others wait
        with _alone(), _compiling_told(name):
            _compile(name)
    except Exception as error:
        # a numba that does not suit numpy, say: whatever it is, PyTorch can do without
        _numba, _failure = False, str(error)
        warnings.warn(
            f"numba is installed but does not work, so PyTorch computes alone: {error}",
            stacklevel=2,
        )
        return
    _ready.add(name)


def _compile(name: str) -> None:
    """Load the kernels of a module from disk, or compile them, and see that they work."""
    global _on_disk  # noqa: PLW0603  (of the process)
    from uwaug.formation.loops import proof

    run = proof.prove if name == "kernels" else proof.prove_gradients
    module = import_module(f"uwaug.formation.loops.{name}")
    try:
        run()
    except proof.LoopsDifferError:
        raise
    except OSError:  # a full disk, or one that is not shared as it should be
        _on_disk = False
    except Exception:  # a damaged file, as a crash of the machine may leave it
        _on_disk = _drop_kept(name)
    else:
        return
    reload(module)
    run()


@contextmanager
def _alone() -> Iterator[None]:
    """While one process compiles, the others wait, and then take what it has left on disk."""
    folder = _folder()
    if folder is None or fcntl is None:
        yield
        return
    with ExitStack() as stack:
        with suppress(OSError):  # a disk without locks
            file = stack.enter_context((folder / "loops.lock").open("w"))
            fcntl.flock(file, fcntl.LOCK_EX)
            # a child that was forked meanwhile holds the file open too
            stack.callback(fcntl.flock, file, fcntl.LOCK_UN)
            _drop_older(folder)
        yield


@contextmanager
def _compiling_told(name: str) -> Iterator[None]:
    """Say when loops are being compiled: a warning, as that alone is seen where nobody has set up
    logging, and the program seems to hang.
    """
    from numba.core import event

    folder = _folder() if _on_disk else None
    where = f"kept in {folder}" if folder else "by each process, as no folder can be written to"
    what = "loops" if name == "kernels" else "loops for gradients"

    class Listener(event.Listener):  # type: ignore[misc]
        heard = False

        def on_start(self, event: Any) -> None:
            if not Listener.heard:
                Listener.heard = True
                _log.warning("uwaug compiles its %s, once: 10 s to a minute; %s", what, where)

        def on_end(self, event: Any) -> None: ...

    began = time.perf_counter()
    with event.install_listener("numba:compile", Listener()):
        yield
    if Listener.heard:
        _log.info("uwaug has compiled its %s in %.0f s", what, time.perf_counter() - began)


def _forget() -> None:
    """A thread of the parent may have held the lock."""
    global _lock  # noqa: PLW0603
    _lock = Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)

# ------------------------------------------------------------------------------ compiling

_on_disk = True  # whether what is compiled is kept there

_F = TypeVar("_F", bound=Callable[..., Any])

# what may be fused is fused; sums keep their order, NaN and infinity their meaning
_OPTIONS = {"fastmath": {"contract", "nsz"}, "nogil": True, "error_model": "numpy"}


def inner(function: _F) -> _F:
    """A part of loops."""
    import numba

    compiled: _F = numba.njit(forceinline=True, **_OPTIONS)(function)
    return compiled


def kernel(function: _F) -> _F:
    """Loops that Python calls: compiled once, and kept on disk where there is room."""
    import numba

    kept = _on_disk and _folder() is not None
    compiled: _F = numba.njit(cache=kept, **_OPTIONS)(function)
    return compiled


@lru_cache
def _folder() -> Path | None:
    """Where numba keeps what it compiles of this folder; None where it can write to none."""
    import numba

    try:
        return Path(numba.njit(cache=True)(kernel).stats.cache_path)
    except RuntimeError:
        return None


def _drop_kept(name: str) -> bool:
    """Remove what is kept of a module's loops; whether it could be."""
    folder = _folder()
    try:
        for compiled in folder.glob(f"{name}.*.nb[ic]") if folder else ():
            compiled.unlink(missing_ok=True)
    except OSError:
        return False
    return True


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
    for compiled in folder.glob("*.nb[ic]"):
        compiled.unlink(missing_ok=True)
    stamp.write_text(digest.hexdigest())
