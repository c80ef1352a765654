"""Draws by name: each number stands for itself."""

from typing import Any

import pytest
import torch
from augmenting import brightness, distances, flat, picture, same

from uwaug import MarineSnow, RandomDevelopment, RandomLight, RandomUnderwater, RandomWater, Sensor
from uwaug._support.nouns import Uniform
from uwaug.distance import MadeUp, Network, Relative
from uwaug.formation.colour import srgb_to_linear

NAMED: dict[str, Any] = {"waters": ["II", "3C"]}
OTHERS: dict[str, dict[str, Any]] = {
    "mu": {"water": RandomWater(mu=(0.02, 0.04))},
    "contrast": {"water": RandomWater(contrast=0.3)},
    "field_seed": {"water": RandomWater(field=None)},
    "mixing": {"water": RandomWater(**NAMED, mixing=(0, 1))},
    "color_matrix": {"water": RandomWater(color_matrix=None)},
    "snow": {"water": RandomWater(snow=MarineSnow((500, 2000)))},
    "noise": {"development": RandomDevelopment(noise=Sensor((2000, 5000), (1, 5)))},
    "distance": {"distance": MadeUp()},
    "light": {"light": RandomLight(share=1.0)},
    "applied": {"p": 0.5},
}


def drawn(**options: Any) -> list[dict[str, Any]]:
    generator = torch.Generator().manual_seed(5)
    record = RandomUnderwater(**options).make_params(picture(16), generator)
    return [flat(sample) for sample in record["samples"]]


@pytest.mark.parametrize("name", OTHERS)
def test_an_option_moves_no_other_number_and_no_other_picture(name: str) -> None:
    changed = set()
    default = {"water": RandomWater(**NAMED)} if name == "mixing" else {}
    for usual, other in zip(drawn(**default), drawn(**OTHERS[name]), strict=True):
        assert usual.pop("water.waters")[0] == other.pop("water.waters")[0]
        changed |= {n for n in {*usual, *other} if usual.get(n) != other.get(n)}
    assert changed
    assert all(name in n.split(".") for n in changed)


def test_numbers_of_other_names_and_seeds_are_independent() -> None:
    names, seeds = ("contrast", "exposure", "tone"), range(4000)
    table = torch.tensor([[Uniform(seed.to_bytes(8))(name) for name in names] for seed in seeds])
    assert torch.allclose(table.mean(0), torch.tensor(0.5), atol=0.02)
    assert torch.allclose(table.std(0), torch.tensor(12**-0.5), atol=0.01)
    assert (torch.corrcoef(table.T) - torch.eye(3)).abs().max() < 0.05
    assert (torch.corrcoef(torch.stack([table[1:, 0], table[:-1, 0]]))[0, 1]).abs() < 0.05


def test_options_are_read_only_and_lists_stay_the_callers_own() -> None:
    waters, contrast, near, keys = ["II", "7C"], [0.2, 0.4], [1.0, 2.0], ["a", "b"]
    snow = MarineSnow([500.0, 600.0])
    water = RandomWater(waters, contrast=contrast, snow=snow)
    augment = RandomUnderwater(water, distance=Relative(near, 5.0), keys=keys)
    with pytest.raises(AttributeError, match="p is read-only"):
        augment.p = 0.5
    before, drawn = augment.to_dict(), augment.at(0, 0, 0)({"a": picture(), "b": distances()})
    for own in (waters, contrast, near, keys):
        own[0] = own[1]
    assert augment.to_dict() == before
    assert same(augment.at(0, 0, 0)({"a": picture(), "b": distances()})["a"], drawn["a"])
    assert (water.waters, snow.density) == (("II", "7C"), (500.0, 600.0))


def test_a_network_gets_srgb() -> None:
    metres = []
    for space, image in (("srgb", picture()), ("linear", srgb_to_linear(picture()))):
        development = RandomDevelopment(color_space=space)  # type: ignore[arg-type]
        augment = RandomUnderwater("II", distance=Network(brightness), development=development)
        record = augment.make_params(image, torch.Generator().manual_seed(1))
        metres.append(augment.scenes(image, None, record).metres)
    torch.testing.assert_close(*metres, rtol=0, atol=1e-4)


def test_median_and_ends_are_those_of_what_is_not_open_water() -> None:
    augment, z = RandomUnderwater(RandomWater(contrast=None, field=None)), 0.1 + distances()
    z[..., :20, :] = torch.inf
    scenes = augment.scenes(picture(), z, augment.make_params(picture()))
    nearest, median, farthest = scenes.scenes[0].setting.span
    rest = z[z < torch.inf]
    assert (nearest, farthest) == (rest.min(), rest.max())
    assert median == pytest.approx(float(rest.median()), rel=0.1)
