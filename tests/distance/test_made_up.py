"""Distances made up from a picture."""

import pickle

import pytest
import torch
from torch import Tensor

import uwaug
from uwaug.distance import MadeUp, cue

SCENES = [k / 24 for k in range(24)]


def made(image: Tensor, scene: float, near: float = 1.0, far: float = 8.0, **options) -> Tensor:
    return MadeUp(**options).metres(None, image, {"near": near, "far": far, "scene": scene})


def texture(height: int, width: int, seed: int = 0) -> Tensor:
    return torch.rand(3, height, width, generator=torch.Generator().manual_seed(seed))


def grain() -> Tensor:
    """240x360."""
    return 0.1 + 0.3 * texture(40, 60).repeat_interleave(6, 1).repeat_interleave(6, 2)


def landscape(horizon: int = 120) -> Tensor:
    """240x360: a blue sky, paler below, over ground of grain, finer above."""
    image = torch.empty(3, 240, 360)
    blue, pale = torch.tensor([[0.35, 0.55, 0.9], [0.7, 0.82, 0.95]])[..., None, None]
    image[:, :horizon] = torch.lerp(blue, pale, torch.linspace(0, 1, horizon)[:, None])
    row = horizon
    for size in (2, 3, 4, 6, 9, 12, 18, 24, 42):
        rows = texture(1, 360 // size + 1, row).repeat_interleave(size, 2)[..., :360]
        image[:, row : row + size] = (0.1 + 0.3 * rows) * torch.tensor([1, 0.9, 0.6])[:, None, None]
        row += size
    return image


def cat() -> Tensor:
    from skimage.data import chelsea

    return torch.from_numpy(chelsea().copy()).permute(2, 0, 1)


@pytest.mark.parametrize("options", [{}, {"cue": "ramp"}], ids=["network", "ramp"])
@pytest.mark.parametrize("size", [(1, 1), (1, 40), (90, 1), (40, 61), (6, 2000)])
def test_every_picture_has_some_solid_ground(size, options) -> None:
    for image in (texture(*size), torch.full((3, *size), 0.5)):
        for scene in SCENES[::8]:
            z = made(image, scene, **options)
            assert z.shape == (1, *size)
            assert float(z.min()) > 0.999
            assert bool(z.isfinite().any())


def test_another_scene_for_another_number_from_near_to_far() -> None:
    maps = [made(cat(), scene, 0.5, 4.0) for scene in SCENES]
    for z in maps:
        assert 0.499 < float(z.min()) < 0.8
        assert 2.5 < float(z.max()) < 4.001
    assert len({tuple(z.flatten()[::97].tolist()) for z in maps}) == len(SCENES)


def test_dtype_default_device_and_threads_change_nothing() -> None:
    image, threads = cat(), torch.get_num_threads()
    expected = made(image, 0.3)
    for dtype in (torch.float32, torch.float64):
        z = made(image.to(dtype) / 255, 0.3)
        assert z.dtype == dtype
        torch.testing.assert_close(z.float(), expected, rtol=1e-3, atol=0)
    with torch.device("meta"):
        assert torch.equal(made(image, 0.3), expected)
    torch.set_default_dtype(torch.float64)
    try:
        assert torch.equal(made(image, 0.3), expected)
        for count in (1, 2, 3):
            torch.set_num_threads(count)
            torch.testing.assert_close(made(image, 0.3), expected, rtol=1e-5, atol=0)
    finally:
        torch.set_default_dtype(torch.float32)
        torch.set_num_threads(threads)


def test_the_sky_is_open_water_in_three_of_four() -> None:
    z = torch.stack([made(landscape(), scene)[0] for scene in SCENES])
    share = z.isinf()[:, :80].float().mean((1, 2))
    assert 12 <= int((share > 0.8).sum()) <= 23
    assert bool(((share > 0.8) | (share == 0)).all())
    assert bool(z[:, 150:].isfinite().all())
    # it begins behind the far end
    rim = z[:, :-1][z[:, :-1].isfinite() & z[:, 1:].isinf()]
    assert bool((rim > 7.99).all())


def test_what_is_plain_has_no_steps() -> None:
    plain = torch.full((3, 240, 360), 0.4)
    for scene in SCENES[::3]:
        light = torch.exp(-made(plain, scene)[0] / 3)
        assert max(float(light.diff(dim=axis).abs().max()) for axis in (0, 1)) < 0.05


def test_distances_step_where_the_picture_does(monkeypatch) -> None:
    # an edge in a pixel of the small copy, which the network blurs
    image = torch.full((3, 240, 360), 0.2)
    image[:, :, 177:] = torch.tensor([0.9, 0.5, 0.3])[:, None, None]

    def blurred(picture: Tensor, weights: object) -> tuple[Tensor, Tensor]:
        height, width = (side // 2 for side in picture.shape[1:])
        log = torch.linspace(-60, 60, width).sigmoid().expand(height, width)
        return log, torch.zeros_like(log)

    monkeypatch.setattr(cue, "relative", blurred)
    at_edge = beside = 0.0
    for scene in SCENES:
        across = torch.exp(-made(image, scene)[0, 120] / 3).diff().abs()
        at_edge += float(across[176])
        beside += float(across.sum() - across[176])
    assert at_edge > 1.0
    assert beside < 1.2 * at_edge


def test_the_ramp_is_near_below_and_needs_no_weights(monkeypatch) -> None:
    def missing() -> None:
        raise FileNotFoundError

    monkeypatch.setattr(cue, "learnt", missing)
    for scene in SCENES:
        z = made(grain(), scene, cue="ramp")
        assert bool(z.isfinite().all())
        assert float(z[0, -20:].mean()) < 0.6 * float(z[0, :20].mean())
    with pytest.raises(FileNotFoundError):
        [made(grain(), scene) for scene in SCENES]


def test_the_weights_are_small_and_stay_where_they_are() -> None:
    assert cue.FILE.stat().st_size < 2e6
    made(grain(), 0.5)
    assert len(pickle.dumps(MadeUp())) < 300
    assert len(pickle.dumps(uwaug.RandomUnderwater(distance=MadeUp()))) < 3e5
