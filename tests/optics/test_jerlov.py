import warnings

import jerlov
import numpy as np
import pytest
from optical import values

from uwaug.optics.water import JERLOV_TYPES, Water

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


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_every_type_is_complete(type):
    water = Water.jerlov(type)
    assert water.name == type
    np.testing.assert_array_equal(water.wavelengths, [300, 310, *range(350, 701, 25)])
    for nm, *expected in PRINTED.get(type, []) + REPAIRED.get(type, []):
        assert values(water, nm) == pytest.approx(expected, rel=1e-12)
    # energy: K_d is more than absorption, less than what leaves the beam
    assert (water.kd >= water.a).all()
    assert (water.kd <= 1.05 * water.beta).all()


def test_types_are_those_of_the_package():
    assert jerlov.SOURCES["solonenko2015"].water_types == JERLOV_TYPES


def test_provenance_names_what_was_repaired():
    note = "misprinted in Solonenko & Mobley 2015, Table 7)"
    for type, where in (("3C", "675–700"), ("5C", "600–700")):
        provenance = Water.jerlov(type).provenance
        assert f"Jerlov {type}: b: Solonenko & Mobley 2015, doi:10.1364/AO.54.005392" in provenance
        assert f"Jerlov {type}: a at {where} nm: Williamson & Hollins 2022 ({note}" in provenance
        assert f"Jerlov {type}: K_d at {where} nm: Jerlov 1976, Table XXVII ({note}" in provenance
        rebuilt = f"Jerlov {type}: b at {where} nm: reconstructed from Eq. (8)"
        assert any(s.startswith(rebuilt) for s in provenance)
    assert len(Water.jerlov("II").provenance) == 3
    assert any("b at 300–700 nm: suspect" in s for s in Water.jerlov("I").provenance)


# wavelength, a, b of Williamson & Hollins 2022 and K_d of Jerlov 1976
MEASURED = {
    "IB": [(400, 0.0448, 0.144, 0.051), (500, 0.0398, 0.128, 0.042), (700, 0.573, 0.111, 0.58)],
    "5C": [(600, 0.285, 1.16, 0.40), (675, 0.557, 1.12, 0.65)],
}


@pytest.mark.parametrize("type", ["IB", "II", "III", "1C", "3C", "5C"])
def test_measured_source(type):
    water = Water.jerlov(type, source="williamson2022")
    np.testing.assert_array_equal(water.wavelengths, np.arange(310, 701))
    for nm, a, b, kd in MEASURED.get(type, []):
        assert values(water, nm) == pytest.approx((a, b, kd), rel=1e-12)
    extrapolated = "a at 310–411 nm: extrapolated by the paper's model (measured at 412–715 nm)"
    borrowed = "K_d at 310–700 nm: Jerlov 1976, Table XXVII (not in this source)"
    assert f"Jerlov {type}: {extrapolated}" in water.provenance
    assert f"Jerlov {type}: {borrowed}" in water.provenance
    assert len(water.provenance) == 5


def test_warnings_of_the_package_stay_inside_and_come_back_on():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Water.jerlov("5C")
        assert caught == []
        jerlov.water("5C", source="solonenko2015").a(600)
        assert [w.category for w in caught] == [jerlov.ProvenanceWarning]


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("5D",), r"type must be one of I, IA, .*9C with source 'solonenko2015', got '5D'"),
        ((5,), "got 5"),
        (
            ("9C", "williamson2022"),
            "type must be one of IB, II, III, 1C, 3C, 5C with source 'williamson2022', got '9C'",
        ),
        (
            ("II", "jerlov1976"),
            "source must be one of solonenko2015, williamson2022, got 'jerlov1976'",
        ),
    ],
)
def test_unknown_type_or_source(arguments, message):
    with pytest.raises(ValueError, match=message):
        Water.jerlov(*arguments)
