"""Numbers in maps that are no distance, and maps of another size."""

import math
from typing import Any

import pytest
import torch
from augmenting import picture
from torch import Tensor

from uwaug import RandomUnderwater
from uwaug.distance import Inverse, Metres, Relative
from uwaug.distance.sizes import brought_to
from uwaug.distance.unknown import standing_alone

H, W = 24, 33
AUG = RandomUnderwater("3C", contrast=0.5)
RECORD = AUG.make_params(picture(), torch.Generator().manual_seed(0))


def floor() -> Tensor:
    """Distances of a floor that ends at a wall, 1xHxW."""
    return (2 / torch.linspace(1, 0.1, H)).clamp(max=8.0)[:, None].expand(1, H, W).clone()


def sky(value: float) -> Tensor:
    z = floor()
    z[:, : H // 2] = value
    return z


@pytest.mark.parametrize("value", [1e7, 1e10, 3e38])
@pytest.mark.parametrize("host", [True, False])
def test_what_no_one_sees_is_open_water(
    value: float, host: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uwaug._support.checks.on_host", lambda x: host)
    expected = AUG.transform(picture(), sky(math.inf), RECORD)
    assert torch.equal(AUG.transform(picture(), sky(value), RECORD), expected)
    filled = RandomUnderwater("3C", contrast=0.5, distance=Metres("far"))
    assert torch.equal(filled.transform(picture(), sky(value), RECORD), expected)


@pytest.mark.parametrize("value", [65.535, 655.35, 1000.0, 65504.0])
def test_a_sky_that_stands_alone_is_asked_for(value: float) -> None:
    with pytest.raises(ValueError, match=r"50 % of a map are .*sky\? --holes far"):
        AUG.transform(picture(), sky(value), RECORD)
    filled = RandomUnderwater("3C", contrast=0.5, distance=Metres("far"))
    expected = AUG.transform(picture(), sky(math.inf), RECORD)
    assert torch.equal(filled.transform(picture(), sky(value), RECORD), expected)


def test_far_distances_that_do_not_stand_alone_are_distances() -> None:
    z = torch.linspace(2, 90, H * W).reshape(1, H, W)
    assert torch.equal(Metres().metres(z, picture(), {}), z)
    assert not standing_alone(torch.full((1, H, W), 60.0), "largest").any()


UNKNOWN: dict[str, Any] = {
    "0 of a matcher": (Inverse(1, 5, holes="behind"), lambda z: 100 / z, 0.0),
    "−1 of a matcher": (Inverse(1, 5, holes="behind"), lambda z: 100 / z, -1.0),
    "−1 of a relative map": (Relative(1, 5, holes="fill"), lambda z: z / 8, -1.0),
}


@pytest.mark.parametrize("case", UNKNOWN)
def test_stand_ins_are_unknown_pixels(case: str) -> None:
    source, made, value = UNKNOWN[case]
    numbers = {"near": 1.0, "far": 5.0, "gamma": 1.0}
    z = made(floor())
    z[..., 3:6, 4:9] = value
    nan = torch.where(z == value, torch.nan, z)
    expected = source.metres(nan, picture(), numbers)
    assert torch.equal(source.metres(z, picture(), numbers), expected)


@pytest.mark.usefixtures("nothing_is_said")
def test_an_inverse_map_is_asked_for_a_least_value_that_stands_alone() -> None:
    numbers, network = {"near": 1.0, "far": 5.0}, 1 / floor() - 1 / 8
    Inverse(1, 5).metres(network, picture(), numbers)  # silent: a warning would be an error
    disparity = 100 / floor()
    disparity[..., 3:6, 4:9] = 0
    with pytest.warns(UserWarning, match=r"1.9 % of a map are 0, a gap away .*--holes behind"):
        Inverse(1, 5).metres(disparity, picture(), numbers)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_small_maps_are_brought_to_the_size_of_their_pictures(dtype: torch.dtype) -> None:
    y, x = torch.meshgrid(torch.arange(96.0), torch.arange(132.0), indexing="ij")
    full = (2 + y / 60 + x / 90).to(dtype)[None]
    full[..., 30:60, 40:80] = 1.2  # a box before a slope
    small = full[..., 2::4, 2::4].contiguous()
    large = brought_to((96, 132), small)
    assert large.shape == full.shape
    away = (large - full).abs() / full
    assert away.median() < 0.01
    # nothing hangs between the box and what is behind it
    edge = large[..., 20:70, 30:90]
    assert ((edge - 1.2).abs().minimum((edge - 2.2).clamp(max=0).abs()) < 1e-5).all()
    small[..., 10, 10] = 0
    assert (brought_to((96, 132), small) == 0).sum() == 16


@pytest.mark.usefixtures("nothing_is_said")
def test_maps_of_the_same_aspect_fit() -> None:
    z = floor()
    whole = torch.cat([z, z], -1)[..., :32].repeat_interleave(2, -1).repeat_interleave(2, -2)
    image = torch.rand(3, 2 * H, 64)
    augment = RandomUnderwater("3C", field=None)
    with pytest.warns(UserWarning, match="a map of 32×24 px is brought to 64×48 px"):
        scenes = augment.scenes(image, whole[..., ::2, ::2].clone(), augment.make_params(image))
    assert scenes.metres.shape == (1, 1, 48, 64)
