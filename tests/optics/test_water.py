import copy
import math
import pickle
import subprocess
import sys

import jerlov
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from optical import values
from scipy.optimize import brentq

from uwaug.optics.water import JERLOV_TYPES, Water

NM = [400.0, 500.0, 600.0, 700.0]


def toy(**changes):
    values = {
        "wavelengths": NM,
        "a": [0.1, 0.2, 0.3, 0.7],
        "b": [0.4, 0.3, 0.2, 0.1],
        "kd": [0.3, 0.3, 0.4, 0.8],
    }
    return Water(**values | changes)


spectra = st.lists(st.floats(1e-3, 50), min_size=4, max_size=4)


# ---------------------------------------------------------------- own spectra


def test_attributes():
    water = toy(name="tank", provenance=["measured by hand"])
    assert water.wavelengths.dtype == water.a.dtype == np.float64
    np.testing.assert_array_equal(water.kd, [0.3, 0.3, 0.4, 0.8])
    np.testing.assert_allclose(water.beta, [0.5, 0.5, 0.5, 0.8], rtol=1e-15)
    assert (water.name, water.provenance) == ("tank", ("measured by hand",))
    assert repr(water) == "Water('tank', 4 wavelengths, 400–700 nm)"
    assert toy().name == "custom"
    assert toy().provenance == ()


def test_immutable_and_independent_of_its_input():
    a = np.array([0.1, 0.2, 0.3, 0.7])
    water = toy(a=a)
    a[:] = 9
    assert water.a[0] == 0.1
    for array in (water.wavelengths, water.a, water.b, water.kd):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(AttributeError):
        water.a = a
    with pytest.raises(AttributeError):
        water.extra = 1


@pytest.mark.parametrize(
    "clone", [copy.copy, copy.deepcopy, lambda w: pickle.loads(pickle.dumps(w))]
)
def test_copies_are_equal_and_still_read_only(clone):
    water = Water.jerlov("5C")
    twin = clone(water)
    assert twin == water
    assert hash(twin) == hash(water)
    assert repr(twin) == repr(water)
    assert not any(array.flags.writeable for array in (twin.wavelengths, twin.a, twin.b, twin.kd))


@pytest.mark.parametrize(
    "changes",
    [{"a": [0.1, 0.2, 0.3, 0.6]}, {"kd": [0, 0, 0, 0]}, {"name": "x"}, {"provenance": ("x",)}],
)
def test_equality_sees_every_field(changes):
    assert toy() == toy()
    assert toy(**changes) != toy()
    assert toy() != "water"


def test_one_wavelength_is_enough():
    water = Water([550], [0.1], [0.3], [0.2])
    assert water.visibility() == pytest.approx(-math.log(0.02) / 0.4)
    assert water.at([550]) == water


@pytest.mark.parametrize(
    "changes, error, message",
    [
        (
            {"wavelengths": [[400, 500], [600, 700]]},
            ValueError,
            r"1-D with at least one sample, got shape \(2, 2\)",
        ),
        ({"wavelengths": []}, ValueError, r"at least one sample, got shape \(0,\)"),
        ({"wavelengths": 550.0}, ValueError, r"1-D .* got shape \(\)"),
        (
            {"wavelengths": [400, 600, 500, 700]},
            ValueError,
            "strictly ascending, but 600 is followed by 500",
        ),
        (
            {"wavelengths": [400, 500, 500, 700]},
            ValueError,
            "strictly ascending, but 500 is followed by 500",
        ),
        ({"wavelengths": [400, np.nan, 600, 700]}, ValueError, "finite, got 1 NaN"),
        (
            {"wavelengths": [0.4, 0.5, 0.6, 0.7]},
            ValueError,
            r"in nm.* got 0.4…0.7; they look like micrometres",
        ),
        (
            {"wavelengths": [4e-7, 5e-7, 6e-7, 7e-7]},
            ValueError,
            "they look like metres: multiply by 1e",
        ),
        (
            {"wavelengths": [4000, 5000, 6000, 7000]},
            ValueError,
            "they look like ångströms: multiply by 0.1",
        ),
        ({"wavelengths": [0, 500, 600, 700]}, ValueError, "between 100 and 3000, got 0…700$"),
        ({"wavelengths": "blue"}, TypeError, "wavelengths must be an array of numbers, got 'blue'"),
        (
            {"a": [0.1, 0.2]},
            ValueError,
            r"a must have one row per wavelength, shape \(4,\), got \(2,\)",
        ),
        ({"b": 0.3}, ValueError, r"b must have one row per wavelength, shape \(4,\), got \(\)"),
        ({"kd": ["?"] * 4}, TypeError, "kd must be an array of numbers"),
        (
            {"a": [0.1, np.nan, 0.3, np.nan]},
            ValueError,
            "a has 2 NaN or infinite of 4 values, at 500, 700 nm: fill",
        ),
        ({"b": [np.inf, 1, 1, 1]}, ValueError, "b has 1 NaN or infinite of 4 values, at 400 nm"),
        ({"kd": [0.1, 0.2, -0.3, 0.4]}, ValueError, "kd has 1 negative of 4 values, at 600 nm"),
        (
            {"provenance": "a note"},
            TypeError,
            "provenance must be a sequence of strings, got the string 'a note'",
        ),
    ],
)
def test_bad_input(changes, error, message):
    with pytest.raises(error, match=message):
        toy(**changes)


