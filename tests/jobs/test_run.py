"""Runs of many pictures: by any number of workers, stopped and resumed, with workers that die."""

import csv
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import torch
from deadly import Deadly
from filing import content, metres, pixels, save

from uwaug._support.atomic import is_part
from uwaug.jobs import Items, Recipe, pool, run
from uwaug.jobs.index import index_of
from uwaug.labels import CocoLabels

COMMAND = [sys.executable, "-m", "uwaug", "degrade", "all", "--distance", "z.npy", "--random"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    here = Path(__file__).parent
    monkeypatch.setenv("PYTHONPATH", f"{here.parent.parent}{os.pathsep}{here.parent}")
    return tmp_path


def scene(count: int, height: int = 12, width: int = 16) -> None:
    for number in range(count):
        save(f"all/{number:02}.png", pixels(height, width, seed=number))
    save("z.npy", metres(height, width))


def items(out: str) -> Items:
    return Items([Path("all")], "z.npy", Path(out))


def test_bytes_depend_on_neither_workers_nor_order_nor_threads(folder):
    """Nor on where in memory things lie, which changes from picture to picture."""
    scene(6, 120, 160)
    recipe = Recipe(random=True, seed=4)
    results = list(run(items("by 2 workers"), recipe, workers=2))
    assert [result.status for result in results] == ["done"] * 6
    assert [result.item for result in results] == list(items("by 2 workers"))
    shuffled = list(items("shuffled"))
    random.Random(0).shuffle(shuffled)
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(5)
        list(run(shuffled, recipe))
        torch.set_num_threads(1)
        list(run(items("by 1 thread"), recipe))
    finally:
        torch.set_num_threads(before)
    expected = content("by 1 thread")
    assert len(expected) == 12
    assert content("by 2 workers") == expected
    assert content("shuffled") == expected


def test_one_bad_picture_does_not_stop_the_rest(folder):
    scene(3)
    Path("all/01.png").write_bytes(b"")
    first, second, third = run(items("out"), Recipe(water="II"))
    assert (first.status, second.status, third.status) == ("done", "failed", "done")
    assert second.reason == "all/01.png: is empty"
    assert set(content("out")) == {"00.png", "00.png.json", "02.png", "02.png.json"}


def test_one_process_reads_the_labels(folder, monkeypatch):
    """A COCO file can be large: workers get the labels of their pictures."""
    scene(3)
    images, annotations = [], []
    for i in range(3):
        images.append({"id": i, "file_name": f"{i:02}.png", "height": 12, "width": 16})
        annotations.append({"id": i, "image_id": i, "category_id": 1, "bbox": [1, 1, 5, 5]})
    Path("coco.json").write_text(json.dumps({"images": images, "annotations": annotations}))
    recipe = Recipe(water="II", labels="coco.json").resolved()
    source = recipe.open_labels()
    assert isinstance(source, CocoLabels)
    Path("coco.json").unlink()
    results = list(run(items("out"), recipe, workers=2, labels=source))
    assert [result.status for result in results] == ["done"] * 3
    hashes = {result.sidecar.label_file for result in results}
    assert hashes == {source.hash}
    assert [result.sidecar.labels["objects"][0]["key"] for result in results] == [0, 1, 2]
    kept = list(run(items("out"), recipe, resume=True, labels=source))
    assert [result.status for result in kept] == ["kept"] * 3


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


def living(leader: int) -> list[int]:
    """The processes of a group that have not ended. Linux."""
    pids = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            state, _, group = (entry / "stat").read_text().rsplit(")", 1)[1].split()[:3]
        except OSError:
            continue
        if int(group) == leader and state != "Z":
            pids.append(int(entry.name))
    return pids


def pictures(out: str) -> int:
    return len(list(Path(out).glob("*.png")))


def parts(out: str) -> list[str]:
    return [path.name for path in Path(out).rglob("*") if is_part(path.name)]


linux = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc")


@linux
def test_killed_and_resumed(folder):
    scene(12, 120, 160)
    assert len(list(run(items("whole"), Recipe(random=True)))) == 12
    process = start("out")
    wait_for(lambda: pictures("out") >= 3)
    process.kill()
    process.communicate()
    wait_for(lambda: not living(process.pid), 10)
    assert 3 <= pictures("out") < 12
    process = start("out", "--resume")
    process.communicate()
    assert process.returncode == 0
    found = content("out")
    lines = list(csv.DictReader(found.pop("index.csv").decode().splitlines()))
    assert found == content("whole")
    assert [line["output"] for line in lines] == [f"{n:02}.png" for n in range(12)]
    assert {line["status"] for line in lines} == {"kept", "done"}


@linux
@pytest.mark.parametrize(
    ("number", "all_of_them", "times", "code"),
    [
        (signal.SIGINT, True, 1, 130),
        (signal.SIGINT, True, 2, 130),  # an impatient hand
        (signal.SIGTERM, False, 1, 143),
    ],
)
def test_stopped_by_a_signal(folder, number, all_of_them, times, code):
    scene(40, 120, 160)
    process = start("out")
    wait_for(lambda: pictures("out") >= 2)
    # Ctrl-C goes to all processes of a terminal
    for _ in range(times):
        (os.killpg if all_of_them else os.kill)(process.pid, number)
        time.sleep(0.1)
    _, err = process.communicate(timeout=30)
    assert process.returncode == code
    assert "Traceback" not in err
    assert "Stopped: " in err
    assert "--resume goes on" in err
    wait_for(lambda: not living(process.pid), 10)
    assert parts("out") == []
    assert pictures("out") < 40
    assert not Path("out/index.csv").exists()


def test_a_picture_that_kills_its_worker_fails_alone(folder):
    scene(4)
    deadly = [item._replace(distance=Path(f"{item.id}.npy")) for item in items("out")]
    deadly[1] = deadly[1]._replace(distance=Path("deadly.npy"))
    for item in deadly:
        save(item.distance, metres())
    Path("out").mkdir()
    with index_of(Path("out")) as index:
        results = list(run(deadly, Recipe(water="II", distance=Deadly()), workers=2))
        for result in results:
            index.add(result)
    # what the worker has left is removed, and the index is no part of that
    assert len(Path("out/index.csv").read_text().splitlines()) == 5
    assert [result.status for result in results] == ["done", "failed", "done", "done"]
    assert "all/01.png: the process died over it" in str(results[1].reason)
    assert parts("out") == []


@pytest.mark.parametrize("force", [False, True])
def test_no_picture_is_lost_when_a_pool_breaks_between_two(folder, monkeypatch, force):
    """Broken before a picture is handed over, when others are written and not told of yet."""
    scene(6)
    submit, calls = pool.ProcessPoolExecutor.submit, []

    def broken(self, *arguments):
        calls.append(1)
        if len(calls) == 4:
            wait_for(lambda: pictures("out") == 3)
            raise pool.BrokenProcessPool
        return submit(self, *arguments)

    monkeypatch.setattr(pool.ProcessPoolExecutor, "submit", broken)
    results = list(run(items("out"), Recipe(water="II"), workers=2, force=force))
    assert [result.item.id for result in results] == [f"{n:02}.png" for n in range(6)]
    assert {result.status for result in results} == {"done"}
