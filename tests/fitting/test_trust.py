"""What a camera or a map has done to a picture: fitted where it can be, else suspected and said."""

import re

import pytest
import torch
from fitted import COLOURS, TRUTH, Known, medium

import uwaug
from uwaug.cli.console import cures_in_flags
from uwaug.fitting import Fit
from uwaug.fitting.data import Observations
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear

VEIL = {"beta": TRUTH["beta"], "veil": TRUTH["veil"]}
FIXED = {"gain": "fixed", "shading": "fixed", "tone": "fixed"}


def held(fit: Fit) -> int:
    """How many of six 95 % intervals hold the truth, or are none."""
    count = 0
    for kind, values in VEIL.items():
        for colour, value in zip(COLOURS, values, strict=True):
            number = fit.parameters[f"{kind}_{colour}"]
            count += number.low is None or number.low <= value <= number.high
    return count


def taken(known: Known, change) -> Known:
    """The observed picture as a camera stores light (3xHxW) that is changed."""
    light = change(srgb_to_linear(known.observed.double() / 255))
    observed = (255 * linear_to_srgb(light).clamp(0, 1)).round().to(torch.uint8)
    return known._replace(observed=observed)


def position(like: torch.Tensor) -> torch.Tensor:
    h, w = like.shape[-2:]
    y, x = (torch.linspace(-(n - 1), n - 1, n, dtype=torch.float64) for n in (h, w))
    return torch.stack(torch.meshgrid(y, x, indexing="ij")) / (h * h + w * w) ** 0.5


CAMERAS = {
    "gain": lambda light: torch.tensor([1.25, 1.0, 0.9])[:, None, None] * light,
    "shading": lambda light: (1 - 0.3 * position(light).square().sum(0)) * light,
    "tone": lambda light: light**1.2,
}


@pytest.mark.parametrize("fault", CAMERAS)
def test_what_a_camera_has_done_is_fitted(hazy: Known, fault: str) -> None:
    picture = taken(hazy, CAMERAS[fault])
    fit = uwaug.fit(*picture, model="haze", pixels=3000)
    assert fit.fitted.name == f"haze + {fault}"
    assert "Of the camera, this is fitted too: " in fit.message
    expected = {"gain_1_red": 1.25, "gain_1_blue": 0.9} if fault == "gain" else {}
    expected |= {"shading": {"vignette": 0.3, "right": 0.0}, "tone": {"tone": 1.2}}.get(fault, {})
    for name, value in expected.items():
        assert fit.parameters[name].value == pytest.approx(value, abs=0.05), name
    for kind, values in VEIL.items():
        found = [fit.parameters[f"{kind}_{colour}"].value for colour in COLOURS]
        assert found == pytest.approx(values, rel=0.05)
    assert held(fit) >= 4
    known_not_to = uwaug.fit(*picture, model="haze", pixels=3000, **FIXED)
    assert "Verdict: " in known_not_to.message
    assert f'{fault}="' in known_not_to.message
    assert f"--{fault} " in cures_in_flags(known_not_to.message)
    assert known_not_to.fitted.name == "haze"


def test_a_camera_that_has_done_nothing_is_not_fitted(haze: Fit) -> None:
    assert haze.fitted.name == "haze"
    for word in ("Of the camera", "Verdict", "The model misses"):
        assert word not in haze.message


def test_a_camera_is_kept_in_a_file(hazy: Known, tmp_path) -> None:
    picture = taken(hazy, lambda light: CAMERAS["tone"](CAMERAS["shading"](light)))
    fit = uwaug.fit(*picture, model="haze", pixels=2000, shading="free", tone="free")
    fit.save(tmp_path / "fit.json")
    again = Fit.load(tmp_path / "fit.json")
    assert again.fitted == fit.fitted
    assert again.parameters == fit.parameters
    assert fit.residual[0].nanmean().abs() < 2e-3
    assert fit.rms < 0.02
    assert len(fit.sample(3)) == 3


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda k: k._replace(distance=k.distance + 0.4), "an offset of the distances.* nearer"),
        (lambda k: k._replace(distance=k.distance - 0.4), "an offset of the distances.* farther"),
        (lambda k: k._replace(observed=k.observed.roll(1, 2)), "a shift"),
    ],
)
def test_what_is_wrong_is_named_and_widens(hazy: Known, haze: Fit, change, cause) -> None:
    fit = uwaug.fit(*change(hazy), model="haze", pixels=2000, **FIXED)
    assert held(fit) >= 5
    (said,) = (line for line in fit.message.splitlines() if line.startswith("The model misses"))
    assert re.search(cause, said), said
    assert "Verdict: " in fit.message
    errors = fit.errors.get("beta_red", 1.0)
    assert errors > 2 * haze.errors["beta_red"]