def test_long_lists_of_bad_values_are_cut():
    nm = np.arange(400.0, 500.0)
    message = r"a has 100 NaN or infinite of 100 values, at 400, .*, 407, … nm"
    with pytest.raises(ValueError, match=message):
        Water(nm, nm * np.nan, nm, nm)


# ---------------------------------------------------------------- resample, mix


def test_at_is_linear_interpolation():
    water = toy(name="tank", provenance=("by hand",))
    fine = water.at([400, 425, 650, 700])
    np.testing.assert_allclose(fine.a, [0.1, 0.125, 0.5, 0.7], rtol=1e-15)
    np.testing.assert_allclose(fine.b, [0.4, 0.375, 0.15, 0.1], rtol=1e-15)
    np.testing.assert_allclose(fine.kd, [0.3, 0.3, 0.6, 0.8], rtol=1e-15)
    assert (fine.name, fine.provenance) == (water.name, water.provenance)
    assert water.at(water.wavelengths) == water


@pytest.mark.parametrize(
    "nm, asked", [([399, 500], "399–500"), ([500, 701], "500–701"), ([720], "720")]
)
def test_at_never_extrapolates(nm, asked):
    message = rf"^{asked} nm is outside the data of 'custom', 400–700 nm"
    with pytest.raises(ValueError, match=message):
        toy().at(nm)


def test_mix_by_hand():
    other = Water([450, 500, 800], [1, 2, 5], [3, 3, 3], [1, 1, 1], name="other")
    mixed = toy(name="toy").mix(other, 0.25)
    np.testing.assert_array_equal(mixed.wavelengths, [450, 500, 600, 700])
    np.testing.assert_allclose(mixed.a, [0.3625, 0.65, 0.975, 1.525], rtol=1e-14)
    np.testing.assert_allclose(mixed.b, [1.0125, 0.975, 0.9, 0.825], rtol=1e-14)
    np.testing.assert_allclose(mixed.kd, [0.475, 0.475, 0.55, 0.85], rtol=1e-14)
    assert mixed.name == "0.75·toy + 0.25·other"


def test_mix_names_and_provenance():
    clear, turbid = Water.jerlov("II"), Water.jerlov("7C")
    mixed = clear.mix(turbid, 0.3)
    assert mixed.name == "0.7·II + 0.3·7C"
    assert mixed.provenance == clear.provenance + turbid.provenance
    again = mixed.mix(clear, 0.5)
    assert again.name == "0.5·(0.7·II + 0.3·7C) + 0.5·II"
    assert again.provenance == mixed.provenance
    assert clear.mix(turbid, 0.388214).name == "0.61·II + 0.39·7C"
    assert clear.with_contents(0.025843).name == "0.026·contents of II"
    assert clear.mix(Water.jerlov("ii"), 0.4) is clear


@pytest.mark.parametrize("t, same", [(0, "II"), (1, "7C")])
def test_mix_ends(t, same):
    mixed, end = Water.jerlov("II").mix(Water.jerlov("7C"), t), Water.jerlov(same)
    for key in ("wavelengths", "a", "b", "kd"):
        np.testing.assert_array_equal(getattr(mixed, key), getattr(end, key))


