"""What a camera does between sensor and file, against plain NumPy."""

from typing import Any

import numpy as np
import pytest
import torch
from referees import developed as referee
from scenes import picture, rand, stepped
from torch import Tensor

from uwaug import Development, Lamp, Light, Medium, PointSpread, Underwater, form_image
from uwaug.formation.development import BURNT, GAINS, compressed, curved, exposed, metering_points
from uwaug.optics.view import WIDE

ALL = {"exposure": 0.5, "white_balance": 0.6, "saturation": 1.4, "gamut": 0.8, "tone": 1.3}
STAGES: dict[str, dict[str, float]] = {
    "exposure": {"exposure": -1.3},
    "full white balance": {"white_balance": 1.0},
    "no white balance": {"white_balance": -0.4},
    "grey": {"saturation": 0.0},
    "gamut": {"gamut": 1.0},
    "less contrast": {"tone": 0.6},
    "all": ALL,
}
MEDIA = {
    "grey": lambda **options: Medium.from_water("1C", **options),
    "spectral": lambda **options: Medium.from_water(
        "II", **{"surfaces": "spectral", "vertical_depth": 6.0, **options}
    ),
    # where the mean of red is negative: no gain brings it to the others
    "deep": lambda **options: MEDIA["spectral"](vertical_depth=15.0, g=0.05, **options),
}
CLEAR = Medium.from_coefficients(*[(1e-9,) * 3] * 3)
SWITCH = pytest.mark.parametrize("switch", ["0", "1"])


def developed(medium: Medium, image: Tensor, z: Tensor, **stages: Any) -> Tensor:
    development = Development(**stages)
    return Underwater(medium, color_space="linear", development=development)(image, z)


def coloured(height: int, width: int) -> Tensor:
    """Pictures of pure and dim colours, in double precision."""
    image = picture(height, width).double()
    return image * torch.tensor([1.3, 0.8, 0.3]).double().reshape(3, 1, 1) ** 1.5


def luminance(light: Tensor) -> float:
    weights = torch.from_numpy(referee.LUMINANCE).reshape(3, 1, 1)
    return float((weights * light).sum(1).mean())


@pytest.mark.parametrize("metered", [False, True])
@pytest.mark.parametrize("medium", MEDIA)
@pytest.mark.parametrize("stage", STAGES)
def test_stages(stage: str, medium: str, metered: bool) -> None:
    water = MEDIA[medium](point_spread=PointSpread.none())
    image, z = coloured(20, 26), stepped(1, 1, 20, 26)
    plain = developed(water, image, z)[0].numpy()
    ours = developed(water, image, z, metered=metered, **STAGES[stage])[0].numpy()
    points = metering_points(20, 26, image.device).numpy()
    scene = image[0].numpy() if metered else None
    wanted = referee.Camera(**STAGES[stage]).develop(plain, points, scene, BURNT)
    np.testing.assert_allclose(ours, wanted, rtol=0, atol=1e-10)


# ---- exposure


@pytest.mark.parametrize("depth", [0.0, 20.0])
def test_metering_keeps_the_mean_luminance(depth: float) -> None:
    medium = Medium.from_water("1C", vertical_depth=depth, g=0.05, tolerance=1e-5)
    for height, width, period in ((96, 128, 0), (16, 16, 2), (64, 64, 4), (3, 3, 0)):
        # so dim that nothing burns out
        image, z = 0.7 * rand(1, 3, height, width) ** 2, 0.5 + 3 * rand(1, 1, height, width, seed=1)
        if period:
            image[..., ::period] = 0.0
        after = developed(medium, image, z, metered=True)
        assert luminance(after) == pytest.approx(luminance(image), rel=0.04)


