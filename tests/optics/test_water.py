"""Waters: spectra, mixing, what one sees through them, more and less in them, names and files.
Their copies and what is wrong with files, of cameras, too.
"""

import copy
import math
import pickle
import warnings
from pathlib import Path
from typing import Any

import jerlov
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusing import refusals

from uwaug import JERLOV_TYPES, Water, load_camera, load_water
from uwaug._support import codec
from uwaug.cli import choices
from uwaug.optics.constituents import PLACES
from uwaug.optics.spectra import WAVELENGTHS
from uwaug.optics.water import CONTRAST_THRESHOLD

NM = [400.0, 500.0, 600.0, 700.0]
QUANTITIES = ("wavelengths", "a", "b", "kd")
TOY = {"a": [0.1, 0.2, 0.3, 0.7], "b": [0.4, 0.3, 0.2, 0.1], "kd": [0.3, 0.3, 0.4, 0.8]}


def toy(**changes: Any) -> Water:
    return Water(**{"wavelengths": NM, **TOY, **changes})


def test_equality_sees_every_field_and_nothing_changes_later() -> None:
    a = np.array(TOY["a"])
    water = toy(a=a)
    a[:] = 9
    assert water == toy()
    changes = {"a": [0.1, 0.2, 0.3, 0.6], "kd": [1, 1, 1, 1], "name": "x", "provenance": ("x",)}
    for name, value in changes.items():
        assert water != toy(**{name: value}), name


def test_at_is_linear_interpolation() -> None:
    water = toy(name="tank", provenance=("by hand",))
    fine = water.at([400, 425, 650, 700])
    np.testing.assert_allclose(fine.a, [0.1, 0.125, 0.5, 0.7], rtol=1e-15)
    np.testing.assert_allclose(fine.b, [0.4, 0.375, 0.15, 0.1], rtol=1e-15)
    np.testing.assert_allclose(fine.kd, [0.3, 0.3, 0.6, 0.8], rtol=1e-15)
    assert (fine.name, fine.provenance) == (water.name, water.provenance)


def test_mix_by_hand() -> None:
    other = Water([450, 500, 800], [1, 2, 5], [3, 3, 3], [1, 2, 5], name="other", provenance=("x",))
    mixed = toy(name="toy").mix(other, 0.25)
    np.testing.assert_array_equal(mixed.wavelengths, [450, 500, 600, 700])
    np.testing.assert_allclose(mixed.a, [0.3625, 0.65, 0.975, 1.525], rtol=1e-14)
    np.testing.assert_allclose(mixed.b, [1.0125, 0.975, 0.9, 0.825], rtol=1e-14)
    np.testing.assert_allclose(mixed.kd, [0.475, 0.725, 1.05, 1.6], rtol=1e-14)
    assert (mixed.name, mixed.provenance) == ("0.75·toy + 0.25·other", ("x",))


def test_mixtures_end_in_their_waters() -> None:
    clear, turbid = Water.jerlov("II"), Water.jerlov("7C")
    for t, end in ((0, clear), (1, turbid)):
        for key in QUANTITIES:
            np.testing.assert_array_equal(getattr(clear.mix(turbid, t), key), getattr(end, key))
    nested = clear.mix(turbid, 0.3).mix(clear, 0.5)
    assert nested.name == "0.5·(0.7·II + 0.3·7C) + 0.5·II"
    assert clear.mix(Water.jerlov("ii"), 0.4) is clear


def test_visibility_at_the_ends() -> None:
    for beta in (1e-6, 1e6):
        grey = Water(NM, [beta / 4] * 4, [beta * 3 / 4] * 4, [beta] * 4)
        assert grey.visibility() == pytest.approx(-math.log(0.02) / beta, rel=1e-12)
    assert Water(NM, [0] * 4, [0] * 4, [0] * 4).visibility() == math.inf


@pytest.mark.parametrize("type", ["I", "II", "9C"])
def test_contrast_is_what_luminance_keeps(type: str) -> None:
    water, nm = Water.jerlov(type), np.linspace(400, 700, 2401)
    observer, xyz = jerlov.cie_1931_cmf()
    eye = np.interp(nm, observer, xyz[:, 1])
    beta = np.interp(nm, water.wavelengths, water.beta)
    for metres in (0.0, 1.0, 7.0):
        kept = np.trapezoid(eye * np.exp(-beta * metres), nm) / np.trapezoid(eye, nm)
        assert water.contrast(metres) == pytest.approx(kept, rel=1e-4)
    assert water.contrast(water.visibility()) == pytest.approx(CONTRAST_THRESHOLD, rel=1e-9)
    depth = water.depth_of_daylight(0.03)
    assert water.daylight(depth) == pytest.approx(0.03, rel=1e-9)
    # K_d in place of β, the same integral
    grey = Water(water.wavelengths, water.kd, 0 * water.kd, water.kd)
    assert water.daylight(depth) == pytest.approx(grey.contrast(depth), rel=1e-12)


