import numpy as np
import pytest
import torch
from fitted import COLOURS, HAZE, TRUTH, Known, as_bytes, errors, medium, scene, seen

import uwaug
from uwaug.formation.colour import srgb_to_linear

NOISE = "What is left is not noise"


def remark(fit, words):
    return [note for note in fit.notes if words in note]


def values(fit, kind):
    return [fit.parameters[f"{kind}_{colour}"].value for colour in COLOURS]


# ---- what comes back


def test_a_water_comes_back(auto):
    assert auto.model == "gaussian"
    assert [tried.name for tried in auto.candidates if tried.chosen] == ["gaussian"]
    assert all(number.state == "free" for number in auto.parameters.values())
    assert auto.parameters["exponent"].value == pytest.approx(0.9, abs=0.15)
    assert auto.rms == pytest.approx(0.01, rel=0.1)
    assert values(auto, "beta") == pytest.approx(TRUTH["beta"], rel=0.05)
    assert abs(errors(auto)).max() < 3.5
    assert (abs(errors(auto)) < 2).mean() >= 0.75
    np.testing.assert_allclose(np.sqrt(np.diag(auto.covariance)), [*auto.errors.values()])
    assert not remark(auto, NOISE)


def test_the_medium_makes_the_observed_picture():
    """A picture at 4 m of depth in 3C came back 61 grey levels off: its gain was left out."""
    clean, z = scene()
    law = uwaug.PointSpread.calibrated()
    options = {"vertical_depth": 4.0, "g": 0.05, "surfaces": "spectral", "point_spread": law}
    observed = uwaug.Underwater(uwaug.Medium.from_water("3C", **options))(clean, z)
    fit = uwaug.fit(clean, observed, z, model="gaussian", pixels=1500)
    again = uwaug.Underwater(fit.medium)(clean, z)
    assert (again.double() - observed.double()).abs().mean() < 1
    # daylight that is lost is the medium's, and V(0) is that of the picture
    assert values(fit, "gain") == pytest.approx(fit.medium.ambient()[0].tolist())
    assert max(values(fit, "gain")) < 0.6
    far = fit.medium.backscatter(torch.tensor(1e4))[0].tolist()
    assert values(fit, "veil") == pytest.approx(far, rel=1e-3)
    assert max(far) < 0.4
    assert not remark(fit, NOISE)


@pytest.mark.parametrize("gain", [(1.0, 1.0, 1.0), (0.4, 0.9, 1.1)])
def test_a_gain_is_fitted_where_there_is_one(gain):
    factor = torch.tensor(gain).double()[:, None, None]
    known = seen(medium(**HAZE), gain=factor)
    fit = uwaug.fit(*known, model="haze", pixels=2000)
    assert values(fit, "beta") == pytest.approx(TRUTH["beta"], rel=0.04)
    wanted = [x * one for x, one in zip(TRUTH["veil"], gain, strict=True)]
    assert values(fit, "veil") == pytest.approx(wanted, rel=0.04)
    assert ("gain_red" in fit.parameters) == (gain != (1.0, 1.0, 1.0))
    assert fit.medium.ambient()[0].tolist() == pytest.approx(gain, rel=0.04)
    fixed = uwaug.fit(*known, model="haze", pixels=2000, gain="fixed")
    assert bool(remark(fixed, NOISE)) == (gain != (1.0, 1.0, 1.0))
    assert "gain_red" not in fixed.parameters


def test_the_model_that_made_the_picture_is_chosen(haze, hazy):
    law = uwaug.PointSpread(0.8, 0.8, "exponential")
    assert uwaug.fit(*seen(medium(law=law)), pixels=1000).model == "exponential"
    assert uwaug.fit(*hazy, pixels=500).model == "haze"


def test_a_veil_of_its_own_rate():
    clean, z = scene()
    light = srgb_to_linear(clean.double() / 255)
    beta, G, veil = (torch.tensor(TRUTH[k]).double()[:, None, None] for k in ("beta", "G", "veil"))
    image = light * torch.exp(-beta * z) - veil * torch.expm1(-G * z)
    fit = uwaug.fit(clean, as_bytes(image), z, pixels=1000)
    assert fit.model == "veil"
    assert abs(errors(fit)).max() < 4
    assert remark(fit, "direct light and light that is scattered forward are one")


