"""Conditions: numbers of water and camera that belong together."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import torch
from augmenting import flat

from uwaug import RandomUnderwater, RandomWater
from uwaug.transforms import Conditions, RandomDevelopment
from uwaug.transforms.conditions import OF_DEVELOPMENT, OF_WATER, mixed, photographed
from uwaug.transforms.random_water import WATERS

IMAGE = torch.zeros(3, 8, 8)


def drawn(augment: RandomUnderwater, count: int = 1) -> list[dict[str, Any]]:
    """Numbers of so many draws, from the same keys for all transforms."""
    record = augment.make_params(IMAGE.expand(count, 3, 8, 8), torch.Generator().manual_seed(0))
    return [flat(sample) for sample in record["samples"]]


def test_numbers_of_a_condition_stay_together() -> None:
    rows = [{"water": {"mu": 0.1 * i}, "development": {"tone": 1.0 + i}} for i in range(3)]
    samples = drawn(RandomUnderwater(conditions=Conditions(rows, weights=(0.0, 1.0, 3.0))), 400)
    pairs = Counter((s["water.mu"], s["development.tone"]) for s in samples)
    assert set(pairs) == {(0.1, 2.0), (0.2, 3.0)}
    assert 260 < pairs[0.2, 3.0] < 340


def test_defaults_are_conditions_of_photographs_and_lie_in_the_ranges() -> None:
    water, camera, sensor = RandomWater(), RandomDevelopment(), RandomDevelopment.noise
    ranges = {**water.ranges(), **camera.ranges(), **sensor.ranges()}
    for row in photographed().rows:
        numbers = {**row["water"], **row["development"], **row["development"]["noise"]}
        for name in (*OF_WATER, *OF_DEVELOPMENT, "full_well"):
            low, high = ranges[name]
            assert low <= numbers[name] <= high
        assert WATERS.holds(numbers["waters"][0])
    tones = {row["development"]["tone"] for row in photographed().rows}
    samples = drawn(RandomUnderwater(), 200)
    assert min(tones) <= min(s["development.tone"] for s in samples)
    assert max(s["development.tone"] for s in samples) <= max(tones)
    assert len({s["development.tone"] for s in samples}) >= 195  # they lie between conditions


def test_what_is_set_wins_and_leaves_the_rest() -> None:
    deep, flat_tone = RandomWater(vertical_depth=(3, 4)), RandomDevelopment(tone=1)
    default = drawn(RandomUnderwater(), 20)
    changed = drawn(RandomUnderwater(deep, development=flat_tone), 20)
    for before, after in zip(default, changed, strict=True):
        different = {name for name in before if before[name] != after[name]}
        assert different == {"water.vertical_depth", "development.tone"}
        assert 3 <= after["water.vertical_depth"] <= 4


def test_a_water_that_is_named_is_as_clear_as_in_nature() -> None:
    default, named = drawn(RandomUnderwater())[0], drawn(RandomUnderwater("3C"))[0]
    assert default.keys() - named.keys() >= {"water.clearness"}
    assert named["water.mu"] == default["water.mu"]
    clean = drawn(RandomUnderwater(development=RandomDevelopment(noise=None)))[0]
    assert default.keys() - clean.keys() >= {"development.noise.full_well"}


def test_conditions_of_ones_own_hold_whatever_is_set_and_are_written() -> None:
    own = Conditions([{"water": {"mu": 0.05}}, {"water": {"mu": 0.07}}], weights=[1, 0])
    augment = RandomUnderwater(RandomWater(mu=0.1), conditions=own)
    read = RandomUnderwater.from_dict(json.loads(json.dumps(augment.to_dict())))
    assert [s["water.mu"] for s in drawn(read, 9)] == [0.05] * 9
    assert RandomUnderwater().to_dict() == {"kind": "RandomUnderwater"}
    assert RandomUnderwater(conditions=None).to_dict()["conditions"] == "none"


def test_between_two_conditions() -> None:
    first, second = (
        {"waters": [{"cdom": cdom}], "depth": depth, "name": name, "seed": 1}
        for cdom, depth, name in ((0.1, -1.0, "a"), (10.0, 3.0, "b"))
    )
    half = mixed(first, second, 0.5)
    assert half["waters"][0]["cdom"] == pytest.approx(1.0)  # of contents the ratio counts
    assert (half["depth"], half["name"], half["seed"]) == (1.0, "a", 1)


@pytest.mark.parametrize("weights", [(1,), (-1, 2), (0, 0), (1, 2, 3)])
def test_weights_are_one_for_each(weights: Any) -> None:
    with pytest.raises(ValueError, match="weights must be one for each"):
        Conditions([{}, {}], weights)


def test_a_file_of_ones_own_is_read_as_the_default_one(tmp_path: Path) -> None:
    head = "weight,chlorophyll,cdom,minerals,clearness,vertical_depth,mu,color_matrix,exposure,"
    head += "white_balance,saturation,gamut,tone,full_well\n"
    (tmp_path / "own.csv").write_text(head + "1,2,.3,.1,.5,7,.1,.5,0,.2,1.1,.9,1.2,30000\n")
    augment = RandomUnderwater(
        RandomWater(color_matrix=0.2), conditions=Conditions.read(tmp_path / "own.csv")
    )
    (sample,) = drawn(augment)
    assert (sample["water.vertical_depth"], sample["development.tone"]) == (7.0, 1.2)
    assert sample["water.color_matrix"] == 0.2
    (tmp_path / "own.csv").write_text(head.replace("tone,", "") + "1,2\n")
    with pytest.raises(ValueError, match=r"own.csv: expected numbers in weight, chlor.*tone"):
        Conditions.read(tmp_path / "own.csv")
    with pytest.raises(TypeError, match=r"conditions must be.*Conditions.read"):
        RandomUnderwater(conditions="own.csv")  # type: ignore[arg-type]
