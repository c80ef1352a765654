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

import pytest
from filing import content, metres, pixels, save

from uwaug import RandomUnderwater, RandomWater
from uwaug.files import Recipe, Row, degrade, propose, read_record
from uwaug.files.folder import MANIFEST, held, manifest_of

H, W = 24, 32
RECIPE = Recipe(RandomUnderwater(RandomWater("II", contrast=None)))
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


def rows() -> list[Row]:
    return propose("all", "depth", "labels")


def statuses(recipe: Recipe = RECIPE, **options: Any) -> str:
    """The first letter of what became of each picture."""
    return "".join(r.status[0] for r in degrade(recipe, rows(), "out", **options).results)


def test_a_manifest_says_who_with_what_and_which_files() -> None:
    degrade(RECIPE, rows(), "out", sheet=True)
    manifest = manifest_of(Path("out"))
    assert manifest is not None
    lists = {"table.csv", "index.csv", "sheet.jpg", "train.txt", "data.yaml"}
    assert {*manifest["files"]} == content("out").keys()
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
        (damaged, "sws"),
        (lambda: save("all/3.png", pixels(H, W)) and save("depth/3.npy", metres(H, W)), "sssw"),
        (lambda: [Path("labels/1.txt").unlink(), Path("out/labels/1.txt").unlink()], "sws"),
        (lambda: Path("depth/1.npy").rename("depth/1.NPY"), "sws"),
    ],
)
def test_resume_makes_what_is_not_there_or_of_another_row(
    change: Callable[[], Any], expected: str
) -> None:
    degrade(RECIPE, rows(), "out")
    change()
    before = content("out")
    assert statuses(resume=True) == expected
    after = content("out")
    changed = {name for name in {*before, *after} if before.get(name) != after.get(name)}
    assert not any(name.startswith(("images/0", "images/2", "labels/0")) for name in changed)
    degrade(RECIPE, rows(), "new")
    fresh = content("new")
    assert {**after, "index.csv": b""} == {**fresh, "index.csv": b""}


def test_frames_are_made_anew_where_their_film_has_changed() -> None:
    frames = propose("all", "depth", sequence=True)
    degrade(RECIPE, frames, "film")
    later = [*frames[:2], frames[2]._replace(time=9.0)]
    done = degrade(RECIPE, later, "film", resume=True).results
    assert [result.status[0] for result in done] == ["s", "w", "w"]  # the usual step is another
    done = degrade(RECIPE, [row._replace(film="") for row in later], "film", resume=True).results
    assert [result.status[0] for result in done] == ["w"] * 3


@pytest.mark.parametrize(
    "change, recipe, message",
    [
        (lambda: None, replace(RECIPE, seed=5), "out was made with another recipe: choose another"),
        (
            lambda: Path("all/1.png").unlink(),
            RECIPE,
            r"out holds 3 files that this run does not make, such as images/1\.png: remove them",
        ),
        (
            lambda: [
                save("all/3.png", pixels(H, W)),
                save("depth/3.npy", metres(H, W)),
                write("out/images/3.png", "mine"),
            ],
            RECIPE,
            r"out/images/3\.png was not written by a run: move it",
        ),
        (
            lambda: write(f"out/{MANIFEST}", '{"files": ["../all/0.png"], "lists": []}'),
            RECIPE,
            "out is not empty, and of no run",
        ),
    ],
)
def test_another_run_is_refused(change: Callable[[], Any], recipe: Recipe, message: str) -> None:
    degrade(RECIPE, rows(), "out")
    change()
    before = content(".")
    with pytest.raises(FileExistsError, match=message):
        degrade(recipe, rows(), "out", resume=True)
    assert content(".") == before


@pytest.mark.parametrize("options", [{}, {"resume": True}, {"force": True}])
@pytest.mark.parametrize("own", ["index.csv", "notes.txt", "images/1.png"])
def test_a_folder_of_ones_own_is_no_run_s(own: str, options: dict[str, bool]) -> None:
    write(f"out/{own}", "mine")
    with pytest.raises(FileExistsError, match="out is not empty, and of no run"):
        degrade(RECIPE, rows(), "out", **options)
    assert content("out") == {own: b"mine"}


def test_force_removes_what_a_run_has_written_and_nothing_else() -> None:
    degrade(replace(RECIPE, maps="npy", variants=2), rows(), "out", sheet=True)
    with pytest.raises(FileExistsError, match=r"out is of a run: .*--resume.*--force"):
        degrade(RECIPE, rows(), "out")
    write("out/notes.txt", "mine")
    Path("all/1.png").write_bytes(b"")
    summary = degrade(RECIPE, rows()[1:], "out", force=True)
    assert [result.status for result in summary.results] == ["failed", "written"]
    assert content("out").keys() == {
        *("images/2.png", "images/2.png.json", "labels/2.txt", "notes.txt"),
        *("table.csv", "index.csv", "data.yaml", "train.txt"),
    }
    # what is read is not removed
    before = content(".")
    again = [row._replace(labels=Path("out/labels/2.txt")) for row in rows()[2:]]
    with pytest.raises(ValueError, match=r"out/labels/2.txt is read, and would be"):
        degrade(RECIPE, again, "out", force=True)
    assert content(".") == before


def test_a_list_that_no_run_has_written_stays() -> None:
    degrade(RECIPE, rows()[:2], "out")
    write("out/sheet.jpg", "mine")
    notes = degrade(RECIPE, rows(), "out", resume=True, sheet=True).notes
    assert "out/sheet.jpg was not written by a run: move it, or choose another folder" in notes
    assert Path("out/sheet.jpg").read_text() == "mine"
    assert "2.png" in Path("out/train.txt").read_text()


def test_a_run_that_makes_nothing_lists_no_labels_anew() -> None:
    degrade(RECIPE, rows(), "out")
    before = content("out")
    for picture in Path("all").iterdir():
        picture.write_bytes(b"")
        Path("out/images", picture.name).unlink()
    assert statuses(resume=True) == "fff"
    assert all(content("out")[name] == before[name] for name in ("train.txt", "data.yaml"))


def test_files_of_ones_own_in_the_places_of_a_run_stay() -> None:
    degrade(RECIPE, rows(), "out")
    for name in ("images/1.png", "images/1.png.json"):
        Path("out", name).unlink()
    write("out/images/1.png", "mine")
    (failure,) = degrade(RECIPE, rows(), "out", resume=True).failures
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
            degrade(RECIPE, rows(), "out")
        process.kill()
    assert Path("out", LOCK).exists()
    assert statuses() == "www"
    assert not Path("out", LOCK).exists()


def test_an_error_within_frees_the_folder() -> None:
    with pytest.raises(FileNotFoundError, match="mine"), held(Path("out")):
        raise FileNotFoundError("mine")
    assert not Path("out", LOCK).exists()
