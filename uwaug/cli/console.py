"""What commands have in common: how they end, and what they say meanwhile."""

import importlib.util
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

import typer
from rich.console import Console

__all__ = ["fail", "refuse", "require_matplotlib", "require_room", "said"]


def refuse(message: object) -> NoReturn:
    """For what was asked for wrongly."""
    _end(2, message)


def fail(message: object) -> NoReturn:
    """For what was asked for rightly and cannot be done."""
    _end(1, message)


def _end(code: int, message: object) -> NoReturn:
    print(f"Error: {message}", file=sys.stderr)
    raise typer.Exit(code)


def require_matplotlib(what: str) -> None:
    """Fail where what is to be drawn cannot be."""
    if importlib.util.find_spec("matplotlib") is None:
        cure = 'pip install ".[plot]" in a checkout of uwaug'
        fail(f"{what} with matplotlib, which is not installed: {cure}")


def require_room(path: Path, force: bool) -> None:
    """Before long work: refuse to write over a file, fail where none can be."""
    if path.exists() and not force:
        refuse(f"{path} exists: choose another file, or --force to write over it")
    if path.is_dir():
        fail(f"path must be a file, but {path} is a folder")
    if not path.parent.is_dir():
        fail(f"path: there is no folder {path.parent}")


@contextmanager
def said() -> Iterator[Callable[[str], None]]:
    """Says on a terminal what is being done, for as long as it is."""
    errors = Console(stderr=True)
    if not errors.is_terminal:
        yield lambda _: None
        return
    with errors.status("starting") as status:
        yield status.update
