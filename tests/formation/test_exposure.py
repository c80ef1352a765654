import math

import pytest
import torch
from scenes import distances, picture

from uwaug import Medium, RandomUnderwater, Underwater, Water, form_image
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear
from uwaug.formation.exposure import GAINS, auto_gain

LUMINANCE = torch.tensor([0.2126, 0.7152, 0.0722]).view(3, 1, 1)


def deep(metres: float, **options: object) -> Medium:
    return Medium.from_water(Water.jerlov("1C"), vertical_depth=metres, g=0.05, mu=0.075, **options)


@pytest.mark.parametrize("metres", [0.0, 5.0, 10.0, 20.0])
def test_auto_keeps_the_mean_luminance(metres: float) -> None:
    image, z = picture(96, 128), distances(96, 128)
    degrade = Underwater(deep(metres, tolerance=1e-5), color_space="linear", exposure="auto")
    before, after = (float((LUMINANCE * x).sum(1).mean()) for x in (image, degrade(image, z)))
    assert after == pytest.approx(before, rel=0.03), "measured on every 16th pixel"


def test_the_gain_is_bounded() -> None:
    image, z = picture(), distances()
    for metres in (300.0, 60.0):
        sums = deep(metres).sums(exact_at_lens=False)
        gain = auto_gain(image.double(), z.double(), sums)
        assert GAINS[0] <= gain <= GAINS[1]
    black = auto_gain(torch.zeros_like(image).double(), z.double(), sums)
    assert black == GAINS[0], "as of a picture that is almost black"


def test_the_veil_is_never_brighter_than_white() -> None:
    image, z = picture(), distances()
    z[..., -1, -1] = math.inf  # open water, in no other pixel
    medium = Medium.from_water(Water.jerlov("III"), vertical_depth=10.0, mu=1.0, g=0.05)
    degrade = Underwater(medium, color_space="linear", exposure="auto")
    assert degrade(image, z)[..., -1, -1].max() <= 1 + 1e-5


def test_stops_double_the_light() -> None:
    image, z, medium = picture(), distances(), deep(2.0)
    plain = Underwater(medium, color_space="linear")(image, z)
    for stops in (-1.0, 2.0):
        degrade = Underwater(medium, color_space="linear", exposure=stops)
        torch.testing.assert_close(degrade(image, z), 2**stops * plain, rtol=0, atol=4e-3)


def test_each_picture_of_a_batch_has_its_own_gain() -> None:
    images = torch.cat([picture(), 0.2 * picture()])
    degrade = Underwater(deep(5.0), exposure="auto", color_space="linear")
    together = degrade(images, distances())
    for one, result in zip(images, together, strict=True):
        torch.testing.assert_close(degrade(one, distances()[0]), result, rtol=0, atol=1e-5)


def test_gradients_pass_the_gain() -> None:
    image, z = picture(8, 8).double().requires_grad_(), distances(8, 8).double()
    degrade = Underwater(deep(5.0), color_space="linear", exposure="auto").double()
    assert torch.autograd.gradcheck(lambda x: degrade(x, z), image)


@pytest.mark.parametrize("exposure", ["bright", math.nan, 11.0, None])
def test_refused(exposure: object) -> None:
    with pytest.raises(ValueError, match="exposure must be"):
        Underwater(deep(1.0), exposure=exposure)


# Values from 0 to 1


def bright() -> Medium:
    """A veil above white."""
    return Medium.from_water(Water.jerlov("III"), mu=0.6)


def test_srgb_is_clipped_to_what_files_hold() -> None:
    image, z = picture(), 10 * distances()
    light = form_image(srgb_to_linear(image), z, bright()).image
    assert light.max() > 1.1
    planned = (0.1, 80.0)
    out = Underwater(bright(), planned)(image, z)
    assert out.max() == 1
    torch.testing.assert_close(out, linear_to_srgb(light).clamp(0, 1), rtol=0, atol=2e-3)
    assert Underwater(bright(), planned, color_space="linear")(image, z).max() > 1.1
    aug = RandomUnderwater.survey(waters="III", mu=0.6, field_probability=0.0)
    assert aug(image[0], z[0])[0].max() == 1
    aug = RandomUnderwater.survey(waters="III", mu=0.6, color_space="linear")
    assert aug(image[0], z[0])[0].max() > 1.1


def test_pictures_above_1_keep_their_headroom() -> None:
    images = torch.cat([picture(), 3 * picture()])
    images[1, :, :16] = 3.0
    z = torch.full((1, 1, 32, 40), 1e-3)
    medium = Medium.from_water(Water.jerlov("III"), vertical_depth=0.0)
    out = Underwater(medium, (0.0, 20.0))(images, z)
    assert out[0].max() <= 1
    assert out[1].max() == pytest.approx(3.0, abs=0.02)


@pytest.mark.parametrize("side", [3, 16, 32, 64])
def test_small_and_striped_pictures_keep_their_luminance(side: int) -> None:
    generator = torch.Generator().manual_seed(side)
    image = torch.rand(1, 3, side, side, generator=generator) ** 2
    degrade = Underwater(deep(10.0, tolerance=1e-5), color_space="linear", exposure="auto")
    for period in (0, 2, 4):
        striped = image.clone()
        if period:
            striped[..., ::period] = 0.0
        z = torch.full((1, 1, side, side), 3.0)
        before, after = (
            float((LUMINANCE * x).sum(1).mean()) for x in (striped, degrade(striped, z))
        )
        assert after == pytest.approx(before, rel=0.03)


def test_black_is_no_exception() -> None:
    degrade = Underwater(Medium.from_water("3C", vertical_depth=2.0), exposure="auto")
    z = torch.full((1, 1, 16, 16), 3.0)
    black, almost = (degrade(torch.full((1, 3, 16, 16), v), z).mean() for v in (0.0, 1e-6))
    assert black == pytest.approx(float(almost), rel=1e-3)


def test_empty_pictures() -> None:
    degrade = Underwater(deep(2.0), exposure="auto")
    for shape in ((0, 8, 8), (2, 0, 8)):
        empty = torch.zeros(shape[0], 3, *shape[1:])
        assert degrade(empty, torch.zeros(shape[0], 1, *shape[1:])).shape == empty.shape


@pytest.mark.parametrize("metres", [0.05, 0.2, 3.0])
def test_close_scenes_are_not_black(metres: float) -> None:
    """Waters that are turbid enough for a scene at arm's length let no light down to 10 m."""
    image, distance = picture()[0], metres * (0.7 + 0.1 * distances()[0])
    for key in range(20):
        out, _ = RandomUnderwater.hazy().at(0, 0, key)(image, distance)
        assert out.mean((1, 2)).min() > 0.02
        out, _ = RandomUnderwater(compensation=None).at(0, 0, key)(image, distance)
        assert out.mean((1, 2)).max() > 0.1  # reds may die


def test_maps_of_every_fourth_row_are_looked_at() -> None:
    """As a lidar gives them."""
    aug, image, gains = RandomUnderwater(unknown="far"), picture(64, 96)[0], []
    record = aug.make_params(image, torch.Generator().manual_seed(1))
    for first in range(4):
        distance = torch.zeros(1, 64, 96)
        distance[:, first::4] = 4.0
        used = aug.resolve(image, distance, record)["samples"][0]["used"]
        gains.append(used["contents"])
    assert max(gains) == pytest.approx(min(gains), rel=1e-6)
