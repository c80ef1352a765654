import math
from pathlib import Path
from typing import Any

import jerlov
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uwaug.optics.spectra import WAVELENGTHS
from uwaug.optics.water import CONTRAST_THRESHOLD, JERLOV_TYPES, Water, load_water

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
    "changes",
    [{"a": [0.1, 0.2, 0.3, 0.6]}, {"kd": [0, 0, 0, 0]}, {"name": "x"}, {"provenance": ("x",)}],
)
def test_equality_sees_every_field(changes):
    assert toy() == toy()
    assert toy(**changes) != toy()
    assert toy() != "water"


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
    assert clear.with_contents(1.001).name == "II"
    assert clear.with_contents(0).name == "pure water (without contents of II)"
    assert clear.mix(Water.jerlov("ii"), 0.4) is clear


@pytest.mark.parametrize("t, same", [(0, "II"), (1, "7C")])
def test_mix_ends(t, same):
    mixed, end = Water.jerlov("II").mix(Water.jerlov("7C"), t), Water.jerlov(same)
    for key in ("wavelengths", "a", "b", "kd"):
        np.testing.assert_array_equal(getattr(mixed, key), getattr(end, key))


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


@given(st.floats(1e-6, 1e6))
def test_visibility_of_grey_water(beta):
    water = Water(NM, [beta / 4] * 4, [beta * 3 / 4] * 4, [beta] * 4)
    assert water.visibility() == pytest.approx(-math.log(0.02) / beta, rel=1e-12)


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


def test_only_the_contents_are_scaled():
    scaled = Water.jerlov("1C").with_visibility(3)
    water = Water.jerlov("1C").at(scaled.wavelengths)
    # below pure water at 605 and 610 nm, between wavelengths of the table
    a_w = np.minimum(water.a, jerlov.pure_water_absorption(water.wavelengths))
    b_w = jerlov.pure_water_scattering(water.wavelengths)
    factor = (scaled.b - b_w) / (water.b - b_w)
    np.testing.assert_allclose(factor, factor[0], rtol=1e-10)
    assert factor[0] > 1
    np.testing.assert_allclose(scaled.a, a_w + factor[0] * (water.a - a_w), rtol=1e-10)
    k_w = a_w + b_w / 2
    np.testing.assert_allclose(scaled.kd, k_w + factor[0] * (water.kd - k_w), rtol=1e-10)


@pytest.mark.parametrize("type", JERLOV_TYPES[1:])
@pytest.mark.parametrize("metres", [1.0, 10.0])
def test_scaled_before_or_after_it_is_taken_to_bands(type: str, metres: float) -> None:
    """`Water.with_visibility` and `RandomUnderwater`, which keeps bands alone, make one water."""
    scaled = Water.jerlov(type).with_visibility(metres).at(WAVELENGTHS)
    bands = Water.jerlov(type).at(WAVELENGTHS).with_visibility(metres)
    for key in ("a", "b", "kd"):
        np.testing.assert_allclose(getattr(scaled, key), getattr(bands, key), rtol=1e-12)


def test_with_visibility_is_named():
    water = Water.jerlov("II").with_visibility(5)
    assert water.name == "II at 5 m visibility"
    *before, last = water.provenance
    assert tuple(before) == Water.jerlov("II").provenance
    assert last.startswith("II at 5 m visibility: all but pure water scaled by 1.908")
    assert water.mix(Water.jerlov("I"), 0.5).name == "0.5·(II at 5 m visibility) + 0.5·I"


def test_pure_water_is_not_known_everywhere():
    wide = Water([250, 850], [1, 2], [1, 1], [1, 2])
    message = r"tabulated at 300–800 nm, but .*250–850 nm\) leaves it: resample"
    with pytest.raises(ValueError, match=message):
        wide.with_visibility(1)
    assert wide.at([300, 800]).with_visibility(1).visibility() == pytest.approx(1, rel=1e-12)


@pytest.mark.parametrize(
    "changes, error, message",
    [
        ({"wavelengths": []}, ValueError, r"at least one sample, got shape \(0,\)"),
        (
            {"wavelengths": [400, 500, 500, 700]},
            ValueError,
            "ascending, but 500 is followed by 500",
        ),
        ({"wavelengths": [400, np.nan, 600, 700]}, ValueError, "finite, got 1 NaN"),
        ({"wavelengths": [0, 500, 600, 700]}, ValueError, "between 100 and 3000, got 0…700$"),
        ({"wavelengths": "blue"}, TypeError, "must be an array of numbers, got 'blue'"),
        ({"a": [0.1, 0.2]}, ValueError, r"a must have one row per wavelength, shape \(4,\)"),
        ({"b": [np.inf, 1, 1, 1]}, ValueError, "b has 1 NaN or infinite of 4 values, at 400 nm"),
        ({"kd": [0.1, 0.2, -0.3, 0.4]}, ValueError, "kd has 1 negative of 4 values, at 600 nm"),
        ({"provenance": "a note"}, TypeError, "provenance must be a sequence of strings"),
    ],
)
def test_bad_input(changes, error, message):
    with pytest.raises(error, match=message):
        toy(**changes)


