"""What a file held: its hash."""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from uwaug._support.atomic import require_regular


@dataclass(frozen=True)
class FileHash:
    """A file as it was read: its absolute path, the SHA-256 of its content, and its size."""

    path: str
    sha256: str
    bytes: int

    @staticmethod
    def of(path: str | os.PathLike[str]) -> "FileHash":
        """Read a file for its hash.

        Raises:
            OSError: if it cannot be read.
        """
        require_regular(path)
        with Path(path).open("rb") as file:
            return FileHash.of_stream(file, os.path.abspath(path))

    @staticmethod
    def of_stream(file: BinaryIO, path: str) -> "FileHash":
        """Read an open file for its hash, from its beginning; `path` names it."""
        file.seek(0)
        digest = hashlib.sha256()
        while part := file.read(1 << 20):
            digest.update(part)
        return FileHash(path, digest.hexdigest(), file.tell())
