import math

import numpy as np
import pytest
import torch
from referees import reference
from refusing import refusals
from scenes import coefficients, constant, rand, uniform

from uwaug import PointSpread
from uwaug.blur.plan import plan_blur
from uwaug.blur.stack import varying_blur
from uwaug.formation.demand import BlurDemand, blur_demand
from uwaug.optics.point_spread import Law
from uwaug.optics.view import View

RANGES = [(0.9, 4.5), (0.75, 15.0), (2.0, 60.0)]


@pytest.mark.parametrize("shape", ["gaussian", "exponential"])
@pytest.mark.parametrize(
    "low, high",
    [*RANGES, (0.0, 0.5), (0.0, 4.0), (0.6, 1.0), (2.0, 2.0), (5.0, 5.0), (0.0, 200.0)],
)
@pytest.mark.parametrize("shared", [False, True])
def test_error_on_a_picture_is_the_predicted_one(shape, low, high, shared) -> None:
    image = reference.picture(160, 200)
    single = torch.from_numpy(image)[None].float()
    for tolerance in (0.01, 0.002):
        plan = plan_blur(low, high, tolerance, shape, shared=shared)
        assert plan.error <= 0.6 * tolerance
        squares = []
        for sigma in np.geomspace(max(low, 0.2), high, 7):
            exact = getattr(reference, shape)(image, sigma)
            result = constant(single, float(sigma), plan)[0]
            squares.append(float(((result.double().numpy() - exact) ** 2).mean()))
        assert math.sqrt(np.mean(squares)) <= tolerance, f"{plan}: {np.sqrt(squares)}"
        assert math.sqrt(max(squares)) <= 2.5 * tolerance


@pytest.mark.parametrize("shape", ["gaussian", "exponential"])
@pytest.mark.parametrize("low, high", [(0.0, 3.0), (0.9, 4.5), (0.75, 15.0), (2.0, 60.0)])
def test_one_blur_fewer_would_miss_the_tolerance(shape, low, high) -> None:
    # the error of a number of blurs does not depend on the tolerance it was planned for
    error = {}
    for tolerance in np.geomspace(0.5, 0.002, 70):
        plan = plan_blur(low, high, float(tolerance), shape)
        error[len(plan.sigmas)] = plan.error
    for tolerance in (0.01, 0.002):
        plan = plan_blur(low, high, tolerance, shape)
        fewer = [e for k, e in error.items() if 1 < k < len(plan.sigmas)]
        assert fewer
        assert min(fewer) > 0.48 * tolerance


def test_shared_plans_are_put_together_from_few_blurs() -> None:
    ends = [2.0 ** (n / 2) for n in range(-4, 12)]
    ranges = [(low, high) for low in ends for high in ends if low < high]
    plans = {
        shared: [plan_blur(*each, 0.004, "exponential", shared=shared) for each in ranges]
        for shared in (False, True)
    }
    widths = {shared: [s for plan in each for s in plan.sigmas] for shared, each in plans.items()}
    assert len(set(widths[True])) < len(set(widths[False])) / 8
    assert len(widths[True]) < 1.1 * len(widths[False])


def test_few_blurs_serve_a_wide_range() -> None:
    # Lagrange weights at Chebyshev nodes need 4, 7 and 9 for 60 dB; a linear interpolation in σ 8,
    # and more than 16
    assert [len(plan_blur(low, high, 0.002).sigmas) for low, high in RANGES] == [4, 7, 8]
    assert len(plan_blur(0.1, 2000.0, 0.0002).sigmas) <= 33


def test_no_blur_where_it_would_not_show() -> None:
    plan = plan_blur(0.0, 0.02)
    assert plan.sigmas == (0.0,)
    image = rand(1, 3, 8, 8)
    assert torch.equal(varying_blur(image, torch.full((1, 1, 8, 8), 0.02), plan), image)
    assert "no blur" in str(plan)


LIMITS = [
    *(((160, 200), sigma, sigma, 1e-4, "exponential") for sigma in (0.06, 0.1, 0.14)),
    # half pictures err most at narrow grids
    *(((160, 200), sigma, sigma, 1e-5, "gaussian") for sigma in (2.4, 3.3, 4.7, 6.6)),
    ((32, 32), 2.0, 20.0, 0.002, "exponential"),
    ((40, 1500), 2.0, 20.0, 0.002, "exponential"),
]


@pytest.mark.parametrize("size, low, high, tolerance, shape", LIMITS)
def test_the_tolerance_holds_at_limits(size, low, high, tolerance, shape) -> None:
    image = reference.picture(*size)
    plan = plan_blur(low, high, tolerance, shape, max(size))
    for sigma in {low, math.sqrt(low * high), high}:
        result = constant(torch.from_numpy(image)[None], sigma, plan)[0].numpy()
        error = result - getattr(reference, shape)(image, sigma)
        assert math.sqrt((error**2).mean()) <= tolerance


test_what_is_refused = refusals(
    (plan_blur, -1.0, 2.0, "sigma_min.*-1"),
    (plan_blur, 3.0, 2.0, "sigma_min.*3.0 and 2.0"),
    (plan_blur, 0.0, math.inf, "sigma_max.*inf"),
    (plan_blur, math.nan, 2.0, "sigma_min.*nan"),
    (plan_blur, 0.0, math.nan, "sigma_max.*nan"),
    (plan_blur, 0.0, 2.0, 0.0, r"tolerance.*\(0, 1\).*0"),
    (plan_blur, 0.0, 2.0, math.nan, "tolerance.*nan"),
    (plan_blur, 0.0, 2.0, 0.002, "box", "shape.*box"),
    (plan_blur, 1.0, 4.0, 0.002, "gaussian", 0.5, "longest must be finite and ≥ 1"),
    (plan_blur, 0.0, 900.0, 1e-12, "0…900 px need more than 32 blurs.*1e-12.*larger tolerance"),
    error=ValueError,
)


# ---- what a medium asks for


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
    paper = BlurDemand(2.0, 3.0, 0.01, Law("exponential", "paper"))
    expected = plan_blur(2.0 * 32 / 518, 3.0 * 144 / 518, 0.01, "exponential", 4 * 144)
    assert paper.plan_all((32, 144)) == expected
    # a picture is at least as wide as its short side, and 4 times as wide as the largest at most
    focal = BlurDemand(0.02, 0.03, 0.01, Law("exponential", "focal"), View(90.0))
    ends = 0.02 * focal.law.pixels((32, 32), View(90.0)), 0.03 * 4 * 144 / 2
    assert focal.plan_all((32, 144)) == plan_blur(*ends, 0.01, "exponential", 4 * 144)


def test_similar_media_share_a_plan() -> None:
    plans = set()
    for b_mean in np.linspace(0.7, 0.72, 9):
        demand = blur_demand(uniform(0.5, 0.2, b_mean=b_mean)(), (1.0, 6.0))
        plans.add(demand.plan((100, 100), shared=True))
    assert len(plans) <= 2
