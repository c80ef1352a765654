"""What commands have in common: exit codes, errors, what they say meanwhile."""

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
    """End with 1: a file that cannot be read or written or is not what it should be, or a package
    that is missing; or with 2: used wrongly.
    """
    if isinstance(message, OSError) and message.filename and message.strerror:
        message = f"{message.filename}: {message.strerror}"  # without the number of the error
    print(f"Error: {message}", file=sys.stderr)
    raise typer.Exit(code)


@contextmanager
def reported_errors() -> Iterator[None]:
    """End with one line and an exit code where the library raises. Where the content of a file is
    at fault, the library names the file first.
    """
    try:
        yield
    except (OSError, ImportError) as error:
        end(1, error)
    except (TypeError, ValueError) as error:
        end(1 if os.path.exists(str(error).partition(": ")[0]) else 2, _with_flag(str(error)))


def _with_flag(message: str) -> str:
    """An error that begins with an argument of the library, with the flag that was given for it."""
    name = message.partition(" ")[0].rstrip(":")
    flag = f"--{name.replace('_', '-')}"
    is_given = any(word.partition("=")[0] == flag for word in sys.argv)
    return flag + message.removeprefix(name) if is_given else message


def require_folder(out: Path) -> None:
    """Refuse, before any work, the name of a picture where a command writes a folder of them."""
    from uwaug.files.pictures import ENDINGS

    if out.suffix.lower() in ENDINGS and not out.is_dir():
        end(2, f"--out must be a folder, for several pictures; got {out}")


def require_writable(path: Path, *, force: bool, endings: tuple[str, ...] = ()) -> None:
    """Refuse, before any work, to write over another file unasked, or to a name that does not end
    in one of `endings`; fail where no file can be.
    """
    if endings and path.suffix not in endings:
        end(2, f"--out must end in {' or '.join(endings)}, got {path}")
    if path.is_dir():
        end(1, f"{path} is a folder, and --out must be a file")
    if path.exists() and not force:
        end(2, f"{path} exists: choose another file, or --force to write over it")
    if not path.parent.is_dir():
        end(1, f"there is no folder {path.parent}")


def print_counts(summary: "Summary", what: str, out: Path) -> None:
    """Say how many pictures or maps a run has written to where."""
    skipped = summary.count("skipped")
    already = f", {skipped} were there" if skipped else ""
    print(f"{summary.count('written')} of {len(summary.results)} {what} written to {out}{already}")


def end_if_failed(failures: Sequence[str]) -> None:
    """End with 1 and the first of what went wrong, if anything did."""
    if failures:
        more = f"\nand {len(failures) - 5} more" if len(failures) > 5 else ""
        end(1, "\n".join(failures[:5]) + more)


def print_written(*paths: Path) -> None:
    """Name the files that were written."""
    for path in paths:
        print(f"{path}  ({path.stat().st_size / 1024:.0f} KiB)")


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Say on a terminal what is being done, for as long as it is."""
    from rich.console import Console

    with Console(stderr=True).status("starting") as line:
        yield line.update


@contextmanager
def counted() -> Iterator[Callable[[int, int], None]]:
    """Tell on a terminal how many of how many are done."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    console = Console(stderr=True)
    off = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=off) as progress:
        task = progress.add_task("", total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
