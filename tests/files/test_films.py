"""Which pictures are frames of one film, seen by one camera or by several."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from filing import metres, pixels, save

from uwaug import RandomDevelopment, RandomUnderwater, Sensor
from uwaug.files import Recipe, degrade, find_items, read_picture, read_record
from uwaug.files.films import frames_of, rigs_of, unjoined
from uwaug.files.items import Item

NS = "14036365797635{}.png"


def films(names: str, rig: str = "auto") -> list[dict[str, float]]:
    """The moment of each frame of each film."""
    films: dict[Any, dict[str, float]] = {}
    for item, frame in frames_of([Item(n, Path(n)) for n in names.split()], rig).items():
        films.setdefault(frame.candidates, {})[item.name] = frame.moment
    return list(films.values())


@pytest.mark.parametrize(
    "first, second",
    [
        ("image_2/{}.png", "image_3/{}.png"),
        ("drive_1/image_02/data/{}.png", "drive_1/image_03/data/{}.png"),
        ("mav0/cam0/data/140363657976{}5584.png", "mav0/cam1/data/140363657976{}5584.png"),
        ("left/{}.png", "right/{}.jpg"),
        ("imgL/{}.png", "imgR/{}.png"),
        ("leftImg8bit/a/x_{}.png", "rightImg8bit/a/x_{}.png"),
        ("image_left/{}_left.png", "image_right/{}_right.png"),
        ("CAM_FRONT/{}.png", "CAM_FRONT_LEFT/{}.png"),
        ("Camera_0/rgb_{}.png", "Camera_1/rgb_{}.png"),
        ("cameraA/{}.png", "cameraB/{}.png"),
        ("left/1.{}0000.png", "right/1.{}0003.png"),  # frames of nearly the same times
        ("seas/left_{}.png", "seas/right_{}.png"),
        ("seas/cam0_{}.png", "seas/cam1_{}.png"),
    ],
)
def test_cameras_of_a_rig_share_a_film(first: str, second: str) -> None:
    names = [name.format(number) for name in (first, second) for number in range(100, 103)]
    assert films(" ".join(names)) == [dict(zip(names, (0, 1, 2, 0, 1, 2), strict=True))]
    # a frame that one of them lacks
    del names[4]
    assert [*films(" ".join(names))[0].values()] == [0, 1, 2, 0, 2]
    folders = len({str(Path(name).parent) for name in names})
    assert len(films(" ".join(names), "none")) == folders


def test_a_frame_that_the_first_camera_lacks() -> None:
    (moments,) = films("left/0.png left/2.png right/0.png right/1.png right/2.png")
    assert [*moments.values()] == [0, 2, 0, 1, 2]


@pytest.mark.parametrize(
    "names",
    [
        "bear/0.jpg swan/0.jpg",
        "IMG_0001/0.jpg IMG_0002/0.jpg",
        "clip_1/0.jpg clip_2/0.jpg",
        "a/left/0.jpg b/right/0.jpg",
        "left/0.png left/1.png right/7.png right/8.png",
        "left/1.100.png left/1.200.png right/1.300.png",
        "leftover/0.png right/0.png",
    ],
)
def test_films_that_have_nothing_in_common(names: str) -> None:
    assert len(films(names)) == 2


def test_what_is_said_of_films() -> None:
    def said(names: str, rig: str = "auto") -> str:
        return rigs_of(frames_of([Item(name, Path(name)) for name in names.split()], rig))

    assert said("a/0.png a/1.png") == said("0.png") == ""
    assert said("a/0.png b/0.png").startswith("2 films, each in its own water: ")
    got = "image_2 and image_3 are taken for one rig: one water, metered on image_2"
    assert got in said("image_3/0.png image_2/0.png")
    assert "metered on s/b" in said("s/b/0.png s/c/9.png", "b,c")
    left_and_right = [Item(name, Path(name)) for name in ("s/left/0.png", "s/right/0.png")]
    assert unjoined(left_and_right).startswith("s/left and s/right look like cameras of a rig: ")
    assert unjoined(left_and_right[:1]) == ""
    with pytest.raises(ValueError, match=r"rig \(--rig\): no folder of pictures is called d"):
        said("b/0.png c/0.png", "b,d")
    with pytest.raises(ValueError, match=r"rig \(--rig\) is of films"):
        Recipe(RandomUnderwater(), rig="none")


def test_a_rig_is_metered_on_one_camera(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for camera in range(2):
        for number in range(3):
            save(f"rig/cam{camera}/{number}.png", pixels(seed=number) // (camera + 1))
            save(f"maps/cam{camera}/{number}.npy", metres() + camera)
    save("rig/cam0/1.png", pixels() // 100)  # is too dark to be metered
    recipe = Recipe(
        RandomUnderwater(development=RandomDevelopment(noise=Sensor(2000))), sequence=True
    )
    items = find_items("rig", "maps")
    assert degrade(recipe, items, "wet").failures == []
    degrade(recipe, items[::-1], "again", workers=2)
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


@pytest.mark.parametrize(
    "names, moments",
    [
        ("{}0.png", [0, 1, 2, 40]),  # every tenth frame
        ("dive_2_{}.png", [0, 1, 2, 40]),
        ("l/{}.png", [0, 1, 2, 40]),
        ("17000000{}.000.png", [0, 1, 2, 40]),  # seconds
        ("17000000{0}.{0}.png", [0, 1, 2, 40]),
        ("{0}-of-{0}.png", [0, 1, 2, 3]),  # two numbers
    ],
)
def test_frames_that_are_not_there_took_their_time(names: str, moments: list[int]) -> None:
    there = [names.format(number) for number in (11, 12, 13, 51)]
    assert films(" ".join(there)) == [dict(zip(there, moments, strict=True))]


def test_frames_without_numbers_follow_in_order() -> None:
    assert films("a.png b.png d.png") == [{"a.png": 0, "b.png": 1, "d.png": 2}]
