"""A run of `uwaug degrade` that is killed again and again, and goes on.

`python -m benchmarks.accuracy.jobs_kill [FILES] [KILLS]` degrades 200 pictures with two workers,
killed ten times with signal 9 (the command, or one of its workers) at random moments, each time
started again with --resume; then once more without being killed. It writes results/jobs_kill.json:
whether pictures, records and index are those of an undisturbed run, whether anything is left over,
and after how many seconds the last process of a killed run was gone.
"""

import argparse
import csv
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.harness import ROOT, save
from uwaug._support.atomic import is_part

SEED = 11
SIZE = (120, 160)


def scene(folder: Path, files: int) -> None:
    """Pictures, and distances of all of them."""
    rng = np.random.default_rng(SEED)
    (folder / "all").mkdir()
    for number in range(files):
        pixels = rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(folder / f"all/{number:04}.png")
    z = np.linspace(1, 6, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE)
    np.save(folder / "z.npy", z)


def start(folder: Path, out: str) -> "subprocess.Popen[str]":
    """The command, in a group of processes of its own."""
    command = [sys.executable, "-m", "uwaug", "degrade", "all", "--distance", "z.npy"]
    command += ["--random", "--seed", "3", "--keep-terms", "--workers", "2", "--resume"]
    return subprocess.Popen(
        [*command, "--out", out],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def living(leader: int) -> list[int]:
    """The processes of a group that have not ended. Linux."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            state, _, of = (entry / "stat").read_text().rsplit(")", 1)[1].split()[:3]
        except OSError:
            continue
        if int(of) == leader and state != "Z":
            found.append(int(entry.name))
    return found


def workers(leader: int) -> list[int]:
    """Those of a group that a server of processes has made."""
    found = []
    for pid in living(leader):
        try:
            parent = int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1])
            command = Path(f"/proc/{parent}/cmdline").read_bytes()
        except OSError:
            continue
        if b"forkserver" in command:
            found.append(pid)
    return found


def done(out: Path) -> int:
    """Pictures that are there, without their terms."""
    return sum("_" not in path.name for path in out.glob("*.png"))


def killed(folder: Path, files: int, kills: int) -> list[dict[str, Any]]:
    """Run until all is done, killed on the way; what happened at each kill."""
    rng, out, found = random.Random(SEED), folder / "killed", []
    for number in range(kills):
        process = start(folder, "killed")
        # some new pictures later: the moment after the last of them is random too
        goal = min(done(out) + rng.randrange(2 * files // (kills + 1)), files - 1)
        while process.poll() is None and done(out) < goal:
            time.sleep(0.01)
        time.sleep(rng.random() / 2)
        found.append({"number": number, "pictures": done(out), **_kill(process, rng)})
        print(found[-1], flush=True)
    process = start(folder, "killed")
    _, err = process.communicate()
    if process.returncode:
        raise RuntimeError(f"the last run failed: {err}")
    return found


def _kill(process: "subprocess.Popen[str]", rng: random.Random) -> dict[str, Any]:
    """Kill a run's command; every third time a worker first, which must not stop the run."""
    survived = None
    below = workers(process.pid)
    if below and rng.randrange(3) == 0:
        os.kill(rng.choice(below), signal.SIGKILL)
        time.sleep(2 * rng.random())
        survived = process.poll() is None
    process.kill()
    began = time.perf_counter()
    process.wait()
    while living(process.pid):
        if time.perf_counter() - began > 30:
            raise RuntimeError(f"processes {living(process.pid)} go on")
        time.sleep(0.01)
    process.communicate()
    return {"survived_worker": survived, "gone_after_s": time.perf_counter() - began}


def content(folder: Path) -> dict[str, bytes]:
    """Pictures and records."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix in (".png", ".json"):
            found[path.relative_to(folder).as_posix()] = path.read_bytes()
    return found


def index(folder: Path) -> list[dict[str, str]]:
    """Its lines, without what tells the time."""
    with (folder / "index.csv").open(newline="") as file:
        return [{**line, "seconds": "", "status": ""} for line in csv.DictReader(file)]


def main(quick: bool = False, files: int = 200, kills: int = 10) -> dict[str, Any]:
    """Print and save; return what is saved (nothing is, if quick)."""
    if quick:
        files, kills = 12, 1
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene(folder, files)
        found = killed(folder, files, kills)
        process = start(folder, "whole")
        _, err = process.communicate()
        if process.returncode:
            raise RuntimeError(f"the undisturbed run failed: {err}")
        whole, after = folder / "whole", folder / "killed"
        extra = {path.name for path in after.rglob("*")} - {path.name for path in whole.rglob("*")}
        results = {
            "files": files,
            "kills": found,
            "pictures_and_records_identical": content(whole) == content(after),
            "index_identical": index(whole) == index(after),
            "left_over": sorted(extra),
            "parts": sum(is_part(path.name) for path in after.rglob("*")),
        }
    print({key: value for key, value in results.items() if key != "kills"})
    if not quick:
        print(save("jobs_kill", results))
    return results


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="?", type=int, default=200)
    parser.add_argument("kills", nargs="?", type=int, default=10)
    parser.add_argument("--quick", action="store_true", help="a smoke test, nothing written")
    arguments = parser.parse_args()
    main(arguments.quick, arguments.files, arguments.kills)