def test_several_pictures_are_of_one_water():
    pair = [seen(medium(**HAZE), seed=seed) for seed in (1, 2)]
    observed, z = (torch.stack(each) for each in list(zip(*pair, strict=True))[1:])
    fit = uwaug.fit(pair[0].clean, observed, z, model="haze", pixels=2000)
    assert abs(errors(fit, kinds=("beta", "veil"))).max() < 4
    assert fit.rendered().shape == observed.shape


# ---- what pictures cannot tell


def test_a_veil_without_end_is_not_printed_as_a_number():
    clear = seen(medium(uwaug.PointSpread.none(), beta=(0.02,) * 3, G=(0.02,) * 3))
    fit = uwaug.fit(*clear, model="veil", pixels=2000)
    for colour in COLOURS:
        number = fit.parameters[f"veil_{colour}"]
        assert (number.state, number.value, number.error) == ("not identified", None, None)
    assert remark(fit, "Not identified: ")
    assert remark(fit, "straight line")
    source = fit.parameters["source_green"]
    assert source.value == pytest.approx(0.02 * 0.28, abs=4 * source.error)


def test_numbers_at_a_bound_say_so():
    plain = seen(medium(**{**HAZE, "veil": (0.0, 0.28, 0.33)}))
    fit = uwaug.fit(*plain, model="haze", pixels=2000)
    veil = fit.parameters["veil_red"]
    assert veil.value == pytest.approx(0.0, abs=2e-3)
    assert veil.low <= veil.value <= veil.high < 0.01
    at_bound = veil.state == "at bound"
    assert at_bound == (veil.error is None) == bool(remark(fit, "At the end of what they may be"))


def test_what_is_black_is_not_identified(hazy):
    dark, behind = hazy.clean.clone(), hazy.observed.clone()
    dark[2] = 0
    light = medium(**HAZE).backscatter(hazy.distance.double())[0, 2]
    behind[2] = as_bytes(light, noise=0.0)
    fit = uwaug.fit(dark, behind, hazy.distance, model="veil", pixels=2000)
    assert fit.parameters["beta_blue"].state == "not identified"
    red = fit.parameters["beta_red"]
    assert red.value == pytest.approx(TRUTH["beta"][0], abs=4 * red.error)


@pytest.mark.parametrize("wall", [True, False])
def test_what_shows_no_blur_tells_no_scattering(hazy, wall):
    """Of a grey wall; and of a blur within a pixel, where β is 40 % too small at .18 px."""
    clean = torch.full_like(hazy.clean, 128) if wall else hazy.clean
    water = medium() if wall else medium(law=uwaug.PointSpread(0.1, 0.9))
    light = srgb_to_linear(clean.double() / 255)
    observed = as_bytes(uwaug.form_image(light, hazy.distance.double(), water).image, 0.005)
    fit = uwaug.fit(clean, observed, hazy.distance, model="gaussian", gain="fixed", pixels=2000)
    assert values(fit, "beta") == [None] * 3
    assert values(fit, "G") == pytest.approx(TRUTH["G"], rel=0.2)
    assert wall or remark(fit, "A blur below 0.8 px is hardly told from none")


# ---- what may be wrong


def test_pictures_of_our_own_do_not_alarm(known):
    """One that had no noise but of 8 bits was said to be off by .022 m, and an estimate."""
    clean, _, z = known
    law = uwaug.PointSpread(2.0, 0.62, "exponential")
    observed = uwaug.Underwater(medium(law=law))(clean, z)
    fit = uwaug.fit(clean, observed, z, model=law.shape, pixels=2000)
    assert not remark(fit, NOISE)
    assert values(fit, "G") == pytest.approx(TRUTH["G"], rel=0.02)


def test_what_is_no_noise_is_said(known):
    """Of pictures that are moved aside, and of another tone."""
    moved = known._replace(observed=known.observed.roll((2, 2), (1, 2)))
    light = srgb_to_linear(known.observed.double() / 255)
    toned = known._replace(observed=as_bytes(light**1.2, noise=0.0))
    for wrong in (moved, toned):
        fit = uwaug.fit(*wrong, model="gaussian", pixels=4000)
        assert remark(fit, NOISE)


def hazed(noise=0.0):
    """A haze that was composed in the values of the file, as bytes, and its distances."""
    clean, z = scene()
    beta, veil = (torch.tensor(x).double()[:, None, None] for x in (SET["beta"], SET["veil"]))
    left = torch.exp(-beta * z)
    values = clean / 255 * left + veil * (1 - left)
    values = values + noise * torch.randn(values.shape, generator=torch.Generator().manual_seed(2))
    return clean, (255 * values.clamp(0, 1)).round().to(torch.uint8), z


