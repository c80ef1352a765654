"""How sure a fit is, and which model it takes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from fitted import HAZE, STONES, errors, medium, objective, seen, veil_water, veiled

import uwaug
import uwaug.fitting.errors
from uwaug.fitting.data import Observations
from uwaug.fitting.errors import cluster_covariance, parameter, parameters, profile_interval
from uwaug.fitting.least_squares import (
    influence,
    loss,
    multistart,
    one_thread,
    solve,
    starting_points,
)
from uwaug.fitting.models import Quantity
from uwaug.fitting.noise import Noise, estimate_noise, reweight
from uwaug.fitting.selection import FittedModel, cross_validate, one_standard_error_rule

CLEAR = {**HAZE, "veil": (0.0,) * 3}


def solved(problem):
    return multistart(problem, starting_points(problem), 0)


@pytest.fixture(scope="module")
def settled(hazy):
    problem = objective(hazy)
    return problem, solved(problem)


# ---- the rule

RATE = Quantity("beta_red", "1/m", 0.01, ("beta_red",))


@pytest.mark.parametrize(
    ("value", "error", "profile", "state"),
    [
        (1.0, 0.2, (), "free"),
        (1.0, 0.3, (), "not identified"),  # a lower end at .41, half of which is less
        (1.0, np.nan, (), "not identified"),
        (0.01, 0.009, (), "free"),  # less than shows
        (0.01, 0.02, (), "not identified"),
        (1.0, 0.01, (0.2, 5.0), "not identified"),  # the profile counts
        (1.0, 9.0, (0.9, 1.2), "free"),
        (-0.5, 0.01, (), "free"),
    ],
)
def test_one_rule_says_what_is_identified(value, error, profile, state):
    number = parameter(RATE, value, error, profile)
    assert number.state == state
    if state == "not identified":
        assert (number.value, number.error, number.low, number.high) == (None,) * 4
    elif not profile and value > 0:
        assert (number.low, number.high) == pytest.approx(
            (max(value - 1.96 * error, 0), value + 1.96 * error)
        )
    bound = parameter(RATE, value, error, profile, at_bound=True)
    assert bound.state == ("at bound" if state == "free" else state)
    assert bound.error is None
    assert parameter(RATE, value, error, profile, shows=False).state == "not identified"


def test_a_number_that_may_be_negative_keeps_both_ends() -> None:
    """Half a picture's tilt is −.01 ± .02: its interval was −.01 … .03."""
    tilt = Quantity("down", "1", 0.02, ("down",), signed=True)
    number = parameter(tilt, -0.01, 0.02)
    assert (number.low, number.high) == pytest.approx((-0.0492, 0.0292))


def test_no_door_reports_what_another_would_not():
    """A veil that has hardly begun to bend: `fit_veil` reported errors of up to half of it."""
    reported = []
    for G in (0.05, 0.07, 0.1, 0.14):
        fit = uwaug.fitting.fit_veil(veiled(veil_water(G=(G,) * 3)), STONES, darkest=0.0)
        reported += [number for number in fit.parameters.values() if number.value is not None]
    assert len(reported) > 12
    assert max(number.error / number.value for number in reported) < 0.2526


# ---- covariance and profiles


def test_errors_are_those_of_repetitions():
    away = []
    for seed in range(16):
        problem = objective(seen(medium(**HAZE), seed=seed), count=600)
        solution = solve(problem, starting_points(problem)[0])
        numbers = parameters(problem, solution, cluster_covariance(problem, solution))
        away += errors(SimpleNamespace(parameters=numbers), kinds=("beta", "veil")).tolist()
    away = np.array(away)
    assert 0.75 < away.std() < 1.3
    assert abs(away.mean()) < 0.5
    assert (abs(away) < 1.96).mean() > 0.85


def test_dependent_residuals_widen_errors(settled):
    problem, solution = settled
    assert cluster_covariance(problem, solution).design_effect == pytest.approx(1.0, abs=0.3)
    # one error for all pixels of a cluster
    clusters = torch.from_numpy(problem.pixels.clusters)[:, None, None]
    rng = torch.Generator().manual_seed(0)
    common = 0.02 * torch.randn(int(clusters.max()) + 1, generator=rng, dtype=torch.float64)
    pixels = replace(problem.pixels, observed=problem.pixels.observed + common[clusters])
    spoilt = replace(problem, pixels=pixels)
    assert cluster_covariance(spoilt, solve(spoilt, solution.theta)).design_effect > 2


def test_uneven_light_widens_errors_over_large_clusters(hazy):
    clean, observed, z = hazy
    (pair,) = Observations.of(clean, observed, z).pairs
    rows, columns = pair.size
    y, x = torch.meshgrid(torch.linspace(0, 7, rows), torch.linspace(0, 10, columns), indexing="ij")
    uneven = 1 + 0.06 * torch.sin(x) * torch.sin(y)  # over a third of the picture
    problem = objective(hazy)
    observed = Observations((pair._replace(observed=pair.observed * uneven),), "srgb", 8, "m")
    drawn = observed.sample_pixels((), 2000, 0)
    problem = replace(problem, pixels=drawn.weighed(drawn.weights / 0.01))
    solution = solved(problem)
    wide = cluster_covariance(problem, solution).design_effect
    fine = replace(problem, pixels=replace(problem.pixels, others=()))
    fine = cluster_covariance(fine, solution).design_effect
    assert wide > 1.2 * fine
    assert fine > 1.2


def test_profile_is_the_normal_interval_inside(settled):
    problem, solution = settled
    covariance = cluster_covariance(problem, solution)
    error = np.sqrt(np.diag(covariance.matrix))
    for place in (0, 4):
        for end in profile_interval(problem, solution, covariance, place):
            half = abs(end[place] - solution.theta[place])
            assert half == pytest.approx(1.96 * error[place], rel=0.15)