@SWITCH
@pytest.mark.parametrize("lit", [False, True])
@pytest.mark.parametrize("stops", [-1.0, 1.5, 6.0])
def test_no_stops_bring_more_pixels_above_white(
    stops: float, lit: bool, switch: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UWAUG_FAST", switch)
    image, z = picture(60, 80) ** 2, 0.3 + 6 * rand(1, 1, 60, 80, seed=1).float()
    z[..., :20] = 30.0
    light = Light((Lamp((0.3, 0.0, 0.0), 9.0),), daylight=0.0) if lit else None
    for mu in (0.03, 1.0):  # and with a veil 20 times as bright as white
        medium = Medium.from_water("III", g=0.05, mu=mu, point_spread=PointSpread.none())
        camera = Development(stops, metered=True)
        degrade = Underwater(medium, None, color_space="linear", development=camera, light=light)
        brightest = degrade(image, z)[0].amax(0).flatten()[metering_points(60, 80, z.device)]
        share = float((brightest > (1 + 1e-5) * 2 ** min(stops, 0.0)).double().mean())
        assert share <= BURNT
        assert share > 0.8 * BURNT or stops < 6, "as bright as may be"


def test_on_a_wall_that_lamps_light_evenly_the_mean_luminance_is_kept() -> None:
    image, z = 0.5 * rand(1, 3, 60, 80), torch.full((1, 1, 60, 80), 5.0).double()
    even = Light((Lamp((0.0, 0.0, -100.0), 1e4),), daylight=0.0)
    gain = Development(metered=True).gain(image, z, CLEAR, even.curves(CLEAR, z, WIDE))
    after = exposed(form_image(image, z, CLEAR, light=even).image, gain)
    assert luminance(after) == pytest.approx(luminance(image), rel=0.02)


def test_the_gain_is_bounded() -> None:
    image, z = picture().double(), torch.full((1, 1, 32, 40), 3.0).double()
    development = Development(metered=True)
    for depth, scene in ((300.0, image), (60.0, image), (60.0, 0 * image)):
        gain = development.gain(scene, z, Medium.from_water("1C", vertical_depth=depth))
        assert GAINS[0] <= float(gain) <= GAINS[1]
    bright = Medium.from_water("III", vertical_depth=10.0, mu=1.0, g=0.05)
    black, almost = (
        developed(bright, torch.full_like(image, v), z, metered=True).mean() for v in (0, 1e-6)
    )
    assert black == pytest.approx(float(almost), rel=1e-3)
    # and no more blurs are asked for than there are
    degrade = Underwater(MEDIA["spectral"](), development=Development(10.0, metered=True))
    assert degrade(coloured(64, 90), stepped(1, 1, 64, 90)).isfinite().all()


def test_a_planned_blur_knows_of_saturation() -> None:
    plain, vivid = (
        Underwater(MEDIA["spectral"](), development=Development(saturation=s)).demand
        for s in (1.0, 4.0)
    )
    assert vivid.blur_tolerance == plain.blur_tolerance / 4


@SWITCH
@pytest.mark.parametrize("metered", [False, True])
def test_pictures_of_a_batch_are_developed_one_by_one(
    metered: bool, switch: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UWAUG_FAST", switch)
    images = torch.cat([picture(40, 50), 0.2 * picture(40, 50).flip(1)])
    # without a blur, which is planned for all of a batch
    law = PointSpread.none()
    waters = Medium.stack([MEDIA[name](point_spread=law) for name in ("grey", "spectral")])
    z, stages = stepped(2, 1, 40, 50).float(), {**ALL, "metered": metered}
    together = developed(waters, images, z, **stages)
    for n in range(2):
        alone = developed(waters[n], images[n], z[n], **stages)
        torch.testing.assert_close(alone, together[n], rtol=0, atol=1e-6)


# ---- gamut and tone


@pytest.mark.parametrize("contrast", [0.25, 0.9, 1.1, 4.0])
def test_tone_is_a_curve(contrast: float) -> None:
    light = torch.linspace(-6, 6, 24_001, dtype=torch.float64)
    wanted = referee.curved(light.numpy(), contrast)
    np.testing.assert_allclose(curved(light, contrast).numpy(), wanted, rtol=0, atol=1e-12)


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_gamut_compression(share: float) -> None:
    """Of all distances from grey, dim and bright; and where light ends."""
    values = torch.linspace(-3, 1, 1001, dtype=torch.float64)
    grown = torch.cat([values, 1e-9 * values, torch.zeros(1).double(), -values])
    light = torch.stack([torch.ones_like(grown), grown, grown.flip(0)])[:, None]
    for brightest in (0.0, 1e-9, 1e-3, 20.0):
        dim = torch.cat([brightest * light, light - 1], -1)
        wanted = referee.compressed(dim.numpy(), share)
        ours = compressed(dim[None], share)[0].numpy()
        np.testing.assert_allclose(ours, wanted, rtol=0, atol=1e-12 * max(1.0, brightest))


# ---- gradients


@pytest.mark.parametrize("metered", [False, True])
@pytest.mark.parametrize("medium", ["grey", "spectral"])
def test_gradients(medium: str, metered: bool) -> None:
    image, z = coloured(5, 6).requires_grad_(), stepped(1, 1, 5, 6).requires_grad_()
    camera = Development(metered=metered, **ALL)
    degrade = Underwater(MEDIA[medium](), color_space="linear", development=camera)
    assert torch.autograd.gradcheck(degrade, (image, z))


DARK = Medium.from_water("3C", vertical_depth=50.0, g=0.0, mu=0.0, surfaces="spectral")


@pytest.mark.parametrize(
    "options, colour, metres",
    [
        *[(ALL, colour, 0.0) for colour in ((0, 0, 0), (1, 1, 1), (30, 0, 0), (-1, 0, -2))],
        (STAGES["less contrast"], (0, 0, 0), 0.0),
        ({"metered": True}, (1, 1, 1), 900.0),  # light underflows
        ({"white_balance": 0.5}, (1, 1, 1), 900.0),
    ],
)
def test_slopes_of_black_and_bright_pictures_are_finite(
    options: Any, colour: tuple[float, ...], metres: float
) -> None:
    medium = DARK if metres else MEDIA["spectral"]()
    image = torch.tensor(colour).float().reshape(1, 3, 1, 1).repeat(1, 1, 6, 7).requires_grad_()
    z = torch.full((1, 1, 6, 7), metres, requires_grad=True)
    development = Development(**options)
    degrade = Underwater(medium, None, color_space="linear", development=development)
    degrade(image, z).sum().backward()
    assert all(bool(leaf.grad.isfinite().all()) for leaf in (image, z))
