"""A run owns its folder: what it replaces, what stays, and whom it lets in."""

import json
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filing import content, metres, pixels, save

from uwaug import RandomUnderwater, RandomWater
from uwaug.files import Item, Recipe, degrade, find_items, read_picture, read_record
from uwaug.files.folder import MANIFEST, held, manifest_of

H, W = 24, 32
RECIPE = Recipe(RandomUnderwater(RandomWater("II", contrast=None)), labels="labels")
LOCK = ".uwaug-run.lock"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for number in range(3):
        save(f"all/{number}.png", pixels(H, W, seed=number))
        save(f"depth/{number}.npy", metres(H, W))
        write(f"labels/{number}.txt", "0 .5 .5 1 1\n")


def write(path: str | Path, text: str) -> None:
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(text)


def items() -> list[Item]:
    return find_items("all", "depth")


def statuses(recipe: Recipe = RECIPE, **options: Any) -> str:
    """The first letter of what became of each picture."""
    return "".join(r.status[0] for r in degrade(recipe, items(), "out", **options).results)


def test_a_manifest_says_who_with_what_and_which_files() -> None:
    degrade(RECIPE, items(), "out", sheet=True)
    manifest = manifest_of(Path("out"))
    assert manifest is not None
    lists = {"index.csv", "sheet.jpg", "train.txt", "data.yaml"}
    assert {*manifest["files"], *manifest["lists"]} == content("out").keys()
    assert {*manifest["lists"]} == lists
    assert manifest["recipe"] == read_record(Path("out/images/0.png.json"))["recipe"]
    assert (manifest["host"], manifest["process"]) == (socket.gethostname(), os.getpid())
    assert {path.name for path in Path("out").iterdir()} >= {MANIFEST}
    assert not Path("out", LOCK).exists()


def damaged() -> None:
    """A record lacks its recipe, and says of a truth that there is none of."""
    record = Path("out/images/1.png.json")
    entries = {**read_record(record), "truth": {"gain": 1}}
    del entries["recipe"]
    write(record, json.dumps(entries))


@pytest.mark.parametrize(
    "change, expected",
    [
        (lambda: None, "sss"),
        (lambda: Path("out/images/1.png").unlink(), "sws"),
        (lambda: Path("out/labels/1.txt").unlink(), "sws"),
        (lambda: Path("out/images/1.png.json").write_text('{"uwaug": '), "sws"),
        (damaged, "sws"),
        (lambda: save("all/1.png", pixels(H, W, seed=9)), "sws"),
        (lambda: save("depth/1.npy", 2 * metres(H, W)), "sws"),
        (lambda: Path("labels/1.txt").write_text("0 .5 .1 1 .2\n"), "sws"),
        (lambda: Path("all/1.png").write_bytes(b""), "sfs"),
        (lambda: save("all/3.png", pixels(H, W)), "sssf"),  # without a map
    ],
)
def test_resume_makes_what_is_not_there_or_of_other_files(
    change: Callable[[], Any], expected: str
) -> None:
    degrade(RECIPE, items(), "out")
    change()
    before = content("out")
    assert statuses(resume=True) == expected
    after = content("out")
    changed = {name for name in {*before, *after} if before.get(name) != after.get(name)}
    assert not any(name.startswith(("images/0", "images/2", "labels/0")) for name in changed)
    if "f" not in expected:
        degrade(RECIPE, items(), "new")
        fresh = content("new")
        assert {**after, "index.csv": b""} == {**fresh, "index.csv": b""}


@pytest.mark.parametrize(
    "change, recipe, message",
    [
        (lambda: None, replace(RECIPE, seed=5), "out was made with another recipe: choose another"),
        (lambda: None, replace(RECIPE, labels=None), "out was made with another recipe"),
        (
            lambda: Path("all/1.png").unlink(),
            RECIPE,
            r"out holds 3 files that this run does not make, such as images/1\.png: remove them",
        ),
        (lambda: Path("labels/1.txt").unlink(), RECIPE, r"holds 1 files .* labels/1\.txt"),
        (
            lambda: [save("all/3.png", pixels(H, W)), write("out/images/3.png", "mine")],
            RECIPE,
            r"out/images/3\.png was not written by a run: move it",
        ),
        (lambda: write(f"out/{MANIFEST}", '{"files"'), RECIPE, "out is not empty, and of no run"),
        (
            lambda: write(f"out/{MANIFEST}", '{"files": ["../all/0.png"], "lists": {}}'),
            RECIPE,
            "out is not empty, and of no run",
        ),
    ],
)
def test_another_run_is_refused(change: Callable[[], Any], recipe: Recipe, message: str) -> None:
    degrade(RECIPE, items(), "out")
    change()
    before = content(".")
    with pytest.raises(FileExistsError, match=message):
        degrade(recipe, items(), "out", resume=True)
    assert content(".") == before


