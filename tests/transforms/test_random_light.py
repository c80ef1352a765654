"""Pictures that lamps light: how often, by what, and how far."""

import json
import math
from typing import Any

import pytest
import torch
from augmenting import H, W, distances, picture
from torch import Tensor

from uwaug import Lamp, Light, Medium, RandomLight, RandomUnderwater
from uwaug._support.nouns import Uniform
from uwaug.optics.view import WIDE
from uwaug.transforms import Measured
from uwaug.transforms.random_light import RIGS

NIGHT = RandomLight(share=1.0)
CLEAR = Medium.from_coefficients((1e-9,) * 3, (1e-9,) * 3, (0.0,) * 3)


def lights(random: RandomLight, count: int, metres: float = 3.0) -> list[Any]:
    seen = Measured(W, H, 0.0, 1.0, metres / 2, 2 * metres, metres)
    return [random.of(random.drawn(Uniform(seed.to_bytes(8))), seen) for seed in range(count)]


def test_so_many_pictures_are_taken_by_lamps() -> None:
    for random, share in ((RandomLight(), 0.1), *((RandomLight(x), x) for x in (0.0, 0.3, 1.0))):
        lit = sum(len(light.lamps) > 0 for light in lights(random, 1000)) / 1000
        assert lit == pytest.approx(share, abs=0.03 if 0 < share < 1 else 0)
    aug = RandomUnderwater.from_dict({"light": {"share": 0.5, "rigs": "diver"}})
    assert aug.light == RandomLight(0.5, "diver")
    aug = RandomUnderwater.from_dict({"light": {"lamps": [{"position": [1, 0, 0]}]}})
    assert aug.light == Light((Lamp((1.0, 0.0, 0.0)),))


@pytest.mark.parametrize("name", RIGS)
def test_rigs(name: str) -> None:
    rig = RIGS[name]
    drawn = lights(RandomLight(share=1.0, rigs=(name,)), 200)
    assert {len(light.lamps) for light in drawn} == set(range(rig.lamps[0], rig.lamps[1] + 1))
    sides = {math.copysign(1, light.lamps[0].position[0]) for light in drawn}
    assert sides == {-1.0, 1.0}
    for light in drawn:
        x, y, z = light.lamps[0].position
        assert z == 0
        assert rig.aside[0] <= abs(x) <= rig.aside[1]
        assert rig.above[0] <= -y <= rig.above[1]
        for lamp in light.lamps[1:]:
            assert abs(lamp.position[0]) <= abs(x)
            assert lamp.position[0] * x < 0 or len(light.lamps) > 2


def test_the_axes_of_all_lamps_cross_at_the_scene() -> None:
    for light in lights(NIGHT, 50, metres=4.0):
        ends = [[p + a for p, a in zip(x.position, x.aim, strict=True)] for x in light.lamps]
        for end in ends:
            assert end == pytest.approx(ends[0])
            assert end[2] == pytest.approx(4.0)
            assert abs(end[0]) <= 0.1 * 4 + 1e-9
            assert 0.05 * 4 - 1e-9 <= end[1] <= 0.3 * 4 + 1e-9


@pytest.mark.parametrize("metres", [1.0, 3.0, 8.0])
def test_lamps_reach_the_scene_however_far_it_is(metres: float) -> None:
    """A white plate at the median distance is as bright as in daylight by all lamps together, in
    clear water, and a quarter as bright by two stops less power.
    """
    z = torch.full((1, 1, 3, 3), metres, dtype=torch.float64)
    for stops in (0.0, -2.0):
        random = RandomLight(1.0, power=stops, across=0.0, down=0.0, daylight=0.0, tint=0.0)
        for light in lights(random, 40, metres):
            middle = light.curves(CLEAR, z, WIDE).direct[0, :, 1, 1] / 2**stops
            assert 0.4 < float(middle.min()) <= float(middle.max()) < 1.01


def test_open_water_alone_is_lit_too() -> None:
    light = lights(NIGHT, 1, metres=math.inf)[0]
    assert all(math.isfinite(lamp.power) for lamp in light.lamps)
    z = torch.full((1, H, W), math.inf)
    assert RandomUnderwater(light=NIGHT)(picture(), z)[0].isfinite().all()


def test_lamps_stay_in_a_film() -> None:
    augment, z = RandomUnderwater(light=NIGHT), 1 + distances()
    params = augment.make_params(picture(), torch.Generator().manual_seed(0))
    record = json.loads(json.dumps(augment.for_clip(params, picture(), z)))

    def light(far: Tensor, drawn: Any) -> Light:
        return augment.scenes(picture(), far, drawn).scenes[0].setting.light

    assert light(z, record) == light(1.5 * z, record) != light(1.5 * z, params)
    still, frame = (augment.transform(picture(), z, each) for each in (params, record))
    torch.testing.assert_close(still, frame, rtol=0, atol=2e-3)
