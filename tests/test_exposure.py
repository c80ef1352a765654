import math

import pytest
import torch
from degrading import distances, picture

from uwaug import Medium, RandomUnderwater, Underwater, Water, form_image
from uwaug.colour import linear_to_srgb, srgb_to_linear
from uwaug.exposure import GAINS, auto_gain

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
    assert black == 1, "there is no brightness to be kept"


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
    out = Underwater(bright())(image, z)
    assert out.max() == 1
    torch.testing.assert_close(out, linear_to_srgb(light).clamp(0, 1), rtol=0, atol=2e-3)
    assert Underwater(bright(), color_space="linear")(image, z).max() > 1.1
    aug = RandomUnderwater.survey(waters="III", mu=0.6, field_probability=0.0)
    assert aug(image[0], z[0])[0].max() == 1
    aug = RandomUnderwater.survey(waters="III", mu=0.6, color_space="linear")
    assert aug(image[0], z[0])[0].max() > 1.1


def test_pictures_above_1_keep_their_headroom() -> None:
    images = torch.cat([picture(), 3 * picture()])
    images[1, :, :16] = 3.0
    z = torch.full((1, 1, 32, 40), 1e-3)
    medium = Medium.from_water(Water.jerlov("III"), vertical_depth=0.0)
    out = Underwater(medium)(images, z)
    assert out[0].max() <= 1
    assert out[1].max() == pytest.approx(3.0, abs=0.02)
