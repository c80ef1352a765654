import numpy as np
import pytest
from scenes import coefficients, uniform

from uwaug.blur.plan import plan_blur
from uwaug.formation.demand import BlurDemand, blur_demand
from uwaug.optics.point_spread import PointSpread


def test_demand_leaves_out_what_cannot_show() -> None:
    medium = coefficients(law=PointSpread(1.0, 1.0))
    near, far = blur_demand(medium, (0.1, 3.0)), blur_demand(medium, (0.1, 1e6))
    assert far.high < 0.7 * 1e3, "at a million metres nothing is left to be blurred"
    assert far.high > near.high
    assert blur_demand(uniform(0.4, 0.4)(), (0.1, 20.0)).high == 0
    assert blur_demand(uniform(1e4, 1e4 - 1)(), (1.0, 20.0)).high == 0
    widened = blur_demand(medium, (0.1, 3.0), margin=2.0)
    assert (widened.low, widened.high) == pytest.approx((near.low / 2, near.high * 2))


def test_a_plan_for_all_sizes_serves_pictures_four_times_as_long() -> None:
    demand = BlurDemand(2.0, 3.0, 0.01, "exponential", 96.0)
    expected = plan_blur(2.0 * 32 / 96, 3.0 * 144 / 96, 0.01, "exponential", 4 * 144)
    assert demand.plan_all((32, 144)) == expected


def test_similar_media_share_a_plan() -> None:
    plans = set()
    for b_mean in np.linspace(0.7, 0.72, 9):
        demand = blur_demand(uniform(0.5, 0.2, b_mean=b_mean)(), (1.0, 6.0))
        plans.add(demand.plan((100, 100), shared=True))
    assert len(plans) <= 2
