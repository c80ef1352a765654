import math
import warnings

import pytest
import torch
from scenes import rand

import uwaug


def scene(near: float, far: float) -> tuple[torch.Tensor, torch.Tensor]:
    return rand(1, 3, 360, 400).float(), near + (far - near) * rand(1, 1, 360, 400, seed=1).float()


def survey(water: str) -> uwaug.Underwater:
    """Planned for .7…6.5 m."""
    return uwaug.load_preset("survey", water=water).module()


@pytest.mark.parametrize(
    "water, near, far, said",
    [
        ("7C", 0.1, 0.5, "100% of the pixels lie nearer than the 0.7…6.5 m"),
        ("II", 10.0, 20.0, "100% of the pixels lie farther than the 0.7…6.5 m"),
    ],
)
def test_pixels_beyond_the_plan_are_reported_once(water, near, far, said) -> None:
    degrade = survey(water)
    image, z = scene(near, far)
    with pytest.warns(UserWarning, match=said) as warned:
        degrade(image, z)
    assert warned[0].filename == __file__
    degrade(image, z)  # an error, in these tests, if it warned again


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_few_pixels_and_open_water_are_not_reported(factor: float) -> None:
    degrade = survey("7C")
    image, z = scene(1.0, 5.0)
    z[..., 0, :20] = 0.2
    z[..., 50:, :] = math.inf
    degrade(image, z, torch.full_like(z, factor))  # an error, in these tests, if it warned
    degrade(image[:0], z[:0])


def test_the_field_counts() -> None:
    degrade = survey("7C")
    image, z = scene(1.0, 2.0)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        degrade(image, z, torch.full_like(z, 0.1))
    assert len(caught) == 1
