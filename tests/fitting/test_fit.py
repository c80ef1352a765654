import numpy as np
import pytest
import torch
from fitted import COLOURS, HAZE, TRUTH, as_bytes, errors, medium, seen

import uwaug
from uwaug.fitting.coefficients import lossy_media
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear


def test_a_water_comes_back_within_its_errors(auto):
    assert auto.model == "gaussian"
    away = errors(auto)
    assert abs(away).max() < 3.5
    assert (abs(away) < 2).mean() >= 0.75
    for name, number in auto.parameters.items():
        assert number.state == "free", name
        assert number.low < number.value < number.high
        if name.startswith(("beta", "G_", "veil")):
            assert number.error < 0.05 * number.value
    assert auto.parameters["exponent"].value == pytest.approx(0.9, abs=0.15)
    assert auto.rms == pytest.approx(0.01, rel=0.1)
    assert auto.noise.deviation(torch.tensor(0.3), "srgb") == pytest.approx(0.01, rel=0.1)


def test_candidates_are_part_of_the_result(auto):
    names = [tried.name for tried in auto.candidates]
    assert names == [
        "attenuation", "haze", "veil", "paper", "calibrated", "gaussian", "exponential",
    ]  # fmt: skip
    best = next(tried for tried in auto.candidates if tried.behind == 0)
    assert best.name == "gaussian"
    assert all(x.behind > x.behind_error for x in auto.candidates if x is not best)
    assert "Model 'gaussian'" in auto.message
    assert "* gaussian" in auto.summary()


def test_starts_meet(known, gaussian):
    for width, beta in ((0.5, 0.2), (6.0, 1.5)):
        start = {"width": width, "beta_red": beta}
        other = uwaug.fit(*known, model="gaussian", pixels=4000, start=start)
        np.testing.assert_allclose(other.theta, gaussian.theta, rtol=2e-3)


def scattered_away(G):
    rows = [torch.tensor([values], dtype=torch.float64) for values in (TRUTH["beta"], G)]
    return lossy_media(*rows, torch.tensor([TRUTH["veil"]], dtype=torch.float64))


@pytest.mark.parametrize(
    ("model", "water"),
    [
        ("attenuation", lambda: medium(**{**HAZE, "veil": (0, 0, 0)})),
        ("veil", lambda: scattered_away(TRUTH["G"])),
        ("exponential", lambda: medium(uwaug.PointSpread(0.8, 0.8, "exponential"))),
    ],
)
def test_the_model_that_made_the_picture_is_chosen(model, water):
    assert uwaug.fit(*seen(water()), pixels=600).model == model


def test_gains_of_several_pictures():
    channels = torch.tensor([0.4, 0.9, 1.1]).reshape(3, 1, 1)
    near, far = seen(medium(), seed=1, gain=0.7), seen(medium(), seed=2, gain=channels)
    both = (near.clean, [near.observed, far.observed], [near.distance, far.distance])
    fit = uwaug.fit(*both, gain="channels", model="gaussian", pixels=4000)
    wanted = torch.cat([torch.full((1, 3), 0.7), channels.reshape(1, 3)]).double()
    torch.testing.assert_close(fit.gains, wanted, rtol=0.03, atol=0.0)
    assert abs(errors(fit)).max() < 4
    assert len(fit.residual) == 2


def test_a_gain_that_is_not_needed_is_left_out(hazy):
    fit = uwaug.fit(*hazy, gain="free", pixels=500)
    assert (fit.model, fit.fitted.gain) == ("haze", "fixed")
    assert {"haze", "haze + gain"} <= {tried.name for tried in fit.candidates}


def test_another_exposure_is_said(haze):
    brighter = seen(medium(**HAZE), gain=1.15)
    fit = uwaug.fit(*brighter, model="haze", pixels=1000)
    assert "Of the camera, this is fitted too: gain_1" in fit.message
    assert fit.gains.mean() == pytest.approx(1.15, rel=0.02)
    as_it_is = {"gain": "fixed", "tone": "fixed", "shading": "fixed"}
    assert "another exposure" in uwaug.fit(*brighter, model="haze", pixels=1000, **as_it_is).message
    assert "exposure" not in haze.message