# ---------------------------------------------------------------- contrast


CONTENT = JERLOV_TYPES[1:]  # in type I there is less than the tables' error


def pure() -> Water:
    nm = np.arange(400.0, 701.0, 5.0)
    a, b = jerlov.pure_water_absorption(nm), jerlov.pure_water_scattering(nm)
    return Water(nm, a, b, a + b / 2, name="pure")


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_contrast_is_what_luminance_keeps(type: str) -> None:
    water = Water.jerlov(type)
    nm = np.linspace(400, 700, 2401)
    observer, xyz = jerlov.cie_1931_cmf()
    eye = np.interp(nm, observer, xyz[:, 1])
    beta = np.interp(nm, water.wavelengths, water.beta)
    for metres in (0.0, 1.0, 7.0):
        kept = np.trapezoid(eye * np.exp(-beta * metres), nm) / np.trapezoid(eye, nm)
        assert water.contrast(metres) == pytest.approx(kept, rel=1e-4)
    assert water.contrast(0.0) == pytest.approx(1.0, rel=1e-12)
    assert water.contrast(water.visibility()) == pytest.approx(CONTRAST_THRESHOLD, rel=1e-9)


@given(st.sampled_from(CONTENT), st.floats(0.03, 1.0), st.floats(0.1, 20))
def test_with_contrast_round_trip(type: str, share: float, metres: float) -> None:
    water = Water.jerlov(type)
    wanted = share * water.most_contrast(metres)
    scaled = water.with_contrast(wanted, metres)
    assert scaled.contrast(metres) == pytest.approx(wanted, rel=1e-9)
    assert min(scaled.a.min(), scaled.b.min(), scaled.kd.min()) >= 0


@pytest.mark.parametrize("type", CONTENT)
def test_visibility_is_contrast_at_the_threshold(type: str) -> None:
    water = Water.jerlov(type)
    one, other = water.with_visibility(5), water.with_contrast(CONTRAST_THRESHOLD, 5)
    for key in ("a", "b", "kd"):
        np.testing.assert_array_equal(getattr(one, key), getattr(other, key))


@pytest.mark.parametrize("type", JERLOV_TYPES)
@pytest.mark.parametrize("metres", [0.3, 4.0, 60.0])
def test_most_contrast_is_that_of_pure_water(type: str, metres: float) -> None:
    water = Water.jerlov(type)
    most = water.most_contrast(metres)
    assert water.contrast(metres) <= most < 1
    clearest = water.with_contrast(most, metres)  # where a range is clamped
    assert clearest.contrast(metres) == pytest.approx(most, rel=1e-12)
    np.testing.assert_array_less(clearest.beta, water.at(clearest.wavelengths).beta + 1e-12)
    with pytest.raises(ValueError, match=rf"contrast=.* at {metres:g} m is more than the pure"):
        water.with_contrast(min(1.001 * most, 1.0), metres)


def test_pure_water_keeps_its_contrast() -> None:
    water = pure()
    most = water.most_contrast(5)
    assert most == water.contrast(5)
    same = water.with_contrast(most, 5)
    np.testing.assert_array_equal(same.beta, water.beta)
    with pytest.raises(ValueError, match="'pure' is nothing but pure water to the eye: there is"):
        water.with_contrast(0.5 * most, 5)


def test_water_that_is_pure_where_it_matters_says_so() -> None:
    # type I lies below the table of pure water at most wavelengths
    message = "'I' is nothing but pure water to the eye"
    with pytest.raises(ValueError, match=message):
        Water.jerlov("I").at(WAVELENGTHS).with_visibility(4)


