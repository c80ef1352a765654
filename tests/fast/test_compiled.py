"""Functions on small arrays: as compiled and as they are."""

from typing import Any

import numpy as np
import pytest

from uwaug import Water
from uwaug._support.compiled import compiled
from uwaug.formation import demand
from uwaug.optics import quadrature, water
from uwaug.optics.reduction import default_bands

pytest.importorskip("numba")


@compiled
def _twice(x: float) -> float:
    return 2 * x


@compiled
def _sum_of_twice(values: np.ndarray) -> float:
    total = 0.0
    for value in values:
        total += _twice(value)
    return total


def test_compiled_functions_call_each_other() -> None:
    values = np.arange(5.0)
    assert _sum_of_twice(values) == _sum_of_twice.function(values) == _sum_of_twice.loop(values)


@pytest.mark.parametrize("tolerance", [0.02, 0.002, 1e-5])
@pytest.mark.parametrize("name", ["I", "5C", "9C"])
def test_quadrature(name: str, tolerance: float) -> None:
    spectra = Water.jerlov(name).at(default_bands(Water.jerlov(name)))
    weights = np.random.default_rng(0).normal(0.02, 0.02, (6, 61))
    weights[3:] = np.abs(weights[3:])
    z = quadrature.distances_of(spectra.beta)
    case = spectra.beta, weights, z, weights @ np.exp(-spectra.beta[:, None] * z), tolerance
    require_the_same(quadrature._reduced, case, rtol=1e-5, atol=1e-7)


def test_demand_and_contents() -> None:
    rng = np.random.default_rng(1)
    rates, weights = rng.uniform(0.05, 1, (2, 3)), rng.normal(0, 0.3, (2, 9, 3))
    scattered = rates, weights, rates / 2, np.abs(weights), 0.3, 9.0, 0.002, False
    require_the_same(demand._scattered, scattered)
    for contrast in (0.1, 0.3):  # of which one lasts to infinity
        case = contrast, np.full(4, 0.25), np.array([0.0, 0.1, 0.5, 2.0])
        require_the_same(water._distance_to, case)


def require_the_same(function: Any, case: tuple[Any, ...], rtol: float = 1e-9, atol: float = 0.0):
    pairs = [function.loop(*case), function.function(*case)]
    ours, theirs = (pair if isinstance(pair, tuple) else (pair,) for pair in pairs)
    for value, wanted in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(value, wanted, rtol, atol)
