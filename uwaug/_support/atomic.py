"""Files that are written whole or not at all, and read only where they are files."""

import os
import re
import secrets
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["is_part", "remove_left", "require_regular", "written_whole"]

_PART = re.compile(r"\.uwaug-[0-9a-f]{16}\.part")
"""Names of files that are being written."""

_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe (FIFO)",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFLNK: "a symbolic link to itself",
}


def is_part(name: str) -> bool:
    """Whether a file's name is that of a file being written, or left by a process that was killed
    while it wrote.
    """
    return _PART.fullmatch(name) is not None


def remove_left(folder: Path) -> None:
    """Remove from a folder the files that were being written by processes that were killed. What
    living ones are writing stays, on systems that have locks.
    """
    for path in folder.glob(".uwaug-*.part"):
        if not is_part(path.name):
            continue
        with suppress(OSError):
            handle = os.open(path, os.O_RDWR)
            try:
                if _locked(handle):
                    path.unlink()
            finally:
                os.close(handle)


def _locked(handle: int) -> bool:
    """Lock a file for as long as it is open here; whether nobody else has done so."""
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


def require_regular(path: str | os.PathLike[str]) -> None:
    """Refuse a path that cannot be read as a file, before it is opened: opening a pipe would wait
    for somebody to write.

    Raises:
        OSError: if there is nothing at `path`, or what is no regular file.
    """
    _refuse_irregular(Path(path), os.stat(path))


@contextmanager
def written_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A file beside `path` to write to, which takes its place if nothing went wrong.

    A symbolic link stays, and what it points to is replaced. A file that exists keeps its mode, a
    new one has that of any new file. The part written so far is removed after any exception, also
    one that a signal raises; only a process killed at once leaves it, under a name that `is_part`
    knows.

    Raises:
        OSError: if `path` is something else than a regular file, such as a folder, a pipe or a
            device; if its folder is missing or cannot be written to; or, with `path` as the file's
            name, if it cannot be written.
    """
    # the target of a link that points nowhere is made
    target = Path(os.path.realpath(path))
    mode = _mode_of(target)
    part, handle = _new_part(target.parent, private=mode is not None)
    try:
        yield part
        if mode is not None:
            part.chmod(mode)
        _flush(part)
        part.replace(target)
        _flush_folder(target.parent)
    except OSError as error:
        if error.errno is not None and error.filename in (None, part, str(part)):
            error.filename = os.fspath(path)
        raise
    finally:
        if handle is not None:
            os.close(handle)
        part.unlink(missing_ok=True)


def _mode_of(target: Path) -> int | None:
    """The permissions of the file that will be replaced; None if there is none."""
    try:
        status = os.lstat(target)
    except FileNotFoundError:
        return None
    _refuse_irregular(target, status)
    return stat.S_IMODE(status.st_mode)


def _refuse_irregular(path: Path, status: os.stat_result) -> None:
    kind = stat.S_IFMT(status.st_mode)
    if kind == stat.S_IFREG:
        return
    refusal = IsADirectoryError if kind == stat.S_IFDIR else OSError
    raise refusal(f"path must be a file, but {path} is {_KINDS.get(kind, 'no regular file')}")


def _new_part(folder: Path, *, private: bool) -> tuple[Path, int | None]:
    """A new, empty file, and a handle that locks it (see `remove_left`). O_EXCL: whatever has
    that name, a link above all, is not opened.

    `private` until it takes the place of a file that may be; otherwise the process's own umask
    applies to it, as to any new file.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"path: there is no folder {folder}")
    part = folder / f".uwaug-{secrets.token_hex(8)}.part"
    try:
        handle = os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600 if private else 0o666)
    except OSError as error:
        reason = f"cannot write to the folder {folder}: {error.strerror}"
        raise type(error)(f"path: {reason}") from error
    if sys.platform == "win32":
        # which gives no open file another name
        os.close(handle)
        return part, None
    _locked(handle)
    return part, handle


def _flush(part: Path) -> None:
    """Onto the disk: else a crash of the machine could leave an empty file in place of the old."""
    with part.open("rb+") as file:
        os.fsync(file.fileno())


def _flush_folder(folder: Path) -> None:
    """The new entry too, where the system can do that."""
    with suppress(OSError, AttributeError):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
