"""Draws by name: each number stands for itself."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import pytest
import torch
from augmenting import distances, picture
from torch import Tensor

from uwaug import KeepVisible, RandomDevelopment, RandomLight, RandomUnderwater, Sensor
from uwaug.distance import MadeUp, Source
from uwaug.formation.colour import srgb_to_linear
from uwaug.transforms import Measured
from uwaug.transforms.draws import uniform_of

OTHERS: dict[str, dict[str, Any]] = {
    "mu": {"mu": (0.01, 0.05)},
    "no contrast": {"contrast": None},
    "no field": {"field": None},
    "half of the pictures": {"p": 0.5},
    "mixed": {"mixing": (0, 1)},
    "noise": {"development": RandomDevelopment(noise=Sensor((2000, 5000), (1, 5)))},
    "grey": {"development": RandomDevelopment(color_matrix=None)},
    "made up": {"distance": MadeUp()},
    "night": {"light": RandomLight(share=1.0)},
}


def drawn(**options: Any) -> list[dict[str, Any]]:
    generator = torch.Generator().manual_seed(5)
    samples: list[dict[str, Any]] = RandomUnderwater(**options).make_params(picture(4), generator)[
        "samples"
    ]
    return samples


@pytest.mark.parametrize("name", OTHERS)
def test_an_option_moves_no_other_number_and_no_other_picture(name: str) -> None:
    for usual, other in zip(drawn(), drawn(**OTHERS[name]), strict=True):
        assert usual["waters"][0] == other["waters"][0]
        shared = usual["numbers"].keys() & other["numbers"].keys() - OTHERS[name].keys()
        assert len(shared) >= 8
        assert {n: usual["numbers"][n] for n in shared} == {n: other["numbers"][n] for n in shared}
        assert other["field_seed"] in (usual["field_seed"], None)


def test_numbers_of_other_names_and_seeds_are_independent() -> None:
    names, seeds = ("contrast", "exposure", "tone"), range(4000)
    table = torch.tensor([[uniform_of(seed)(name) for name in names] for seed in seeds])
    assert torch.allclose(table.mean(0), torch.tensor(0.5), atol=0.02)
    assert torch.allclose(table.std(0), torch.tensor(12**-0.5), atol=0.01)
    assert (torch.corrcoef(table.T) - torch.eye(3)).abs().max() < 0.05
    assert (torch.corrcoef(torch.stack([table[1:, 0], table[:-1, 0]]))[0, 1]).abs() < 0.05


@pytest.mark.parametrize("name", ["contrast", "waters", "distance", "p", "development"])
def test_options_are_read_only(name: str) -> None:
    augment = RandomUnderwater("7C")
    with pytest.raises(AttributeError, match=rf"{name} is read-only: dataclasses.replace\(trans"):
        setattr(augment, name, 0.5)
    with pytest.raises(AttributeError, match="min_contrast is read-only"):
        KeepVisible(augment).min_contrast = 0.5
    assert augment.eval().training is False
    assert replace(augment, contrast=0.5).to_dict()["contrast"] == 0.5
    assert "contrast" not in augment.to_dict()


@dataclass(frozen=True)
class Brightness(Source):
    """Distances of a network that takes sRGB, with a number of its own."""

    reads_maps = False
    reads_pictures = True

    def ranges(self) -> dict[str, Any]:
        return {"metres a unit": (1.0, 2.0)}

    def metres(
        self, distance: Tensor | None, image: Tensor, numbers: Mapping[str, float]
    ) -> Tensor:
        return 0.1 + numbers["metres a unit"] * image[:1]


def test_a_source_that_reads_pictures_gets_srgb() -> None:
    srgb = picture()
    metres = []
    for space, image in (("srgb", srgb), ("linear", srgb_to_linear(srgb))):
        development = RandomDevelopment(color_space=space)  # type: ignore[arg-type]
        augment = RandomUnderwater(distance=Brightness(), development=development, contrast=None)
        record = augment.make_params(image, torch.Generator().manual_seed(1))
        metres.append(augment.scenes(image, None, record).metres)
    torch.testing.assert_close(*metres, rtol=0, atol=1e-5)


def test_what_is_measured_of_a_film_takes_the_place_of_a_frame() -> None:
    own = Measured(64, 0.0, 1.0, 1.0, 4.0, 2.0)
    film = own.of_film({"median": 3.0, "exposure": 0.5, "white_balance": [1.0, 2.0, 3.0]})
    assert film == (64, 0.0, 1.0, 1.0, 4.0, 3.0, 0.5, (1.0, 2.0, 3.0))
    assert own.of_film({}) == own


def test_median_and_ends_are_those_of_what_is_not_open_water() -> None:
    augment, z = RandomUnderwater(contrast=None, field=None), 1 + distances()
    z[..., :20, :] = torch.inf
    scenes = augment.scenes(picture(), z, augment.make_params(picture()))
    nearest, median, farthest = scenes.spans[0]
    rest = z[z < torch.inf]
    assert (nearest, farthest) == (rest.min(), rest.max())
    assert median == pytest.approx(float(rest.median()), rel=0.1)