CONTENT = JERLOV_TYPES[1:]  # in type I there is less than the tables' error


def test_only_the_contents_are_scaled() -> None:
    scaled = Water.jerlov("1C").with_contrast(0.02, 3)
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
    assert scaled.name == "1C with 0.02 of the contrast at 3 m"
    assert scaled.provenance[-1].startswith(f"{scaled.name}: all but pure water scaled by")


@given(st.sampled_from(CONTENT), st.floats(0.03, 1.0), st.floats(0.1, 20))
def test_with_contrast_is_contrast_before_and_after_resampling(
    type: str, share: float, metres: float
) -> None:
    water = Water.jerlov(type)
    wanted = share * water.with_contents(0).contrast(metres)
    scaled = water.with_contrast(wanted, metres)
    assert scaled.contrast(metres) == pytest.approx(wanted, rel=1e-9)
    again = water.with_contents(water.contents_for(wanted, metres))
    bands = water.at(WAVELENGTHS).with_contrast(wanted, metres)
    for key in QUANTITIES[1:]:
        np.testing.assert_allclose(getattr(again, key), getattr(scaled, key), rtol=1e-12)
        ours = getattr(scaled.at(WAVELENGTHS), key)
        np.testing.assert_allclose(getattr(bands, key), ours, rtol=1e-9)


def test_names_and_ends_of_contents() -> None:
    water = Water.jerlov("II")
    assert water.with_contents(0.025843).name == "0.026·contents of II"
    assert water.with_contents(0).name == "0·contents of II"
    assert water.contents_for(0.5, math.inf) == 1
    assert water.contents_for(0.9999, 10) == 0


@pytest.mark.parametrize(
    "water", [Water.jerlov("II"), Water.jerlov("5C", "williamson2022")], ids=lambda w: w.name
)
def test_derived_waters_are_waters(water: Water) -> None:
    # they skip the checks of the constructor, which copies and codec pass
    derived = [water.with_contents(factor) for factor in (0, 0.3, 1000)]
    derived += [derived[1].at([450.0, 607.0]), water.mix(Water.jerlov("9C"), 0.3)]
    for before in (water, *derived, load_camera("Nikon 5100 (NPL)")):
        stored = codec.from_plain(codec.to_plain(before), type(before))
        for after in (before, copy.deepcopy(before), pickle.loads(pickle.dumps(before)), stored):
            assert after == before
            assert hash(after) == hash(before)
            arrays = [value for value in vars(after).values() if isinstance(value, np.ndarray)]
            assert len(arrays) >= 2
            assert not any(array.flags.writeable for array in arrays)


# wavelength, a, b, K_d: printed by Solonenko & Mobley 2015, Tables 4–8, and repaired by a of
# Williamson & Hollins 2022, b of Solonenko & Mobley, Eq. (8) with Table 3, K_d of Jerlov 1976,
# Table XXVII; measured by Williamson & Hollins. Against their package: test_data.py
TABLES = {
    ("II", "solonenko2015"): [(550, 0.0622, 0.358, 0.0999), (700, 0.582, 0.238, 0.624)],
    ("3C", "solonenko2015"): [(550, 0.082, 1.06, 0.187), (675, 0.503, 0.7542, 0.56)],
    ("5C", "solonenko2015"): [(300, 5.36, 3.73, 6.75), (600, 0.285, 1.1468, 0.40)],
    ("5C", "williamson2022"): [(600, 0.285, 1.16, 0.40), (675, 0.557, 1.12, 0.65)],
    ("IB", "williamson2022"): [(400, 0.0448, 0.144, 0.051), (700, 0.573, 0.111, 0.58)],
}


def test_types_are_as_printed_measured_or_repaired() -> None:
    for (type, source), rows in TABLES.items():
        water = Water.jerlov(type, source)
        for nm, *printed in rows:
            (at,) = np.flatnonzero(water.wavelengths == nm)
            assert [water.a[at], water.b[at], water.kd[at]] == pytest.approx(printed, 1e-12)
    borrowed = "Jerlov IB: K_d at 310–700 nm: Jerlov 1976, Table XXVII (not in this source)"
    assert borrowed in Water.jerlov("IB", "williamson2022").provenance


