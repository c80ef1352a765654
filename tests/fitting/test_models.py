from dataclasses import replace

import numpy as np
import pytest
import torch
from fitted import COLOURS, TRUTH, medium, objective, seen

import uwaug
from uwaug.blur.plan import plan_blur
from uwaug.blur.stack import node_slopes, node_weights
from uwaug.fitting.coefficients import render
from uwaug.fitting.data import Observations
from uwaug.fitting.least_squares import Objective
from uwaug.fitting.models import MODELS, SpectralModel, TurbidityModel
from uwaug.optics.camera import load_camera
from uwaug.optics.curves import curves
from uwaug.optics.scattering import Scattering

# of torch's own forward mode
pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")


def middle(model, seed=0):
    factor = np.random.default_rng(seed).uniform(0.7, 1.3, len(model.bounds))
    return np.array([bound.begin for bound in model.bounds.values()]) * factor


def forward_mode(model, pixels, theta):
    def light(numbers):
        return render(model.coefficients(numbers), pixels, model.shape)

    return torch.func.jacfwd(light)(torch.from_numpy(theta))


@pytest.mark.parametrize("name", [*MODELS, "series", "camera"])
def test_slopes_are_those_of_forward_mode(known, name):
    problem = objective(known, "gaussian" if name in ("series", "camera") else name)
    if name == "camera":
        camera = replace(problem.model, gain="channels", shading=True, tone=True)
        problem = replace(problem, model=camera)
    if name == "series":
        geometry = problem.model.geometry
        problem = replace(problem, model=TurbidityModel(MODELS["gaussian"], geometry, (0,), 1))
    theta = middle(problem.model)
    if name == "camera":
        theta[-5:] = [0.2, 0.1, -0.1, 1.2, 0.4]
    weights = problem.pixels.weights[..., None]
    wanted = (weights * forward_mode(problem.model, problem.pixels, theta)).reshape(-1, len(theta))
    residual, jacobian = problem.linearised(theta)
    np.testing.assert_allclose(jacobian, wanted, atol=1e-12 * float(wanted.abs().max()))
    np.testing.assert_allclose(residual, problem.residual(theta), atol=1e-13)


def test_slopes_near_no_attenuation(known):
    problem = objective(known, "gaussian")
    model, pixels = problem.model, problem.pixels
    theta = middle(model)
    theta[3:6] = [0.0, 1e-6, 1e-3]  # G/β
    _, slopes = model.jacobian(theta, pixels)
    assert slopes.isfinite().all()
    # at a G of exactly 0 the formula is clamped, and autograd has no slope there
    wanted = forward_mode(model, pixels, theta)
    torch.testing.assert_close(slopes[:, 1:, ..., 4:6], wanted[:, 1:, ..., 4:6], atol=1e-8, rtol=0)


@pytest.mark.parametrize("shape", ["gaussian", "exponential"])
def test_slopes_of_the_weights(shape):
    plan = plan_blur(0.0, 30.0, 0.002, shape)
    sigma = torch.linspace(0.0, 40.0, 300, dtype=torch.float64).reshape(1, 1, 1, -1)
    sigma.requires_grad_()
    weights = node_weights(sigma, plan)
    rows = [torch.autograd.grad(row.sum(), sigma, retain_graph=True)[0] for row in weights[0]]
    wanted, sigma = torch.cat(rows, 1), sigma.detach()
    inside = (sigma > 0) & (sigma < 30)
    slopes = node_slopes(sigma, plan)
    torch.testing.assert_close(slopes * inside, wanted * inside, atol=1e-12, rtol=1e-10)
    assert slopes[..., -1].abs().max() == 0
    assert node_slopes(sigma, plan_blur(0.0, 0.0)).abs().max() == 0


def test_pixels_are_those_of_the_image():
    problem = objective(seen(medium(), noise=0.0), "gaussian")
    truth = {"width": 0.8 * problem.pixels.reference**0.9, "exponent": 0.9}
    for c, colour in enumerate(COLOURS):
        beta, G, veil = (TRUTH[kind][c] for kind in ("beta", "G", "veil"))
        truth |= {f"beta_{colour}": beta, f"share_{colour}": G / beta, f"source_{colour}": G * veil}
    theta = np.array([truth[name] for name in problem.model.bounds])
    error = problem.render(theta) - problem.pixels.observed
    # rounding to 8 bits, and the tolerance of the blur
    assert error.square().mean().sqrt() < 2e-3
    assert error.mean().abs() < 2e-4


