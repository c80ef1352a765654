"""How clear a water is that was asked for, where scenes, lamps or waters stand in the way."""

from typing import Any

import pytest
import torch
from augmenting import COAST, RAW, distances, picture
from torch import Tensor

from uwaug import Lamp, Light, RandomLight, RandomUnderwater, RandomWater, View
from uwaug.distance import Inverse, MadeUp, Network, Relative
from uwaug.transforms.random_underwater import SEVERITIES

ABOVE = Light((Lamp((0.1, -0.5, 0.0), power=3.0, aim=(0.0, 0.2, 1.0), cone=35.0),), daylight=0.1)
EVEN = {**RandomWater.PLAIN, "waters": "II"}


@pytest.mark.parametrize("crop", [None, (0.0, 0.3)], ids=str)
@pytest.mark.parametrize("size", [(36, 16), (9, 90)], ids=str)
def test_lamps_leave_the_contrast_that_is_asked_for_in_any_frame(size: Any, crop: Any) -> None:
    """Of a wall, in portraits and panoramas and crops of them; and a view may name its centre."""
    view, (height, width) = View(50.0), size
    if crop is not None:
        view = view.crop((2 * height, 2 * width), int(crop[0] * width), int(crop[1] * height))
    image, wall = torch.rand(3, height, width), torch.full((1, height, width), 2.0)
    made = []
    for same in (view, View(focal_px=view.focal(width), center=view.middle(size))):
        water = RandomWater(contrast=0.4, **EVEN)
        aug = RandomUnderwater(water, light=ABOVE, development=RAW, view=same)
        record = aug.make_params(image)
        left = float(aug.contrast_left(image, wall, record).mean())
        assert left == pytest.approx(0.4, abs=0.01)
        made.append(aug.transform(image, wall, record))
    assert (made[0] - made[1]).abs().max() < 1e-4


def slope(image: Tensor) -> Tensor:
    """Relative distance of a floor, half of it far away."""
    rows = torch.linspace(2, 0, image.shape[-2]).clamp(max=1)
    return rows[:, None].expand(1, *image.shape[-2:]).contiguous()


PLACED: dict[str, Any] = {
    "made up": MadeUp(),
    "relative": Relative(gamma=0.5),
    "from a near end": Relative(near=(1.0, 2.0)),
    "inverse": Inverse(),
    "network": Network(slope, holds=Relative()),
}


@pytest.mark.parametrize("light", [None, RandomLight(share=1.0)], ids=["day", "lamps"])
@pytest.mark.parametrize("name", PLACED)
def test_scenes_are_placed_where_each_grade_can_be_reached(name: str, light: Any) -> None:
    source = PLACED[name]
    z = slope(picture()) if source.reads_maps else None
    grades = [RandomUnderwater.severity(g, distance=source, light=light) for g in SEVERITIES]
    for key in range(8 if light is None else 2):
        metres = []
        for aug, asked in zip(grades, SEVERITIES.values(), strict=True):
            record = aug.make_params(picture(), aug.generator_of(5, 0, key))
            scenes = aug.scenes(picture(), z, record)
            clarity, light = scenes.clarity(0), scenes.scenes[0].setting.light
            assert clarity is not None
            metres.append(scenes.metres)
            if light is None or not light.lamps:
                assert clarity.water.contrast(clarity.metres) == pytest.approx(asked)
            assert clarity.contents > 0
        # one scene in five waters
        assert all(torch.equal(other, metres[0]) for other in metres)


def test_what_pure_water_does_not_leave_is_asked_for_in_the_nearest_scene() -> None:
    aug = RandomUnderwater(RandomWater(contrast=1.0), distance=MadeUp(), light=None)
    scenes = aug.scenes(picture(), None, aug.make_params(picture()))
    near, far = scenes.metres.aminmax()
    assert 0.0999 < near < far < 0.2001


@pytest.mark.filterwarnings("ignore:.*hardly that water")
@pytest.mark.parametrize("asked", [{"visibility": 2.5}, {"contrast": 0.05}], ids=str)
def test_type_i_takes_all_that_may_be_added_and_no_picture_is_refused(asked: Any) -> None:
    """It is pure water to the eye in a part of the spectrum, which nothing in it can darken."""
    aug = RandomUnderwater(RandomWater(["I", COAST], **asked), light=None)
    contents = []
    for key in range(8):
        record = aug.make_params(picture(), aug.generator_of(0, 0, key))
        clarity = aug.scenes(picture(), 0.5 + distances(), record).clarity(0)
        assert clarity is not None
        if record["samples"][0]["water"]["waters"] == ["I"]:
            contents.append(clarity.contents)
            assert "hardly that water" in clarity.odd
    assert 50 < max(contents) <= 4096
