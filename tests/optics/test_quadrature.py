import itertools

import numpy as np
import pytest
import torch
from optical import CURVES, Z, errors
from referees import reference

from uwaug.optics.medium import Medium
from uwaug.optics.water import JERLOV_TYPES, Water

DEPTHS = (0.0, 1.0, 10.0)
SHARES = (0.0, 0.2, 1.0)
ANY = np.concatenate([Z, np.geomspace(20, 1e4, 200)])  # distances


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


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_curves_keep_the_tolerance_at_any_distance(type: str) -> None:
    water = Water.jerlov(type)
    for depth, g in itertools.product(DEPTHS, (0.02, 0.2)):
        medium = Medium.from_water(water, vertical_depth=depth, g=g)
        z = np.concatenate([np.geomspace(1e-6, 1e5, 1500), np.linspace(20, 150, 200)])
        assert max(errors(medium, water, np.sort(z), depth=depth, g=g, mu=0.3)) <= 0.002


def test_curves_of_rates_that_are_spent_within_a_millimetre() -> None:
    # all of their light is gone before a distance that anyone would look at
    water = Water([400, 700], a=[20.0, 9e3], b=[3e3, 1e3], kd=[0.1, 0.1])
    medium = Medium.from_water(water)
    z = np.geomspace(1e-7, 1.0, 2000)
    assert max(errors(medium, water, z, depth=1.0, g=0.2, mu=0.3)) <= 0.002


@pytest.mark.parametrize("seed", range(40))
def test_mixtures_of_any_visibility_keep_the_tolerance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = (Water.jerlov(type) for type in rng.choice(JERLOV_TYPES[1:], 2))
    water = one.mix(other, rng.uniform()).with_visibility(np.exp(rng.uniform(-0.5, 3)))
    drawn = {"g": rng.uniform(0.02, 1.0), "mu": rng.uniform()}
    depth, tolerance = rng.choice([0.0, 3.0, 15.0]), 10 ** rng.uniform(-5, -2)
    camera = rng.choice([reference.NIKON, "Sigma SDMerill (NPL)"])
    medium = Medium.from_water(water, camera, vertical_depth=depth, tolerance=tolerance, **drawn)
    exact = Medium.from_water(water, camera, vertical_depth=depth, tolerance=0, **drawn)
    z = torch.logspace(-5, 4, 1500, dtype=torch.float64)
    for name in CURVES:
        error = (getattr(medium, name)(z) - getattr(exact, name)(z)).abs().max()
        # between the distances that are looked at, the error may be 1 % larger
        assert error <= 1.01 * tolerance
    assert all((t >= 0).all() for t in medium.tensors())


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_no_more_rates_than_needed(type: str) -> None:
    water = Water.jerlov(type)
    media = []
    for tolerance in np.geomspace(0.3, 0.0004, 60):
        media.append(Medium.from_water(water, vertical_depth=0.0, tolerance=tolerance))
    for curves, rates in ((slice(0, 1), "beta"), (slice(1, 3), "G")):
        found = {}
        for medium in media:
            worst = max(errors(medium, water, ANY, depth=0.0, g=0.2, mu=0.3)[curves])
            found[getattr(medium, rates).shape[1]] = worst
        for tolerance in (0.002, 0.0005):
            medium = Medium.from_water(water, vertical_depth=0.0, tolerance=tolerance)
            needed = getattr(medium, rates).shape[1]
            fewer = [error for k, error in found.items() if k < needed]
            assert fewer, f"no medium with fewer than {needed} rates to compare with"
            assert min(fewer) > tolerance


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
