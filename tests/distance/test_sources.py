"""What `RandomUnderwater(distance=…)` takes."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from refusing import refusals

from uwaug.distance import (
    Inverse,
    MadeUp,
    Metres,
    Network,
    Plane,
    Relative,
    along_ray,
    fill_unknown,
    from_inverse,
    from_relative,
)

NAN, INF = math.nan, math.inf
IMAGE = torch.rand(3, 2, 4)
ENDS = {"near": 1.0, "far": 3.0}
NUMBERS = {**ENDS, "gamma": 2.0, "distance": 2.5, "holds": ENDS}
T = torch.tensor([[[0.0, 0.25, 0.5, 1.0], [0.1, 0.2, 0.3, 0.4]]])


@pytest.mark.parametrize(
    "source, given, expected",
    [
        (Metres(), T + 1, T + 1),
        (Metres(), torch.full((1, 2, 4), INF), torch.full((1, 2, 4), INF)),
        (Relative(), T, from_relative(T, 1.0, 3.0, 2.0)),
        (Inverse(), T, from_inverse(T, 1.0, 3.0)),
        (Plane(), None, torch.full((1, 2, 4), 2.5)),
        (Network(lambda image: T), None, from_inverse(T, 1.0, 3.0)),
        (Network(lambda image: T + 1, Metres()), None, T + 1),
        (Metres(planar=True), T + 1, along_ray(T + 1, 2.0)),
        (Metres("far", True), T, along_ray(T, 2.0).where(T > 0, INF)),
        (Metres(planar=True), T[..., ::2, ::2] + 1, along_ray(T[..., ::2, ::2] + 1, 1.0)),
        (Network(lambda image: T + 1, Metres(planar=True)), None, along_ray(T + 1, 2.0)),
    ],
)
def test_metres(source: Any, given: Any, expected: Any) -> None:
    assert torch.equal(source.metres(given, IMAGE, NUMBERS, focal_px=2.0), expected)


HOLED = torch.tensor([[[1.0, 2.0, 0.0, NAN], [1.0, 2.0, 3.0, -1.0]]])


@pytest.mark.parametrize(
    "holes, expected",
    [
        ("far", torch.where(HOLED > 0, HOLED, INF)),
        (7.0, torch.where(HOLED > 0, HOLED, 7.0)),
        ("behind", fill_unknown(HOLED, behind=True)),
    ],
)
def test_holes(holes: Any, expected: Any) -> None:
    assert torch.equal(Metres(holes).metres(HOLED, IMAGE, {}), expected)
    relative = Relative(holes=holes).metres(torch.where(HOLED > 0, T, NAN), IMAGE, NUMBERS)
    assert bool((relative > 0).all())


def test_relative_distance_0_is_no_hole() -> None:
    z = Relative(0.0).metres(T, IMAGE, {**NUMBERS, "near": 0.0})
    assert 0 < float(z.min()) < 1e-5


def metres(source: Any, given: Any) -> Callable[[], object]:
    return lambda: source.metres(given, IMAGE, NUMBERS)


test_what_is_refused = refusals(
    (metres(Metres(), HOLED), r"NaN at 1, negative at 1 and zero at 1 of 8 pixels"),
    (metres(Metres(), 2000 * (T + 1)), "metres.*divide by 1000"),
    (metres(Metres(planar=True), T + 1), "planar maps need the camera's view: give view="),
    (metres(Metres("fill"), 0 * T), "have a known pixel"),
    (metres(Relative(), T + 1), r"t must lie in \[0, 1\]"),
    (metres(Inverse(), 0 * T), "inverse must vary"),
    (metres(Network(lambda image: T[..., 1:]), None), r"map is \(2, 3\) but image is \(2, 4\)"),
    (lambda: Metres("skip"), "holes must be one of error, fill, behind, far"),
    (lambda: Metres(0.0), "holes must be finite and > 0 m"),
    (lambda: Metres("error", "no"), "planar must be true or false, got 'no'"),
    (lambda: Relative((1, 3), (2, 5)), "near must lie below far"),
    (lambda: Relative(1, 5, 0.0), "gamma must be"),
    (lambda: Inverse((0.0, 1.0)), "near must be a number or a range .* ≥ 1e-06 m"),
    (lambda: MadeUp(1, 5, "regions"), "cue must be one of network, ramp, got 'regions'"),
    (lambda: Plane((3.0, 1.0)), "distance must be"),
    (lambda: Plane(-1.0), "distance must be"),
    (lambda: Network(len, 3.0), "holds must be a uwaug.Source"),
)


@pytest.mark.parametrize(
    "ends, metres, placed",
    [
        ((None, None), (0.7, 6.0), (0.7, 6.0)),
        ((None, None), (0.01, 0.05), (0.1, 0.2)),  # no nearer than a lens, twice as far at least
        ((None, None), (9.0, 400.0), (2.5, 50.0)),
        ((3.0, None), (0.7, 4.0), (3.0, 6.0)),
        ((None, 1.0), (0.7, 6.0), (0.5, 1.0)),
        ((2.0, 7.0), (0.7, 6.0), (2.0, 7.0)),
    ],
)
@pytest.mark.parametrize("kind", [Relative, Inverse, MadeUp])
def test_ends_are_placed_in_the_water(kind: Any, ends: Any, metres: Any, placed: Any) -> None:
    source = kind(*ends)
    assert source.has_size == (None not in ends)
    for one, wrap in ((source, lambda x: x), (Network(len, source), lambda x: {"holds": x})):
        drawn = wrap(source.drawn(lambda name: 0.5))
        for end, share in zip(ends, ("near_left", "far_left"), strict=True):
            assert (end is None) == (share in source.ranges())
        found = one.placed(drawn, lambda left: metres[left < 0.3])
        found = found.get("holds", found)
        assert (found["near"], found["far"]) == placed
    assert source.reach() == (ends if source.has_size else None)
