from dataclasses import replace

import numpy as np
import pytest
import torch
from fitted import TRUTH, medium, pair, seen, structure
from uwaug.fitting.choice import Tried, choose, held_out
from uwaug.fitting.pixels import Pair, gather, thinned
from uwaug.fitting.report import parameters_of
from uwaug.fitting.search import Search
from uwaug.fitting.solve import Problem, influence, loss, solve
from uwaug.fitting.start import best_of_starts, guess
from uwaug.fitting.threads import one_thread
from uwaug.fitting.uncertainty import limits, spread

import uwaug
from uwaug.fitting.noise import estimated

HAZE = {"G": TRUTH["beta"]}


def problem_of(known, name="haze", noise=0.01, count=2000):
    drawn = gather([pair(known)], (), count, np.random.default_rng(0))
    # dark pixels, whose noise is clipped, are left out by the truth
    lit = drawn.observed.mean(1, keepdim=True) > 0.05
    one = structure(name)
    geometry = one.geometry._replace(reference=drawn.reference)
    drawn = drawn.weighed(drawn.weights * lit / noise)
    return Problem(replace(one, geometry=geometry), drawn)


def solved(problem):
    first = problem.structure.begun(guess(problem.structure, problem.pixels), {})
    return best_of_starts(problem, [first], 0)


def test_errors_are_those_of_repetitions():
    away = []
    for seed in range(16):
        problem = problem_of(seen(medium(uwaug.PointSpread.none(), **HAZE), seed=seed))
        solution = solved(problem)
        found = parameters_of(problem, solution, spread(problem, solution))
        for kind in ("beta", "veil"):
            for c, colour in enumerate(("red", "green", "blue")):
                one = found[f"{kind}_{colour}"]
                away.append((one.value - TRUTH[kind][c]) / one.error)
    away = np.array(away)
    assert 0.75 < away.std() < 1.3
    assert abs(away.mean()) < 0.5
    assert (abs(away) < 1.96).mean() > 0.85


@pytest.fixture(scope="module")
def settled():
    problem = problem_of(seen(medium(uwaug.PointSpread.none(), **HAZE)))
    return problem, solved(problem)


def test_dependent_residuals_widen_errors(settled):
    problem, solution = settled
    before = spread(problem, solution)
    assert before.widened == pytest.approx(1.0, abs=0.3)
    # one error for all pixels of a block
    blocks = torch.from_numpy(problem.pixels.blocks)[:, None, None]
    rng = torch.Generator().manual_seed(0)
    common = 0.02 * torch.randn(int(blocks.max()) + 1, generator=rng, dtype=torch.float64)
    pixels = replace(problem.pixels, observed=problem.pixels.observed + common[blocks])
    spoilt = replace(problem, pixels=pixels)
    after = spread(spoilt, solve(spoilt, solution.theta))
    assert after.widened > 2


def test_profile_is_the_normal_interval_inside(settled):
    problem, solution = settled
    error = np.sqrt(np.diag(spread(problem, solution).covariance))
    for place in (0, 4):
        low, high = limits(problem, solution, place)
        assert not low.at_bound
        assert not high.at_bound
        assert solution.theta[place] - low.theta[place] == pytest.approx(
            1.96 * error[place], rel=0.15
        )
        assert high.theta[place] - solution.theta[place] == pytest.approx(
            1.96 * error[place], rel=0.15
        )


def test_profile_ends_at_a_bound():
    problem = problem_of(seen(medium(uwaug.PointSpread.none(), G=TRUTH["beta"], veil=(0.0,) * 3)))
    solution = solved(problem)
    error = np.sqrt(np.diag(spread(problem, solution, free=problem.free).covariance))
    place = 3 + int((solution.theta / error)[3:].argmin())  # the source of a colour
    assert solution.theta[place] < 1.9 * error[place]
    low, high = limits(problem, solution, place)
    assert low.at_bound
    assert low.theta[place] < 1e-9
    assert 0 < high.theta[place] < 0.01


def test_numbers_that_are_held_stay(settled):
    problem, solution = settled
    held = replace(problem, held={0: 0.5})
    found = solve(held, solution.theta)
    assert found.theta[0] == 0.5
    assert found.cost > solution.cost
    covariance = spread(held, found).covariance
    assert (covariance[0] == 0).all()
    assert (np.diag(covariance)[1:] > 0).all()


