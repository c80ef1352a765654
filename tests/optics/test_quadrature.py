import itertools

import numpy as np
import pytest
from optical import errors

from uwaug.optics.medium import Medium
from uwaug.optics.water import JERLOV_TYPES, Water

DEPTHS = (0.0, 1.0, 10.0)
SHARES = (0.0, 0.2, 1.0)


@pytest.mark.parametrize("type", JERLOV_TYPES)
@pytest.mark.parametrize("tolerance", [0.01, 0.002, 0.0005])
def test_curves_keep_the_tolerance(type: str, tolerance: float) -> None:
    water = Water.jerlov(type)
    worst = {}
    for depth, g in itertools.product(DEPTHS, SHARES):
        medium = Medium.from_water(water, vertical_depth=depth, g=g, mu=0.3, tolerance=tolerance)
        worst[depth, g] = max(errors(medium, water, depth=depth, g=g, mu=0.3))
    missed = {case: error for case, error in worst.items() if error > tolerance}
    assert max(worst.values()) <= tolerance, missed


@pytest.mark.parametrize("type", ["I", "II", "9C"])
@pytest.mark.parametrize(
    "span", [(0.0, 0.5), (0.0, 200.0), (0.0, 1000.0), (5.0, 6.0), (3.0, 80.0)], ids=str
)
def test_curves_keep_the_tolerance_over_any_range(type: str, span: tuple[float, float]) -> None:
    water = Water.jerlov(type)
    medium = Medium.from_water(water, vertical_depth=0.0, distance_range=span)
    z = np.geomspace(max(span[0], 1e-3), span[1], 600)
    assert max(errors(medium, water, z, depth=0.0, g=0.2, mu=0.3)) <= 0.002


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_no_tolerance_keeps_all_bands(type: str) -> None:
    water = Water.jerlov(type)
    medium = Medium.from_water(water, vertical_depth=10.0, g=0.2, mu=0.3, tolerance=0)
    assert medium.beta.shape == (1, 61)
    assert max(errors(medium, water, depth=10.0, g=0.2, mu=0.3)) < 1e-14


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_no_more_rates_than_needed(type: str) -> None:
    water = Water.jerlov(type)
    media = []
    for tolerance in np.geomspace(0.3, 0.0004, 60):
        media.append(Medium.from_water(water, vertical_depth=0.0, tolerance=tolerance))
    for curves, rates in ((slice(0, 1), "beta"), (slice(1, 3), "G")):
        found = {}
        for medium in media:
            worst = max(errors(medium, water, depth=0.0, g=0.2, mu=0.3)[curves])
            found[getattr(medium, rates).shape[1]] = worst
        for tolerance in (0.002, 0.0005):
            medium = Medium.from_water(water, vertical_depth=0.0, tolerance=tolerance)
            needed = getattr(medium, rates).shape[1]
            fewer = [error for k, error in found.items() if k < needed]
            assert fewer, f"no medium with fewer than {needed} rates to compare with"
            assert min(fewer) > tolerance


def test_the_water_decides_how_much_to_model() -> None:
    rates = {t: Medium.from_water(Water.jerlov(t), vertical_depth=0.0) for t in JERLOV_TYPES}
    assert all(len(m.beta[0]) <= 6 and len(m.G[0]) <= 7 for m in rates.values())
    assert len(rates["II"].beta[0]) < len(rates["I"].beta[0])


def test_a_water_that_absorbs_in_part_of_the_spectrum_only() -> None:
    a, b, kd = [0, 0, 0.1, 0.3], [0.3, 0.2, 0.2, 0.2], [0.1, 0.1, 0.2, 0.3]
    water = Water([400, 500, 600, 700], a, b, kd)
    medium = Medium.from_water(water, g=0.0)
    assert max(errors(medium, water, depth=1.0, g=0.0, mu=0.3)) <= 0.002


def test_the_error_in_the_repr_is_the_error() -> None:
    water = Water.jerlov("9C")
    medium = Medium.from_water(water, tolerance=0.0005)
    claimed = float(repr(medium).split("within ")[1].split()[0])
    assert max(errors(medium, water, depth=1.0, g=0.2, mu=0.3)) <= 1.1 * claimed
