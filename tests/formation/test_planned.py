import math

import pytest
from degrading import coastal

from uwaug import PointSpread, Underwater
from uwaug.formation.demand import EVERY_SIDE


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"sides": (64, 32)}, ValueError, r"sides must be whole numbers, 1 ≤ smallest ≤ largest"),
        ({"sides": (0, 32)}, ValueError, r"sides must be .*, got \(0, 32\)"),
        ({"sides": (32, 1e6)}, ValueError, r"≤ 16384 px, got \(32, 1000000.0\)"),
        ({"sides": (32, 64.5)}, ValueError, r"sides must be whole numbers"),
        ({"sides": (32, math.nan)}, ValueError, r"sides must be whole numbers"),
        ({"sides": 512}, TypeError, r"sides must be \(smallest, largest\) .*, got 512"),
        ({"sides": ()}, TypeError, r"sides must be \(smallest, largest\) .*, got \(\)"),
        ({"sides": ("a", "b")}, TypeError, r"sides must be \(smallest, largest\)"),
        ({"distance_range": 5.0}, TypeError, r"distance_range must be .* in metres, got 5\.0"),
        ({"distance_range": (1, 2, 3)}, TypeError, r"distance_range must be .* got \(1, 2, 3\)"),
        ({"distance_range": None, "sides": (32, 64)}, ValueError, "sides need a distance_range"),
    ],
)
def test_wrong_ranges(change, error, message):
    with pytest.raises(error, match=message):
        Underwater(coastal(), **change)


def test_with_sides_pictures_of_all_sizes_share_a_plan():
    medium = coastal(point_spread=PointSpread.paper(0.8))
    degrade = Underwater(medium, sides=(32, 700))
    plans = {degrade.plan(size) for size in ((1, 1), (33, 40), (700, 900), (3000, 4000))}
    assert plans == {degrade.demand.plan_all((32, 700))}
    assert "for short sides of 32…700 px" in repr(degrade)
    sized = Underwater(medium)
    assert sized.sides is None
    assert sized.plan((33, 40)) != sized.plan((700, 900))


@pytest.mark.parametrize("law", [PointSpread(40.0, 0.5), PointSpread.none()])
def test_a_law_that_knows_no_size_has_one_plan_anyway(law):
    degrade = Underwater(coastal(point_spread=law))
    assert degrade.sides == EVERY_SIDE
    assert degrade.plan((1, 1)) == degrade.plan((4000, 6000))
    # an exponential shape asks for no blurs much wider than the picture
    assert Underwater(coastal(point_spread=PointSpread.calibrated(60.0))).sides is None
