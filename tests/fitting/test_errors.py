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
from uwaug.fitting.errors import covariance_of, parameter, parameters
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
    number = parameter(RATE, value, error)
    assert number.state == state
    bound = parameter(RATE, value, error, at_bound=True)
    assert bound.error is None
    if state == "not identified":
        assert (number.value, number.error, number.low, number.high) == (None,) * 4
        assert bound.state == state
    else:
        wanted = (max(value - 1.96 * error, 0), value + 1.96 * error)
        assert (number.low, number.high) == pytest.approx(wanted)
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


def test_dependent_residuals_widen_errors(settled):
    problem, solution = settled
    assert covariance_of(problem, solution).design_effect == pytest.approx(1.0, abs=0.3)
    # one error for all pixels of a block
    blocks = torch.from_numpy(problem.pixels.blocks)
    rng = torch.Generator().manual_seed(0)
    common = 0.02 * torch.randn(int(blocks.max()) + 1, generator=rng, dtype=torch.float64)
    pixels = replace(problem.pixels, observed=problem.pixels.observed + common[blocks])
    spoilt = replace(problem, pixels=pixels)
    assert covariance_of(spoilt, solve(spoilt, solution.theta)).design_effect > 2


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
    weighed, _ = reweighed(spoilt, solution.theta, clips=True)
    assert not (weighed.weights[..., ::20] > 0).any()
    assert (weighed.weights > 0).double().mean() > 0.8


# ---- choice


def candidate(count, losses):
    return FittedModel(None, SimpleNamespace(theta=np.zeros(count)), 10 * np.array(losses))


def test_one_standard_error():
    simple = candidate(3, [1.0, 1.2, 0.8, 1.1])
    # better by less than its error
    middle = candidate(5, [1.1, 1.0, 0.8, 1.0])
    # better by far, in every block
    rich = candidate(9, [0.5, 0.7, 0.3, 0.6])
    assert one_standard_error_rule([simple, middle]) is simple
    assert one_standard_error_rule([middle, simple]) is simple
    assert one_standard_error_rule([simple, middle, rich]) is rich
    excess, error = simple.behind(middle)
    assert excess == pytest.approx(2)
    assert error == pytest.approx(np.sqrt(4 * np.var([-1, 2, 0, 1])))
    # a loss of less than 2 is that of chance, however sure it is
    little = candidate(9, simple.losses / 10 - 0.03)
    assert one_standard_error_rule([simple, little]) is simple


def test_held_out_loss_is_more_than_that_of_the_fit(settled):
    problem, solution = settled
    fitted = cross_validated(problem, solution, 0)
    assert 2 * solution.cost < fitted.loss < 2.2 * solution.cost
    np.testing.assert_array_equal(fitted.losses, cross_validated(problem, solution, 0).losses)


@pytest.mark.parametrize("jpeg", [None, 95])
def test_what_a_file_loses_is_part_of_the_errors(jpeg):
    rng = torch.Generator().manual_seed(0)
    clean = torch.nn.functional.interpolate(
        torch.rand(1, 3, 15, 20, generator=rng), scale_factor=4, mode="bilinear"
    )[0]
    z = torch.linspace(1, 5, 60 * 80).reshape(1, 60, 80)
    rates = (0.5, 0.2, 0.3)
    observed = uwaug.Underwater(uwaug.Medium.from_coefficients(rates, rates, (0.1, 0.3, 0.4)))(
        clean, z
    )
    values = (255 * observed).round().to(torch.uint8)
    if jpeg is not None:
        values = _through_jpeg(values, jpeg)
    options = {"model": "haze", "gain": "fixed", "progress": False}
    known = uwaug.fit(clean, values, z, jpeg=jpeg, **options)
    # as if it were a file without loss: values between the levels
    between = (values / 255 + 2e-5).clamp(max=1)
    unknown = uwaug.fit(clean, between, z, **options)
    for name, rate in zip(("beta_red", "beta_green", "beta_blue"), rates, strict=True):
        number = known.parameters[name]
        assert number.low <= rate <= number.high
        assert number.error > 0.95 * unknown.parameters[name].error
    if jpeg is not None:
        assert known.errors["beta_green"] > 1.2 * unknown.errors["beta_green"]
        with pytest.raises(ValueError, match="jpeg must be"):
            uwaug.fit(clean, values, z, jpeg=0, **options)
