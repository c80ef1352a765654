"""Pictures of a few numbers, and their slopes."""

import numpy as np
import pytest
import torch
from fitted import COLOURS, TRUTH, medium, objective, seen

import uwaug
from uwaug.blur.plan import plan_blur
from uwaug.blur.stack import node_slopes, node_weights
from uwaug.fitting.data import Pictures
from uwaug.fitting.jerlov import TypeModel
from uwaug.fitting.model import MODELS, CoefficientModel, report_slopes
from uwaug.fitting.solve import Objective
from uwaug.optics.camera import load_camera

FIXED = {"G_red": 0.2, "veil_green": 0.3, "veil_blue": 0.2, "G_blue": 0.1}


def differences(function, theta, step=1e-6):
    columns = []
    for unit in np.eye(len(theta)) * step:
        columns.append((function(theta + unit) - function(theta - unit)) / (2 * step))
    return np.stack(columns, -1)


@pytest.mark.parametrize("fixed", [{}, FIXED])
@pytest.mark.parametrize("name", MODELS)
def test_slopes_are_those_of_the_image(known, name, fixed):
    if name == "haze":
        fixed = {key: x for key, x in fixed.items() if "G" not in key}
    problem = objective(known, name, 500, gain=True)
    model = CoefficientModel(MODELS[name], problem.model.geometry, True, fixed)
    factor = np.random.default_rng(0).uniform(0.7, 1.3, len(model.bounds))
    theta = np.array([bound.begin or 0.2 for bound in model.bounds.values()]) * factor
    problem = Objective(model, problem.pixels)
    wanted = differences(problem.residual, theta)
    scale = np.abs(wanted).max(0)
    assert np.abs(problem.jacobian(theta) / scale - wanted / scale).max() < 1e-5
    wanted = differences(model.report, theta)
    np.testing.assert_allclose(report_slopes(model, theta), wanted, rtol=1e-5, atol=1e-7)


def test_slopes_near_no_attenuation(known):
    problem = objective(known, "gaussian")
    theta = problem.model.start({"share_red": 0.0, "share_green": 1e-6, "share_blue": 1e-3})
    step = np.zeros(len(theta))
    step[4] = 1e-5
    wanted = (problem.residual(theta + step) - problem.residual(theta)) / 1e-5
    np.testing.assert_allclose(problem.jacobian(theta)[:, 4], wanted, atol=1e-3)
    assert np.isfinite(problem.jacobian(theta)).all()


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


def test_pixels_are_those_of_the_image():
    problem = objective(seen(medium(), noise=0.0), "gaussian")
    reference = problem.model.geometry.reference
    truth = {"width": 0.8 * reference**0.9, "exponent": 0.9}
    for c, colour in enumerate(COLOURS):
        beta, G, veil = (TRUTH[kind][c] for kind in ("beta", "G", "veil"))
        truth |= {f"beta_{colour}": beta, f"share_{colour}": G / beta, f"source_{colour}": G * veil}
    error = 0.01 * problem.residual(problem.model.start(truth))
    # rounding to 8 bits, and the tolerance of the blur
    assert np.sqrt((error**2).mean()) < 2e-3
    assert abs(error.mean()) < 2e-4


def test_a_term_of_the_image_shows_in_fits(known, monkeypatch):
    problem, image = objective(known, "gaussian"), uwaug.Medium.image
    before = problem.residual(problem.model.start({}))
    monkeypatch.setattr(uwaug.Medium, "image", lambda *inputs: image(*inputs) + 0.05)
    after = problem.residual(problem.model.start({}))
    used = problem.pixels.weights.flatten().numpy() > 0
    np.testing.assert_allclose((after - before)[used], 5.0)


# ---- by spectra


def spectral(known, surfaces="grey"):
    pictures = Pictures.of(*known, "srgb")
    camera, law = load_camera("Nikon 5100 (NPL)"), uwaug.PointSpread.paper()
    water = uwaug.Water.jerlov("3C")
    model = TypeModel(water, camera, surfaces, 0.2, law, None, pictures.geometry)
    return Objective(model, pictures.sample(["gaussian"], 600, 0))


@pytest.mark.parametrize("surfaces", ["grey", "spectral"])
def test_pixels_by_spectra_are_those_of_the_image(surfaces):
    water = uwaug.Medium.from_water("3C", vertical_depth=3.0, tolerance=0, surfaces=surfaces)
    error = spectral(seen(water, noise=0.0), surfaces).residual(np.array([0.0, 3.0, 0.0]))
    # what remains is the rounding to 8 bits, and two tolerances of blurs
    assert np.abs(error).max() < 0.006
    assert error.std() < 0.0015


def test_slopes_by_spectra_are_those_of_wider_differences():
    water = uwaug.Medium.from_water("3C", vertical_depth=3.0, tolerance=0)
    problem, theta = spectral(seen(water)), np.array([0.2, 2.0, 0.1])
    wide = differences(problem.residual, theta, 1e-3)
    assert np.abs(problem.jacobian(theta) - wide).max() < 1e-3 * np.abs(wide).max()
    wide = differences(problem.model.report, theta, 1e-3)
    np.testing.assert_allclose(report_slopes(problem.model, theta), wide, rtol=1e-3, atol=1e-5)
