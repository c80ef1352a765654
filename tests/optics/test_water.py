"""Waters: spectra, mixing, what one sees through them, more and less in them, names and files."""

import math
import pickle
from pathlib import Path
from typing import Any

import jerlov
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uwaug import JERLOV_TYPES, Water, load_water
from uwaug._support import codec
from uwaug.cli import choices
from uwaug.optics.constituents import PLACES
from uwaug.optics.spectra import WAVELENGTHS
from uwaug.optics.water import CONTRAST_THRESHOLD

NM = [400.0, 500.0, 600.0, 700.0]
QUANTITIES = ("wavelengths", "a", "b", "kd")


def toy(**changes: Any) -> Water:
    values = {
        "wavelengths": NM,
        "a": [0.1, 0.2, 0.3, 0.7],
        "b": [0.4, 0.3, 0.2, 0.1],
        "kd": [0.3, 0.3, 0.4, 0.8],
    }
    return Water(**values | changes)


# ---- own spectra


def test_independent_of_its_input() -> None:
    a = np.array([0.1, 0.2, 0.3, 0.7])
    water = toy(a=a)
    a[:] = 9
    assert water.a[0] == 0.1


@pytest.mark.parametrize(
    "changes",
    [{"a": [0.1, 0.2, 0.3, 0.6]}, {"kd": [1, 1, 1, 1]}, {"name": "x"}, {"provenance": ("x",)}],
)
def test_equality_sees_every_field(changes: dict[str, Any]) -> None:
    assert toy() == toy() != toy(**changes)


@pytest.mark.parametrize(
    "name, values, words",
    [
        ("wavelengths", [], "shape"),
        ("wavelengths", [400, 500, 500, 700], "500 after 500"),
        ("wavelengths", [400, np.nan, 600, 700], "nan"),
        ("wavelengths", [0, 500, 600, 700], "0…700"),
        ("wavelengths", "blue", "'blue'"),
        ("a", [0.1, 0.2], "shape"),
        ("b", [np.inf, 1, 1, 1], "infinite of 4 values, at 400 nm"),
        ("kd", [0.1, 0.2, -0.3, 0.4], "1 negative of 4 values, at 600 nm"),
        ("kd", [0.1, 0.16, 0.3, 0.59], "less at .500.0, 700.0. nm"),
        ("provenance", "a note", "list of strings"),
    ],
)
def test_spectra_that_are_refused(name: str, values: Any, words: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"{name}.*{words}"):
        toy(**{name: values})


# ---- resample, mix


def test_at_is_linear_interpolation() -> None:
    water = toy(name="tank", provenance=("by hand",))
    fine = water.at([400, 425, 650, 700])
    np.testing.assert_allclose(fine.a, [0.1, 0.125, 0.5, 0.7], rtol=1e-15)
    np.testing.assert_allclose(fine.b, [0.4, 0.375, 0.15, 0.1], rtol=1e-15)
    np.testing.assert_allclose(fine.kd, [0.3, 0.3, 0.6, 0.8], rtol=1e-15)
    assert (fine.name, fine.provenance) == (water.name, water.provenance)
    for nm, asked in (([399, 500], "399–500"), ([500, 701], "500–701"), ([720], "720–720")):
        message = rf"^{asked} nm is outside the data of 'tank', 400–700 nm"
        with pytest.raises(ValueError, match=message):
            water.at(nm)


def test_mix_by_hand() -> None:
    other = Water([450, 500, 800], [1, 2, 5], [3, 3, 3], [1, 2, 5], name="other")
    mixed = toy(name="toy").mix(other, 0.25)
    np.testing.assert_array_equal(mixed.wavelengths, [450, 500, 600, 700])
    np.testing.assert_allclose(mixed.a, [0.3625, 0.65, 0.975, 1.525], rtol=1e-14)
    np.testing.assert_allclose(mixed.b, [1.0125, 0.975, 0.9, 0.825], rtol=1e-14)
    np.testing.assert_allclose(mixed.kd, [0.475, 0.725, 1.05, 1.6], rtol=1e-14)
    assert mixed.name == "0.75·toy + 0.25·other"


