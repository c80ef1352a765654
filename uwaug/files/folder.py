"""The folder of a run: one run at a time, and a manifest of what it writes."""

import json
import os
import socket
import sys
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from uwaug import __version__
from uwaug._support.atomic import require_regular, write_whole

MANIFEST = "uwaug-run.json"  # by whom, with what, and which files
NOT_OURS = "was not written by a run: move it, or choose another folder"

_LOCK = ".uwaug-run.lock"
_FAR_BYTE = 1 << 20  # Windows lets nobody read a byte that is locked
_ANEW = "force=True (--force) removes what it wrote, and begins anew"


def manifest_of(folder: Path) -> dict[str, Any] | None:
    """The manifest of the run that a folder is of; None without one."""
    try:
        require_regular(folder / MANIFEST)
        manifest = json.loads((folder / MANIFEST).read_bytes())
        names = map(Path, [*manifest["files"], *manifest["lists"]])
        is_inside = all(".." not in name.parts and not name.is_absolute() for name in names)
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None
    return manifest if is_inside else None


@contextmanager
def held(out: Path) -> Iterator[None]:
    """Open a context in which no other run works in a folder; a FileExistsError if one does. A
    process that is killed holds nothing.
    """
    out.mkdir(parents=True, exist_ok=True)
    with (out / _LOCK).open("a+", encoding="utf-8") as file:
        is_locked = _lock(file)
        # without a name, the file is that of a run that has just ended
        if not is_locked or not os.fstat(file.fileno()).st_nlink:
            file.seek(0)
            who = file.read() or "a process"
            raise FileExistsError(f"{out}: {who} is at work there: give each job its own --out")
        file.truncate(0)
        file.write(f"process {os.getpid()} on {socket.gethostname()}")
        file.flush()
        try:
            yield
        finally:
            with suppress(OSError):  # Windows removes no open file
                os.unlink(file.name)


def _lock(file: IO[str]) -> bool:
    """Lock a file until it is closed; False if another has. Some file systems have no locks."""
    try:
        if sys.platform == "win32":
            import msvcrt

            file.seek(_FAR_BYTE)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        pass
    return True


class RunFolder:
    """What a run may write in a folder that it holds: `files` of its results, and `lists` of all.
    Anything else in the folder is refused, but a run to `resume`, with the same `made_with`, or to
    remove by `force`. `inputs` are real paths of files that are read, and never removed.
    """

    def __init__(
        self,
        out: Path,
        made_with: Mapping[str, Any],
        files: Collection[str],
        inputs: Collection[str] = (),
        *,
        resume: bool = False,
        force: bool = False,
    ) -> None:
        self.out, earlier = out, manifest_of(out)
        if earlier is None:
            if any(not name.startswith(".") for name in os.listdir(out)):
                raise FileExistsError(f"{out} is not empty, and of no run: choose another folder")
        elif force:
            own = [out / name for name in earlier["files"]]
            if read := next((file for file in own if os.path.realpath(file) in inputs), None):
                raise ValueError(f"{read} is read, and would be removed: choose another folder")
            for file in own:
                file.unlink(missing_ok=True)
        elif not resume:
            raise FileExistsError(f"{out} is of a run: resume=True (--resume) goes on, {_ANEW}")
        else:
            if changes := [name for name, x in made_with.items() if earlier.get(name) != x]:
                got = f"{out} was made with another {' and '.join(changes)}"
                raise FileExistsError(f"{got}: choose another folder; {_ANEW}")
            results = {*earlier["files"]} - {*earlier["lists"]}
            if stale := [name for name in sorted(results - {*files}) if (out / name).exists()]:
                got = f"{out} holds {len(stale)} files that this run does not make"
                raise FileExistsError(f"{got}, such as {stale[0]}: remove them; or {_ANEW}")
        earlier = (resume and not force and earlier) or {"files": [], "lists": []}
        for name in {*files} - {*earlier["files"]}:
            if os.path.lexists(out / name):
                raise FileExistsError(f"{out / name} {NOT_OURS}")
        who = {"uwaug": __version__, "host": socket.gethostname(), "process": os.getpid()}
        lists = [*earlier["lists"]]
        self._manifest = {**who, **made_with, "files": [*files, *lists], "lists": lists}
        self._save()

    def write_lists(self, lists: Mapping[str, bytes]) -> list[str]:
        """Write files of all pictures, but those that no run has written: a sentence on each."""
        own, notes = self._manifest["lists"], []
        for name in lists.keys() - {*own}:
            if os.path.lexists(self.out / name):
                notes.append(f"{self.out / name} {NOT_OURS}")
            else:
                own.append(name)
                self._manifest["files"].append(name)
        self._save()
        for name in lists.keys() & {*own}:
            write_whole(self.out / name, lists[name])
        return notes

    def _save(self) -> None:
        write_whole(self.out / MANIFEST, f"{json.dumps(self._manifest, indent=1)}\n".encode())