def test_noise_of_the_clean_picture_is_told_from_the_residuals(known: Known) -> None:
    """It looks like detail that the water has taken away: β is too large, by .1 of itself here."""
    generator = torch.Generator().manual_seed(0)
    noise = 0.02 * torch.randn(known.clean.shape, generator=generator)
    clean = (255 * (known.clean.double() / 255 + noise).clamp(0, 1)).round().to(torch.uint8)
    fit = uwaug.fit(*known._replace(clean=clean), model="gaussian", pixels=4000)
    (said,) = (line for line in fit.message.splitlines() if line.startswith("The model misses"))
    size = re.search(r"noise of the clean picture, ([\d.]+) of white", said)
    assert size, said
    assert float(size[1]) == pytest.approx(0.02, rel=0.25)
    assert held(fit) == 6
    assert "Verdict: harmless" not in fit.message


@pytest.mark.parametrize("gains", [(1.0, 1.0, 1.0), (1.25, 1.0, 0.9)])
def test_noise_of_the_observed_picture_is_not_that_of_the_clean_one(known: Known, gains) -> None:
    """Not where a white balance makes the noise of one colour larger either."""
    picture = taken(known, lambda light: torch.tensor(gains)[:, None, None] * light)
    fit = uwaug.fit(*picture, model="gaussian", pixels=4000)
    assert "noise of the clean picture" not in fit.message


def test_verdicts_are_graded(known: Known) -> None:
    """A map that is a little rough is harmless, one picture beside the other is not."""
    rough = known._replace(distance=(4 * known.distance).round() / 4)
    aside = known._replace(observed=known.observed.roll(2, 2))
    harmless = uwaug.fit(*rough, model="gaussian", pixels=3000).message
    grave = uwaug.fit(*aside, model="gaussian", pixels=3000).message
    assert "do not rely" not in harmless
    assert "Verdict: do not rely on it" in grave


def test_pictures_without_noise_do_not_alarm(known: Known) -> None:
    clean, _, z = known
    water = medium()
    observed = uwaug.Underwater(water, None)(clean.double() / 255, z)
    fit = uwaug.fit(clean.double() / 255, observed, z, model="gaussian", pixels=2000)
    assert "The model misses" not in fit.message
    assert "Verdict" not in fit.message
    assert held(fit) >= 5


def test_widths_are_told_in_the_measure_of_a_law(gaussian: Fit) -> None:
    law = gaussian.medium.point_spread
    said = f"PointSpread({law.scale:.3g}, {law.exponent:.3g}) at b̄ = "
    assert said in gaussian.message
    lengths = float(gaussian.medium.b_mean) * gaussian.fitted.geometry.reference
    width = law.scale * lengths**law.exponent
    assert gaussian.parameters["width"].value == pytest.approx(width, rel=1e-6)


def test_a_blur_within_a_pixel_is_said_to_tell_little(gaussian: Fit, known: Known) -> None:
    """β is 40 % too small at .18 px in a picture of the default tolerance."""
    clean, _, z = known
    water = medium(law=uwaug.PointSpread(0.1, 0.9))
    observed = uwaug.Underwater(water)(clean, z)
    narrow = uwaug.fit(clean, observed, z, model="gaussian", pixels=1000)
    assert 0 < narrow.parameters["width"].value < 0.6
    said = "A blur below 0.6 px is hardly told from none"
    assert said in narrow.message
    assert said not in gaussian.message


def test_what_pixels_know_of_their_places(known: Known) -> None:
    (pair,) = Observations.of(*known).pairs
    corner = pair.position[:, -1, -1]
    assert float(corner.norm()) == pytest.approx(1.0, abs=0.03)
    assert (corner > 0).all()
    ramp = pair._replace(clean=torch.arange(5.0).double().expand(3, 4, 5))
    assert (ramp.slopes[1, :, :, 1:-1] == 1).all()
    assert (ramp.slopes[0] == 0).all()
    assert (ramp.detail[:, :, 1:-1].abs() < 1e-12).all()