ROWS = "400,0.5,1.3,0.7\n550,0.2,1.1,0.3\n700,0.7,1.0,0.8\n"
TANK = Water([400, 550, 700], [0.5, 0.2, 0.7], [1.3, 1.1, 1.0], [0.7, 0.3, 0.8], name="tank")


@pytest.mark.parametrize(
    "header",
    [
        "",
        "\ufeffwavelength, a, b, kd\r\n",
        "nm,Absorption,scattering,Kd\n",
        '"wavelength","a","b","K_d"\n',
        "wavelength [nm],a [1/m],b (m^-1),K_d/m⁻¹\n",
        "λ/nm,a/m⁻¹,b (m−1),kd [ m^{-1} ]\n",
        "wavelength_nm,a 1/m,b /m,kd\n",
    ],
)
def test_water_from_a_file(tmp_path: Path, header: str) -> None:
    table = np.array([TANK.wavelengths, *(getattr(TANK, name) for name in ("a", "b", "kd"))])
    text = header + "".join(",".join(map(repr, row)) + "\n" for row in table.T.tolist())
    path = tmp_path / "tank.csv"
    for separator, point in ((",", "."), (";", ","), ("\t", ",")):
        path.write_text(text.replace(",", separator).replace(".", point), encoding="utf-8")
        water = load_water(path)
        assert (water.name, water.provenance) == ("tank", ("a, b, K_d: tank.csv",))
        for name in QUANTITIES:
            np.testing.assert_allclose(getattr(water, name), getattr(TANK, name), rtol=1e-12)


def test_absorption_and_attenuation_are_enough(tmp_path: Path) -> None:
    path, lake = tmp_path / "ac.csv", Water.from_constituents(chlorophyll=3, cdom=0.2, minerals=1)
    columns = {"nm": lake.wavelengths, "a": lake.a, "c": lake.beta, "K_d": lake.kd}
    for count in (4, 3):
        rows = np.array(list(columns.values())[:count]).T
        np.savetxt(path, rows, "%.17g", ",", header=",".join([*columns][:count]), comments="")
        water = load_water(path)
        for name in ("a", "b", "kd"):  # the model of contents takes the same K_d
            np.testing.assert_allclose(getattr(water, name), getattr(lake, name), rtol=1e-12)
    assert water.provenance == ("a, c: ac.csv", "b: c − a", "K_d: of a and b by Kirk 1984")


@pytest.mark.parametrize("share", [0.01, 0.1])
def test_a_table_below_pure_water_is_doubted(tmp_path: Path, share: float) -> None:
    """In 1/cm, or of contents alone; blue light tells nothing, as pure water hardly absorbs it."""
    path, lake = tmp_path / "lake.csv", Water.from_constituents(chlorophyll=3, minerals=1)
    for nm in (lake.wavelengths, lake.wavelengths[lake.wavelengths < 570]):
        water = lake.at(nm)
        rows = np.array([nm, share * water.a, share * water.b, share * water.kd]).T
        np.savetxt(path, rows, "%.17g", ",")
        with warnings.catch_warnings(record=True) as doubts:
            warnings.simplefilter("always")
            load_water(path)
        told = ["in 1/cm, times 100" in str(doubt.message) for doubt in doubts]
        assert told == ([True] if nm[-1] > 600 else [])


SENSOR = "400,0,1,2\n500,0,3,0\n700,4,1,0\n"


