"""Pictures, media and ranges at random, against the equations, and the blur of benchmarks."""

import numpy as np
import pytest
import torch
from referees import reference
from referees.reference import BANDS
from scenes import SIZES, rand

from benchmarks.exact import blur_exact
from uwaug import Camera, Medium, PointSpread, Water, form_image

TOLERANCES = (0.01, 0.002, 0.0005, 0.0001)


def scene(generator: np.random.Generator, h: int, w: int) -> np.ndarray:
    """Distances, m: a slope and steps, of a range that is drawn."""
    near = 10 ** generator.uniform(-1, 0.5)
    steps = np.kron(generator.random((3, 3)), np.ones((-(-h // 3), -(-w // 3))))[:h, :w]
    share = 0.7 * steps + 0.3 * np.linspace(0, 1, h * w).reshape(h, w)
    return near * (1 + share * (10 ** generator.uniform(0.1, 1.2) - 1))


def spectrum(generator: np.random.Generator, low: float, high: float) -> np.ndarray:
    """A smooth spectrum between two values."""
    places = np.linspace(400, 700, 5)
    return np.interp(BANDS, places, generator.uniform(low, high, 5))


@pytest.mark.parametrize("shape", ["gaussian", "exponential"])
@pytest.mark.parametrize("seed", range(8))
def test_every_picture_is_right_within_its_tolerance(seed: int, shape: str) -> None:
    generator = np.random.default_rng((seed, shape == "gaussian"))
    h, w = (int(size) for size in generator.integers(8, 28, 2))
    J, z = reference.picture(h, w, seed).clip(0, 1), scene(generator, h, w)
    # spectra and a camera that no table holds
    dirt = 10 ** generator.uniform(-1.5, 0.2)
    a, b = spectrum(generator, 0.02, 0.02 + 0.4 * dirt), spectrum(generator, 0.7 * dirt, dirt)
    water = Water(BANDS, a, b, a + spectrum(generator, 0.0, 0.6 * dirt))
    peaks = generator.uniform((570, 510, 430), (630, 560, 480))
    seen = np.exp(-0.5 * ((BANDS[:, None] - peaks) / generator.uniform(20, 50, 3)) ** 2)
    seen /= seen.sum(0)
    depth, g, mu = generator.uniform(0, (3, 0.5, 0.5))
    # widths from a fiftieth of a pixel to the whole picture at the farthest distance
    lengths = float((b @ seen).mean()) * z
    exponent, widest = generator.uniform(0.5, 1.2), 10 ** generator.uniform(-1.7, 1.5)
    scale = float(widest / lengths.max() ** exponent)
    curves = reference.spectral_curves(water, z, depth=depth, g=g, mu=mu, camera=seen)
    exact = reference.terms(J, z, curves, scale * lengths**exponent, shape)
    law = PointSpread(scale, exponent, shape)
    image, distance = torch.from_numpy(J), torch.from_numpy(z)[None]
    numbers = {"vertical_depth": depth, "g": g, "mu": mu, "point_spread": law}
    for tolerance in TOLERANCES:
        medium = Medium.from_water(water, Camera(BANDS, seen), tolerance=tolerance / 10, **numbers)
        found = form_image(image, distance, medium, tolerance=tolerance)
        parts = (found.direct, found.forward, found.backscatter)
        names = ("direct", "forward", "backscatter")
        for name, part, wanted in zip(names, parts, exact, strict=True):
            error = np.sqrt(np.square(part.numpy() - wanted).mean())
            assert error <= tolerance, f"{name} at {tolerance}: {medium}"


# ---- the blur that benchmarks take for exact


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("least, most, error", [(0.5, 0.75, 1e-8), (1, 3, 1e-12), (1, 25, 1e-12)])
def test_the_exact_blur_reads_each_pixel_with_its_own_width(size, least, most, error) -> None:
    image, sigma = rand(3, *size), least + (most - least) * rand(*size, seed=1)
    at = torch.randperm(sigma.numel())[:200]
    expected = reference.varying_gaussian(image.numpy(), sigma.numpy(), at.numpy())
    np.testing.assert_allclose(blur_exact(image, sigma, at).numpy(), expected, rtol=0, atol=error)
    assert torch.equal(blur_exact(image, 0 * sigma).reshape(image.shape), image)
