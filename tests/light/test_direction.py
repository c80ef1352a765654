"""Daylight from above."""

import json
import math
from typing import Any

import pytest
import torch
from scenes import rand
from torch import Tensor

from uwaug import Lamp, Light, Medium, RandomLight, RandomUnderwater, Underwater
from uwaug._support.codec import from_plain, to_plain
from uwaug.light.direction import veil_factor
from uwaug.optics.view import WIDE, View

MEDIUM = Medium.from_water("3C", vertical_depth=6.0, g=0.05, mu=0.05)
LAMP = Lamp((0.4, -0.3, 0.0), 2.0)


def scene(batch: int = 2) -> tuple[Tensor, Tensor]:
    z = 0.5 + 4 * rand(batch, 1, 30, 44, seed=1)
    z[..., :9, :] = torch.inf
    return rand(batch, 3, 30, 44).float(), z.float()


@pytest.mark.parametrize("view", [60.0, 120.0])
def test_a_ray_sees_what_its_elevation_does(view: float) -> None:
    height, width = 480, 640
    factors = veil_factor(20.0, torch.zeros(1, 1, height, width), View(view))[0, 0]
    focal = width / 2 / math.tan(math.radians(view / 2))
    pitch = math.radians(20)
    for row, column in ((0, 0), (100, 639), (240, 320), (479, 5)):
        right, down = column - (width - 1) / 2, row - (height - 1) / 2
        up = focal * math.sin(pitch) - down * math.cos(pitch)
        sine = min(up / math.hypot(right, down, focal), math.sin(math.pi / 4))
        assert float(factors[row, column]) == pytest.approx((1 - 0.8 * sine) ** -2, rel=1e-5)


@pytest.mark.parametrize("light", [Light(pitch=0.0), Light([LAMP], daylight=0.5, pitch=0.0)])
def test_the_veil_alone_is_multiplied(light: Light) -> None:
    _, z = scene()
    z = z.double().clamp(max=1e6)
    level = Light(light.lamps, light.daylight)
    day = Light((), light.daylight).curves(MEDIUM, z, WIDE).veil
    factors = veil_factor(0.0, z, WIDE)
    curves, before = light.curves(MEDIUM, z, WIDE), level.curves(MEDIUM, z, WIDE)
    assert torch.equal(curves.direct, before.direct)
    assert torch.equal(curves.scatter, before.scatter)
    torch.testing.assert_close(curves.veil, before.veil + (factors - 1) * day)


def test_each_picture_has_its_pitch() -> None:
    image, z = scene()
    water, pitches = MEDIUM.to(torch.float32), (12.0, -30.0)

    def degraded(pitch: float | Tensor, rows: slice) -> Tensor:
        light = Light(pitch=pitch)
        return Underwater(water, light=light, distance_range=None)(image[rows], z[rows])

    together = degraded(torch.tensor(pitches), slice(None))
    for i, pitch in enumerate(pitches):
        alone = degraded(pitch, slice(i, i + 1))
        assert (together[i : i + 1] - alone).abs().max() < 1e-6


def test_gradients_of_pitch() -> None:
    image, z = (x.double() for x in scene(1))
    module = Underwater(MEDIUM, distance_range=None)

    def degraded(pitch: Tensor) -> Tensor:
        module.light = Light(pitch=pitch)
        return module(image, z)[..., ::7, ::11]

    pitch = torch.tensor([5.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(degraded, pitch)


def test_random_pictures_look_up_and_down() -> None:
    augment = RandomUnderwater(light=RandomLight(share=0.0, pitch=(-40.0, 40.0)))
    image, z = scene(1)
    samples = augment.make_params(image.expand(64, -1, -1, -1))["samples"]
    pitches = [sample["light"]["pitch"] for sample in samples]
    assert min(pitches) < -30 < 30 < max(pitches)
    for sample in samples[:4]:
        picture = augment.transform(image, z, {"samples": [sample]})
        level = augment.transform(image, z, {"samples": [{**sample, "light": {"pitch": 0.0}}]})
        assert not torch.equal(picture, level)
    params, level = {"samples": samples[:1]}, RandomLight(share=0.0, pitch=None)
    with pytest.raises(ValueError, match=r"other options: light\.pitch"):
        RandomUnderwater(light=level).transform(image, z, params)
    params = RandomUnderwater(light=level).make_params(image)
    assert params["samples"][0]["light"] == {}
    paper = RandomUnderwater(light=None).transform(image, z, params)
    assert torch.equal(RandomUnderwater(light=level).transform(image, z, params), paper)


def test_pitches_are_written_and_read() -> None:
    light = Light(pitch=torch.tensor([5.0, -3.0]))
    read = from_plain(json.loads(json.dumps(to_plain(light))), Light)
    assert isinstance(read.pitch, Tensor)
    assert torch.equal(read.pitch, torch.tensor([5.0, -3.0]))


def test_pictures_and_pitches_are_as_many() -> None:
    image, z = scene(2)
    module = Underwater(MEDIUM, light=Light(pitch=torch.tensor([1.0, 2.0, 3.0])))
    with pytest.raises(ValueError, match="pitch"):
        module(image, z)
    two = Light(pitch=torch.tensor([40.0, -40.0]))
    for water in (MEDIUM, MEDIUM.to(torch.float32)):
        above, below = Underwater(water, light=two, distance_range=None)(image[:1], z[:1])
        assert above[:, 0].mean() > below[:, 0].mean()
    with pytest.raises(ValueError, match="must be one number for all pictures"):
        RandomUnderwater(light=two)


@pytest.mark.parametrize("pitch", [91.0, torch.tensor([91.0]), torch.tensor([1]), "up"])
def test_wrong_pitches_are_refused(pitch: Any) -> None:
    with pytest.raises((TypeError, ValueError), match="pitch must be"):
        Light(pitch=pitch)
