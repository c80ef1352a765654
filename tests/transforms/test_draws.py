"""Draws by name: each number stands for itself."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch
from augmenting import distances, flat, picture, same
from torch import Tensor

from uwaug import (
    KeepVisible,
    MarineSnow,
    RandomDevelopment,
    RandomLight,
    RandomUnderwater,
    RandomWater,
    Sensor,
)
from uwaug._support.nouns import Uniform, number
from uwaug.distance import MadeUp, Relative, Source
from uwaug.formation.colour import srgb_to_linear
from uwaug.transforms import Measured

OTHERS: dict[str, dict[str, Any]] = {
    "mu": {"water": RandomWater(mu=(0.02, 0.04))},
    "contrast": {"water": RandomWater(contrast=0.3)},
    "field_seed": {"water": RandomWater(field=None)},
    "mixing": {"water": RandomWater(mixing=(0, 1))},
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
    for usual, other in zip(drawn(), drawn(**OTHERS[name]), strict=True):
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


AUGMENT = RandomUnderwater("7C")
OPTIONS: list[tuple[Any, str]] = [
    *[(AUGMENT, n) for n in ("water", "distance", "light", "development", "p", "keys")],
    *[(KeepVisible(AUGMENT), "min_contrast"), (RandomWater(), "contrast"), (MadeUp(), "near")],
    *[(RandomLight(), "share"), (RandomDevelopment(), "exposure"), (MarineSnow(), "seed")],
]


def test_options_are_read_only() -> None:
    for owner, name in OPTIONS:
        said = f"cannot assign to field '{name}'|{name} is read-only: dataclasses.replace"
        with pytest.raises(AttributeError, match=said):
            setattr(owner, name, 0.5)
    assert replace(AUGMENT.eval(), p=0.5).to_dict() == AUGMENT.to_dict() | {"p": 0.5}


def test_lists_stay_the_callers_own() -> None:
    waters, contrast, near, keys = ["II", "7C"], [0.2, 0.4], [1.0, 2.0], ["a", "b"]
    snow = MarineSnow([500.0, 600.0])
    water = RandomWater(waters, contrast=contrast, snow=snow)
    augment = RandomUnderwater(water, distance=Relative(near, 5.0), keys=keys)
    before, drawn = augment.to_dict(), augment.at(0, 0, 0)({"a": picture(), "b": distances()})
    for own in (waters, contrast, near, keys):
        own[0] = own[1]
    assert augment.to_dict() == before
    assert same(augment.at(0, 0, 0)({"a": picture(), "b": distances()})["a"], drawn["a"])
    assert (water.waters, snow.density) == (("II", "7C"), (500.0, 600.0))


@dataclass(frozen=True)
class Brightness(Source):
    """Distances of a network that takes sRGB, with numbers of its own."""

    reads_maps = False
    reads_pictures = True

    power: Any = number((0.1, 0.2), 0.0)

    def ranges(self) -> dict[str, Any]:
        return {**super().ranges(), "metres a unit": (1.0, 2.0)}

    def metres(
        self, distance: Tensor | None, image: Tensor, drawn: Mapping[str, Any], **view: Any
    ) -> Tensor:
        return drawn["power"] + drawn["metres a unit"] * image[:1]


def test_a_source_that_reads_pictures_gets_srgb() -> None:
    srgb = picture()
    metres = []
    for space, image in (("srgb", srgb), ("linear", srgb_to_linear(srgb))):
        development = RandomDevelopment(color_space=space)  # type: ignore[arg-type]
        water = RandomWater(contrast=None)
        augment = RandomUnderwater(water, distance=Brightness(), development=development)
        record = augment.make_params(image, torch.Generator().manual_seed(1))
        metres.append(augment.scenes(image, None, record).metres)
        assert record["samples"][0]["distance"].keys() == {"power", "metres a unit"}
    torch.testing.assert_close(*metres, rtol=0, atol=1e-5)


def test_what_is_measured_of_a_film_takes_the_place_of_a_frame() -> None:
    own = Measured(64, 48, 0.0, 1.0, 1.0, 4.0, 2.0)
    settled = {"median": 3.0, "exposure": 0.5, "white_balance": [1.0, 2.0, 3.0]}
    balance = {"white_balance": (1.0, 2.0, 3.0)}
    moved = (0.5, 0.0, -0.25)
    assert own.of_film(settled, moved) == own._replace(**{**settled, **balance}, moved=moved)
    assert own.of_film({}, (0.0, 0.0, 0.0)) == own


def test_median_and_ends_are_those_of_what_is_not_open_water() -> None:
    augment, z = RandomUnderwater(RandomWater(contrast=None, field=None)), 0.1 + distances()
    z[..., :20, :] = torch.inf
    scenes = augment.scenes(picture(), z, augment.make_params(picture()))
    nearest, median, farthest = scenes.scenes[0].setting.span
    rest = z[z < torch.inf]
    assert (nearest, farthest) == (rest.min(), rest.max())
    assert median == pytest.approx(float(rest.median()), rel=0.1)


@pytest.mark.parametrize("kind", [list, np.array, torch.tensor, deque])
def test_any_two_numbers_are_a_range(kind: Any) -> None:
    made = RandomUnderwater(
        RandomWater("3C", contrast=kind([0.25, 0.5])), distance=kind([1.0, 4.0])
    )
    same = RandomUnderwater(RandomWater("3C", contrast=(0.25, 0.5)), distance=(1.0, 4.0))
    assert repr(made) == repr(same)
    assert made.to_dict() == same.to_dict()
    with pytest.raises(ValueError, match="must be a number or a range"):
        RandomWater("3C", contrast=kind([0.5, 0.25]))