@pytest.mark.parametrize("options", [{}, {"resume": True}, {"force": True}])
@pytest.mark.parametrize("own", ["index.csv", "notes.txt", "images/1.png"])
def test_a_folder_of_ones_own_is_no_run_s(own: str, options: dict[str, bool]) -> None:
    write(f"out/{own}", "mine")
    with pytest.raises(FileExistsError, match="out is not empty, and of no run"):
        degrade(RECIPE, items(), "out", **options)
    assert content("out") == {own: b"mine"}
    save("single.png", pixels())
    with pytest.raises(FileExistsError, match=r"single\.png was not written by a run: move it"):
        degrade(replace(RECIPE, labels=None), items()[:1], "single.png", **options)
    assert np.array_equal(read_picture("single.png").permute(1, 2, 0), pixels())


def test_force_removes_what_a_run_has_written_and_nothing_else() -> None:
    degrade(replace(RECIPE, maps="npy", variants=2), items(), "out", sheet=True)
    with pytest.raises(FileExistsError, match=r"but of a run: .*--resume.*--force"):
        degrade(RECIPE, items(), "out")
    write("out/notes.txt", "mine")
    write("out/data.yaml", "names: [crab]\n")
    Path("all/1.png").write_bytes(b"")
    summary = degrade(RECIPE, items()[1:], "out", force=True)
    assert [result.status for result in summary.results] == ["failed", "written"]
    assert content("out").keys() == {
        *("images/2.png", "images/2.png.json", "labels/2.txt", "notes.txt"),
        *("index.csv", "data.yaml", "train.txt"),
    }
    assert "out/data.yaml stays, as it was edited" in summary.notes[-1]
    assert Path("out/data.yaml").read_text() == "names: [crab]\n"
    # what is read is not removed
    before = content(".")
    with pytest.raises(ValueError, match=r"out/labels/2.txt is read, and would be"):
        degrade(replace(RECIPE, labels="out/labels"), items()[2:], "out", force=True)
    assert content(".") == before


@pytest.mark.parametrize("name", ["data.yaml", "index.csv", "train.txt", "sheet.jpg"])
def test_lists_that_were_edited_stay(name: str) -> None:
    degrade(RECIPE, items()[:2], "out", sheet=True)
    file = Path("out", name)
    edited = file.read_bytes() + b"mine\n"
    file.write_bytes(edited)
    notes = degrade(RECIPE, items(), "out", resume=True, sheet=True).notes
    (note,) = (note for note in notes if "edited" in note)
    assert note.startswith(f"out/{name} stays, as it was edited: remove it")
    assert file.read_bytes() == edited
    file.unlink()
    degrade(RECIPE, items(), "out", resume=True, sheet=True)
    assert b"mine" not in file.read_bytes()


def test_a_run_that_makes_nothing_lists_nothing_anew() -> None:
    degrade(RECIPE, items(), "out")
    before = content("out")
    for picture in Path("all").iterdir():
        picture.write_bytes(b"")
    assert statuses(resume=True) == "fff"
    assert {**content("out"), "index.csv": b""} == {**before, "index.csv": b""}


def test_files_of_ones_own_in_the_places_of_a_run_stay() -> None:
    degrade(RECIPE, items(), "out")
    for name in ("images/1.png", "images/1.png.json"):
        Path("out", name).unlink()
    write("out/images/1.png", "mine")
    (failure,) = degrade(RECIPE, items(), "out", resume=True).failures
    assert "out/images/1.png was not written by a run: move it" in failure
    assert Path("out/images/1.png").read_text() == "mine"


# Two runs at once

WAITING = """
import sys
from pathlib import Path
from uwaug.files.folder import held
with held(Path("out")):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_two_runs_at_once_are_refused_and_a_killed_one_holds_nothing() -> None:
    line = [sys.executable, "-c", WAITING]
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(line, **pipes) as process:
        assert process.stdout.readline() == b"held\n"  # type: ignore[union-attr]
        expected = f"out: process {process.pid} on {socket.gethostname()} is at work there: give"
        with pytest.raises(FileExistsError, match=expected):
            degrade(RECIPE, items(), "out")
        process.kill()
    assert Path("out", LOCK).exists()
    assert statuses(progress=lambda done, count: refused()) == "www"
    assert not Path("out", LOCK).exists()


def refused() -> None:
    with pytest.raises(FileExistsError, match=f"process {os.getpid()} on .* at work there"):
        degrade(RECIPE, items(), "out", resume=True)


@pytest.mark.parametrize("silence, is_refused", [(10, True), (1000, False)])
def test_a_run_on_a_machine_whose_lock_is_not_seen(silence: float, is_refused: bool) -> None:
    write(Path("out", LOCK), "process 7 on node-9")
    then = Path("out", LOCK).stat().st_mtime - silence
    os.utime(Path("out", LOCK), (then, then))
    if not is_refused:
        assert statuses() == "www"
        return
    with pytest.raises(FileExistsError, match="process 7 on node-9 is at work there: give each"):
        degrade(RECIPE, items(), "out")


def test_an_error_within_frees_the_folder() -> None:
    with pytest.raises(FileNotFoundError, match="mine"), held(Path("out")):
        raise FileNotFoundError("mine")
    assert not Path("out", LOCK).exists()