def test_profile_ends_at_a_bound():
    problem = objective(seen(medium(**CLEAR)))
    solution = solved(problem)
    everything = cluster_covariance(problem, solution, free=problem.free)
    error = np.sqrt(np.diag(everything.matrix))
    place = 3 + int((solution.theta / error)[3:].argmin())  # the source of a colour
    assert solution.theta[place] < 1.9 * error[place]
    low, high = profile_interval(problem, solution, everything, place)
    assert low[place] < 1e-9
    assert 0 < high[place] < 0.01


def test_a_covariance_is_computed_once_for_all_profiles(monkeypatch):
    problem = objective(seen(medium(**CLEAR)))
    solution = solved(problem)
    covariance, computed = cluster_covariance(problem, solution), []

    def counted(*arguments, **options):
        computed.append(arguments)
        return cluster_covariance(*arguments, **options)

    monkeypatch.setattr(uwaug.fitting.errors, "cluster_covariance", counted)
    numbers = parameters(problem, solution, covariance)
    assert sum(number.low == 0 for number in numbers.values()) > 1
    assert len(computed) == 1


def test_numbers_that_are_held_stay(settled):
    problem, solution = settled
    held = replace(problem, held={0: 0.5})
    end = solve(held, solution.theta)
    assert end.theta[0] == 0.5
    assert end.cost > solution.cost
    covariance = cluster_covariance(held, end).matrix
    assert (covariance[0] == 0).all()
    assert (np.diag(covariance)[1:] > 0).all()


# ---- least squares


def test_influence_is_the_slope_of_the_loss():
    r = np.linspace(-8, 8, 33)
    step = 1e-5
    slope, curvature = influence(r)
    wanted = (loss(r + step) - loss(r - step)) / (4 * step)
    np.testing.assert_allclose(slope, wanted, atol=1e-8)
    further, _ = influence(r + step)
    np.testing.assert_allclose(curvature, (further - slope) / step, atol=1e-4)


def test_far_starts_meet(known):
    problem = objective(known, "gaussian", 1000)
    first = starting_points(problem)[0]
    rng = np.random.default_rng(3)
    costs = []
    for _ in range(5):
        start = np.clip(first * np.exp(rng.uniform(-1, 1, len(first))), *problem.bounds)
        costs.append(multistart(problem, [start], 0, more=0).cost)
    assert max(costs) < min(costs) * (1 + 1e-4)


# ---- noise


def test_the_noise_is_a_value():
    light = torch.tensor([0.0, 1.0])
    deviation = Noise(read=0.01, shot=1e-4, bits=None).deviation(light, "srgb")
    torch.testing.assert_close(deviation, torch.tensor([1e-4, 2e-4]).sqrt(), rtol=1e-6, atol=0.0)
    rounded = Noise(0.0, 0.0).deviation(torch.tensor([0.5]), "linear")
    assert float(rounded) == pytest.approx(1 / 255 / 12**0.5, rel=1e-5)
    with pytest.raises(ValueError, match=r"Noise\.read must be in \[0, 1\], got -1"):
        Noise(-1)


def test_noise_is_that_of_the_residuals():
    rng = torch.Generator().manual_seed(0)
    light = torch.rand(40_000, generator=rng, dtype=torch.float64)
    deviation = (0.01**2 + 4e-4 * light).sqrt()
    residual = deviation * torch.randn(light.shape, generator=rng, dtype=torch.float64)
    residual[::50] = 1.0  # outliers
    noise = estimate_noise(residual, light, light > -1, None, "linear")
    assert noise.read == pytest.approx(0.01, rel=0.1)
    assert noise.shot == pytest.approx(4e-4, rel=0.1)


def test_what_lies_far_off_has_no_weight(settled, hazy):
    problem, solution = settled
    observations = Observations.of(*hazy)
    pixels = observations.sample_pixels((), 500, 0)
    observed = pixels.observed.clone()
    observed[..., ::20] += 0.3  # particles
    pixels = replace(pixels, observed=observed)
    with one_thread():
        weighed, _, _ = reweight(problem.model, solution.theta, pixels, None, observations)
    assert not (weighed.weights[..., ::20] > 0).any()
    assert (weighed.weights > 0).double().mean() > 0.8


# ---- selection


def candidate(count, losses):
    return FittedModel(None, SimpleNamespace(theta=np.zeros(count)), 10 * np.array(losses), 40)


def test_one_standard_error():
    simple = candidate(3, [1.0, 1.2, 0.8, 1.1])
    # better by less than its error
    middle = candidate(5, [1.1, 1.0, 0.8, 1.0])
    # better by far, in every cluster
    rich = candidate(9, [0.5, 0.7, 0.3, 0.6])
    assert one_standard_error_rule([simple, middle]) is simple
    assert one_standard_error_rule([middle, simple]) is simple
    assert one_standard_error_rule([simple, middle, rich]) is rich
    excess, error = simple.delta_loss(middle)
    assert excess == pytest.approx(2)
    assert error == pytest.approx(np.sqrt(4 * np.var([-1, 2, 0, 1])))
    # a loss of less than 2 is that of chance, however sure it is
    little = candidate(9, simple.losses / 10 - 0.03)
    assert one_standard_error_rule([simple, little]) is simple
    assert rich.delta_loss(rich) == (0.0, 0.0)


def test_held_out_loss_is_more_than_that_of_the_fit(settled):
    problem, solution = settled
    losses = cross_validate(problem, solution, 0)
    assert losses.sum() > 2 * solution.cost
    assert losses.sum() < 2.2 * solution.cost
    np.testing.assert_array_equal(losses, cross_validate(problem, solution, 0))
