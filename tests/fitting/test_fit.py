import dataclasses

import numpy as np
import pytest
import torch
from fitted import COLOURS, TRUTH, medium, seen
from uwaug.fitting.media import _without_scatter

import uwaug


@pytest.fixture(scope="module")
def known():
    return seen(medium())


@pytest.fixture(scope="module")
def found(known):
    return uwaug.fit(*known, pixels=5000, focal_px=332.0)


def errors(found, truth=TRUTH, kinds=("beta", "G", "veil")):
    away = []
    for kind in kinds:
        for c, colour in enumerate(COLOURS):
            one = found.parameters[f"{kind}_{colour}"]
            away.append((one.value - truth[kind][c]) / one.error)
    return np.array(away)


def test_a_water_comes_back_within_its_errors(found):
    assert found.model == "gaussian"
    away = errors(found)
    assert abs(away).max() < 3.5
    assert (abs(away) < 2).mean() >= 0.75
    for name, one in found.parameters.items():
        assert one.state == "free", name
        assert one.low < one.value < one.high
        if name.startswith(("beta", "G_", "veil")):
            assert one.error < 0.05 * one.value
    assert found.parameters["exponent"].value == pytest.approx(0.9, abs=0.15)
    assert found.rms == pytest.approx(0.01, rel=0.1)
    assert found.noise.deviation(torch.tensor(0.3), "srgb") == pytest.approx(0.01, rel=0.1)


def test_candidates_are_part_of_the_result(found):
    names = [one.name for one in found.candidates]
    assert names == [
        "attenuation", "haze", "veil", "paper", "calibrated", "gaussian", "exponential",
    ]  # fmt: skip
    best = next(one for one in found.candidates if one.behind == 0)
    assert best.name == "gaussian"
    assert all(one.behind > one.behind_error for one in found.candidates if one is not best)
    assert "Model 'gaussian'" in found.message
    assert "* gaussian" in found.summary()


def test_random_starts_meet(known):
    ends = []
    for seed in range(3):
        start = {"width": (1.0, 4.0, 12.0)[seed], "beta_red": (0.2, 0.6, 1.5)[seed]}
        one = uwaug.fit(
            *known, model="gaussian", pixels=4000, start=start, noise=uwaug.fitting.Noise(0.01)
        )
        ends.append(one.theta)
    np.testing.assert_allclose(ends[1], ends[0], rtol=2e-3)
    np.testing.assert_allclose(ends[2], ends[0], rtol=2e-3)


def scattered_away(G):
    rows = [torch.tensor([values], dtype=torch.float64) for values in (TRUTH["beta"], G)]
    return _without_scatter(*rows, torch.tensor([TRUTH["veil"]], dtype=torch.float64))


@pytest.mark.parametrize(
    ("model", "water"),
    [
        ("attenuation", lambda: medium(uwaug.PointSpread.none(), G=TRUTH["beta"], veil=(0, 0, 0))),
        ("haze", lambda: medium(uwaug.PointSpread.none(), G=TRUTH["beta"])),
        ("veil", lambda: scattered_away(TRUTH["G"])),
        ("exponential", lambda: medium(uwaug.PointSpread(2.0, 0.8, "exponential"))),
    ],
)
def test_the_model_that_made_the_picture_is_chosen(model, water):
    assert uwaug.fit(*seen(water()), pixels=3000).model == model


def test_gains_are_found():
    known = seen(medium(), gain=0.7)
    found = uwaug.fit(*known, gain="free", model="gaussian", pixels=6000)
    gain = found.parameters["gain_1"]
    assert gain.value == pytest.approx(0.7, abs=4 * gain.error)
    assert abs(errors(found)).max() < 4
    channels = torch.tensor([0.4, 0.9, 1.1]).reshape(3, 1, 1)
    known = seen(medium(), gain=channels)
    found = uwaug.fit(*known, gain="channels", model="gaussian", pixels=6000)
    torch.testing.assert_close(found.gains[0], channels.flatten().double(), rtol=0.03, atol=0.0)


def test_a_gain_that_is_not_needed_is_left_out(known):
    found = uwaug.fit(*known, gain="free", pixels=2000)
    assert found.structure.gain == "fixed"
    assert {"gaussian", "gaussian + gain"} <= {one.name for one in found.candidates}


def test_several_pictures_of_one_water():
    near, far = seen(medium(), seed=1), seen(medium(), seed=2)
    found = uwaug.fit(
        near.clean,
        [near.observed, far.observed],
        [near.distance, far.distance],
        model="gaussian",
        gain="free",
        pixels=8000,
    )
    assert abs(errors(found)).max() < 4
    assert found.gains.shape == (2, 3)
    assert len(found.residual) == 2


def test_what_is_known_is_not_fitted(known):
    fixed = {"G_red": 0.3, "veil_red": 0.1, "exponent": 0.9}
    found = uwaug.fit(*known, model="gaussian", fixed=fixed, pixels=4000)
    for name, value in fixed.items():
        one = found.parameters[name]
        assert (one.value, one.state, one.error) == (pytest.approx(value), "fixed", None)
    assert found.parameters["source_red"].value == pytest.approx(0.03)
    assert found.parameters["source_red"].state == "fixed"
    assert abs(errors(found, kinds=("beta",))).max() < 4
    # what fits no place leaves fewer candidates
    with pytest.raises(ValueError, match=r"fixed: expected some of beta_red.*got exponent"):
        uwaug.fit(*known, model="haze", fixed={"exponent": 1.0})


