"""Exit codes, errors and progress of commands."""

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import typer

if TYPE_CHECKING:
    from uwaug.files.summary import Summary


def end(code: int, message: object) -> NoReturn:
    """Print an error and end, with code 1 if a file or a package failed, 2 for wrong use."""
    if isinstance(message, OSError) and message.filename and message.strerror:
        message = f"{message.filename}: {message.strerror}"  # without the number of the error
    print(f"Error: {message}", file=sys.stderr)
    raise typer.Exit(code)


@contextmanager
def reported_errors() -> Iterator[None]:
    """End with one line and an exit code where the library raises. Messages on the content of a
    file begin with its name.
    """
    try:
        yield
    except (OSError, ImportError) as error:
        end(1, error)
    except (TypeError, ValueError) as error:
        end(1 if os.path.exists(str(error).partition(": ")[0]) else 2, _with_flag(str(error)))


def _with_flag(message: str) -> str:
    name = message.partition(" ")[0].rstrip(":")
    flag = f"--{name.replace('_', '-')}"
    is_given = any(word.partition("=")[0] == flag for word in sys.argv)
    rest = message.removeprefix(name).removeprefix(f" ({flag})")  # which some name themselves
    return flag + rest if is_given else message


def require_folder(out: Path) -> None:
    """Refuse the name of a picture where a command writes a folder of pictures."""
    from uwaug.files.pictures import ENDINGS

    if out.suffix.lower() in ENDINGS and not out.is_dir():
        end(2, f"--out must be a folder, for several pictures; got {out}")


def require_writable(path: Path, *, force: bool, endings: tuple[str, ...] = ()) -> None:
    """Refuse, before any work, a file that cannot be written, that exists, or with another end."""
    if endings and path.suffix not in endings:
        end(2, f"--out must end in {' or '.join(endings)}, got {path}")
    if path.is_dir():
        end(1, f"{path} is a folder, and --out must be a file")
    if path.exists() and not force:
        end(2, f"{path} exists: choose another file, or --force to write over it")
    if not path.parent.is_dir():
        end(1, f"there is no folder {path.parent}")


def print_counts(summary: "Summary", what: str, out: Path) -> None:
    """Print how many pictures or maps a run has written to a folder."""
    skipped = summary.count("skipped")
    more = f", {skipped} were there" if skipped else ""
    print(f"{summary.count('written')} of {len(summary.results)} {what} written to {out}{more}")


def end_if_failed(failures: Sequence[str]) -> None:
    """End with code 1 and the first five failures, if there are any."""
    if failures:
        more = f"\nand {len(failures) - 5} more" if len(failures) > 5 else ""
        end(1, "\n".join(failures[:5]) + more)


def print_written(*paths: Path) -> None:
    """Print names and sizes of files."""
    for path in paths:
        print(f"{path}  ({path.stat().st_size / 1024:.0f} KiB)")


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Show the step that the command is at: on a terminal in place of the one before."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda step: print(step, file=sys.stderr, flush=True)
        return
    with console.status("starting") as line:
        yield line.update


@contextmanager
def counted() -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar, on a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    console = Console(stderr=True)
    disable = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=disable) as progress:
        task = progress.add_task("", total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