def test_influence_is_the_slope_of_the_loss():
    r = np.linspace(-8, 8, 33)
    step = 1e-5
    for robust in (True, False):
        slope, curvature = influence(r, robust)
        wanted = (loss(r + step, robust) - loss(r - step, robust)) / (4 * step)
        np.testing.assert_allclose(slope, wanted, atol=1e-8)
        further, _ = influence(r + step, robust)
        np.testing.assert_allclose(curvature, (further - slope) / step, atol=1e-4)


class Numbers:
    def __init__(self, count):
        self.theta = np.zeros(count)


def test_one_standard_error():
    simple = Tried(None, Numbers(3), 10 * np.array([1.0, 1.2, 0.8, 1.1]), 40)
    # better by less than its error
    middle = Tried(None, Numbers(5), 10 * np.array([1.1, 1.0, 0.8, 1.0]), 40)
    # better by far, in every block
    rich = Tried(None, Numbers(9), 10 * np.array([0.5, 0.7, 0.3, 0.6]), 40)
    assert choose([simple, middle]) is simple
    assert choose([middle, simple]) is simple
    assert choose([simple, middle, rich]) is rich
    excess, error = simple.behind(middle)
    assert excess == pytest.approx(2)
    assert error == pytest.approx(np.sqrt(4 * np.var([-1, 2, 0, 1])))
    # a loss of less than 2 is that of chance, however sure it is
    little = Tried(None, Numbers(9), simple.losses - 0.3, 40)
    assert choose([simple, little]) is simple
    assert rich.behind(rich) == (0.0, 0.0)


def test_held_out_loss_is_more_than_that_of_the_fit(settled):
    problem, solution = settled
    losses = held_out(problem, solution, 0)
    assert losses.sum() > 2 * solution.cost
    assert losses.sum() < 2.2 * solution.cost
    np.testing.assert_array_equal(losses, held_out(problem, solution, 0))


def test_noise_is_that_of_the_residuals():
    rng = torch.Generator().manual_seed(0)
    light = torch.rand(40_000, generator=rng, dtype=torch.float64)
    deviation = (0.01**2 + 4e-4 * light).sqrt()
    residual = deviation * torch.randn(light.shape, generator=rng, dtype=torch.float64)
    residual[::50] = 1.0  # outliers
    found = estimated(residual, light, light > -1, None, "linear")
    assert found.read == pytest.approx(0.01, rel=0.1)
    assert found.shot == pytest.approx(4e-4, rel=0.1)


@pytest.mark.parametrize("robust", [True, False])
def test_what_lies_far_off_has_no_weight_in_robust_fits(robust):
    problem = problem_of(seen(medium(uwaug.PointSpread.none(), **HAZE), step=4), count=500)
    observed = problem.pixels.observed.clone()
    observed[..., ::20] += 0.3  # particles
    spoilt = replace(problem.pixels, observed=observed)
    search = Search("srgb", robust, 0, {}, lambda _: None, 8)
    with one_thread():
        weights = search.weighed([problem.structure], spoilt, None)[0].weights
    assert bool((weights[..., ::20] > 0).any()) is not robust
    assert (weights > 0).double().mean() > 0.8


def test_pixels_are_spread_over_the_distances():
    z = torch.full((1, 100, 100), 2.0, dtype=torch.float64)
    z[:, :10] = torch.linspace(2.0, 6.0, 1000, dtype=torch.float64).reshape(1, 10, 100)
    colour = torch.rand(3, 100, 100, dtype=torch.float64)
    usable = torch.ones_like(z, dtype=torch.bool)
    usable[..., 50:] = False
    one = Pair(colour, colour, z, usable)
    drawn = gather([one], (), 600, np.random.default_rng(0))
    assert drawn.z.shape == (1, 1, 1, 600)
    # 500 of 5000 usable pixels lie beyond 2 m
    assert float((drawn.z > 2.1).double().mean()) > 0.4
    few = thinned(drawn, 100, np.random.default_rng(0))
    assert few.z.shape[-1] == 100
    # one pair has fewer pixels: the rest of its row has no weight
    small = Pair(colour, colour, z, usable & (z > 5.5))
    both = gather([one, small], (), 1000, np.random.default_rng(0))
    count = int((usable & (z > 5.5)).sum())
    assert int((both.weights[1, 0] > 0).sum()) == count
    assert int((both.weights[0, 0] > 0).sum()) == 500