@pytest.mark.parametrize(
    ("name", "law"),
    [("paper", uwaug.PointSpread.paper()), ("calibrated", uwaug.PointSpread.calibrated(70.0))],
)
def test_a_law_is_that_of_its_name(known, name, law):
    model = objective(known, name).model
    c = model.coefficients(torch.from_numpy(middle(model)))
    lengths = ((c.beta - c.G) / 0.95).mean() * model.geometry.reference
    sigma = law.sigma(lengths.reshape(1, 1, 1, 1), tuple(known.clean.shape[-2:]))
    assert float(c.width[0]) == pytest.approx(float(sigma), rel=1e-6)


# ---- by spectra


def spectral(known, *names, surfaces="grey"):
    observations = Observations.of(*known)
    model = SpectralModel(
        waters=tuple(uwaug.Water.jerlov(name) for name in names),
        camera=load_camera("Nikon 5100 (NPL)"),
        surfaces=surfaces,
        scattering=Scattering.PAPER,
        point_spread=uwaug.PointSpread.paper(),
        depth=None,
        sizes=tuple(pair.size for pair in observations.pairs),
        geometry=observations.geometry(),
        gain="free",
    )
    return Objective(model, observations.sample_pixels(["gaussian"], 600, 0))


@pytest.fixture(scope="module")
def jerlov():
    return seen(uwaug.Medium.from_water("3C", vertical_depth=3.0, tolerance=0), noise=0.0)


@pytest.mark.parametrize("surfaces", ["grey", "spectral"])
def test_pixels_by_spectra_are_those_of_the_image(surfaces):
    water = uwaug.Medium.from_water("3C", vertical_depth=3.0, tolerance=0, surfaces=surfaces)
    problem = spectral(seen(water, noise=0.0), "3C", surfaces=surfaces)
    error = problem.render(np.array([0.0, 3.0, 1.0])) - problem.pixels.observed
    # what remains is the rounding to 8 bits, and two tolerances of blurs
    assert error.abs().max() < 0.006
    assert error.std() < 0.0015


def test_slopes_by_spectra_are_those_of_wider_differences(jerlov):
    problem = spectral(jerlov, "1C", "3C")
    theta = np.array([0.2, 0.4, 2.0, 1.1])
    _, jacobian = problem.linearised(theta)
    reported = problem.model.report_jacobian(theta)
    for i, step in enumerate(1e-3 * np.eye(4)):
        wide = (problem.residual(theta + step) - problem.residual(theta - step)) / 2e-3
        assert np.abs(jacobian[:, i] - wide).max() < 1e-3 * np.abs(wide).max()
        wide = (problem.model.report(theta + step) - problem.model.report(theta - step)) / 2e-3
        np.testing.assert_allclose(reported[:, i], wide, rtol=1e-4, atol=1e-6)


def test_grid_holds_the_curves_to_open_water(jerlov):
    pixels = spectral(jerlov, "II").pixels
    z = pixels.z.clone()
    z[..., :5] = 1e9
    z[..., 5:10] = 300.0
    grid = replace(pixels, z=z).grid
    water = uwaug.Medium.from_water("II", vertical_depth=2.0, tolerance=0)
    sums = water.sums(exact_at_lens=True)
    for exact, at_nodes in zip(curves(sums, z), curves(sums, grid.z), strict=True):
        assert (at_nodes @ grid.weights - exact).abs().max() < 1e-6


def test_a_colour_matrix_and_a_black_are_found(jerlov):
    problem = spectral(jerlov, "3C", surfaces="spectral")
    pixels, model = problem.pixels, replace(problem.model, gain="matrix")
    light = problem.render(np.array([0.0, 3.0, 1.0]))
    matrix = torch.tensor([[0.9, 0.1, 0.0], [0.2, 0.6, -0.1], [0.0, 0.1, 1.2]]).double()
    observed = torch.einsum("ij,pjkn->pikn", matrix, light) + 0.05
    developed = replace(pixels, observed=observed)
    again = model.render(np.array([0.0, 3.0]), developed)
    assert (again - observed).abs().max() < 1e-6
