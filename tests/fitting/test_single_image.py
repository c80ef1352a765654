"""The water of a real picture, against pictures that were rendered with known constants."""

import math
import re
import warnings
from typing import Any, NamedTuple

import pytest
import torch
from fitted import as_bytes
from torch import Tensor

from uwaug import Medium, RandomUnderwater, Underwater
from uwaug.fitting import red_channel_prior
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear

HEIGHT, WIDTH, CELL = 240, 320, 4
HORIZON = 86
"""px from above: open water."""


class Water(NamedTuple):
    beta: tuple[float, float, float]
    veil: tuple[float, float, float]

    @property
    def medium(self) -> Medium:
        return Medium.from_coefficients(self.beta, self.beta, self.veil)


WATERS = {
    "blue": Water((0.6, 0.18, 0.12), (0.03, 0.16, 0.28)),
    "green": Water((0.7, 0.25, 0.45), (0.02, 0.25, 0.12)),
    "middle": Water((0.35, 0.2, 0.25), (0.08, 0.3, 0.35)),
    "turbid": Water((0.8, 0.5, 0.55), (0.15, 0.35, 0.3)),
}


def cells(seed: int = 0) -> Tensor:
    """A picture of random patches."""
    generator = torch.Generator().manual_seed(seed)
    values = torch.rand(3, HEIGHT // CELL, WIDTH // CELL, generator=generator)
    return values.repeat_interleave(CELL, 1).repeat_interleave(CELL, 2)


def seafloor(black: float = 0.35) -> tuple[Tensor, Tensor]:
    """Coloured stones on a plane .7 to 6.4 m away, some of them black; and open water."""
    lit = cells(seed=1)[:1] > black
    below = torch.arange(HEIGHT) - HORIZON + 20
    z = torch.where(below >= 20, 128 / below.clamp(min=1), torch.inf)
    return (0.15 + 0.8 * cells()) * lit, z[None, :, None].expand(1, HEIGHT, WIDTH).clone()


def seen(scene: Tensor, z: Tensor, water: Water, noise: float = 0.005) -> Tensor:
    """As a camera's 8 bits, with noise."""
    values = linear_to_srgb(Underwater(water.medium, None, color_space="linear")(scene, z))
    grain = torch.randn(values.shape, generator=torch.Generator().manual_seed(2))
    return ((values + noise * grain).clamp(0, 1) * 255).round().to(torch.uint8)


@pytest.mark.parametrize("name", WATERS)
@pytest.mark.parametrize("known", ["metres and open water", "metres", "nothing"])
def test_recovers_known_constants(name: str, known: str) -> None:
    water, (scene, z) = WATERS[name], seafloor()
    distance = {"metres": torch.where(z.isinf(), torch.nan, z), "nothing": None}.get(known, z)
    estimate = red_channel_prior(seen(scene, z, water), distance)
    torch.testing.assert_close(estimate.veil, torch.tensor(water.veil).double(), rtol=0.05, atol=0)
    far = estimate.open_water & z.isfinite()
    surfaces = z.isfinite() & ~far & estimate.transmission[:1].isfinite()
    assert surfaces.float().mean() > 0.4
    arrives = torch.exp(-torch.tensor(water.beta)[:, None, None] * z)
    assert (arrives[:, far[0]] < 0.4).all()  # what is taken for water is faint
    apart = (estimate.transmission - arrives)[:, surfaces[0]]
    assert apart.abs().mean(1).max() < (0.03 if estimate.metric else 0.05)
    assert apart.square().mean(1).sqrt().max() < (0.03 if estimate.metric else 0.06)
    assert estimate.metric == (known != "nothing")
    assert not estimate.doubts
    unit = "metres" if estimate.metric else "relative distance"
    assert f"red-channel prior, {unit}" in repr(estimate.medium)
    if estimate.metric:
        steps = torch.linspace(0.8, 8, 50)[None, None]
        apart = estimate.medium.transmission(steps) - water.medium.transmission(steps)
        assert apart.abs().max() < 0.05


def test_the_medium_makes_the_picture_again() -> None:
    """Another scene in the water of the picture, at the picture's own relative distances."""
    water, (scene, z) = WATERS["middle"], seafloor()
    estimate = red_channel_prior(seen(scene, z, water))
    medium = estimate.medium
    assert torch.equal(medium.G, estimate.rates[None])
    assert torch.equal(medium.beta, medium.G)
    torch.testing.assert_close(medium.backscatter(torch.tensor(1e6).double())[0], estimate.veil)
    relative = -estimate.transmission[2:].double().log() / estimate.rates[2]
    assert 0.9 < float(relative[relative.isfinite()].quantile(0.98)) < 1.1
    other, apply = cells(seed=5), Underwater(medium, None, color_space="linear")
    mine = apply(other, torch.where(relative.isnan(), 1.0, relative).float())
    light = srgb_to_linear(seen(other, z, water, noise=0) / 255)
    assert (mine - light).square().mean().sqrt() < 0.03


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_values_and_color_spaces_agree(dtype: torch.dtype) -> None:
    scene, z = seafloor()
    picture = seen(scene, z, WATERS["turbid"])
    wanted, unit = red_channel_prior(picture, z), picture.to(dtype) / 255
    for estimate in (
        red_channel_prior(unit, z),
        red_channel_prior(srgb_to_linear(unit), z, color_space="linear"),
    ):
        torch.testing.assert_close(estimate.veil, wanted.veil, rtol=1e-5, atol=0)
        torch.testing.assert_close(estimate.rates, wanted.rates, rtol=1e-2, atol=0)


def test_large_pictures_are_looked_at_small() -> None:
    scene, z = seafloor()
    picture = seen(scene, z, WATERS["turbid"])
    large, far = (x.repeat_interleave(3, 1).repeat_interleave(3, 2)[:, :-1] for x in (picture, z))
    estimate, wanted = red_channel_prior(large, far), red_channel_prior(picture, z)
    torch.testing.assert_close(estimate.veil, wanted.veil, rtol=0.01, atol=0)
    torch.testing.assert_close(estimate.rates, wanted.rates, rtol=0.03, atol=0)
    assert estimate.transmission.shape == large.shape
    assert estimate.open_water.shape == far.shape


# ---- where the scene does not allow it


def test_says_where_nothing_is_dark() -> None:
    scene, z = seafloor(black=0.0)
    with pytest.warns(UserWarning, match="nothing dark"):
        estimate = red_channel_prior(seen(scene, z, WATERS["blue"]))
    for words in (*estimate.doubts[-1:], repr(estimate.medium), repr(estimate)):
        assert "nothing dark" in words
    with pytest.warns(UserWarning, match="the rate of red"):
        red_channel_prior(seen(0.2 + 0.8 * scene, z, WATERS["blue"]), z)


@pytest.mark.parametrize(
    "rate, said", [(8.0, "hardly any of it is left"), (0.001, "it hardly fades")]
)
def test_says_where_red_is_gone_or_does_not_fade(rate: float, said: str) -> None:
    water = Water((rate, 0.2, 0.25), (0.08, 0.3, 0.35))
    scene, z = seafloor()
    with pytest.warns(UserWarning, match=rf"the rate of red \([^)]*{said}"):
        red_channel_prior(seen(scene, z, water), z)


@pytest.mark.parametrize(
    "beta", [(0.6, 0.25, 0.2), (0.4, 0.2, 0.2), (1.0, 0.4, 0.3)], ids=["coast", "clear", "turbid"]
)
def test_red_is_doubted_where_its_veil_is_as_dark_as_dark_surfaces(
    beta: tuple[float, float, float], motorcycle: Any
) -> None:
    """The darkest of the motorcycle reflect .02, nearly half of the veil of red."""
    z = motorcycle.distance.float()
    z[:, : z.shape[1] // 3] = torch.inf
    water = Water(beta, (0.05, 0.25, 0.35))
    with pytest.warns(UserWarning, match="the rate of red"):
        estimate = red_channel_prior(seen(motorcycle.linear.float(), z, water, noise=0), z)
    assert not any("green" in doubt for doubt in estimate.doubts)
    assert float(estimate.rates[1]) == pytest.approx(beta[1], rel=0.1)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_rates_are_doubted_where_hardly_any_light_is_left(noise: float, motorcycle: Any) -> None:
    """Red is 39 % too large, which hardly shows in its transmission, .02 to .15."""
    z = motorcycle.distance.float()
    z[:, : z.shape[1] // 3] = torch.inf
    water = Water((0.8, 0.5, 0.6), (0.08, 0.2, 0.15))
    with pytest.warns(UserWarning, match=r"the rate of red \(by what is dark .* /m"):
        estimate = red_channel_prior(seen(motorcycle.linear.float(), z, water, noise=noise), z)
    doubtful = " ".join(estimate.doubts)
    for colour, rate, beta in zip(
        ("red", "green", "blue"), estimate.rates, water.beta, strict=True
    ):
        assert colour in doubtful or float(rate) == pytest.approx(beta, rel=0.15)


def test_the_bundled_scene_is_doubted(motorcycle: object) -> None:
    z = motorcycle.distance.float()
    z = 1 + 7 * (z - z.min()) / (z.max() - z.min())
    z[:, :120] = torch.inf
    with pytest.warns(UserWarning, match="all distances"):
        estimate = red_channel_prior(seen(motorcycle.linear.float(), z, WATERS["green"]))
    veil = torch.tensor(WATERS["green"].veil).double()
    torch.testing.assert_close(estimate.veil, veil, rtol=0.05, atol=0)


def test_other_even_parts_are_said() -> None:
    scene, z = seafloor()
    picture = seen(scene, z, WATERS["middle"])
    picture[:, 160:230, 100:220] = torch.tensor([20, 60, 90], dtype=torch.uint8)[:, None, None]
    with pytest.warns(UserWarning, match="as even, of another colour"):
        red_channel_prior(picture)


def refused(
    picture: object, distance: Tensor | None, said: str, error: type[Exception] = ValueError
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        with pytest.raises(error, match=said):
            red_channel_prior(picture, distance)


def test_refuses_walls() -> None:
    """A smooth wall behind stones, as open water would be."""
    scene, z = seafloor()
    scene[:, :HORIZON], z[:, :HORIZON] = 0.3, 3.0
    for water in WATERS.values():
        refused(seen(scene, z, water), z, r"looks like open water is 3 m away")
    refused(seen(scene, z.clamp(max=4) / 8, WATERS["middle"]), None, "red is darkest")
    scene[:, :HORIZON] *= cells(seed=7)[:, :HORIZON]
    refused(seen(scene, z, WATERS["middle"]), None, "no open water in view")


def test_refuses_pictures_that_tell_nothing() -> None:
    scene, z = seafloor()
    refused(seen(scene, z, WATERS["blue"]).flip(0), None, "red is darkest")
    even = torch.full((3, 96, 96), 0.3)
    refused(even, None, "even all over")
    far = torch.linspace(1, 6, 96 * 96).reshape(1, 96, 96)
    far[:, :20] = torch.inf
    refused(even, far, "even all over")
    refused(even[:, :40], None, "too small, 40×96 px")
    bright = seen(1 - 0.3 * scene, z.clamp(min=4), WATERS["turbid"])
    refused(bright, None, "hardly any surface is darker")
    refused(cells(), None, "no open water in view")
    dark = (cells() * 255).to(torch.uint8)
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
    refused(scene.numpy(), z, "picture must be a floating-point tensor", TypeError)
    refused(scene[None], z, "picture must be one")
    refused(scene[:1], z, "picture must have shape")
    refused(scene * 255, z, "picture reaches .* divide a 0…255 image")
    refused(scene * math.nan, z, "picture is NaN")
    with pytest.raises(ValueError, match="color_space"):
        red_channel_prior(scene, z, color_space="rgb")


def test_pictures_are_no_spectra() -> None:
    picture = as_bytes(cells())
    told = re.escape("uwaug.fitting.red_channel_prior")
    for waters in ([picture], picture, [picture.numpy()], {picture: 1.0}):
        with pytest.raises(TypeError, match=told):
            RandomUnderwater(waters)
