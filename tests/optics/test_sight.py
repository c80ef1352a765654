import math

import jerlov
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uwaug.optics.bands import WAVELENGTHS
from uwaug.optics.water import CONTRAST_THRESHOLD, JERLOV_TYPES, Water

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
    np.testing.assert_array_less(clearest.beta, water.beta + 1e-12)
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


def test_contrast_is_named() -> None:
    water = Water.jerlov("II").with_contrast(0.4, 3)
    assert water.name == "II with 0.4 of the contrast at 3 m"
    assert water.provenance[-1].startswith(f"{water.name}: all but pure water scaled by 0.5")


@pytest.mark.parametrize(
    "contrast, metres, match",
    [
        (0.0, 3.0, "contrast must be finite and > 0, got 0"),
        (-0.1, 3.0, "contrast must be finite and > 0"),
        (math.nan, 3.0, "contrast must be finite and > 0, got nan"),
        (1.0, 3.0, r"contrast=1 at 3 m is more than the pure water in 'II' allows, 0\.\d+"),
        (0.5, 0.0, "metres must be finite and > 0, got 0"),
        (0.5, math.inf, "metres must be finite and > 0, got inf"),
        (0.5, math.nan, "metres must be finite and > 0, got nan"),
    ],
)
def test_with_contrast_rejects(contrast: float, metres: float, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        Water.jerlov("II").with_contrast(contrast, metres)


@pytest.mark.parametrize("metres", [-1.0, math.inf, math.nan])
def test_contrast_wants_a_distance(metres: float) -> None:
    for method in (Water.jerlov("II").contrast, Water.jerlov("II").most_contrast):
        with pytest.raises(ValueError, match="metres must be finite and ≥ 0"):
            method(metres)


def test_contents_out_of_reach() -> None:
    with pytest.raises(ValueError, match=r"out of reach: its contents would be .* times as much"):
        Water.jerlov("9C").with_visibility(2e-308)


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