@pytest.mark.parametrize(
    "load, text, message",
    [
        (load_water, "nm,a [dB/m],b,kd\n" + ROWS, "a in another unit"),
        (load_water, "nm,a [1/cm],b,kd\n" + ROWS, "a in another unit than 1/m"),
        (load_water, "nm,a,b [cm],kd\n" + ROWS, "b in another unit"),
        (load_water, "nm,a,b (km-1),kd\n" + ROWS, "b in another unit than 1/m"),
        (load_water, "nm,a,b,kd (%)\n" + ROWS, "K_d in another unit"),
        (load_water, "µm,a,b,kd\n.4,.5,1.3,.7\n", "in nm"),
        (load_water, "wavenumber [1/cm],a,b,kd\n" + ROWS, "wavelength in another unit"),
        (load_water, "site,Secchi [m]\n1,5\n", "line 1"),
        (load_water, "nm,a,c\n400,.5,.4\n", "b must be finite and ≥ 0, got -0.1"),
        (load_water, "nm,a,b,kd\n", "no rows"),
        (load_water, "nm,a,kd,b\n" + ROWS, "line 1"),
        (load_water, "nm,a,beta,kd\n" + ROWS, "line 1"),
        (load_water, ROWS + "710,1,2\n", "line 4"),
        (load_water, ROWS + "650,1,2,1\n", "650 after 700"),
        (load_camera, SENSOR.replace(",", ":"), "line 1"),
        (load_camera, "frequency [THz],R,G,B\n" + SENSOR, "wavelength in another unit"),
        (load_camera, "wavelength,B,G,R\n" + SENSOR, "line 1"),
        (load_camera, "user,name,pass-word-of-mine,hunter2\n", "line 1"),
    ],
)
def test_bad_files(tmp_path: Path, load: Any, text: str, message: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as info:
        load(path)
    assert str(info.value).startswith(str(path))
    assert "hunter2" not in str(info.value)  # its path may come from a preset of somebody else


def test_water_by_name_and_contents() -> None:
    assert load_water(TANK) is TANK
    for name in ("3c", "Jerlov3C", "jerlov 3C", "Jerlov-3c"):
        assert load_water(name) == Water.jerlov("3C")
    contents = {"chlorophyll": 5.0, "cdom": 0.3, "minerals": 1.5}
    water = Water.from_constituents(**contents)
    assert load_water("minerals=1.5, CDOM=.3,chlorophyll=5") == load_water(water.name) == water
    assert Water.from_constituents(**contents, name="harbour").name == "harbour"


def test_choices_of_the_command_line_are_the_waters_that_have_names() -> None:
    """It lists them without loading the library."""
    assert (JERLOV_TYPES, tuple(PLACES)) == (choices.WATERS, choices.PLACES)
    assert {load_water(name.upper()).name for name in PLACES} == {*PLACES}


II, PURE_TYPE = Water.jerlov("II"), Water.jerlov("I").at(WAVELENGTHS)
FAR_RED = Water([750, 800], [2.6, 2.4], [0, 0], [2.6, 2.4])
WIDE = Water([250, 850], [1, 2], [1, 1], [1, 2])


test_what_is_refused = refusals(
    (lambda: toy(wavelengths=[]), "wavelengths.*shape"),
    (lambda: toy(wavelengths=[400, 500, 500, 700]), "wavelengths.*500 after 500"),
    (lambda: toy(wavelengths=[400, np.nan, 600, 700]), "wavelengths.*nan"),
    (lambda: toy(wavelengths=[0, 500, 600, 700]), "wavelengths.*0…700"),
    (lambda: toy(wavelengths="blue"), "wavelengths.*'blue'"),
    (lambda: toy(a=[0.1, 0.2]), "a.*shape"),
    (lambda: toy(b=[np.inf, 1, 1, 1]), "b.*got inf at 400 nm, and 1 of 4"),
    (lambda: toy(kd=[0.1, 0.2, -0.3, 0.4]), "kd.*got -0.3 at 600 nm, and 1 of 4"),
    (lambda: toy(kd=[0.1, 0.16, 0.3, 0.59]), "kd.*less at .500.0, 700.0. nm"),
    (lambda: toy(provenance="a note"), "provenance.*list of strings"),
    (lambda: toy().at([399, 500]), "399–500 nm is outside"),
    (lambda: toy().at([500, 701]), "500–701 nm is outside"),
    (lambda: toy().mix(toy(), -0.1), "t must be"),
    (lambda: toy().mix("7C", 0.5), "other must be"),
    (lambda: toy().mix(FAR_RED, 0.5), "no common wavelength"),
    (FAR_RED.visibility, "no wavelength in 400–700 nm"),
    (lambda: II.with_contrast(-0.1, 3.0), "contrast must be"),
    (lambda: II.with_contrast(0.5, math.nan), "metres must be"),
    (lambda: II.with_contrast(1.0, 3.0), "II with 1 of .* pure water in it leaves"),
    (lambda: II.with_contents(0).with_contrast(0.5, 5.0), "is but pure water"),
    (lambda: PURE_TYPE.with_contrast(0.02, 4.0), "I .* is but pure water"),
    (lambda: Water.jerlov("9C").with_contrast(0.02, 2e-308), "out of reach"),
    (lambda: WIDE.with_contrast(0.02, 1.0), "250–850 nm"),
    (Water.jerlov, "5D", "'5D'"),
    (Water.jerlov, "9C", "williamson2022", "IB, II, III, 1C, 3C, 5C"),
    (Water.jerlov, "II", "jerlov1976", "source must be one of .*'jerlov1976'"),
    (load_water, 7, "7"),
    (load_water, "chlorophyll=1:5", "chlorophyll=1:5"),
    (load_water, "salt=3", "salt=3"),
    (load_water, "nowhere.csv", "nowhere.csv"),
    error=(TypeError, ValueError, FileNotFoundError),
)
