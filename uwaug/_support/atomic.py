"""Files that are written whole or not at all, and read only where they are files."""

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_PARTS = f".uwaug-{'[0-9a-f]' * 16}.part"  # that are being written, or left by killed processes
_writing: set[str] = set()  # names of the parts that this process has begun and not ended


def remove_left(folder: Path) -> None:
    """Remove unfinished files from a folder, also those of other living processes."""
    for path in folder.glob(_PARTS):
        if path.name not in _writing:
            with suppress(OSError):
                path.unlink()


def read_text(path: Path) -> str:
    """Text of a file in UTF-8, with a byte order mark or without, or in PowerShell's UTF-16."""
    require_regular(path)
    data = path.read_bytes()
    is_utf16 = data.startswith((b"\xff\xfe", b"\xfe\xff"))
    try:
        return data.decode("utf-16" if is_utf16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: is no text in UTF-8, save it as such: {error}") from None


def require_regular(path: str | os.PathLike[str]) -> None:
    """Refuse, by an OSError, what is no regular file: to open a pipe would wait for a writer."""
    if not stat.S_ISREG(os.stat(path).st_mode):
        raise OSError(f"path must be a regular file, got {path}")


@contextmanager
def written_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Open a context with a new file beside `path`, which takes its place at the end.

    A symbolic link stays, and its target is replaced. A file that exists keeps its mode. After any
    exception the new file is removed. Only a process killed at once leaves it, see `remove_left`.

    Raises:
        OSError: if `path` is no regular file, or it or its folder cannot be written.
    """
    # the target of a link that points nowhere is made
    target = Path(os.path.realpath(path))
    mode = None
    with suppress(FileNotFoundError):
        require_regular(target)
        mode = stat.S_IMODE(target.stat().st_mode)
    part = target.with_name(f".uwaug-{secrets.token_hex(8)}.part")
    _writing.add(part.name)
    try:
        # what replaces a file is nobody else's to read before it has that file's mode
        part.touch(0o666 if mode is None else 0o600, exist_ok=False)
        yield part
        if mode is not None:
            part.chmod(mode)
        with part.open("rb+") as file:
            # or a crash of the machine could leave an empty file in place of the old
            os.fsync(file.fileno())
        part.replace(target)
    except OSError as error:
        if error.errno is not None and error.filename in (None, part, str(part)):
            error.filename = os.fspath(path)
        raise
    finally:
        _writing.discard(part.name)
        with suppress(OSError):
            part.unlink()


def write_whole(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all; its folders are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as part:
        part.write_bytes(content)