def test_what_is_known_is_not_fitted(known):
    fixed = {"G_red": 0.3, "veil_red": 0.1, "exponent": 0.9}
    fit = uwaug.fit(*known, model="gaussian", fixed=fixed, pixels=2000)
    for name, value in fixed.items():
        number = fit.parameters[name]
        assert (number.value, number.state, number.error) == (pytest.approx(value), "fixed", None)
    assert fit.parameters["source_red"].value == pytest.approx(0.03)
    assert fit.parameters["source_red"].state == "fixed"
    assert abs(errors(fit, kinds=("beta",))).max() < 4
    # forward scatter takes no light away
    assert fit.fitted.bounds["beta_red"].low == 0.3
    # what fits no place leaves fewer candidates
    with pytest.raises(ValueError, match=r"fixed: expected some of beta_red.*got exponent"):
        uwaug.fit(*known, model="haze", fixed={"exponent": 1.0})


def test_a_field_is_taken_into_account(known):
    clean, _, z = known
    generator = torch.Generator().manual_seed(3)
    field = uwaug.gaussian_random_field(z.shape, low=0.6, high=1.4, generator=generator)[0]
    observed = uwaug.Underwater(scattered_away(TRUTH["G"]), None)(clean, z, field)
    good = uwaug.fit(clean, observed, z, field=field, model="veil", pixels=1000)
    bad = uwaug.fit(clean, observed, z, model="veil", pixels=1000)
    for kind in ("beta", "G"):
        for c, colour in enumerate(COLOURS):
            value = good.parameters[f"{kind}_{colour}"].value
            assert value == pytest.approx(TRUTH[kind][c], rel=0.03)
    assert bad.rms > 4 * good.rms
    assert "depend on each other" in bad.message
    assert "depend on each other" not in good.message
    assert bad.parameters["beta_red"].error > 5 * good.parameters["beta_red"].error


def test_a_veil_without_end_is_not_printed_as_a_number():
    clear = seen(medium(uwaug.PointSpread.none(), beta=(0.02,) * 3, G=(0.02,) * 3))
    fit = uwaug.fit(*clear, model="veil", pixels=2000)
    for colour in COLOURS:
        number = fit.parameters[f"veil_{colour}"]
        assert (number.state, number.value, number.error) == ("not identified", None, None)
    assert "Not identified: " in fit.message
    assert "straight line" in fit.message
    assert "not identified" in fit.summary()
    source = fit.parameters["source_green"]
    assert source.value == pytest.approx(0.02 * 0.28, abs=4 * source.error)


def test_numbers_at_a_bound_say_so():
    plain = seen(medium(**{**HAZE, "veil": (0.0, 0.28, 0.33)}))
    fit = uwaug.fit(*plain, model="haze", pixels=2000)
    veil = fit.parameters["veil_red"]
    assert veil.state in ("at bound", "free")
    assert veil.value == pytest.approx(0.0, abs=2e-3)
    assert veil.low <= veil.value <= veil.high
    assert 0 < veil.high < 0.01
    if veil.state == "at bound":
        assert veil.error is None
        assert "At the end of what they may be: veil_red" in fit.message


def test_what_is_black_is_not_identified(hazy):
    dark, z = hazy.clean.clone(), hazy.distance
    dark[2] = 0
    behind = hazy.observed.clone()
    light = medium(**HAZE).backscatter(z.double())[0, 2]
    behind[2] = (linear_to_srgb(light) * 255).round().to(torch.uint8)
    for begin in (0.3, 3.0):
        start = {"beta_blue": begin, "G_blue": 0.2}
        fit = uwaug.fit(dark, behind, z, model="veil", start=start, pixels=2000)
        assert fit.parameters["beta_blue"].state == "not identified"
        red = fit.parameters["beta_red"]
        assert red.state == "free"
        assert red.value == pytest.approx(TRUTH["beta"][0], abs=4 * red.error)


def test_a_grey_wall_shows_no_scattering(hazy):
    wall = torch.full_like(hazy.clean, 128)
    light = srgb_to_linear(wall.double() / 255)
    observed = as_bytes(uwaug.form_image(light, hazy.distance.double(), medium()).image, 0.005)
    fit = uwaug.fit(wall, observed, hazy.distance, model="gaussian", pixels=2000)
    for c, colour in enumerate(COLOURS):
        assert fit.parameters[f"beta_{colour}"].state == "not identified"
        assert fit.parameters[f"G_{colour}"].value == pytest.approx(TRUTH["G"][c], rel=0.2)


