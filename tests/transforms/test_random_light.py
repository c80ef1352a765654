"""Pictures that lamps light: how often, by what, and how far."""

import json
import math
from collections.abc import Callable
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
    seen = Measured(W, W, 0.0, 1.0, metres / 2, 2 * metres, metres)
    return [random.of(random.drawn(Uniform(seed.to_bytes(8))), seen) for seed in range(count)]


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_so_many_pictures_are_taken_by_lamps(share: float) -> None:
    drawn = lights(RandomLight(share=share), 1000)
    lit = sum(len(light.lamps) > 0 for light in drawn) / len(drawn)
    assert lit == pytest.approx(share, abs=0.05 if 0 < share < 1 else 0)


def test_lamps_light_a_twentieth_of_default_draws() -> None:
    augment, count = RandomUnderwater(), 600
    record = augment.make_params(picture()[None].expand(count, -1, -1, -1))
    lit = ["rig" in sample["light"] for sample in record["samples"]]
    assert sum(lit) / count == pytest.approx(1 / 20, abs=0.03)


def test_a_picture_has_one_light_at_every_severity() -> None:
    grades = [RandomUnderwater.severity(level) for level in range(1, 6)]
    for seed in range(12):
        generators = (torch.Generator().manual_seed(seed) for _ in grades)
        records = [
            grade.make_params(picture(), generator)
            for grade, generator in zip(grades, generators, strict=True)
        ]
        drawn = [record["samples"][0]["light"] for record in records]
        assert drawn == [drawn[0]] * 5


@pytest.mark.parametrize(("metres", "share"), [(1.0, 0.73), (8.0, 0.95)])
def test_where_lamps_aim_they_are_nearly_as_bright_as_daylight(metres: float, share: float) -> None:
    random = RandomLight(share=1.0, power=0.0, tint=0.0)
    arriving = [
        sum(lamp.power / math.dist((0.0, 0.0, 0.0), lamp.aim) ** 2 for lamp in light.lamps)
        for light in lights(random, 400, metres)
    ]
    assert sorted(arriving)[200] == pytest.approx(share, abs=0.02)


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
        ends = [
            tuple(p + a for p, a in zip(lamp.position, lamp.aim, strict=True))
            for lamp in light.lamps
        ]
        for end in ends:
            assert end == pytest.approx(ends[0])
            assert end[2] == pytest.approx(4.0)
            assert abs(end[0]) <= 0.1 * 4 + 1e-9
            assert 0.05 * 4 - 1e-9 <= end[1] <= 0.3 * 4 + 1e-9


@pytest.mark.parametrize("metres", [1.0, 3.0, 8.0])
def test_lamps_reach_the_scene_however_far_it_is(metres: float) -> None:
    """A white plate at the median distance is as bright as in daylight, in clear water, and a
    quarter as bright by two stops less power.
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


@pytest.mark.parametrize(
    "table, expected",
    [
        ({"share": 0.5, "rigs": "diver"}, RandomLight(0.5, "diver")),
        ({"power": [-2, 0]}, RandomLight(power=(-2, 0))),
        ({"lamps": [{"position": [1, 0, 0]}]}, Light((Lamp((1.0, 0.0, 0.0)),))),
        ({"kind": "Light", "daylight": 0.5}, Light(daylight=0.5)),
    ],
)
def test_tables(table: dict[str, Any], expected: Any) -> None:
    assert RandomUnderwater.from_dict({"light": table}).light == expected


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: RandomLight(share=1.5), r"share must be in \[0, 1\]"),
        (lambda: RandomLight(rigs=("torch",)), "rigs must be one of vehicle, diver, strobe"),
        (lambda: RandomLight(rigs=()), "rigs must be one of vehicle, diver, strobe"),
        (lambda: RandomLight(cone=120.0), r"cone must be a number or a range"),
        (lambda: RandomLight(daylight=(-1.0, 0.0)), r"daylight must be a number or a range"),
    ],
)
def test_what_is_refused(make: Callable[[], Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        make()