def test_mixtures_ends_and_names() -> None:
    clear, turbid = Water.jerlov("II"), Water.jerlov("7C")
    for t, end in ((0, clear), (1, turbid)):
        for key in QUANTITIES:
            np.testing.assert_array_equal(getattr(clear.mix(turbid, t), key), getattr(end, key))
    mixed = clear.mix(turbid, 0.3)
    assert mixed.name == "0.7·II + 0.3·7C"
    assert mixed.provenance == clear.provenance + turbid.provenance
    assert mixed.mix(clear, 0.5).name == "0.5·(0.7·II + 0.3·7C) + 0.5·II"
    assert clear.mix(Water.jerlov("ii"), 0.4) is clear


@pytest.mark.parametrize(
    "other, t, words",
    [
        (toy(), -0.1, "t must be"),
        (toy(), math.nan, "t must be"),
        ("7C", 0.5, "other must be"),
        (Water([800, 900], [1, 1], [1, 1], [1, 1]), 0.5, "no common wavelength"),
    ],
)
def test_mix_refuses(other: Any, t: float, words: str) -> None:
    with pytest.raises((TypeError, ValueError), match=words):
        toy().mix(other, t)


# ---- what one sees


@given(st.floats(1e-6, 1e6))
def test_visibility_is_koschmieders(beta: float) -> None:
    grey = Water(NM, [beta / 4] * 4, [beta * 3 / 4] * 4, [beta] * 4)
    assert grey.visibility() == pytest.approx(-math.log(0.02) / beta, rel=1e-12)


def test_visibility_without_attenuation_and_without_light() -> None:
    nothing = Water(NM, [0] * 4, [0] * 4, [0] * 4)
    assert nothing.visibility() == math.inf
    infrared = Water([750, 780], [2.6, 2.4], [0, 0], [2.6, 2.4])
    with pytest.raises(ValueError, match="no wavelength in 400–700 nm"):
        infrared.visibility()


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


# ---- more or less in it


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


def test_names_of_contents() -> None:
    water = Water.jerlov("II")
    assert water.with_contents(0.025843).name == "0.026·contents of II"
    assert water.with_contents(1.001).name == "II"
    assert water.with_contents(0).name == "0·contents of II"
    assert water.contents_for(0.5, math.inf) == 1
    assert water.contents_for(0.9999, 10) == 0


PURE = Water(
    WAVELENGTHS,
    jerlov.pure_water_absorption(WAVELENGTHS),
    jerlov.pure_water_scattering(WAVELENGTHS),
    jerlov.pure_water_absorption(WAVELENGTHS) + jerlov.pure_water_scattering(WAVELENGTHS) / 2,
    name="pure",
)
WIDE = Water([250, 850], [1, 2], [1, 1], [1, 2])


