"""Distances made up from a picture."""

from itertools import product

import pytest
import torch
from torch import Tensor

from uwaug.distance import MadeUp

SCENES = [k / 24 for k in range(24)]


def made(image: Tensor, scene: float, near: float = 1.0, far: float = 8.0) -> Tensor:
    return MadeUp().metres(None, image, {"near": near, "far": far, "scene": scene})


def texture(height: int, width: int, seed: int = 0) -> Tensor:
    return torch.rand(3, height, width, generator=torch.Generator().manual_seed(seed))


def steps(z: Tensor) -> Tensor:
    """Of light, from column to column and from row to row, the larger one (H-1 x W-1)."""
    light = torch.exp(-z[0] / 3)
    across, down = light.diff(dim=1)[1:], light.diff(dim=0)[:, 1:]
    return torch.maximum(across.abs(), down.abs())


@pytest.mark.parametrize(
    ("size", "value"),
    [*product([(1, 1), (1, 90), (90, 1), (2, 3), (40, 61), (6, 2000)], (None, 0.5))],
)
def test_every_picture_has_some_solid_ground(size, value) -> None:
    image = texture(*size) if value is None else torch.full((3, *size), value)
    for scene in SCENES:
        z = made(image, scene)
        assert z.shape == (1, *size)
        assert float(z.min()) > 0.999
        assert bool(z.isfinite().any())


def test_distances_reach_from_near_to_far() -> None:
    for scene in SCENES:
        z = made(grain(), scene, 0.5, 4.0)  # no top is plain
        assert 0.499 < float(z.min()) < 0.8
        assert 3.2 < float(z.max()) < 4.001


def test_another_scene_for_another_number_and_the_same_for_the_same() -> None:
    image = texture(48, 64)
    maps = [made(image, scene) for scene in SCENES]
    assert all(torch.equal(made(image, scene), z) for scene, z in zip(SCENES, maps, strict=True))
    assert len({tuple(z.flatten()[::97].tolist()) for z in maps}) == len(SCENES)


def test_a_picture_in_whole_numbers_is_the_same_scene() -> None:
    image = (255 * texture(30, 40)).byte()
    for dtype in (torch.float32, torch.float64):
        z = made(image.to(dtype) / 255, 0.3)
        assert z.dtype == dtype
        torch.testing.assert_close(z.float(), made(image, 0.3), rtol=1e-3, atol=0)


def test_another_default_device_changes_nothing() -> None:
    image = texture(30, 40)
    with torch.device("meta"):
        elsewhere = made(image, 0.3)
    assert torch.equal(elsewhere, made(image, 0.3))


def grain() -> Tensor:
    """240x360."""
    return 0.1 + 0.3 * texture(40, 60).repeat_interleave(6, 1).repeat_interleave(6, 2)


def scene_with_sky(horizon: int = 120) -> Tensor:
    """240x360: a plain top, ground of coarse grain."""
    image = grain()
    image[:, :horizon] = torch.tensor([0.6, 0.8, 0.95])[:, None, None]
    return image


def test_a_plain_top_is_open_water_in_three_of_four() -> None:
    share = [made(scene_with_sky(), scene).isinf()[0, :20].float().mean() for scene in SCENES]
    open_water = sum(float(one) > 0.9 for one in share)
    assert 14 <= open_water <= 23
    assert all(float(one) > 0.9 or float(one) == 0 for one in share)
    for scene in SCENES:
        assert bool(made(scene_with_sky(), scene)[0, 130:].isfinite().all())


def test_what_is_plain_has_no_steps() -> None:
    plain = torch.full((3, 240, 360), 0.4)
    assert max(float(steps(made(plain, scene)).max()) for scene in SCENES) < 0.05


def test_distances_step_where_the_picture_does() -> None:
    # an edge between two pixels of the small copy
    image = torch.full((3, 240, 360), 0.2)
    image[:, :, 173:] = torch.tensor([0.9, 0.5, 0.3])[:, None, None]
    at_edge = beside = 0.0
    for scene in SCENES:
        light = torch.exp(-made(image, scene)[0, 200:] / 3)
        across = light.diff(dim=1).abs().mean(0)
        at_edge += float(across[172])
        beside += float(across[150:195].sum() - across[172])
    assert at_edge > 1.0
    assert beside < 0.7 * at_edge
