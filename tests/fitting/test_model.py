"""Pictures of a few numbers, and their slopes."""

import numpy as np
import pytest
import torch
from fitted import COLOURS, TRUTH, medium, objective, seen

import uwaug
from uwaug.fitting.data import Pictures
from uwaug.fitting.jerlov import TypeModel
from uwaug.fitting.model import report_slopes
from uwaug.fitting.solve import Objective
from uwaug.optics.camera import load_camera
from uwaug.optics.view import WIDE


def spectral(known, surfaces="grey", gains=("gain",)):
    pictures = Pictures.of(*known, "srgb")
    camera, law = load_camera("Nikon 5100 (NPL)"), uwaug.PointSpread.paper()
    water = uwaug.Water.jerlov("3C")
    known = camera, surfaces, 0.2, None, law, WIDE, None, pictures.geometry
    model = TypeModel(water, *known, gains)
    return Objective(model, pictures.sample(["gaussian"], 600, 0))


def differences(function, theta, step):
    columns = []
    for unit in np.eye(len(theta)) * step:
        columns.append((function(theta + unit) - function(theta - unit)) / (2 * step))
    return np.stack(columns, -1)


@pytest.mark.parametrize("name", ["haze", "veil", "exponential", "gaussian", "by spectra", "gains"])
def test_slopes_are_those_of_the_image(known, name):
    """Of numbers that are moved one by one, both ways."""
    if name == "by spectra":
        problem, theta, step = spectral(known), np.array([0.2, 2.0, 0.1]), 1e-3
    elif name == "gains":
        gains = [f"gain_{colour}" for colour in COLOURS]
        problem, step = spectral(known, gains=gains), 1e-3
        theta = np.array([0.2, 2.0, 0.1, -0.2, 0.3])
    else:
        problem, step = objective(known, name, 500, gain=True), 1e-6
        bounds = problem.model.bounds
        factor = np.random.default_rng(0).uniform(0.7, 1.3, len(bounds))
        theta = np.array([bound.begin or 0.2 for bound in bounds.values()]) * factor
    wanted = differences(problem.residual, theta, step)
    scale = np.abs(wanted).max(0)
    assert np.abs((problem.jacobian(theta) - wanted) / scale).max() < step + 1e-5
    wanted = differences(problem.model.report, theta, step)
    slopes = report_slopes(problem.model, theta)
    np.testing.assert_allclose(slopes, wanted, rtol=step + 1e-5, atol=1e-5)


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
    """In the picture and in its slopes: a fit knows no equation of its own."""
    problem, image = objective(known, "gaussian"), uwaug.Medium.image
    theta = problem.model.start({})
    before, slopes = problem.residual(theta), problem.jacobian(theta)
    monkeypatch.setattr(uwaug.Medium, "image", lambda *inputs: 2 * image(*inputs) + 0.05)
    light = problem.model.render(theta, problem.pixels) - 0.05
    weights = problem.pixels.weights
    wanted = before + (weights * (light / 2 + 0.05)).flatten().numpy()
    np.testing.assert_allclose(problem.residual(theta), wanted, atol=1e-9)
    np.testing.assert_allclose(problem.jacobian(theta), 2 * slopes, rtol=1e-6, atol=1e-4)


@pytest.mark.parametrize("surfaces", ["grey", "spectral"])
def test_pixels_by_spectra_are_those_of_the_image(surfaces):
    paper = {"g": 0.2, "point_spread": uwaug.PointSpread.paper(), "surfaces": surfaces}
    water = uwaug.Medium.from_water("3C", vertical_depth=3.0, tolerance=0, **paper)
    problem = spectral(seen(water, noise=0.0), surfaces)
    with torch.no_grad():
        error = 0.01 * problem.residual(np.array([0.0, 3.0, 0.0]))
    # what remains is the rounding to 8 bits, and two tolerances of blurs
    assert np.abs(error).max() < 0.006
    assert error.std() < 0.0015
