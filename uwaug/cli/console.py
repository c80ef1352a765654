"""What commands have in common: exit codes, errors in the words of the command line, what they say
meanwhile.
"""

import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import typer

if TYPE_CHECKING:
    from rich.progress import Progress

_PAUSE = 10.0
"""Seconds between two lines of progress where there is no terminal."""

_ALIKE = """
    black_point clean color_matrix color_space compensation contrast distance distance_kind
    distance_unit exposure far field fit focal_px gain gamma gamut ignore_index image
    keep_terms mask min_contrast model near observed offset_px parameters planar preset random
    saturation seed severity shading sides surfaces tone unknown variants vertical_depth
    visibility water white_balance
"""
"""Arguments of the library whose flags have their names."""

FLAGS = {name: f"--{name.replace('_', '-')}" for name in _ALIKE.split()}
FLAGS |= {
    "baseline_m": "--baseline",
    "network": "--depth-network",
    "systems": "--system",
    "type": "--water",
    "unit": "--distance-unit",
    "void": "--ignore-index",
}
"""Arguments of the library, and the flags that set them."""

_ANY = "|".join(FLAGS)
_NAME = re.compile(rf"\b({_ANY})\b")
_SUBJECT = re.compile(rf"^({_ANY})( and ({_ANY}))?(?= must\b| is\b| are\b| would |:)")
_UNDERSCORED = re.compile(rf"\b({'|'.join(name for name in FLAGS if '_' in name)})\b")
_GIVEN = re.compile(rf"""\b({_ANY})=["']?([\w.…]+)["']?""")
_RANGE = re.compile(rf"\b({_ANY})=[(\[]([\w.]+), ([\w.]+)[)\]]")
_SAID = re.compile(rf"\b({_ANY}) = ([\w.]+)")


def in_flags(message: str) -> str:
    """A message of the library with flags in place of the arguments that it names.

    An argument of one word is known by its place, as the same word may be used in a sentence: it is
    what the message is about, or it has a value. Where a file is at fault, its keys are named, and
    only a cure such as `unit="mm"` is an argument.
    """
    message = message.replace("a range (low, high) with low ≤ high", "a range LOW:HIGH")
    message = _RANGE.sub(lambda match: f"{FLAGS[match[1]]} {match[2]}:{match[3]}", message)
    message = cures_in_flags(message)
    if os.path.exists(message.partition(": ")[0]):
        return message
    message = _SAID.sub(lambda match: f"{FLAGS[match[1]]} {match[2]}", message)
    message = _SUBJECT.sub(lambda match: _NAME.sub(_flag, match[0]), message)
    return _UNDERSCORED.sub(_flag, message)


def cures_in_flags(text: str) -> str:
    """A text, such as a fit's summary, with flags in place of the arguments to which it gives a
    value, as in `gain="channels"`; names of numbers stay.
    """
    return _GIVEN.sub(lambda match: f"{FLAGS[match[1]]} {match[2]}", text)


def _flag(match: re.Match[str]) -> str:
    return FLAGS[match[1]]


def refuse(message: object) -> NoReturn:
    """End with 2: used wrongly, by flags or inputs that do not go together."""
    _end(2, message)


def fail(message: object) -> NoReturn:
    """End with 1: a file that cannot be read or written or is not what it should be, or a package
    that is missing.
    """
    _end(1, message)


def _end(code: int, message: object) -> NoReturn:
    if isinstance(message, OSError) and message.filename and message.strerror:
        message = f"{message.filename}: {message.strerror}"  # without the number of the error
    print(f"Error: {in_flags(str(message))}", file=sys.stderr)
    raise typer.Exit(code)


@contextmanager
def reported_errors(*written: Path) -> Iterator[None]:
    """End with one line and an exit code where the library raises.

    Where the content of a file is at fault, the library names the file first: one that is there, or
    one of those that are `written`.
    """
    try:
        yield
    except (OSError, ImportError) as error:
        fail(error)
    except (TypeError, ValueError) as error:
        at_fault = str(error).partition(": ")[0]
        if os.path.exists(at_fault) or at_fault in map(str, written):
            fail(error)
        refuse(error)


def require_package(extra: str, name: str) -> None:
    """Fail before long work without a package of an extra."""
    from uwaug._support.extras import require

    with reported_errors():
        require(extra, name)


def require_not_read(option: str, path: Path, inputs: Iterable[Path]) -> None:
    """Refuse to write over an input, --force or not."""
    if path.resolve() in {file.resolve() for file in inputs}:
        refuse(f"{path} is read, and would be written over: choose another {option}")


def require_writable(
    option: str,
    path: Path,
    *,
    force: bool,
    endings: tuple[str, ...] = (),
    inputs: Iterable[Path] = (),
) -> None:
    """Refuse, before any work, to write over an input, or unasked over another file, or to a name
    that does not end in one of `endings`; fail where no file can be.
    """
    if endings and path.suffix not in endings:
        refuse(f"{option} must end in {' or '.join(endings)}, got {path}")
    require_not_read(option, path, inputs)
    if path.exists() and not force:
        refuse(f"{path} exists: choose another file, or --force to write over it")
    if path.is_dir():
        fail(f"{path} is a folder: {option} must be a file")
    if not path.parent.is_dir():
        fail(f"there is no folder {path.parent} for {option}")


def print_written(*paths: Path | None) -> None:
    """Name the files that were written."""
    for path in filter(None, paths):
        print(f"{path}  ({path.stat().st_size / 1024:.0f} KiB)")


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Say on a terminal what is being done, for as long as it is."""
    from rich.console import Console

    errors = Console(stderr=True)
    if not errors.is_terminal:
        yield lambda _: None
        return
    with errors.status("starting") as line:
        yield line.update


class Counter:
    """Counts what is done of a long run: a bar on a terminal, else a line now and then."""

    def __init__(self, total: int, progress: "Progress | None") -> None:
        self._total, self._progress = total, progress
        self._task = None if progress is None else progress.add_task("", total=total, rate="")
        self._start = self._printed = time.monotonic()
        self.done = 0

    def advance(self) -> None:
        """Count one more."""
        self.done += 1
        now = time.monotonic()
        rate = self.done / max(now - self._start, 1e-9)
        if self._progress is not None and self._task is not None:
            self._progress.update(self._task, advance=1, rate=f"{rate:.3g}/s")
        elif now - self._printed > _PAUSE and self.done < self._total:
            self._printed = now
            left = (self._total - self.done) / rate
            line = f"{self.done} of {self._total}, {rate:.3g}/s, {left:.0f} s left"
            print(line, file=sys.stderr, flush=True)


@contextmanager
def counted(total: int) -> Iterator[Counter]:
    """A counter of `total` things, shown on standard error."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    if not console.is_terminal:
        yield Counter(total, None)
        return
    rate = TextColumn("{task.fields[rate]}")
    columns = (BarColumn(), MofNCompleteColumn(), rate, TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        yield Counter(total, progress)
