"""Maps of another size than their pictures."""

import math

import pytest
import torch
from torch import Tensor

from uwaug import RandomUnderwater, RandomWater
from uwaug.distance import Inverse, Metres, Network, Relative, Source, along_ray
from uwaug.distance.sizes import brought_to, same_aspect
from uwaug.optics.view import View

H, W = 96, 132


def scene() -> Tensor:
    """A slope with a box before it, 1xHxW, m."""
    y, x = torch.meshgrid(torch.arange(1.0 * H), torch.arange(1.0 * W), indexing="ij")
    z = (2 + y / 60 + x / 90)[None]
    z[..., 30:60, 40:80] = 1.2
    return z


def sampled(z: Tensor, step: int = 4) -> Tensor:
    return z[..., step // 2 :: step, step // 2 :: step].contiguous()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_small_maps_are_brought_to_the_size_of_their_pictures(dtype: torch.dtype) -> None:
    full = scene().to(dtype)
    large = brought_to((H, W), sampled(full))
    assert (large.shape, large.dtype) == (full.shape, dtype)
    assert ((large - full).abs() / full).median() < 0.005
    # nothing hangs between the box and what is behind it
    edge = large[..., 20:70, 30:90]
    assert ((edge - 1.2).abs().minimum((edge - 2.2).clamp(max=0).abs()) < 1e-5).all()


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_holes_and_open_water_keep_their_size(value: float) -> None:
    small = sampled(scene())
    small[..., 10, 10] = value
    large = brought_to((H, W), small)
    expected = torch.zeros(1, H, W, dtype=torch.bool)
    expected[..., 40:44, 40:44] = True
    assert torch.equal(~((large > 0) & large.isfinite()), expected)
    assert torch.equal(large[..., 41, 41], torch.full((1,), value)) or math.isnan(value)


def test_larger_maps_and_gradients() -> None:
    z = scene().requires_grad_()
    small = brought_to((H // 3, W // 3), z)
    assert ((small - sampled(z, 3)).abs() < 0.05).double().mean() > 0.9
    small.sum().backward()
    assert z.grad is not None
    assert float(z.grad.sum()) == pytest.approx(small.numel(), rel=1e-5)


@pytest.mark.parametrize(
    "size, other, alike",
    [
        ((192, 256), (1440, 1920), True),  # a telephone
        ((480, 640), (968, 1296), True),  # ScanNet
        ((518, 686), (480, 640), True),  # a network, of whole patches
        ((56, 100), (1080, 1920), True),
        ((192, 256), (1920, 1440), False),
        ((192, 256), (1080, 1920), False),
        ((480, 640), (480, 600), False),
        ((24, 31), (24, 32), False),
    ],
)
def test_aspects(size: tuple[int, int], other: tuple[int, int], alike: bool) -> None:
    assert same_aspect(size, other) == same_aspect(other, size) == alike


def inverse(z: Tensor) -> Tensor:
    return (1 / z - 1 / z.max()) / (1 / z.min() - 1 / z.max())


FAR = float(scene().max())
SOURCES: list[tuple[Source, Tensor]] = [
    (Metres(), scene()),
    (Metres(planar=True), scene()),
    (Inverse(1.2, FAR), inverse(scene())),
    (Relative(1.2, FAR), ((scene() - 1.2) / (FAR - 1.2)).clamp(max=1)),
]


@pytest.mark.filterwarnings("ignore:a map is")
@pytest.mark.parametrize("source, z", SOURCES)
@pytest.mark.parametrize("host", [True, False])
def test_a_small_map_gives_nearly_the_scene_of_a_whole_one(
    source: Source, z: Tensor, host: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uwaug._support.checks.on_host", lambda x: host)
    augment = RandomUnderwater(RandomWater("3C", field=None), distance=source, view=70)
    image = torch.rand(2, 3, H, W)
    record = augment.make_params(image)
    far, near = (augment.scenes(image, torch.stack([m, m]), record).metres for m in (z, sampled(z)))
    assert near.shape == (2, 1, H, W)
    away = (near / far).log().abs()
    assert away.median() < 0.01
    assert (away < 0.05).double().mean() > 0.9
    planar = along_ray(scene(), View(70).focal(W)) if source == Metres(planar=True) else scene()
    assert torch.allclose(far[0], planar, rtol=1e-3)


def test_functions_may_give_small_maps() -> None:
    network = Network(lambda image: sampled(scene()), Metres())
    augment = RandomUnderwater(RandomWater("3C", field=None), distance=network)
    image = torch.rand(3, H, W)
    assert augment.scenes(image, None, augment.make_params(image)).metres.shape[-2:] == (H, W)


@pytest.mark.usefixtures("nothing_is_said")
def test_it_is_said_once() -> None:
    augment, image = RandomUnderwater("II"), torch.rand(3, H, W)
    with pytest.warns(UserWarning, match="a map is 33×24 px and its picture 132×96 px: it is"):
        augment(image, sampled(scene()))
    augment(image, sampled(scene()))  # silent: a warning would be an error


@pytest.mark.parametrize(
    "size, cure",
    [
        ((H, W - 20), "crop both alike"),
        ((W, H), "turn it, too, as EXIF has turned the picture"),
        ((0, 0), "crop both alike"),
    ],
)
def test_another_aspect_is_refused(size: tuple[int, int], cure: str) -> None:
    with pytest.raises(ValueError, match=f"or their ratio: {cure}"):
        RandomUnderwater("3C")(torch.rand(3, H, W), torch.ones(1, *size))
