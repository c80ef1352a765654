"""Daylight from above."""

import json
import math

import pytest
import torch
from refusing import refusals
from scenes import rand
from torch import Tensor

from uwaug import (
    Development,
    Lamp,
    Light,
    Medium,
    RandomLight,
    RandomUnderwater,
    Sensor,
    Underwater,
    contrast_left,
)
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
    z = scene()[1].double().clamp(max=1e6)
    day = Light((), light.daylight).curves(MEDIUM, z, WIDE).veil
    level = Light(light.lamps, light.daylight).curves(MEDIUM, z, WIDE)
    curves = light.curves(MEDIUM, z, WIDE)
    assert torch.equal(curves.direct, level.direct)
    assert torch.equal(curves.scatter, level.scatter)
    torch.testing.assert_close(curves.veil, level.veil + (veil_factor(0.0, z, WIDE) - 1) * day)


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
    picture = augment.transform(image, z, {"samples": samples[:1]})
    drawn_level = {"samples": [{**samples[0], "light": {"pitch": 0.0}}]}
    assert not torch.equal(picture, augment.transform(image, z, drawn_level))
    # without one, as in the paper
    level = RandomUnderwater(light=RandomLight(share=0.0, pitch=None))
    params = level.make_params(image)
    paper = RandomUnderwater(light=None).transform(image, z, params)
    assert torch.equal(level.transform(image, z, params), paper)


def test_each_picture_has_its_pitch_and_noise() -> None:
    """Of one picture, too."""
    image, z = scene(1)
    for water in (MEDIUM, MEDIUM.to(torch.float32)):  # by PyTorch, by the loops
        for noise in (None, Sensor(8000, seed=3)):
            development = Development(noise=noise)
            both, *alone = (
                Underwater(water, None, light=Light(pitch=pitch), development=development)(image, z)
                for pitch in (torch.tensor([12.0, -30.0]), 12.0, -30.0)
            )
            assert both.shape == (2, *image.shape[1:])
            torch.testing.assert_close(both[:1], alone[0], rtol=0, atol=2e-5)
            if noise is None:
                torch.testing.assert_close(both[1:], alone[1], rtol=0, atol=1e-6)
                assert both[0, 0].mean() > both[1, 0].mean()
    left = contrast_left(z, MEDIUM, light=Light(pitch=torch.tensor([12.0, -30.0])))
    assert left.shape == (2, *z.shape[1:])


def test_pitches_are_written_and_read() -> None:
    light = Light(pitch=torch.tensor([5.0, -3.0]))
    read = from_plain(json.loads(json.dumps(to_plain(light))), Light)
    torch.testing.assert_close(read.pitch, light.pitch)


test_wrong_pitches_are_refused = refusals(
    (lambda: Light(pitch=91.0), "pitch"),
    (lambda: Light(pitch=torch.tensor([91.0])), "pitch"),
    (lambda: Light(pitch=torch.tensor([1])), "pitch"),
    (lambda: Light(pitch="up"), "pitch"),
    (lambda: RandomUnderwater(light=Light(pitch=torch.zeros(2))), "pitch"),
    (lambda: Underwater(MEDIUM, light=Light(pitch=torch.zeros(3)))(*scene(2)), "pitch"),
)
