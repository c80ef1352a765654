"""The water of a picture, against pictures that were rendered with known constants."""

import math
import re
import warnings
from typing import NamedTuple

import pytest
import torch
from torch import Tensor

import uwaug
import uwaug.formation.colour
from uwaug import Medium, RandomUnderwater, Underwater
from uwaug.fitting import red_channel_prior
from uwaug.presets.scene import Scene

HEIGHT, WIDTH, CELL = 240, 320, 4
HORIZON = 86
"""px from above: open water."""


class Known(NamedTuple):
    beta: tuple[float, float, float]
    veil: tuple[float, float, float]


WATERS = {
    "blue": Known((0.6, 0.18, 0.12), (0.03, 0.16, 0.28)),
    "green": Known((0.7, 0.25, 0.45), (0.02, 0.25, 0.12)),
    "middle": Known((0.35, 0.2, 0.25), (0.08, 0.3, 0.35)),
    "turbid": Known((0.8, 0.5, 0.55), (0.15, 0.35, 0.3)),
}


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def cells(values: Tensor) -> Tensor:
    return values.repeat_interleave(CELL, 1).repeat_interleave(CELL, 2)


def seafloor(black: float = 0.35) -> tuple[Tensor, Tensor]:
    """Coloured stones on a plane .7 to 6.4 m away, some of them black; and open water."""
    grid = (HEIGHT // CELL, WIDTH // CELL)
    lit = (random(1, *grid, seed=1) > black).float()
    stones = cells((0.15 + 0.8 * random(3, *grid)) * lit)
    below = torch.arange(HEIGHT) - HORIZON + 20
    z = torch.where(below >= 20, 128 / below.clamp(min=1), torch.inf)
    return stones, z[None, :, None].expand(1, HEIGHT, WIDTH).clone()


def seen(scene: Tensor, z: Tensor, water: Known, noise: float = 0.005) -> Tensor:
    """As a camera's 8 bits, with noise."""
    medium = Medium.from_coefficients(water.beta, water.beta, water.veil)
    light = Underwater(medium, color_space="linear")(scene, z)
    values = uwaug.formation.colour.linear_to_srgb(light)
    grain = torch.randn(values.shape, generator=torch.Generator().manual_seed(2))
    return ((values + noise * grain).clamp(0, 1) * 255).round().to(torch.uint8)


def arrives(water: Known, z: Tensor) -> Tensor:
    return torch.exp(-torch.tensor(water.beta)[:, None, None] * z)


def errors(a: Tensor, b: Tensor, where: Tensor) -> tuple[float, float]:
    """Mean absolute, and RMS, of the worst channel."""
    apart = (a - b)[:, where[0]]
    return float(apart.abs().mean(1).max()), float(apart.square().mean(1).sqrt().max())


@pytest.mark.parametrize("name", WATERS)
@pytest.mark.parametrize("given", ["metres and open water", "metres", "nothing"])
def test_recovers_known_constants(name: str, given: str) -> None:
    water, (scene, z) = WATERS[name], seafloor()
    distance = {"metres": torch.where(z.isinf(), torch.nan, z), "nothing": None}.get(given, z)
    found = red_channel_prior(seen(scene, z, water), distance)
    torch.testing.assert_close(found.veil, torch.tensor(water.veil).double(), rtol=0.05, atol=0)
    far = found.open_water & z.isfinite()
    surfaces = z.isfinite() & ~far & found.transmission[:1].isfinite()
    assert surfaces.float().mean() > 0.4
    mean, rms = errors(found.transmission, arrives(water, z), surfaces)
    assert mean < (0.03 if found.metric else 0.05)
    assert rms < (0.03 if found.metric else 0.06)
    assert (arrives(water, z)[:, far[0]] < 0.4).all()  # what is taken for water is faint
    assert found.metric == (given != "nothing")
    assert not found.doubts
    if found.metric:
        steps = torch.linspace(0.8, 8, 50)[None, None]
        known = Medium.from_coefficients(water.beta, water.beta, water.veil)
        apart = found.medium.transmission(steps) - known.transmission(steps)
        assert apart.abs().max() < 0.05


def test_the_medium_makes_the_picture_again() -> None:
    """Another scene in the water of the picture, at the picture's own relative distances."""
    water, (scene, z) = WATERS["middle"], seafloor()
    found = red_channel_prior(seen(scene, z, water))
    relative = -found.transmission[2:].double().log() / found.rates[2]
    other = cells(random(3, HEIGHT // CELL, WIDTH // CELL, seed=5))
    apply = Underwater(found.medium, color_space="linear")
    mine = apply(other, torch.where(relative.isnan(), 1.0, relative).float())
    wanted = seen(other, z, water, noise=0)
    light = uwaug.formation.colour.to_light(wanted, "srgb")
    assert (mine - light).square().mean().sqrt() < 0.03
    assert 0.9 < float(relative[relative.isfinite()].quantile(0.98)) < 1.1


def test_medium_from_picture() -> None:
    water, (scene, z) = WATERS["middle"], seafloor()
    picture = seen(scene, z, water)
    medium, found = red_channel_prior(picture, z).medium, red_channel_prior(picture, z)
    assert torch.equal(medium.G, found.rates[None])
    assert torch.equal(medium.beta, medium.G)
    torch.testing.assert_close(medium.backscatter(torch.tensor(1e6).double())[0], found.veil)
    assert "estimate" in repr(medium)
    assert "metres" in repr(medium)
    assert "relative" in repr(red_channel_prior(picture).medium)
    both = Medium.stack([medium, red_channel_prior(picture).medium])
    assert len(both) == 2


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32, torch.float64])
def test_values_and_color_spaces_agree(dtype: torch.dtype) -> None:
    scene, z = seafloor()
    picture = seen(scene, z, WATERS["turbid"])
    wanted = red_channel_prior(picture, z)
    unit = picture / 255
    light = uwaug.formation.colour.srgb_to_linear(unit)
    given = picture if dtype == torch.uint8 else unit.to(dtype)
    found = [red_channel_prior(given, z)]
    if dtype != torch.uint8:
        found.append(red_channel_prior(light.to(dtype), z, color_space="linear"))
    for one in found:
        torch.testing.assert_close(one.veil, wanted.veil, rtol=1e-5, atol=0)
        torch.testing.assert_close(one.rates, wanted.rates, rtol=1e-2, atol=0)


def test_large_pictures_are_looked_at_small() -> None:
    scene, z = seafloor()
    picture = seen(scene, z, WATERS["turbid"])
    large = picture.repeat_interleave(3, 1).repeat_interleave(3, 2)[:, :-1]
    far = z.repeat_interleave(3, 1).repeat_interleave(3, 2)[:, :-1]
    found, wanted = red_channel_prior(large, far), red_channel_prior(picture, z)
    torch.testing.assert_close(found.veil, wanted.veil, rtol=0.01, atol=0)
    torch.testing.assert_close(found.rates, wanted.rates, rtol=0.03, atol=0)
    assert found.transmission.shape == large.shape
    assert found.open_water.shape == far.shape


# where the scene does not allow it


def test_says_where_nothing_is_dark() -> None:
    water, (scene, z) = WATERS["blue"], seafloor(black=0.0)
    with pytest.warns(UserWarning, match="nothing dark"):
        found = red_channel_prior(seen(scene, z, water))
    assert any("nothing dark" in doubt for doubt in found.doubts)
    assert "nothing dark" in repr(found.medium)
    assert "nothing dark" in repr(found)


def test_says_where_dark_and_alike_disagree() -> None:
    water, (scene, z) = WATERS["blue"], seafloor(black=0.0)
    with pytest.warns(UserWarning, match="the rate of red"):
        red_channel_prior(seen(0.2 + 0.8 * scene, z, water), z)


@pytest.mark.parametrize(
    "rate, said", [(8.0, "hardly any of it is left"), (0.001, "it hardly fades")]
)
def test_says_where_red_is_gone_or_does_not_fade(rate: float, said: str) -> None:
    scene, z = seafloor()
    water = Known((rate, 0.2, 0.25), (0.08, 0.3, 0.35))
    with pytest.warns(UserWarning, match=rf"the rate of red \([^)]*{said}"):
        red_channel_prior(seen(scene, z, water), z)


def test_the_bundled_scene_is_doubted(motorcycle: Scene) -> None:
    z = motorcycle.distance.float()
    z = 1 + 7 * (z - z.min()) / (z.max() - z.min())
    z[:, :120] = torch.inf
    picture = seen(motorcycle.linear.float(), z, WATERS["green"])
    with pytest.warns(UserWarning, match="all distances"):
        found = red_channel_prior(picture)
    veil = torch.tensor(WATERS["green"].veil).double()
    torch.testing.assert_close(found.veil, veil, rtol=0.05, atol=0)


def test_other_even_parts_are_said() -> None:
    scene, z = seafloor()
    picture = seen(scene, z, WATERS["middle"])
    picture[:, 160:230, 100:220] = torch.tensor([20, 60, 90], dtype=torch.uint8)[:, None, None]
    with pytest.warns(UserWarning, match="as even, of another colour"):
        red_channel_prior(picture)


def wall() -> tuple[Tensor, Tensor]:
    """A smooth wall behind stones, as open water would be, and its distance."""
    scene, z = seafloor()
    scene[:, :HORIZON] = 0.3
    z[:, :HORIZON] = 3.0
    return scene, z


def constant(value: float) -> Tensor:
    return torch.full((3, 96, 96), value)


def refused(picture: Tensor, distance: Tensor | None, said: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        with pytest.raises(ValueError, match=said):
            red_channel_prior(picture, distance)


@pytest.mark.parametrize("name", WATERS)
def test_refuses_a_wall_at_a_known_distance(name: str) -> None:
    scene, z = wall()
    refused(seen(scene, z, WATERS[name]), z, r"looks like open water is 3 m away")


def test_refuses_a_near_wall_by_its_colour() -> None:
    scene, z = wall()
    z = z.clamp(max=4) / 8
    refused(seen(scene, z, WATERS["middle"]), None, "red is darkest")


def test_refuses_a_textured_wall() -> None:
    water, (scene, z) = WATERS["middle"], wall()
    scene[:, :HORIZON] *= cells(random(3, HEIGHT // CELL, WIDTH // CELL, seed=7))[:, :HORIZON]
    refused(seen(scene, z, water), None, "no open water in view")


def test_refuses_pictures_that_tell_nothing() -> None:
    scene, z = seafloor()
    swapped = seen(scene, z, WATERS["blue"]).flip(0)
    refused(swapped, None, "red is darkest")
    refused(constant(0.3), None, "even all over")
    refused(constant(0.3)[:, :40], None, "too small, 40×96 px")
    bright = seen(1 - 0.3 * scene, z.clamp(min=4), WATERS["turbid"])
    refused(bright, None, "hardly any surface is darker")
    texture = cells(random(3, 60, 80))
    refused(texture, None, "no open water in view")
    dark = (texture * 255).to(torch.uint8)
    dark[:, :HORIZON] = 0
    refused(dark, torch.where(z.isinf(), z, 2.0), "open water has the light 0, 0, 0")


def test_refuses_distances_that_tell_nothing() -> None:
    scene, z = seafloor()
    picture = seen(scene, z, WATERS["middle"])
    refused(picture, torch.where(z.isinf(), z, 2.0), "too much alike")
    refused(picture, torch.where(z.isinf(), z, torch.nan), "distance is known at 0 pixels")
    refused(picture, z * 1000, "millimetres")
    refused(picture, z[:, 1:], "distance is")
    refused(picture, z[None], "one map")


def test_refuses_what_is_no_picture() -> None:
    scene, z = seafloor()
    for picture, error, said in (
        (scene.numpy(), TypeError, "picture must be a floating-point tensor"),
        (scene[None], ValueError, "picture must be one"),
        (scene[:1], ValueError, "picture must have shape"),
        (scene * 255, ValueError, "picture reaches .* divide a 0…255 image"),
        (scene * math.nan, ValueError, "NaN"),
    ):
        with pytest.raises(error, match=said):
            red_channel_prior(picture, z)
    with pytest.raises(ValueError, match="color_space"):
        red_channel_prior(scene, z, color_space="rgb")  # type: ignore[arg-type]


def test_pictures_are_no_spectra() -> None:
    picture = seen(*seafloor(), WATERS["middle"])
    told = re.escape("uwaug.fitting.red_channel_prior")
    for waters in ([picture], picture, [picture.numpy()], {picture: 1.0}):
        with pytest.raises(TypeError, match=told):
            RandomUnderwater(waters)  # type: ignore[arg-type]
