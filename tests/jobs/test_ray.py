"""Ray itself, on two cores: what it makes must be what this process makes."""

import json
import os
import random
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from deadly import Deadly
from filing import content
from PIL import Image

from uwaug.jobs import Items, Recipe, run
from uwaug.jobs.ray import Shards, degrade, run_on_ray, shard_schema

ray = pytest.importorskip("ray")
pytestmark = [
    # Ray warns of itself, and leaves pipes of the processes that it starts to the system
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

COUNT = 8
RECIPE = Recipe(random=True)


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    here = Path(__file__).parent.parent
    paths = [str(here), str(here.parent), os.environ.get("PYTHONPATH", "")]
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    ray.init(
        "local",
        num_cpus=2,
        include_dashboard=False,
        log_to_driver=False,
        logging_level="error",
        object_store_memory=10**8,
        runtime_env={"env_vars": {"PYTHONPATH": os.pathsep.join(paths)}},
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


def items_of(pictures: Path, out: Path) -> Items:
    return Items([pictures], "{stem}.npy", out, variants=2)


@pytest.fixture(scope="module")
def here(pictures: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What this process makes."""
    out = tmp_path_factory.mktemp("here")
    assert {one.status for one in run(items_of(pictures, out), RECIPE)} == {"done"}
    return out


def held(folder: Path) -> dict[str, bytes]:
    """The pictures in shards, no two rows of one name; those that failed have none."""
    import pyarrow.dataset

    table = pyarrow.dataset.dataset(folder, format="parquet").to_table(["output", "image"])
    assert table.num_rows == len(set(table["output"].to_pylist()))
    rows = [row for row in table.to_pylist() if row["image"] is not None]
    return {row["output"]: row["image"]["bytes"] for row in rows}


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
    pids = []
    while pid > 1:
        pids.append(str(pid))
        pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    return pids


def test_files_and_sidecars_although_a_worker_dies(
    cluster: None, pictures: Path, here: Path, tmp_path: Path
) -> None:
    mixed = list(items_of(pictures, tmp_path))
    random.Random(0).shuffle(mixed)
    (tmp_path / f".uwaug-{'0' * 16}.part").touch()  # of a task that was killed
    killer = threading.Thread(target=kill_one, args=("_IntoFiles",))
    killer.start()
    results = list(run_on_ray(mixed, RECIPE))
    killer.join()
    assert [result.item for result in results] == mixed
    assert {result.status for result in results} == {"done"}
    assert content(tmp_path) == content(here)


def test_shards_go_on(cluster: None, pictures: Path, here: Path, tmp_path: Path) -> None:
    """A run that was stopped while it wrote its second half."""
    import pyarrow.parquet

    items = items_of(pictures, tmp_path / "shards")
    shards = Shards(str(items.out))
    shards.prepare(RECIPE)
    (part := tmp_path / "part").mkdir()
    for i in range(COUNT // 2):
        for name in (f"{i}.png", f"{i}.npy"):
            (part / name).symlink_to(pictures / name)
    (part / "bad.png").write_bytes(b"no picture")
    (part / "bad.npy").symlink_to(pictures / "0.npy")
    shards.write(items_of(part, items.out), RECIPE)
    tally = shards.tally(1)
    assert (tally.rows, tally.failed) == (COUNT + 2, 2)
    (reason,) = tally.reasons
    assert reason.startswith("2 × is no picture")
    assert reason.endswith(f"(first: {part / 'bad.png'})")
    assert list(tally.notes) == []

    (shard,) = items.out.iterdir()
    schema = pyarrow.parquet.read_schema(shard)
    features = json.loads(schema.metadata[b"huggingface"])["info"]["features"]
    assert features["image"] == {"_type": "Image"}
    (items.out / "half.parquet").write_bytes(shard.read_bytes()[:-100])
    # of a run that was killed while it wrote a shard again, without what failed
    (items.out / f"{shard.name}.part").write_bytes(shard.read_bytes())
    with pytest.raises(FileExistsError, match="holds files, such as"):
        shards.prepare(RECIPE)
    with pytest.raises(ValueError, match="another recipe"):
        shards.prepare(Recipe(random=True, seed=1), resume=True)
    shards.prepare(RECIPE, resume=True)
    shards.write(items, RECIPE, size=4)
    tally = shards.tally(1)
    assert (tally.rows, tally.failed) == (2 * COUNT, 0), "what failed is tried again"
    shown = {name: data for name, data in content(here).items() if name.endswith(".png")}
    assert held(items.out) == shown


def test_rows_of_a_data_set(cluster: None, pictures: Path, here: Path) -> None:
    """Bytes and paths; one of which takes the process with it."""
    rows = []
    for i in range(COUNT):
        name = f"{i}.png"
        picture = {"bytes": (pictures / name).read_bytes(), "path": name}
        distance = {"bytes": (pictures / f"{i}.npy").read_bytes(), "path": f"{i}.npy"}
        rows.append({"id": name, "variant": 1, "input": picture, "distance": distance, "label": i})
    rows[3]["distance"] = {"bytes": b"no map", "path": "3.npy"}
    rows[5]["distance"]["path"] = "deadly.npy"
    recipe = Recipe(random=True, distance=Deadly())
    made = degrade(ray.data.from_items(rows[::-1]), recipe, workers=1).take_all()
    reasons = {row["label"]: row["reason"] for row in made if row["status"] == "failed"}
    assert set(reasons) == {3, 5}
    assert reasons[3].startswith("3.npy: is no picture and no map")
    assert reasons[5].startswith("5.png: the process died over it")
    for row in made:
        i = row["label"]
        if i in reasons:
            assert row["image"] is None
            continue
        assert row["image"]["bytes"] == (here / f"{i}_2.png").read_bytes()
        sidecar = json.loads(row["record"])
        first = json.loads((here / f"{i}_2.png.json").read_text())
        assert sidecar["input"] == first["input"] | {"path": f"{i}.png"}
        assert sidecar["drawn"] == first["drawn"]
        assert row["notes"] == " | ".join(sidecar["notes"])
    with pytest.raises(ValueError, match="expected columns id and input, got item"):
        degrade(ray.data.from_items([1, 2]), recipe)


def test_what_is_somebody_elses_stays(tmp_path: Path) -> None:
    (tmp_path / "mine.parquet").touch()
    with pytest.raises(ValueError, match="no shard of a run"):
        Shards(str(tmp_path)).prepare(RECIPE, force=True)


@pytest.mark.parametrize("how", [{}, {"force": True}, {"resume": True}])
@pytest.mark.parametrize("name", ["wet.run/thesis.txt", "wet.run/recipe.json", "wet/mine.parquet"])
def test_what_no_run_has_written_is_neither_removed_nor_read(
    tmp_path: Path, name: str, how: dict[str, bool]
) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    shards = Shards(str(tmp_path / "wet"))
    if name != "wet.run/recipe.json":
        shards.prepare(RECIPE)
    mine = tmp_path / name
    mine.parent.mkdir(parents=True, exist_ok=True)
    if mine.suffix == ".parquet":
        pq.write_table(pa.table({"mine": [1]}), mine)
    else:
        mine.write_text('{"flour": 500}')
    before = content(tmp_path)
    with pytest.raises((ValueError, FileExistsError)) as refused:
        shards.prepare(RECIPE, **how)
    assert str(mine) in str(refused.value)
    assert content(tmp_path) == before


def test_two_runs_at_once_into_one_place(tmp_path: Path) -> None:
    shards = Shards(str(tmp_path / "wet"))
    with shards.held(), pytest.raises(BlockingIOError, match=r"wet\.run: another run writes to"):
        shards.held().__enter__()
    shards.prepare(RECIPE)


def test_force_removes_the_shards_of_a_run_and_nothing_else(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    shards = Shards(str(tmp_path / "wet"))
    shards.prepare(RECIPE)
    pq.write_table(shard_schema().empty_table(), tmp_path / "wet/whole.parquet")
    (tmp_path / "wet/cut.parquet").write_bytes(b"PAR1")
    other = Recipe(random=True, seed=1)
    shards.prepare(other, force=True)
    assert set(content(tmp_path)) == {"wet.run/recipe.json"}
    assert json.loads((tmp_path / "wet.run/recipe.json").read_text())["seed"] == 1
