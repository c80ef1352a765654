"""Which pictures are frames of one film, seen by one camera or by several."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from filing import metres, pixels, save

from uwaug import RandomDevelopment, RandomUnderwater, Sensor
from uwaug.files import Recipe, Row, degrade, read_picture, read_record
from uwaug.files.films import frames_of


def rows_of(*cells: tuple[str, str, float | None]) -> list[Row]:
    """Rows of name, film and time."""
    return [Row(name, Path(name), film=film, time=time) for name, film, time in cells]


@pytest.mark.parametrize(
    "times, moments",
    [
        ((None, None, None), (0, 1, 2)),  # the order of the rows
        ((7, 9, 8), (0, 2, 1)),
        ((11, 12, 13, 51), (0, 1, 2, 40)),  # frames that are not there took their time
        ((0.1, 0.2, 0.3, 4.1), (0, 1, 2, 40)),
        ((1.4e18, 1.4e18 + 5e7, 1.4e18 + 1.5e8, 1.4e18 + 2e8), (0, 1, 3, 4)),
        ((3, 3, 4, 4, 5, 5), (0, 0, 1, 1, 2, 2)),  # two cameras
        ((3,), (0,)),
    ],
)
def test_moments_are_in_frames(times: tuple[Any, ...], moments: tuple[float, ...]) -> None:
    rows = rows_of(*((f"{n}.png", "f", time) for n, time in enumerate(times)))
    frames = frames_of([*rows, *rows_of(("alone.png", "", 4.0), ("g.png", "g", None))])
    assert [frames[row.name].moment for row in rows] == list(moments)
    order = sorted(range(len(rows)), key=lambda n: moments[n])
    assert [frames[rows[n].name].number for n in order] == list(range(len(rows)))
    assert "alone.png" not in frames
    assert [row.name for row in frames["g.png"].candidates] == ["g.png"]


def test_a_film_is_settled_on_the_middle_of_the_first_camera() -> None:
    rows = rows_of(*((f"{c}{n}.png", "f", n) for c in "ab" for n in range(20)))
    candidates = frames_of(rows)["b3.png"].candidates
    assert candidates[0].name == "a10.png"
    assert len(candidates) == 9
    assert {row.name[0] for row in candidates} == {"a"}


def test_cameras_of_a_rig_may_differ_by_milliseconds() -> None:
    cells = [
        (f"{c}/{n}.png", "f", n / 20 + late)
        for n in range(9)
        for c, late in (("a", 0), ("b", 0.004))
    ]
    frames = frames_of(rows_of(*cells))
    assert [frames[f"{c}/{n}.png"].moment for n in range(9) for c in "ab"] == [
        pytest.approx(n + late) for n in range(9) for late in (0, 0.1)
    ]
    assert {row.name[0] for row in frames["b/3.png"].candidates} == {"a"}


def test_a_film_with_some_times_is_refused() -> None:
    with pytest.raises(ValueError, match=r"time: of film f 1\.png has none"):
        frames_of(rows_of(("0.png", "f", 1.0), ("1.png", "f", None)))


def test_a_rig_is_metered_on_one_camera(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rows = []
    for camera in range(2):
        for number in range(3):
            name = f"cam{camera}/{number}.png"
            picture = save(f"rig/{name}", pixels(seed=number) // (camera + 1))
            z = save(f"maps/cam{camera}/{number}.npy", metres() + camera)
            rows.append(Row(name, picture, z, film="rig", time=number))
    save("rig/cam0/1.png", pixels() // 100)  # is too dark to be metered
    noise = RandomDevelopment(noise=Sensor(2000))
    recipe = Recipe(RandomUnderwater(development=noise))
    assert degrade(recipe, rows, "wet").failures == []
    degrade(recipe, [*rows[2::-1], *rows[3:]], "again", workers=2)
    samples, noises = {}, set()
    for path in sorted(Path("wet").rglob("*.png.json")):
        assert path.read_bytes() == Path("again", path.relative_to("wet")).read_bytes()
        (samples[path.parent.name, path.name[0]],) = read_record(path)["params"]["samples"]
    for sample in samples.values():
        noises.add(sample["development"]["noise"].pop("seed"))
    assert len(noises) == 6  # sensors have no noise in common
    for number in "012":
        assert samples["cam0", number] == samples["cam1", number]
    z = torch.from_numpy(metres())[None]
    draw = recipe.drawn("cam0/1.png", 0)
    clip = recipe.transform.for_clip(draw, read_picture("rig/cam0/2.png"), z)
    measured = json.loads(json.dumps(clip["samples"][0]["measured"]))
    assert all(sample["measured"] == measured for sample in samples.values())