@pytest.mark.parametrize(
    "contrast, metres, match",
    [
        (-0.1, 3.0, "contrast must be finite and > 0"),
        (1.0, 3.0, r"contrast=1 at 3 m is more than the pure water in 'II' allows, 0\.\d+"),
        (0.5, math.nan, "metres must be finite and > 0, got nan"),
    ],
)
def test_with_contrast_rejects(contrast: float, metres: float, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        Water.jerlov("II").with_contrast(contrast, metres)


def test_contents_out_of_reach() -> None:
    with pytest.raises(ValueError, match=r"out of reach: its contents would be .* times as much"):
        Water.jerlov("9C").with_visibility(2e-308)
    message = r"metres=200 is more than the pure water in 'II' allows, 88\.33 m"
    with pytest.raises(ValueError, match=message):
        Water.jerlov("II").with_visibility(200)
    with pytest.raises(ValueError, match="metres must be finite and ≥ 0"):
        Water.jerlov("II").contrast(-1.0)
    with pytest.raises(ValueError, match="contrast must be finite and > 0, got 0"):
        Water.jerlov("II").contents_for(0, 3.0)


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_daylight_fades_with_depth(type: str) -> None:
    water = Water.jerlov(type)
    depth = water.depth_of_daylight(0.03)
    assert water.daylight(depth) == pytest.approx(0.03, rel=1e-9)
    # K_d in place of β, the same integral
    grey = Water(water.wavelengths, water.kd, 0 * water.kd, water.kd)
    assert water.daylight(depth) == pytest.approx(grey.contrast(depth), rel=1e-12)


def test_derived_waters_are_waters() -> None:
    # they skip the checks of the constructor, which must find nothing to say about them
    one, other = Water.jerlov("II"), Water.jerlov("9C")
    for water in (one.mix(other, 0.3), one.with_contrast(0.3, 2.0), one.at([450.0, 512.0])):
        again = Water(
            water.wavelengths,
            water.a,
            water.b,
            water.kd,
            name=water.name,
            provenance=water.provenance,
        )
        assert again == water
        assert hash(again) == hash(water)
        for key in ("wavelengths", "a", "b", "kd"):
            assert not getattr(water, key).flags.writeable


# ---------------------------------------------------------------- by name, contents or file


ROWS = "400,0.5,1.3,0.7\n550,0.2,1.1,0.3\n700,0.7,1.0,0.8\n"
TANK = Water([400, 550, 700], [0.5, 0.2, 0.7], [1.3, 1.1, 1.0], [0.7, 0.3, 0.8], name="tank")


@pytest.mark.parametrize(
    "header",
    [
        "",
        "nm,a,b,K_d\n",
        "\ufeffwavelength, a, b, kd\r\n",
        "lambda [nm],Absorption [1/m],scattering,Kd(PAR)\n",
    ],
)
def test_water_from_a_file(tmp_path: Path, header: str) -> None:
    path = tmp_path / "tank.csv"
    path.write_text(header + ROWS)
    for named in (path, str(path)):
        water = load_water(named)
        assert (water.name, water.provenance) == ("tank", ("a, b, K_d: tank.csv",))
        for name in ("wavelengths", "a", "b", "kd"):
            np.testing.assert_array_equal(getattr(water, name), getattr(TANK, name))


@pytest.mark.parametrize(
    "text, message",
    [
        ("nm,a,b,kd\n", "no rows of wavelength, a, b, K_d"),
        ("nm,a,kd,b\n" + ROWS, "line 1: expected four numbers, wavelength, a, b, K_d"),
        ("nm,a,backscattering,kd\n" + ROWS, "line 1: expected four numbers"),
        ("nm,attenuation,b,kd\n" + ROWS, "line 1: expected four numbers"),
        ("nm,a,beta,kd\n" + ROWS, "line 1: expected four numbers"),
        ("nm,a_p,b_p,kd\n" + ROWS, "line 1: expected four numbers"),
        (ROWS + "710,1,2\n", "line 4: expected four numbers"),
        (ROWS + "710,1,-2,1\n", "b has 1 negative of 4 values, at 710 nm"),
        (ROWS + "710,1,2,nan\n", "kd has 1 NaN or infinite of 4 values, at 710 nm"),
        (ROWS + "650,1,2,1\n", "strictly ascending, but 700 is followed by 650"),
    ],
)
def test_bad_file(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "tank.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as info:
        load_water(path)
    assert str(info.value).startswith(str(path))


def test_water_by_name_and_contents() -> None:
    assert load_water(TANK) is TANK
    assert load_water("7c") == Water.jerlov("7C")
    contents = {"chlorophyll": 5.0, "cdom": 0.3, "minerals": 1.5}
    water = Water.from_constituents(**contents)
    assert load_water("minerals=1.5, CDOM=.3,chlorophyll=5") == load_water(water.name) == water
    named = Water.from_constituents(**contents, name="harbour")
    assert named.name == "harbour"
    np.testing.assert_array_equal(named.a, water.a)


@pytest.mark.parametrize(
    "water, error, message",
    [
        (7, TypeError, "water must be a Jerlov type, .* or a uwaug.Water, got 7"),
        ("7D", ValueError, "water must be one of I, .*, 9C; contents such as .*csv; got '7D'"),
        ("chlorophyll=1:5", ValueError, "one number for each content, got 'chlorophyll=1:5'"),
        ("salt=3", ValueError, r"expected a water such as chlorophyll=5.*, got 'salt=3'"),
        ("nowhere.csv", FileNotFoundError, r"nowhere\.csv"),
    ],
)
def test_no_such_water(water: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        load_water(water)


@pytest.mark.parametrize("name", ["3c", "Jerlov3C", "jerlov 3C", "Jerlov-3c"])
def test_types_by_the_names_that_people_write(name):
    assert load_water(name) == Water.jerlov("3C")
    assert load_water(name).name == "3C"
