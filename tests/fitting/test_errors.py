"""How sure a fit is, and which model it takes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from fitted import HAZE, errors, medium, objective, seen

import uwaug
from uwaug._support.threads import one_thread
from uwaug.fitting.choose import FittedModel, cross_validated, one_standard_error_rule
from uwaug.fitting.data import _through_jpeg
from uwaug.fitting.errors import covariance_of, parameter, parameters, sandwich
from uwaug.fitting.model import Quantity
from uwaug.fitting.solve import guess, influence, loss, multistart, noise, reweighed, solve


@pytest.fixture(autouse=True)
def calmly():
    """As fits run: threads that wait for each other take 3 to 6 times as long."""
    with one_thread(), torch.no_grad():
        yield


@pytest.fixture(scope="module")
def settled(hazy):
    problem = objective(hazy)
    return problem, multistart(problem)


# ---- the rule

RATE = Quantity("beta_red", "1/m", 0.01, "beta_red")


@pytest.mark.parametrize(
    ("value", "error", "state"),
    [
        (1.0, 0.2, "free"),
        (1.0, 0.3, "not identified"),  # a lower end at .41, half of which is less
        (1.0, np.nan, "not identified"),
        (0.01, 0.009, "free"),  # less than shows
        (0.01, 0.02, "not identified"),
    ],
)
def test_one_rule_says_what_is_identified(value, error, state):
    number, bound = (parameter(RATE, value, error, at_bound=at) for at in (False, True))
    assert (number.state, bound.error) == (state, None)
    if state == "not identified":
        assert (number.value, number.error, number.low, number.high) == (None,) * 4
        assert bound.state == state
    else:
        ends = max(value - 1.96 * error, 0), value + 1.96 * error
        assert (number.low, number.high) == pytest.approx(ends)
        assert bound.state == "at bound"
    assert parameter(RATE, value, error, shows=False).state == "not identified"


# ---- covariance


def test_errors_are_those_of_repetitions():
    away = []
    for seed in range(12):
        problem = objective(seen(medium(**HAZE), seed=seed), count=600)
        solution = solve(problem, problem.model.start(guess(problem)))
        numbers, _ = parameters(problem.model, solution, covariance_of(problem, solution))
        away += errors(SimpleNamespace(parameters=numbers), kinds=("beta", "veil")).tolist()
    away = np.array(away)
    assert 0.75 < away.std() < 1.3
    assert abs(away.mean()) < 0.5
    assert (abs(away) < 1.96).mean() > 0.85


def test_errors_grow_with_what_blocks_share_and_with_the_numbers_that_were_fitted(settled):
    """By hand: H⁻¹·Σ s sᵀ·H⁻¹ over blocks, times blocks/(blocks − numbers)."""
    assert covariance_of(*settled).design_effect == pytest.approx(1.0, abs=0.3)
    random, blocks = np.random.default_rng(0), np.repeat(np.arange(12), 50)
    slopes, residual = random.normal(size=(12, 4))[blocks], random.normal(size=12)[blocks]
    inverse = np.linalg.inv(slopes.T @ slopes)
    scores = np.array([slopes[blocks == n].T @ residual[blocks == n] for n in range(12)])
    covariance = sandwich(slopes, residual, np.ones(600), blocks)
    wanted = 12 / (12 - 4) * inverse @ scores.T @ scores @ inverse
    np.testing.assert_allclose(covariance.matrix, wanted, rtol=1e-5)
    assert covariance.design_effect > 2


def test_what_does_not_show_is_not_identified(settled):
    """Two numbers that do the same, one that does nothing, and one beside them."""
    problem, solution = settled

    class Twins(SimpleNamespace):
        def jacobian(self, theta):
            one, two, *_ = problem.jacobian(theta).T
            return np.stack([one, one, 0 * one, two], 1)

    twins = Twins(residual=problem.residual, pixels=problem.pixels, model=problem.model)
    covariance = covariance_of(twins, solution)
    assert [covariance.shows(unit) for unit in np.eye(4)] == [False, False, False, True]
    assert covariance.shows(np.array([1.0, 1.0, 0.0, 0.0]))


# ---- least squares


def test_influence_is_the_slope_of_the_loss():
    r, step = np.linspace(-8, 8, 33), 1e-5
    slope, curvature = influence(r)
    np.testing.assert_allclose(slope, (loss(r + step) - loss(r - step)) / (4 * step), atol=1e-8)
    further, _ = influence(r + step)
    np.testing.assert_allclose(curvature, (further - slope) / step, atol=1e-4)


def test_far_starts_meet(known):
    problem = objective(known, "gaussian", 1000, gain=True)
    rng = np.random.default_rng(3)
    costs = []
    for seed in range(3):
        away = {name: x * np.exp(rng.uniform(-1, 1)) for name, x in guess(problem).items()}
        costs.append(multistart(problem, [away], seed).cost)
    assert max(costs) < min(costs) * (1 + 1e-4)


# ---- noise


def test_noise_is_that_of_the_residuals():
    rng = torch.Generator().manual_seed(0)
    light = torch.rand(40_000, generator=rng, dtype=torch.float64)
    deviation = (0.01**2 + 4e-4 * light).sqrt()
    residual = deviation * torch.randn(light.shape, generator=rng, dtype=torch.float64)
    residual[::50] = 1.0  # outliers
    torch.testing.assert_close(noise(residual, light, light > -1), deviation, rtol=0.1, atol=0.0)


def test_what_lies_far_off_has_no_weight(settled):
    problem, solution = settled
    observed = problem.pixels.observed.clone()
    observed[..., ::20] += 0.3  # particles
    spoilt = replace(problem, pixels=replace(problem.pixels, observed=observed))
    weights = reweighed(spoilt, solution.theta, clips=True)[0].weights
    assert not (weights[..., ::20] > 0).any()
    assert (weights > 0).double().mean() > 0.8


# ---- choice


def candidate(count, losses):
    return FittedModel(None, SimpleNamespace(theta=np.zeros(count)), 10 * np.array(losses))


def test_one_standard_error():
    simple = candidate(3, [1.0, 1.2, 0.8, 1.1])
    middle = candidate(5, [1.1, 1.0, 0.8, 1.0])  # better by less than its error
    rich = candidate(9, [0.5, 0.7, 0.3, 0.6])  # better by far, in every block
    assert one_standard_error_rule([middle, simple]) is simple
    assert one_standard_error_rule([simple, middle, rich]) is rich
    error = np.sqrt(4 * np.var([-1, 2, 0, 1]))
    assert simple.behind(middle) == pytest.approx((2, error))
    # a loss of less than 2 is that of chance, however sure it is
    little = candidate(9, simple.losses / 10 - 0.03)
    assert one_standard_error_rule([simple, little]) is simple


def test_held_out_loss_is_more_than_that_of_the_fit(settled):
    problem, solution = settled
    fitted = cross_validated(problem, solution, 0)
    assert 2 * solution.cost < fitted.loss < 2.2 * solution.cost
    np.testing.assert_array_equal(fitted.losses, cross_validated(problem, solution, 0).losses)


def test_what_jpeg_loses_is_part_of_the_errors():
    rng = torch.Generator().manual_seed(0)
    patches = torch.rand(1, 3, 15, 20, generator=rng)
    clean = torch.nn.functional.interpolate(patches, scale_factor=4, mode="bilinear")[0]
    z, rates = torch.linspace(1, 5, 60 * 80).reshape(1, 60, 80), (0.5, 0.2, 0.3)
    water = uwaug.Medium.from_coefficients(rates, rates, (0.1, 0.3, 0.4))
    values = (255 * uwaug.Underwater(water)(clean, z)).round().to(torch.uint8)
    values = _through_jpeg(values, 95)
    options = {"model": "haze", "gain": "fixed", "progress": False}
    known, unknown = (uwaug.fit(clean, values, z, jpeg=jpeg, **options) for jpeg in (95, None))
    for name, rate in zip(("beta_red", "beta_green", "beta_blue"), rates, strict=True):
        number = known.parameters[name]
        assert number.low <= rate <= number.high
        assert number.error > 0.95 * unknown.parameters[name].error
    assert known.errors["beta_green"] > 1.2 * unknown.errors["beta_green"]
