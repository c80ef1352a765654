import errno
import os
import secrets
import stat
from pathlib import Path

import pytest

from uwaug._support.atomic import remove_left, require_regular, written_whole


def write(path: Path, text: str = "new") -> Path:
    """Write a file; return the name of its part."""
    with written_whole(path) as part:
        part.write_text(text)
    return part


@pytest.fixture
def umask():
    """A mask of files that a group may read, and no others."""
    change = os.umask
    before = change(0o027)
    yield
    change(before)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_new_file_has_the_mode_of_any_and_an_old_one_keeps_its_own(tmp_path, umask, monkeypatch):
    def changed(_: int) -> int:
        raise AssertionError("other threads would see it")

    monkeypatch.setattr(os, "umask", changed)
    path = tmp_path / "a.txt"
    write(path)
    assert mode(path) == 0o640
    for kept in (0o600, 0o666, 0o444):
        path.chmod(kept)
        with written_whole(path) as part:
            assert mode(part) & 0o077 & ~kept == 0  # no more may read it before, either
            part.write_text(f"{kept}")
        assert (mode(path), path.read_text()) == (kept, f"{kept}")


def test_a_link_stays_and_its_target_is_replaced(tmp_path):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    link, target = tmp_path / "link", folder / "target"
    for old in ("old", None):
        target.unlink(missing_ok=True)
        if old is not None:
            target.write_text(old)
        link.unlink(missing_ok=True)
        link.symlink_to(Path("elsewhere", "target"))
        write(link)
        assert link.is_symlink()
        assert target.read_text() == "new"
        assert [path.name for path in folder.iterdir()] == ["target"]
    circle = tmp_path / "circle"
    circle.symlink_to(circle)
    with pytest.raises(OSError, match="symbolic links"):
        write(circle)


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo], ids=["folder", "pipe"])
@pytest.mark.parametrize("linked", [False, True])
def test_what_is_no_regular_file_is_refused(tmp_path, make, linked):
    path = tmp_path / "it"
    make(path)
    before = path.stat()
    if linked:
        path = tmp_path / "link"
        path.symlink_to("it")
    count = len(list(tmp_path.iterdir()))
    for refused in (write, require_regular):
        with pytest.raises(OSError, match="path must be a regular file"):
            refused(path)
    after = path.stat()
    assert (after.st_ino, after.st_mode) == (before.st_ino, before.st_mode)
    assert len(list(tmp_path.iterdir())) == count


FULL = OSError(errno.ENOSPC, "Full")


@pytest.mark.parametrize("error", [ValueError(), KeyboardInterrupt(), FULL])
def test_nothing_is_left_after_an_exception(tmp_path, error):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(type(error)) as info, written_whole(path) as part:  # noqa: PT012
        part.write_text("half")
        remove_left(tmp_path)
        assert part.exists()
        raise error
    if isinstance(error, OSError):
        assert "Full: " in str(info.value)
        assert str(path) in str(info.value)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_killed_processes_have_left_is_removed_and_no_part_of_this_one(tmp_path):
    """Such as the index of a run, when one of its workers has died."""
    for name in (f".uwaug-{secrets.token_hex(8)}.part", ".uwaug-mine.part"):
        (tmp_path / name).touch()
    with written_whole(tmp_path / "index.csv") as part:
        part.write_text("kept")
        remove_left(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {".uwaug-mine.part", "index.csv"}
    assert (tmp_path / "index.csv").read_text() == "kept"
    part.touch()
    remove_left(tmp_path)
    assert not part.exists()
