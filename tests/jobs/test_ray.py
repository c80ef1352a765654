"""Ray itself, on two cores: what it makes must be what the pool makes."""

import io
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.dataset
import pytest
from deadly import Deadly
from PIL import Image
from typer.testing import CliRunner

from uwaug.cli.app import app
from uwaug.jobs import Item, Items, Recipe, run
from uwaug.jobs.ray import Shards, run_on_ray

ray = pytest.importorskip("ray")
pytestmark = [
    pytest.mark.xdist_group("ray"),
    # Ray warns of itself, and leaves pipes of the processes that it starts to the system
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

COUNT = 8
RECIPE = Recipe(random=True)


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    ray.init(
        "local",
        num_cpus=2,
        include_dashboard=False,
        log_to_driver=False,
        logging_level="error",
        object_store_memory=10**8,
    )
    yield
    ray.shutdown()


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(0)
    for i in range(COUNT):
        values = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
        Image.fromarray(values).save(folder / f"{i}.png")
        np.save(folder / f"{i}.npy", rng.uniform(1, 5, (20, 30)).astype(np.float32))
    return folder


def rows_of(pictures: Path, out: Path) -> Items:
    return Items([pictures], "{stem}.npy", out, variants=2)


@pytest.fixture(scope="module")
def pool(pictures: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What this process makes."""
    out = tmp_path_factory.mktemp("pool")
    assert {one.status for one in run(rows_of(pictures, out), RECIPE)} == {"done"}
    return out


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def shown(folder: Path) -> dict[str, bytes]:
    """The pictures in a folder."""
    return {name: data for name, data in content(folder).items() if name.endswith(".png")}


def held(folder: Path) -> dict[str, bytes]:
    """The pictures in shards, no two rows of one name."""
    table = pyarrow.dataset.dataset(folder, format="parquet").to_table(["output", "image"])
    assert table.num_rows == len(set(table["output"].to_pylist()))
    return {row["output"]: row["image"]["bytes"] for row in table.to_pylist()}


def uwaug(*arguments: Any) -> Any:
    return CliRunner().invoke(app, [str(one) for one in arguments])


def degrade(pictures: Path, *arguments: Any) -> Any:
    given = ["--random", "--distance", "{stem}.npy", "--variants", 2, "--ray", "local"]
    return uwaug("degrade", pictures, *given, *arguments)


def test_files_and_records_are_those_of_the_pool(
    cluster: None, pictures: Path, pool: Path, tmp_path: Path
) -> None:
    mixed = list(rows_of(pictures, tmp_path))
    random.Random(0).shuffle(mixed)
    found = list(run_on_ray(mixed, RECIPE))
    assert [one.item for one in found] == mixed
    assert content(tmp_path) == content(pool)
    assert {one.status for one in run_on_ray(mixed, RECIPE, resume=True)} == {"kept"}


def test_bytes_in_a_data_set(cluster: None, pictures: Path, pool: Path) -> None:
    from uwaug.jobs.ray import degrade

    rows = []
    for i in range(COUNT):
        name = f"{i}.png"
        picture = {"bytes": (pictures / name).read_bytes(), "path": name}
        metres = (pictures / f"{i}.npy").read_bytes()
        rows.append({"id": name, "variant": 1, "input": picture, "distance": metres, "label": i})
    rows[3]["distance"] = b"no map"
    made = degrade(ray.data.from_items(rows[::-1]), RECIPE, workers=1).take_all()
    for row in made:
        i = row["label"]
        if i == 3:
            assert row["status"] == "failed"
            assert row["reason"].startswith("distance: ")
            assert row["image"] is None
        else:
            assert row["image"]["bytes"] == (pool / f"{i}_2.png").read_bytes()
            record = json.loads(row["record"])
            first = json.loads((pool / f"{i}_2.png.json").read_text())
            assert (record["input"]["path"], record["drawn"]) == (f"{i}.png", first["drawn"])
    with pytest.raises(ValueError, match="expected columns id and input, got item"):
        degrade(ray.data.from_items([1, 2]), RECIPE)


def test_shards_are_read_back(cluster: None, pictures: Path, pool: Path, tmp_path: Path) -> None:
    place = tmp_path / "shards"
    assert degrade(pictures, "--shards", place).exit_code == 0
    assert held(place) == shown(pool)
    (shard,) = place.iterdir()
    known = json.loads(pyarrow.parquet.read_schema(shard).metadata[b"huggingface"])
    assert known["info"]["features"]["image"] == {"_type": "Image"}
    datasets = pytest.importorskip("datasets")
    features = datasets.Features.from_arrow_schema(pyarrow.parquet.read_schema(shard))
    assert isinstance(features["image"], datasets.Image)
    row = pyarrow.parquet.read_table(shard).slice(0, 1).to_pylist()[0]
    shown_ = features.decode_example(row)["image"]
    assert np.array_equal(shown_, Image.open(io.BytesIO((pool / row["output"]).read_bytes())))

    again = degrade(pictures, "--shards", place)
    assert again.exit_code == 2
    assert "--resume to go on" in again.output
    other = degrade(pictures, "--shards", place, "--resume", "--seed", 1)
    assert other.exit_code == 2
    assert "another recipe" in other.output
    # a shard that a killed run has begun
    (place / "half.parquet").write_bytes(shard.read_bytes()[:-100])
    assert degrade(pictures, "--shards", place, "--resume").exit_code == 0
    assert held(place) == shown(pool)


def test_shards_go_on(cluster: None, pictures: Path, pool: Path, tmp_path: Path) -> None:
    """One of two actors is killed; and a run goes on that was stopped after half of its rows."""
    rows = rows_of(pictures, tmp_path / "shards")
    shards = Shards(str(rows.out))
    shards.prepare(RECIPE)
    (part := tmp_path / "part").mkdir()
    for i in range(COUNT // 2):
        for name in (f"{i}.png", f"{i}.npy"):
            (part / name).symlink_to(pictures / name)
    shards.write(rows_of(part, rows.out), RECIPE)
    assert len(held(rows.out)) == COUNT
    killer = threading.Thread(target=kill_one, args=("_IntoShards",))
    killer.start()
    shards.write(rows, RECIPE, size=4)
    killer.join()
    assert held(rows.out) == shown(pool)


def kill_one(name: str) -> None:
    """The first process of Ray of such a name that is at work."""
    end = time.monotonic() + 60
    while time.monotonic() < end:
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                called = (folder / "cmdline").read_bytes().decode()
                mine = str(os.getpid()) in family(int(folder.name))
            except OSError:
                continue
            if called.startswith("ray::") and name in called and mine:
                os.kill(int(folder.name), signal.SIGKILL)
                return
        time.sleep(0.02)
    raise TimeoutError(name)


def family(pid: int) -> list[str]:
    """A process, its parent, and so on."""
    found = []
    while pid > 1:
        found.append(str(pid))
        pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    return found


def test_a_worker_that_dies_takes_no_picture_with_it(
    cluster: None, pictures: Path, pool: Path, tmp_path: Path
) -> None:
    killer = threading.Thread(target=kill_one, args=("_IntoFiles",))
    killer.start()
    found = list(run_on_ray(rows_of(pictures, tmp_path), RECIPE))
    killer.join()
    assert {one.status for one in found} == {"done"}
    assert content(tmp_path) == content(pool)


def test_a_picture_that_kills_fails_alone(cluster: None, pictures: Path, tmp_path: Path) -> None:
    from uwaug.jobs.ray import degrade

    recipe, rows, items = Recipe(water="II", distance=Deadly()), [], []
    (deadly := tmp_path / "deadly.npy").symlink_to(pictures / "0.npy")
    for name, distance in (("0.png", deadly), ("1.png", pictures / "1.npy")):
        rows.append(Item(name, pictures / name, distance, tmp_path / name))
        items.append({"id": name, "input": str(pictures / name), "distance": str(distance)})
    first, second = run_on_ray(rows, recipe)
    assert (first.status, second.status) == ("failed", "done")
    made = degrade(ray.data.from_items(items, override_num_blocks=1), recipe, workers=1).take_all()
    assert [row["status"] for row in made] == ["failed", "done"]
    for reason in (first.reason, made[0]["reason"]):
        assert "0.png: the process died over it" in str(reason)
    assert made[1]["image"]["bytes"] == rows[1].output.read_bytes()


def test_bad_pictures_are_named_at_the_end(cluster: None, pictures: Path, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in/bad.png").write_bytes(b"no picture")
    (tmp_path / "in/bad.npy").symlink_to(pictures / "0.npy")
    for place in (("--out", tmp_path / "out"), ("--shards", tmp_path / "shards")):
        result = degrade(tmp_path / "in", *place)
        assert result.exit_code == 1
        assert "bad.png: is no picture" in result.output.replace("\n", " ")


def test_what_does_not_go_together(pictures: Path, tmp_path: Path) -> None:
    for arguments, said in (
        (("--ray", "a:1", "--workers", 2, "--out", tmp_path), "has its own"),
        (("--ray", "local", "--shards", tmp_path, "--sheet"), "--sheet is a file"),
        (("--shards", tmp_path), "give --ray local"),
        (("--shards", tmp_path, "--out", tmp_path), "got both"),
        ((), "got neither"),
    ):
        result = uwaug("degrade", pictures, "--water", "II", "--distance", 2, *arguments)
        assert result.exit_code == 2
        assert said in result.output
    (tmp_path / "mine.parquet").touch()
    with pytest.raises(ValueError, match="no shard of a run"):
        Shards(str(tmp_path)).prepare(RECIPE, force=True)


def test_a_driver_that_is_killed_goes_on(pictures: Path, pool: Path, tmp_path: Path) -> None:
    given = ["--random", "--distance", "{stem}.npy", "--variants", "2", "--ray", "local"]
    command = [sys.executable, "-c", "from uwaug.cli import main; main()", "degrade", str(pictures)]
    command += [*given, "--workers", "1", "--out", str(tmp_path)]
    with subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL) as process:
        while len(shown(tmp_path)) < 2 and process.poll() is None:
            time.sleep(0.01)
        process.kill()
    assert len(shown(tmp_path)) < 2 * COUNT
    assert degrade(pictures, "--out", tmp_path, "--resume").exit_code == 0
    assert shown(tmp_path) == shown(pool)
    records = {name: data for name, data in content(pool).items() if name.endswith(".json")}
    assert {name: (tmp_path / name).read_bytes() for name in records} == records
