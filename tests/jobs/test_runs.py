"""Runs of many pictures: by any number of workers, stopped and resumed, with workers that die."""

import csv
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import torch
from filing import content, metres, pixels, save

from benchmarks.accuracy.jobs_kill import living
from uwaug._support.atomic import is_part
from uwaug.jobs import Recipe, Rows
from uwaug.jobs import run as jobs
from uwaug.jobs.run import run

COMMAND = [sys.executable, "-m", "uwaug", "degrade", "all", "--distance", "z.npy", "--random"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent.parent.parent))
    return tmp_path


def scene(count: int, height: int = 12, width: int = 16) -> None:
    for number in range(count):
        save(f"all/{number:02}.png", pixels(height, width, seed=number))
    save("z.npy", metres(height, width))


def rows(inputs: str, out: str) -> Rows:
    return Rows([Path(inputs)], None if inputs.endswith("csv") else "z.npy", Path(out))


def test_bytes_do_not_depend_on_workers_or_order(folder):
    scene(9)
    recipe = Recipe(random=True, seed=4)
    for workers in (1, 2, 4):
        outcomes = list(run(rows("all", f"by {workers}"), recipe, workers=workers))
        assert [one.status for one in outcomes] == ["done"] * 9
        assert [one.row.id for one in outcomes] == [f"{n:02}.png" for n in range(9)]
    lines = [f"all/{n:02}.png,{n:02}.png,z.npy,{n:02}.png" for n in (5, 0, 8, 2, 7, 1, 3, 6, 4)]
    Path("list.csv").write_text("\n".join(["input,id,distance,output", *lines]))
    list(run(rows("list.csv", "shuffled"), recipe))
    expected = content("by 1")
    assert len(expected) == 18
    for out in ("by 2", "by 4", "shuffled"):
        assert content(out) == expected


# What is stopped


def start(out: str, *more: str) -> "subprocess.Popen[str]":
    """A run in a group of processes of its own."""
    return subprocess.Popen(
        [*COMMAND, "--out", out, "--workers", "2", *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # a shell that starts the tests in the background has them ignore Ctrl-C
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    )


def wait_for(what: Callable[[], bool], seconds: float = 60) -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end
        time.sleep(0.01)


def pictures(out: str) -> int:
    return len(list(Path(out).glob("*.png")))


def parts(out: str) -> list[str]:
    return [path.name for path in Path(out).rglob("*") if is_part(path.name)]


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc")
def test_killed_and_resumed(folder):
    scene(16, 120, 160)
    list_of = rows("all", "whole")
    assert len(list(run(list_of, Recipe(random=True)))) == 16
    # killed when so many pictures are there
    for done in (1, 9):
        process = start("out", "--resume")
        wait_for(lambda done=done: pictures("out") >= done)
        process.kill()
        process.communicate()
        wait_for(lambda process=process: not living(process.pid), 10)
    assert 9 <= pictures("out") < 16
    process = start("out", "--resume")
    process.communicate()
    assert process.returncode == 0
    found = content("out")
    lines = list(csv.DictReader(found.pop("index.csv").decode().splitlines()))
    found.pop("index.parquet", None)
    assert found == content("whole")
    assert [line["output"] for line in lines] == [f"{n:02}.png" for n in range(16)]
    assert {line["status"] for line in lines} == {"kept", "done"}


@pytest.mark.parametrize(
    ("number", "all_of_them", "code"),
    [(signal.SIGINT, True, 130), (signal.SIGTERM, False, 143), (signal.SIGTERM, True, 143)],
)
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc")
def test_stopped_by_a_signal(folder, number, all_of_them, code):
    scene(40, 120, 160)
    process = start("out")
    wait_for(lambda: pictures("out") >= 2)
    # Ctrl-C goes to all processes of a terminal, as does what a scheduler sends
    (os.killpg if all_of_them else os.kill)(process.pid, number)
    _, err = process.communicate(timeout=30)
    assert process.returncode == code
    assert "Traceback" not in err
    assert "Stopped: " in err
    assert "--resume goes on" in err
    wait_for(lambda: not living(process.pid), 10)
    assert parts("out") == []
    assert pictures("out") < 40
    assert not Path("out/index.csv").exists()


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc")
def test_a_worker_that_is_killed_stops_nothing(folder):
    scene(16, 120, 160)
    process = start("out")
    wait_for(lambda: pictures("out") >= 2)
    os.kill(workers(process.pid)[0], signal.SIGKILL)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert "16 of 16 pictures" in out
    assert parts("out") == []
    list(run(rows("all", "whole"), Recipe(random=True)))
    found = content("out")
    assert {name: found[name] for name in content("whole")} == content("whole")
    assert len(found) == 32 + len({"index.csv", "index.parquet"} & set(found))


def workers(leader: int) -> list[int]:
    return [pid for pid in living(leader) if _is_worker(pid)]


def _is_worker(pid: int) -> bool:
    """One that a server of processes has made."""
    try:
        parent = int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1])
        return b"forkserver" in Path(f"/proc/{parent}/cmdline").read_bytes()
    except OSError:
        return False


def killing(row, recipe, **_):
    """In place of `degrade_file`: a decoder that takes its process with it."""
    if row.id == "01.png":
        os.kill(os.getpid(), signal.SIGKILL)
    return _DEGRADE(row, recipe)


_DEGRADE = jobs.degrade_file


def test_a_picture_that_kills_its_worker_fails_alone(folder, monkeypatch):
    scene(4)
    monkeypatch.setattr(jobs, "degrade_file", killing)
    outcomes = list(run(rows("all", "out"), Recipe(water="II"), workers=2))
    assert [one.status for one in outcomes] == ["done", "failed", "done", "done"]
    assert "all/01.png: the process died over it" in str(outcomes[1].reason)


def test_bytes_do_not_depend_on_threads(folder):
    """Nor on where in memory things lie, which changes from picture to picture."""
    scene(3, 120, 160)
    before = torch.get_num_threads()
    try:
        for threads in (1, 2, 5):
            torch.set_num_threads(threads)
            list(run(rows("all", f"by {threads}"), Recipe(random=True)))
    finally:
        torch.set_num_threads(before)
    assert content("by 1") == content("by 2") == content("by 5")


@pytest.mark.parametrize("force", [False, True])
def test_no_picture_is_lost_when_a_pool_breaks_between_two(folder, monkeypatch, force):
    """Broken before a picture is handed over, when others are written and not told of yet."""
    scene(6)
    submit, calls = jobs.ProcessPoolExecutor.submit, []

    def broken(self, *arguments):
        calls.append(1)
        if len(calls) == 4:
            wait_for(lambda: pictures("out") == 3)
            raise jobs.BrokenProcessPool
        return submit(self, *arguments)

    monkeypatch.setattr(jobs.ProcessPoolExecutor, "submit", broken)
    outcomes = list(run(rows("all", "out"), Recipe(water="II"), workers=2, force=force))
    assert [one.row.id for one in outcomes] == [f"{n:02}.png" for n in range(6)]
    assert {one.status for one in outcomes} == {"done"}