@pytest.mark.parametrize(
    "water, contrast, metres, message",
    [
        (Water.jerlov("II"), -0.1, 3.0, "contrast must be"),
        (Water.jerlov("II"), 0.5, math.nan, "metres must be"),
        (Water.jerlov("II"), 1.0, 3.0, "pure water in it leaves no more"),
        (PURE, 0.5, 5.0, "pure .* is but pure water"),
        (Water.jerlov("I").at(WAVELENGTHS), 0.02, 4.0, "I .* is but pure water"),
        (Water.jerlov("9C"), 0.02, 2e-308, "out of reach"),
        (WIDE, 0.02, 1.0, "250–850 nm"),
    ],
)
def test_contrasts_out_of_reach(water: Water, contrast: float, metres: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        water.with_contrast(contrast, metres)


@pytest.mark.parametrize(
    "water", [Water.jerlov("II"), Water.jerlov("5C", "williamson2022")], ids=lambda w: w.name
)
def test_derived_waters_are_waters(water: Water) -> None:
    # they skip the checks of the constructor, which copies and codec pass
    derived = [water.with_contents(factor) for factor in (0, 0.3, 20, 1000)]
    derived += [derived[2].at([450.0, 607.0]), water.mix(Water.jerlov("9C"), 0.3)]
    for before in (water, *derived):
        stored = codec.from_plain(codec.to_plain(before), Water)
        for after in (before, pickle.loads(pickle.dumps(before)), stored):
            assert after == before
            assert hash(after) == hash(before)
            assert not any(getattr(after, key).flags.writeable for key in QUANTITIES)


# ---- the Jerlov types


# Solonenko & Mobley 2015, Tables 4–8: wavelength, a, b, K_d
PRINTED = {
    "I": [(400, 0.022, 0.0062, 0.028), (450, 0.018, 0.00381, 0.022)],
    "II": [(400, 0.0355, 0.616, 0.0846), (550, 0.0622, 0.358, 0.0999), (700, 0.582, 0.238, 0.624)],
    "3C": [(550, 0.082, 1.06, 0.187), (650, 0.346, 0.8, 0.498)],
    "5C": [(300, 5.36, 3.73, 6.75), (575, 0.119, 1.23, 0.252)],
    "7C": [(500, 0.29, 2.76, 0.56), (650, 0.403, 1.77, 0.635)],
    "9C": [(400, 1.613, 5.36, 2.48), (550, 0.348, 3.12, 0.696), (700, 0.651, 2.07, 0.99)],
}
# a: Williamson & Hollins 2022; b: Solonenko & Mobley, Eq. (8) with Table 3;
# K_d: Jerlov 1976, Table XXVII
REPAIRED = {
    "3C": [(675, 0.503, 0.7542, 0.56), (700, 0.598, 0.709, 0.71)],
    "5C": [
        (600, 0.285, 1.1468, 0.40),
        (625, 0.357, 1.0702, 0.48),
        (650, 0.402, 1.0014, 0.54),
        (675, 0.557, 0.9395, 0.65),
        (700, 0.614, 0.8834, 0.80),
    ],
}
# a, b of Williamson & Hollins 2022, K_d of Jerlov 1976
MEASURED = {
    "IB": [(400, 0.0448, 0.144, 0.051), (500, 0.0398, 0.128, 0.042), (700, 0.573, 0.111, 0.58)],
    "5C": [(600, 0.285, 1.16, 0.40), (675, 0.557, 1.12, 0.65)],
}


def rows(water: Water, table: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    at = [int(np.flatnonzero(water.wavelengths == nm)[0]) for nm, *_ in table]
    return [tuple(float(getattr(water, key)[i]) for key in QUANTITIES) for i in at]


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_every_type_is_as_printed_or_repaired(type: str) -> None:
    water = Water.jerlov(type)
    np.testing.assert_array_equal(water.wavelengths, [300, 310, *range(350, 701, 25)])
    table = PRINTED.get(type, []) + REPAIRED.get(type, [])
    np.testing.assert_allclose(rows(water, table), table, rtol=1e-12)
    # energy: K_d is more than absorption, less than what leaves the beam
    assert (water.kd >= water.a).all()
    assert (water.kd <= 1.05 * water.beta).all()


@pytest.mark.parametrize("type", MEASURED)
def test_the_measured_source(type: str) -> None:
    water = Water.jerlov(type, source="williamson2022")
    np.testing.assert_array_equal(water.wavelengths, np.arange(310, 701))
    np.testing.assert_allclose(rows(water, MEASURED[type]), MEASURED[type], rtol=1e-12)
    borrowed = "K_d at 310–700 nm: Jerlov 1976, Table XXVII (not in this source)"
    assert f"Jerlov {type}: {borrowed}" in water.provenance


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("5D",), "I, IA, .*9C .*'5D'"),
        (("9C", "williamson2022"), "IB, II, III, 1C, 3C, 5C"),
        (("II", "jerlov1976"), "source must be one of .*'jerlov1976'"),
    ],
)
def test_unknown_types_and_sources(arguments: tuple[str, ...], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Water.jerlov(*arguments)


# ---- by name, contents or file


ROWS = "400,0.5,1.3,0.7\n550,0.2,1.1,0.3\n700,0.7,1.0,0.8\n"
TANK = Water([400, 550, 700], [0.5, 0.2, 0.7], [1.3, 1.1, 1.0], [0.7, 0.3, 0.8], name="tank")


@pytest.mark.parametrize(
    "header, nm, metre",
    [
        ("", 1, 1),
        ("\ufeffwavelength, a, b, kd\r\n", 1, 1),
        ("nm,Absorption,scattering,Kd(PAR)\n", 1, 1),
        ("wavelength [nm],a [1/m],b (m^-1),K_d/m⁻¹\n", 1, 1),
        ("λ/nm,a/cm⁻¹,b (cm−1),kd [ cm^{-1} ]\n", 1, 100),
        ("wavelength_um,a 1/mm,b /mm,kd per mm\n", 1000, 1000),
        ("Wavelength (µm),a [km-1],b [1/km],kd [/km]\n", 1000, 0.001),
        ("microns,a,b,kd\n", 1000, 1),
    ],
)
def test_water_from_a_file(tmp_path: Path, header: str, nm: float, metre: float) -> None:
    table = np.array([TANK.wavelengths / nm, *(getattr(TANK, n) / metre for n in ("a", "b", "kd"))])
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
    rows = zip(lake.wavelengths, lake.a, lake.beta, lake.kd, strict=True)
    texts = [",".join(repr(float(x)) for x in row) + "\n" for row in rows]
    path.write_text("nm,a,c,K_d\n" + "".join(texts))
    np.testing.assert_allclose(load_water(path).b, lake.b, rtol=1e-12)
    path.write_text("nm,a [1/m],c [1/m]\n" + "".join(x.rpartition(",")[0] + "\n" for x in texts))
    water = load_water(path)
    assert water.provenance == ("a, c: ac.csv", "b: c − a", "K_d: of a and b by Kirk 1984")
    for name in ("a", "b", "kd"):  # the model of contents takes the same K_d
        np.testing.assert_allclose(getattr(water, name), getattr(lake, name), rtol=1e-12)


@pytest.mark.parametrize(
    "text, message",
    [
        ("nm,a [dB/m],b,kd\n" + ROWS, "a in another unit"),
        ("nm,a,b [cm],kd\n" + ROWS, "b in another unit"),
        ("nm,a,b,kd (%)\n" + ROWS, "K_d in another unit"),
        ("wavenumber [1/cm],a,b,kd\n" + ROWS, "wavelength in another unit"),
        ("site,Secchi [m]\n1,5\n", "line 1: .*Without a and b"),
        ("nm,a,c\n400,.5,.4\n", "b has 1 negative"),
        ("nm,a,b,kd\n", "no rows"),
        ("nm,a,kd,b\n" + ROWS, "line 1"),
        ("nm,a,beta,kd\n" + ROWS, "line 1"),
        (ROWS + "710,1,2\n", "line 4"),
        (ROWS + "650,1,2,1\n", "650 after 700"),
    ],
)
def test_bad_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "tank.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as info:
        load_water(path)
    assert str(info.value).startswith(str(path))


def test_water_by_name_and_contents() -> None:
    assert load_water(TANK) is TANK
    for name in ("3c", "Jerlov3C", "jerlov 3C", "Jerlov-3c"):
        assert load_water(name) == Water.jerlov("3C")
    contents = {"chlorophyll": 5.0, "cdom": 0.3, "minerals": 1.5}
    water = Water.from_constituents(**contents)
    assert load_water("minerals=1.5, CDOM=.3,chlorophyll=5") == load_water(water.name) == water
    assert Water.from_constituents(**contents, name="harbour").name == "harbour"


@pytest.mark.parametrize("water", [7, "7D", "chlorophyll=1:5", "salt=3", "nowhere.csv"])
def test_no_such_water(water: Any) -> None:
    with pytest.raises((TypeError, ValueError, FileNotFoundError), match=f"{water}"):
        load_water(water)


def test_choices_of_the_command_line_are_the_waters_that_have_names() -> None:
    """It lists them without loading the library."""
    assert (JERLOV_TYPES, tuple(PLACES)) == (choices.WATERS, choices.PLACES)
    assert {load_water(name.upper()).name for name in PLACES} == {*PLACES}