@given(st.floats(0, 1), st.floats(0, 1))
def test_mix_is_a_monotone_slider(t1, t2):
    assume(t1 < t2)
    clear, turbid = Water.jerlov("1C"), Water.jerlov("9C")
    assert clear.mix(turbid, t1).visibility() >= clear.mix(turbid, t2).visibility() * (1 - 1e-12)


@pytest.mark.parametrize("t", [-0.1, 1.5, math.nan])
def test_mix_share(t):
    with pytest.raises(ValueError, match=r"t must be in \[0, 1\].*got"):
        toy().mix(toy(), t)


def test_mix_needs_a_water_and_a_common_range():
    with pytest.raises(TypeError, match=r"other must be a uwaug.Water, got str"):
        toy().mix("7C", 0.5)
    infrared = Water([800, 900], [1, 1], [1, 1], [1, 1])
    with pytest.raises(ValueError, match="no common wavelength"):
        toy().mix(infrared, 0.5)
    assert toy().mix(Water([700, 900], [1, 1], [1, 1], [1, 1]), 0.5).wavelengths == [700]


# ---------------------------------------------------------------- visibility


def test_visibility_at_one_wavelength_is_koschmieder():
    assert toy().visibility(500) == pytest.approx(-math.log(0.02) / 0.5, rel=1e-15)
    assert toy().visibility(650) == pytest.approx(-math.log(0.02) / 0.65, rel=1e-14)
    with pytest.raises(ValueError, match="720 nm is outside the data of 'custom', 400–700 nm"):
        toy().visibility(720)


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_visibility_is_where_luminance_contrast_falls_to_2_percent(type):
    water = Water.jerlov(type)
    nm = np.linspace(400, 700, 2401)
    observer, xyz = jerlov.cie_1931_cmf()
    eye = np.interp(nm, observer, xyz[:, 1])
    beta = np.interp(nm, water.wavelengths, water.a + water.b)
    total = np.trapezoid(eye, nm)

    def excess(z):
        return np.trapezoid(eye * np.exp(-beta * z), nm) / total - 0.02

    reference = brentq(excess, 1e-3, 1e3)
    assert water.visibility() == pytest.approx(reference, rel=1e-4)


def test_visibility_is_what_divers_know():
    metres = {type: Water.jerlov(type).visibility() for type in JERLOV_TYPES}
    assert 60 < metres["I"] < 90  # the clearest Secchi readings are 65 to 80 m
    assert 5 < metres["II"] < 20
    assert 1 < metres["9C"] < metres["7C"] < metres["5C"] < metres["3C"] < metres["1C"] < 10


@given(st.floats(1e-6, 1e6))
def test_visibility_of_grey_water(beta):
    water = Water(NM, [beta / 4] * 4, [beta * 3 / 4] * 4, [beta] * 4)
    assert water.visibility() == pytest.approx(-math.log(0.02) / beta, rel=1e-12)


@given(spectra, spectra)
def test_visibility_lies_between_those_of_the_best_and_the_worst_wavelength(a, b):
    water = Water(NM, a, b, a)
    worst, best = -math.log(0.02) / water.beta.max(), -math.log(0.02) / water.beta.min()
    assert worst * (1 - 1e-12) <= water.visibility() <= best * (1 + 1e-12)


def test_visibility_without_attenuation():
    nothing = Water(NM, [0] * 4, [0] * 4, [0] * 4)
    assert nothing.visibility() == nothing.visibility(500) == math.inf
    window = Water([400, 500, 600, 700], [1, 0, 0, 1], [0] * 4, [0] * 4)
    assert window.visibility() == math.inf
    assert window.visibility(400) < math.inf


def test_visibility_of_what_the_eye_cannot_see():
    infrared = Water([750, 780], [2.6, 2.4], [0, 0], [2.6, 2.4])
    with pytest.raises(ValueError, match="no wavelength in 400–700 nm: give"):
        infrared.visibility()
    assert infrared.visibility(750) == pytest.approx(-math.log(0.02) / 2.6)


# ---------------------------------------------------------------- the turbidity knob


