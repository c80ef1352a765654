"""What an attack on fits has found."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from fitted import COLOURS, TRUTH, medium, pair, seen, structure
from uwaug.fitting.pixels import gather
from uwaug.fitting.solve import Problem, scouted, solve
from uwaug.fitting.start import best_of_starts, guess
from uwaug.fitting.uncertainty import spread
from uwaug.fitting.verdict import _odd_units

import uwaug

HAZE = {"G": TRUTH["beta"]}


@pytest.fixture(scope="module")
def known():
    return seen(medium(), step=4)


@pytest.fixture(scope="module")
def hazy():
    return seen(medium(uwaug.PointSpread.none(), **HAZE), step=4)


def test_what_is_black_is_not_identified(hazy):
    dark, z = hazy.clean.clone(), hazy.distance
    dark[2] = 0
    behind = hazy.observed.clone()
    light = medium(uwaug.PointSpread.none(), **HAZE).backscatter(z.double())[0, 2]
    behind[2] = (uwaug.formation.colour.linear_to_srgb(light) * 255).round().to(torch.uint8)
    for begin in (0.3, 3.0):
        start = {"beta_blue": begin, "G_blue": 0.2}
        found = uwaug.fit(dark, behind, z, model="veil", start=start, pixels=2000)
        assert found.parameters["beta_blue"].state == "not identified"
        red = found.parameters["beta_red"]
        assert red.state == "free"
        assert red.value == pytest.approx(TRUTH["beta"][0], abs=4 * red.error)


def test_a_grey_wall_shows_no_scattering(hazy):
    wall = torch.full_like(hazy.clean, 128)
    light = uwaug.form_image(
        uwaug.formation.colour.srgb_to_linear(wall.double() / 255), hazy.distance.double(), medium()
    ).image
    noise = 0.005 * torch.randn(light.shape, generator=torch.Generator().manual_seed(0))
    observed = uwaug.formation.colour.linear_to_srgb((light + noise).clamp(0, 1))
    observed = (observed * 255).round().to(torch.uint8)
    found = uwaug.fit(wall, observed, hazy.distance, model="gaussian", pixels=2000)
    for c, colour in enumerate(COLOURS):
        assert found.parameters[f"beta_{colour}"].state == "not identified"
        assert found.parameters[f"G_{colour}"].value == pytest.approx(TRUTH["G"][c], rel=0.2)


def test_another_exposure_is_said(hazy):
    brighter = seen(medium(uwaug.PointSpread.none(), **HAZE), step=4, gain=1.15)
    found = uwaug.fit(*brighter, model="haze", pixels=2000)
    assert "A gain of 1.1" in found.message
    assert "A gain of" not in uwaug.fit(*hazy, model="haze", pixels=2000).message


def test_uneven_light_widens_errors(hazy):
    one = pair(hazy)
    rows, columns = one.size
    y, x = torch.meshgrid(torch.linspace(0, 7, rows), torch.linspace(0, 10, columns), indexing="ij")
    uneven = 1 + 0.06 * torch.sin(x) * torch.sin(y)  # over a third of the picture
    one = one._replace(observed=one.observed * uneven.double())
    drawn = gather([one], (), 2000, np.random.default_rng(0))
    drawn = drawn.weighed(drawn.weights / 0.01)
    base = structure("haze")
    geometry = base.geometry._replace(reference=drawn.reference)
    problem = Problem(replace(base, geometry=geometry), drawn)
    first = problem.structure.begun(guess(problem.structure, drawn), {})
    solution = solve(problem, scouted(problem, first))
    wide = spread(problem, solution)
    fine = spread(replace(problem, pixels=replace(drawn, coarser=())), solution)
    assert wide.widened > 1.2 * fine.widened
    assert fine.widened > 1.2


def test_far_starts_meet(known):
    drawn = gather([pair(known)], ("gaussian",), 2000, np.random.default_rng(0))
    drawn = drawn.weighed(drawn.weights * (drawn.observed > 0.03) / 0.01)
    base = structure("gaussian")
    geometry = base.geometry._replace(reference=drawn.reference)
    problem = Problem(replace(base, geometry=geometry), drawn)
    first = problem.structure.begun(guess(problem.structure, drawn), {})
    low, high = problem.limits
    rng = np.random.default_rng(3)
    costs = []
    for _ in range(5):
        start = np.clip(first * np.exp(rng.uniform(-1, 1, len(first))), low, high)
        costs.append(best_of_starts(problem, [start], 0, more=0).cost)
    assert max(costs) < min(costs) * (1 + 1e-4)


def test_noise_above_all_leaves_pixels(hazy):
    loud = seen(medium(uwaug.PointSpread.none(), **HAZE), step=4, noise=0.15)
    found = uwaug.fit(*loud, model="haze", pixels=3000)
    assert found.rms > 0.1
    for c, colour in enumerate(COLOURS):
        one = found.parameters[f"beta_{colour}"]
        assert one.value == pytest.approx(TRUTH["beta"][c], abs=4 * one.error)


def test_units_are_doubted(hazy):
    clean, observed, z = hazy
    assert (
        "are the distances in metres?"
        in uwaug.fit(clean, observed, z / 1000, model="haze", pixels=1000).message
    )
    relative = uwaug.fit(clean, observed, z * 2000, model="haze", relative=True, pixels=1000)
    assert "are the distances in metres?" not in relative.message
    assert _odd_units(relative.parameters, relative.structure) == []


def test_it_works_anywhere(hazy):
    plain = uwaug.fit(*hazy, model="haze", pixels=1000)
    with torch.inference_mode():
        inside = uwaug.fit(*hazy, model="haze", pixels=1000)
    np.testing.assert_array_equal(inside.theta, plain.theta)
    listed = [[one[None]] for one in hazy]
    mask = torch.ones_like(hazy.distance, dtype=torch.uint8)
    again = uwaug.fit(*listed, mask=mask, model="haze", pixels=1000)
    np.testing.assert_array_equal(again.theta, plain.theta)


def test_numbers_of_numpy_are_saved(hazy, tmp_path):
    numbers = {"fixed": {"veil_red": np.float32(0.1)}, "g": np.float32(0.1)}
    found = uwaug.fit(*hazy, model="haze", focal_px=np.float32(300), pixels=1000, **numbers)
    found.save(tmp_path / "fit.json")
    assert uwaug.fitting.Fit.load(tmp_path / "fit.json").parameters == found.parameters


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": {"bta_red": 0.3}}, "start: expected some of beta_red.* got bta_red"),
        ({"start": {"beta_red": float("nan")}}, r"start\['beta_red'\] must be in"),
        ({"fixed": {"width": 1e6}}, r"fixed\['width'\] must be in \[0, "),
        ({"fixed": {"beta_red": 0.3, "G_red": 0.9}}, "expected G_red ≤ beta_red, got 0.9 and 0.3"),
        ({"seed": -1}, "seed must be finite and ≥ 0, got -1"),
    ],
)
def test_refused_options(known, options, message):
    with pytest.raises(ValueError, match=message):
        uwaug.fit(*known, model="gaussian", **options)


def test_refused_inputs(known):
    clean, observed, z = known
    with pytest.raises(ValueError, match="clean: expected one or as many as observed"):
        uwaug.fit([clean, clean], observed, z)
    with pytest.raises(ValueError, match="pair 2 of 2 has 0 pixels that can be used"):
        uwaug.fit(clean, [observed, observed], [z, 0 * z], model="haze")
    with pytest.raises(ValueError, match="only 0 pixels can be used"):
        uwaug.fit(clean, observed, z * torch.inf)
    for value, word in ((torch.nan, "NaN at"), (-1.0, "negative at")):
        with pytest.raises(ValueError, match=f"field is .*{word}"):
            uwaug.fit(clean, observed, z, field=torch.full_like(z, value))
    known_values = {f"beta_{colour}": 0.5 for colour in COLOURS}
    with pytest.raises(ValueError, match="nothing is left to be fitted"):
        uwaug.fit(clean, observed, z, model="attenuation", fixed=known_values)
