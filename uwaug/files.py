"""Files that are written whole or not at all."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["written_whole"]


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A file beside `path` to write to, which takes its place if nothing went wrong.

    Raises:
        OSError: if `path` is a folder, or its folder is missing or cannot be written to.
    """
    if path.is_dir():
        raise IsADirectoryError(f"path must be a file, but {path} is a folder")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"path: there is no folder {path.parent}")
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        reason = f"cannot write to the folder {path.parent}: {error.strerror}"
        raise type(error)(f"path: {reason}") from error
    os.close(handle)
    part = Path(name)
    try:
        yield part
        # what a new file would have: mkstemp's is for the owner alone
        mask = os.umask(0)
        os.umask(mask)
        part.chmod(0o666 & ~mask)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