@given(st.sampled_from(JERLOV_TYPES), st.floats(0.05, 80))
def test_with_visibility_round_trip(type, metres):
    water = Water.jerlov(type).with_visibility(metres)
    assert water.visibility() == pytest.approx(metres, rel=1e-12)
    assert min(water.a.min(), water.b.min(), water.kd.min()) >= 0


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_own_visibility_changes_nothing(type):
    water = Water.jerlov(type)
    same = water.with_visibility(water.visibility())
    for key in ("wavelengths", "a", "b", "kd"):
        np.testing.assert_allclose(getattr(same, key), getattr(water, key), rtol=1e-12)


@given(st.floats(0.1, 80), st.floats(0.1, 80))
def test_clearer_water_has_less_of_everything(v1, v2):
    assume(v1 < v2)
    murky, clear = (Water.jerlov("3C").with_visibility(v) for v in (v1, v2))
    for key in ("a", "b", "kd"):
        assert (getattr(clear, key) <= getattr(murky, key) * (1 + 1e-12)).all()


def test_only_the_contents_are_scaled():
    water = Water.jerlov("1C")  # nowhere below pure water
    a_w = jerlov.pure_water_absorption(water.wavelengths)
    b_w = jerlov.pure_water_scattering(water.wavelengths)
    scaled = water.with_visibility(3)
    factor = (scaled.b - b_w) / (water.b - b_w)
    np.testing.assert_allclose(factor, factor[0], rtol=1e-10)
    assert factor[0] > 1
    np.testing.assert_allclose(scaled.a, a_w + factor[0] * (water.a - a_w), rtol=1e-10)
    k_w = a_w + b_w / 2
    np.testing.assert_allclose(scaled.kd, k_w + factor[0] * (water.kd - k_w), rtol=1e-10)


def test_turbid_water_cleared_absorbs_red_like_a_clear_type():
    clear = Water.jerlov("1C")
    cleared = Water.jerlov("9C").with_visibility(clear.visibility())
    # .344; one factor for all gives .064
    assert values(cleared, 650)[0] == pytest.approx(values(clear, 650)[0], rel=0.02)


def test_with_visibility_is_named():
    water = Water.jerlov("II").with_visibility(5)
    assert water.name == "II at 5 m visibility"
    *before, last = water.provenance
    assert tuple(before) == Water.jerlov("II").provenance
    assert last.startswith("II at 5 m visibility: all but pure water scaled by 1.917")
    assert water.mix(Water.jerlov("I"), 0.5).name == "0.5·(II at 5 m visibility) + 0.5·I"


def test_clearest_is_pure_water():
    message = r"metres=200 is more than the pure water in 'II' allows, 87\.5\d m"
    with pytest.raises(ValueError, match=message):
        Water.jerlov("II").with_visibility(200)
    water = Water.jerlov("II").with_visibility(87.5)
    pure = jerlov.pure_water_absorption(water.wavelengths)
    np.testing.assert_allclose(water.a, np.minimum(pure, Water.jerlov("II").a), rtol=0.01)


@pytest.mark.parametrize("metres", [0, -3, math.nan, math.inf])
def test_visibility_asked_for_must_be_a_length(metres):
    with pytest.raises(ValueError, match="metres must be finite and > 0, got"):
        Water.jerlov("II").with_visibility(metres)


def test_nothing_to_scale():
    nm = np.arange(400.0, 701.0)
    a, b = jerlov.pure_water_absorption(nm), jerlov.pure_water_scattering(nm)
    with pytest.raises(ValueError, match="'pure' is nothing but pure water"):
        Water(nm, a, b, a + b / 2, name="pure").with_visibility(5)


def test_pure_water_is_not_known_everywhere():
    wide = Water([250, 850], [1, 2], [1, 1], [1, 2])
    message = r"tabulated at 300–800 nm, but .*250–850 nm\) leaves it: resample"
    with pytest.raises(ValueError, match=message):
        wide.with_visibility(1)
    assert wide.at([300, 800]).with_visibility(1).visibility() == pytest.approx(1, rel=1e-12)


def test_import_is_light():
    code = "import sys, uwaug.optics.water, uwaug.optics.camera\n"
    code += "print({'colour', 'jerlov'} & set(sys.modules))"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert done.stdout == "set()\n"