SET = {"beta": (0.288, 0.122, 0.134), "veil": (0.10, 0.45, 0.55)}


@pytest.mark.parametrize("model, noise", [("haze", 0.0), ("auto", 0.01)])
def test_a_haze_of_encoded_values_is_told(model, noise):
    """Rates of .515, .162 and .153 came out, with errors of .006."""
    pictures = hazed(noise)
    fit = uwaug.fit(*pictures, model=model, pixels=1000)
    (said,) = remark(fit, NOISE)
    assert "--color-space linear" in said
    # the cure gives the rates, says nothing more, and makes the picture
    cured = uwaug.fit(*pictures, model=model, pixels=1000, color_space="linear")
    assert cured.model == "haze"
    assert not remark(cured, NOISE)
    for kind, truth in SET.items():
        assert values(cured, kind) == pytest.approx(truth, rel=0.02)
    again = cured.module()(pictures[0], pictures[2])
    assert (again.double() - pictures[1].double()).abs().mean() < 255 * noise + 1


@pytest.mark.parametrize(("system", "is_of_values"), [("li-2020", True), ("desai-2024", False)])
def test_published_systems_that_compose_in_encoded_values(system, is_of_values):
    clean, z = scene()
    observed = uwaug.published.picture(system, clean / 255, z, "II")
    observed = (255 * observed.clamp(0, 1)).round().to(torch.uint8)
    fit = uwaug.fit(clean, observed, z, model="haze", pixels=1000)
    assert bool(remark(fit, NOISE)) == is_of_values


def test_fits_bear_outliers_and_noise(hazy):
    spoilt = hazy.observed.clone()
    spoilt[:, ::7, ::5] = 250  # 3 % of the pixels
    fit = uwaug.fit(*hazy._replace(observed=spoilt), model="haze", pixels=2000)
    for kind in ("beta", "veil"):
        assert values(fit, kind) == pytest.approx(TRUTH[kind], rel=0.03)
    loud = seen(medium(**HAZE), noise=0.15)
    fit = uwaug.fit(*loud, model="haze", gain="fixed", pixels=2000)
    assert fit.rms > 0.1
    assert abs(errors(fit, kinds=("beta",))).max() < 4


def test_open_water_counts(known):
    clean, _, z = known
    sea = z.clone()
    sea[:, :20] = torch.inf
    observed = uwaug.Underwater(medium(), None)(clean, sea)
    fit = uwaug.fit(clean, observed, sea, model="gaussian", pixels=2000)
    assert fit.parameters["veil_red"].value == pytest.approx(0.1, rel=0.02)
    assert fit.remainder[-1].distance > 1e6


# ---- how it runs


def test_a_fit_repeats_itself_anywhere(hazy: Known, haze):
    """In inference mode, as batches; by its seed. What it gives can still be trained."""
    with torch.inference_mode():
        again = uwaug.fit(*(x[None] for x in hazy), model="haze", pixels=2000)
    assert again.parameters == haze.parameters
    np.testing.assert_array_equal(again.covariance, haze.covariance)
    other = uwaug.fit(*hazy, model="haze", pixels=2000, seed=5)
    assert other.parameters != haze.parameters
    trained = uwaug.Underwater(again.medium, learnable=True)
    trained(torch.rand(3, 20, 30), torch.rand(1, 20, 30) + 1).sum().backward()


def test_a_chart_of_few_colours_at_four_distances() -> None:
    """96 colours, one number for a patch, tell 12 numbers of 0.3 % noise."""
    random = torch.Generator().manual_seed(0)
    clean = 0.05 + 0.7 * torch.rand(3, 1, 24, generator=random).expand(3, 4, 24)
    z = torch.tensor([1.0, 2.0, 4.0, 7.0])[:, None].expand(1, 4, 24)
    beta, veil = (torch.tensor(x)[:, None, None] for x in ((0.45, 0.12, 0.1), (0.05, 0.3, 0.4)))
    observed = clean * torch.exp(-beta * z) - veil * torch.expm1(-beta * z)
    observed += 0.003 * torch.randn(observed.shape, generator=random)
    fit = uwaug.fit(clean, observed, z, color_space="linear")
    assert {x.name.partition(" ")[0] for x in fit.candidates} <= {"haze", "veil"}
    truth = {"beta": beta.flatten(), "veil": veil.flatten()}
    assert np.abs(errors(fit, truth, ("beta", "veil"))).max() < 4
    for kind, wanted in truth.items():
        assert values(fit, kind) == pytest.approx(wanted.tolist(), rel=0.1)