def test_noise_above_all_leaves_pixels():
    loud = seen(medium(**HAZE), noise=0.15)
    fit = uwaug.fit(*loud, model="haze", pixels=3000)
    assert fit.rms > 0.1
    assert abs(errors(fit, kinds=("beta",))).max() < 4


def test_units_are_doubted(hazy):
    clean, observed, z = hazy
    doubt = "are the distances in metres?"
    assert doubt in uwaug.fit(clean, observed, z / 1000, model="haze", pixels=1000).message
    relative = uwaug.fit(clean, observed, z * 2000, model="haze", relative=True, pixels=1000)
    assert doubt not in relative.message
    assert "scale of the distances is unknown" in relative.message
    assert relative.parameters["beta_red"].unit == "1/unit"


def test_a_fit_repeats_itself_anywhere(hazy, haze):
    """In inference mode, from lists, with a mask that leaves nothing out; by its seed."""
    listed = [[picture[None]] for picture in hazy]
    mask = torch.ones_like(hazy.distance, dtype=torch.uint8)
    with torch.inference_mode():
        again = uwaug.fit(*listed, mask=mask, model="haze", pixels=2000)
    np.testing.assert_array_equal(again.theta, haze.theta)
    np.testing.assert_array_equal(again.covariance, haze.covariance)
    assert not np.array_equal(uwaug.fit(*hazy, model="haze", pixels=2000, seed=5).theta, haze.theta)


def test_progress_is_told_and_nothing_is_searched_twice(hazy, monkeypatch):
    said, searched = [], []
    multistart = uwaug.fitting.api.multistart

    def counted(objective, *arguments):
        searched.append(objective.model.name)
        return multistart(objective, *arguments)

    monkeypatch.setattr(uwaug.fitting.api, "multistart", counted)
    uwaug.fit(*hazy, model="haze", pixels=1000, progress=said.append)
    assert said == [
        "blurring the clean picture",
        "learning the noise",
        "looking at what the camera has done",
        "fitting 'haze', 1 of 1",
        "looking at what may be wrong",
    ]
    assert searched == ["haze"]


def test_fits_bear_outliers(hazy):
    spoilt = hazy.observed.clone()
    spoilt[:, ::7, ::5] = 250  # 3 % of the pixels
    numbers = uwaug.fit(hazy.clean, spoilt, hazy.distance, model="haze", pixels=2000).parameters
    for kind in ("beta", "veil"):
        values = [numbers[f"{kind}_{colour}"].value for colour in COLOURS]
        assert values == pytest.approx(TRUTH[kind], rel=0.03)


def test_open_water_counts(known):
    clean, _, z = known
    sea = z.clone()
    sea[:, :20] = torch.inf
    observed = uwaug.Underwater(medium(), None)(clean, sea)
    fit = uwaug.fit(clean, observed, sea, model="gaussian", pixels=2000)
    assert fit.parameters["veil_red"].value == pytest.approx(0.1, rel=0.02)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "best"}, "model must be one of auto, attenuation"),
        ({"model": "calibrated"}, "focal_px: the calibrated width law needs"),
        ({"focal_px": 0}, "focal_px must be finite and > 0 px"),
        ({"gain": "yes"}, "gain must be one of auto, fixed"),
        ({"g": 1.0}, r"g must be in \[0, 0\.99\]"),
        ({"start": {"bta_red": 0.3}}, "start: expected some of beta_red.* got bta_red"),
        ({"start": {"beta_red": float("nan")}}, r"start\['beta_red'\] must be in"),
        ({"fixed": {"width": 1e6}}, r"fixed\['width'\] must be in \[0, "),
        ({"fixed": {"beta_red": 0.3, "G_red": 0.9}}, "expected G_red ≤ beta_red, got 0.9 and 0.3"),
        (
            {"model": "attenuation", "fixed": {f"beta_{colour}": 0.5 for colour in COLOURS}},
            "nothing is left to be fitted",
        ),
    ],
)
def test_refusals(known, options, message):
    with pytest.raises(ValueError, match=message):
        uwaug.fit(*known, **{"model": "gaussian", **options})