def test_a_field_that_is_given_is_taken_into_account():
    clean, z = seen(medium())[::2]
    generator = torch.Generator().manual_seed(3)
    field = uwaug.gaussian_random_field(z.shape, low=0.6, high=1.4, generator=generator)[0]
    water = uwaug.Underwater(medium(), None, tolerance=5e-4)
    observed = water(clean, z, field)
    good = uwaug.fit(clean, observed, z, field=field, model="gaussian", pixels=4000)
    bad = uwaug.fit(clean, observed, z, model="gaussian", pixels=4000)
    for kind in ("beta", "G"):
        for c, colour in enumerate(COLOURS):
            value = good.parameters[f"{kind}_{colour}"].value
            assert value == pytest.approx(TRUTH[kind][c], rel=0.03)
    assert bad.rms > 4 * good.rms
    assert "depend on each other" in bad.message
    assert "depend on each other" not in good.message
    wider = bad.parameters["beta_red"].error / good.parameters["beta_red"].error
    assert wider > 5


def test_a_veil_without_end_is_not_printed_as_a_number():
    clear = seen(medium(uwaug.PointSpread.none(), beta=(0.02,) * 3, G=(0.02,) * 3))
    found = uwaug.fit(*clear, model="veil", pixels=4000)
    for colour in COLOURS:
        one = found.parameters[f"veil_{colour}"]
        assert (one.state, one.value, one.error) == ("not identified", None, None)
    assert "Not identified: " in found.message
    assert "straight line" in found.message
    assert "not identified" in found.summary()
    source = found.parameters["source_green"]
    assert source.value == pytest.approx(0.02 * 0.28, abs=4 * source.error)


def test_numbers_at_a_bound_say_so():
    plain = seen(medium(uwaug.PointSpread.none(), G=TRUTH["beta"], veil=(0.0, 0.28, 0.33)))
    found = uwaug.fit(*plain, model="haze", pixels=4000)
    veil = found.parameters["veil_red"]
    assert veil.state in ("at bound", "free")
    assert veil.value == pytest.approx(0.0, abs=2e-3)
    assert veil.low <= veil.value <= veil.high
    assert 0 < veil.high < 0.01
    if veil.state == "at bound":
        assert veil.error is None
        assert "At the end of what they may be: veil_red" in found.message


def test_a_relative_distance_has_no_scale(known):
    found = uwaug.fit(*known, model="gaussian", pixels=2000, relative=True)
    assert found.parameters["beta_red"].unit == "1/unit"
    assert "scale of the distances is unknown" in found.message


def test_a_fit_repeats_itself(known):
    first, second = (uwaug.fit(*known, model="veil", pixels=2000, seed=4) for _ in range(2))
    np.testing.assert_array_equal(first.theta, second.theta)
    np.testing.assert_array_equal(first.covariance, second.covariance)
    other = uwaug.fit(*known, model="veil", pixels=2000, seed=5)
    assert not np.array_equal(first.theta, other.theta)


def test_progress_is_told(known):
    said = []
    uwaug.fit(*known, model="haze", pixels=1000, progress=said.append)
    assert said == ["blurring the clean picture", "learning the noise", "fitting 'haze', 1 of 1"]


def test_robust_fits_bear_outliers(known):
    spoilt = known.observed.clone()
    spoilt[:, ::7, ::5] = 250  # 3 % of the pixels
    plain = uwaug.fit(
        known.clean, spoilt, known.distance, model="gaussian", pixels=4000, robust=False
    )
    sturdy = uwaug.fit(known.clean, spoilt, known.distance, model="gaussian", pixels=4000)
    truth = np.array(TRUTH["beta"] + TRUTH["veil"])

    def off(one):
        values = []
        for kind in ("beta", "veil"):
            for colour in COLOURS:
                value = one.parameters[f"{kind}_{colour}"].value
                values.append(10.0 if value is None else value)
        return abs(np.array(values) / truth - 1).max()

    assert off(sturdy) < 0.3 * off(plain)


def test_the_noise_is_a_value():
    noise = uwaug.fitting.Noise(read=0.01, shot=1e-4, bits=None)
    light = torch.tensor([0.0, 1.0])
    torch.testing.assert_close(
        noise.deviation(light, "srgb"), torch.tensor([1e-4, 2e-4]).sqrt(), rtol=1e-6, atol=0.0
    )
    rounded = uwaug.fitting.Noise(0.0, 0.0).deviation(torch.tensor([0.5]), "linear")
    assert float(rounded) == pytest.approx(1 / 255 / 12**0.5, rel=1e-5)
    with pytest.raises(ValueError, match=r"Noise\.read must be in \[0, 1\], got -1"):
        uwaug.fitting.Noise(-1)
    with pytest.raises(dataclasses.FrozenInstanceError):
        noise.read = 1.0
