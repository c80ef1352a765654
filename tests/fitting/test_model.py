import numpy as np
import pytest
import torch
from fitted import medium, pixels, seen, structure
from uwaug.fitting.model import rendered
from uwaug.fitting.solve import Problem
from uwaug.fitting.structure import MODELS

import uwaug
from uwaug.blur.plan import plan_blur
from uwaug.blur.stack import node_slopes, node_weights

# of torch's own forward mode
pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")


@pytest.fixture(scope="module")
def drawn():
    return pixels(seen(medium()))


def middle(one, seed=0):
    factor = np.random.default_rng(seed).uniform(0.7, 1.3, len(one.bounds))
    return np.array([bound.begin for bound in one.bounds.values()]) * factor


@pytest.mark.parametrize("name", MODELS)
def test_slopes_are_those_of_forward_mode(drawn, name):
    one = structure(name)
    problem = Problem(one, drawn)
    theta = middle(one)

    def model(numbers):
        return (drawn.weights * (rendered(one.natural(numbers), drawn, one.shape))).flatten()

    wanted = torch.func.jacfwd(model)(torch.from_numpy(theta)).numpy()
    residual, jacobian = problem.linearised(theta)
    np.testing.assert_allclose(jacobian, wanted, atol=1e-12 * abs(wanted).max())
    np.testing.assert_allclose(residual, problem.residual(theta), atol=1e-13)


def test_slopes_near_no_attenuation(drawn):
    one = structure("gaussian")
    theta = middle(one)
    theta[3:6] = [0.0, 1e-6, 1e-3]  # G/β

    def model(numbers):
        return rendered(one.natural(numbers), drawn, one.shape)

    wanted = torch.func.jacfwd(model)(torch.from_numpy(theta))
    _, found = Problem(one, drawn).linearised(theta)
    assert np.isfinite(found).all()
    # at a G of exactly 0 the formula is clamped, and autograd has no slope there
    np.testing.assert_allclose(
        found.reshape(1, 3, 1, -1, 11)[0, 1:, ..., 4:6], wanted[0, 1:, ..., 4:6], atol=1e-8
    )


@pytest.mark.parametrize("shape", ["gaussian", "exponential"])
def test_slopes_of_the_weights(shape):
    plan = plan_blur(0.0, 30.0, 0.002, shape)
    sigma = torch.linspace(0.0, 40.0, 300, dtype=torch.float64).reshape(1, 1, 1, -1)
    sigma.requires_grad_()
    weights = node_weights(sigma, plan)
    rows = [torch.autograd.grad(row.sum(), sigma, retain_graph=True)[0] for row in weights[0]]
    wanted, sigma = torch.cat(rows, 1), sigma.detach()
    inside = (sigma > 0) & (sigma < 30)
    found = node_slopes(sigma, plan)
    torch.testing.assert_close(found * inside, wanted * inside, atol=1e-12, rtol=1e-10)
    assert found[..., -1].abs().max() == 0
    no_blur = plan_blur(0.0, 0.0)
    assert node_slopes(sigma, no_blur).abs().max() == 0


def test_pixels_are_those_of_the_image():
    water = medium()
    known = seen(water, noise=0.0)
    drawn = pixels(known)
    one = structure("gaussian")
    truth = {"width": 2.0 * drawn.reference**0.9, "exponent": 0.9}
    for c, colour in enumerate(("red", "green", "blue")):
        truth[f"beta_{colour}"] = (0.62, 0.41, 0.48)[c]
        truth[f"share_{colour}"] = (0.30, 0.15, 0.20)[c] / truth[f"beta_{colour}"]
        truth[f"source_{colour}"] = (0.03, 0.042, 0.066)[c]
    theta = np.array([truth[name] for name in one.bounds])
    one = type(one)(
        one.model, one.geometry._replace(reference=drawn.reference), one.gain, one.g, one.fixed
    )
    error = Problem(one, drawn).model(theta) - drawn.observed
    # rounding to 8 bits, and the tolerance of the blur
    assert error.square().mean().sqrt() < 2e-3
    assert error.mean().abs() < 2e-4


def test_a_law_is_that_of_its_name():
    for name, law in (("paper", uwaug.PointSpread.paper()), ("calibrated", None)):
        one = structure(name)
        wanted = law or uwaug.PointSpread.calibrated(300.0)
        natural = one.natural(torch.from_numpy(middle(one)))
        b = ((natural.beta - natural.G) / 0.95).mean()
        size = (166, 250)
        sigma = wanted.sigma((b * 3.0).reshape(1, 1, 1, 1), size)
        assert float(natural.width[0]) == pytest.approx(float(sigma), rel=1e-6)
