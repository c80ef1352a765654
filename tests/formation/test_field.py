import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from uwaug.formation.field import field_of, gaussian_random_field


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def reference(
    noise: np.ndarray, height: int, width: int, exponent: float, low: float, high: float
) -> np.ndarray:
    """One field as the plain sum over waves, from the equation."""
    torus = 2 * max(height, width)
    rows = (np.arange(height) + 0.5 - height / 2)[:, None]
    columns = (np.arange(width) + 0.5 - width / 2)[None, :]
    field = np.zeros((height, width))
    for p, q in np.ndindex(noise.shape):
        ky, kx = (p + 1) // 2, (q + 1) // 2
        if kx == ky == 0:
            continue
        wave_y = np.sin if p % 2 else np.cos
        wave_x = np.sin if q % 2 else np.cos
        density = math.hypot(kx, ky) ** -exponent * (2 if ky else 1) * (2 if kx else 1)
        waves = wave_y(2 * np.pi * ky * rows / torus) * wave_x(2 * np.pi * kx * columns / torus)
        field += noise[p, q] * math.sqrt(density) * waves
    return low + (high - low) * (field - field.min()) / (field.max() - field.min())


@pytest.mark.parametrize(
    "size, exponent", [((8, 8), 0.0), ((5, 9), 2.0), ((9, 4), 4.0), ((1, 6), 2.0)]
)
def test_is_the_sum_of_waves(size, exponent) -> None:
    noise = torch.randn(2, 9, 9, generator=seeded(), dtype=torch.float64)
    field = field_of(noise, *size, exponent, 0.3, 1.7)
    assert field.shape == (2, 1, *size)
    for b in range(2):
        expected = reference(noise[b].numpy(), *size, exponent, 0.3, 1.7)
        np.testing.assert_allclose(field[b, 0].numpy(), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("exponent, height", [(2.0, 64), (4.0, 128)])
def test_power_spectrum_falls_as_the_exponent_says_in_every_direction(exponent, height) -> None:
    noise = torch.randn(60, 257, 257, generator=seeded(), dtype=torch.float64)
    fields = field_of(noise, height, 128, exponent, 0.7, 1.3)
    # under a Hann window, as the fields are not periodic
    window = torch.outer(torch.hann_window(height).double(), torch.hann_window(128).double())
    centred = (fields - fields.mean((-2, -1), keepdim=True))[:, 0]
    powers = torch.fft.fft2(centred * window).abs().square()
    powers /= powers.sum((-2, -1), keepdim=True)  # each field has a range of its own
    power = powers.mean(0).numpy()
    fy, fx = np.meshgrid(np.fft.fftfreq(height), np.fft.fftfreq(128), indexing="ij")
    radius, angle = np.hypot(fy, fx), np.abs(np.arctan2(fy, fx))
    band = (radius > 0.06) & (radius < 0.3)
    slope, _ = np.polyfit(np.log(radius[band]), np.log(power[band]), 1)
    assert slope == pytest.approx(-exponent, abs=0.15)
    scaled = power * radius**exponent
    directions = [
        band & (np.minimum(angle, np.pi - angle) < np.pi / 8),
        band & (np.abs(angle - np.pi / 2) < np.pi / 8),
        band & (np.abs(np.abs(angle - np.pi / 2) - np.pi / 4) < np.pi / 8),
    ]
    levels = [scaled[d].mean() for d in directions]
    assert max(levels) / min(levels) < 1.25


def test_is_not_periodic() -> None:
    fields = gaussian_random_field((200, 64, 64), generator=seeded())[:, 0]
    neighbours = (fields[:, :, 1:] - fields[:, :, :-1]).square().mean().sqrt()
    for wrap in (fields[:, :, 0] - fields[:, :, -1], fields[:, 0] - fields[:, -1]):
        assert wrap.square().mean().sqrt() > 15 * neighbours
    opposite = torch.corrcoef(torch.stack([fields[:, 32, 0], fields[:, 32, -1]]))[0, 1]
    assert opposite < 0.2


def test_the_same_seed_gives_the_same_field_at_any_resolution() -> None:
    sizes = ((32, 48), (128, 192))
    small, large = (gaussian_random_field((2, *size), generator=seeded()) for size in sizes)
    pooled = torch.nn.functional.avg_pool2d(large, 4)
    for a, b in zip(small, pooled, strict=True):
        assert torch.corrcoef(torch.stack([a.flatten(), b.flatten()]))[0, 1] > 0.999
    assert (small - pooled).abs().max() < 0.02


def test_mean_over_draws_is_the_middle() -> None:
    fields = gaussian_random_field((2000, 16, 16), low=0.0, high=1.0, generator=seeded())
    means = fields.mean((1, 2, 3))
    assert means.mean() == pytest.approx(0.5, abs=4 * means.std().item() / math.sqrt(2000))
    noise = torch.randn(3, 65, 65, generator=seeded())
    field = field_of(noise, 20, 30, 4.0, 0.0, 1.0)
    mirrored = field_of(-noise, 20, 30, 4.0, 0.0, 1.0)
    torch.testing.assert_close(mirrored, 1 - field, rtol=0, atol=1e-5)


def test_randomness_comes_from_the_generator_or_the_global_one() -> None:
    a = gaussian_random_field((2, 1, 32, 40), generator=seeded(3))
    assert torch.equal(a, gaussian_random_field((2, 1, 32, 40), generator=seeded(3)))
    assert not torch.equal(a, gaussian_random_field((2, 1, 32, 40), generator=seeded(4)))
    assert not torch.equal(a[0], a[1])
    with torch.random.fork_rng():
        torch.manual_seed(3)
        b = gaussian_random_field((2, 1, 32, 40))
        assert not torch.equal(b, gaussian_random_field((2, 1, 32, 40)))
    assert torch.equal(a, b)
    state = torch.random.get_rng_state()
    gaussian_random_field((32, 40), generator=seeded(3))
    assert torch.equal(state, torch.random.get_rng_state())


SIDES = st.integers(1, 40)
EXPONENTS = st.sampled_from([0.0, 1.5, 2.001, 4.0, 30.0])


@given(SIDES, SIDES, EXPONENTS, st.integers(0, 99))
def test_reaches_and_never_leaves_its_range(height, width, exponent, seed) -> None:
    field = gaussian_random_field(
        (2, height, width), exponent=exponent, low=0.3, high=1.7, generator=seeded(seed)
    )
    assert field.isfinite().all()
    assert (field >= 0.3).all()
    assert (field <= 1.7).all()
    if height * width > 1:
        torch.testing.assert_close(field.amin((1, 2, 3)), torch.full((2,), 0.3))
        torch.testing.assert_close(field.amax((1, 2, 3)), torch.full((2,), 1.7))


def test_shapes_types_and_fields_without_a_range() -> None:
    expected = gaussian_random_field((1, 1, 20, 30), generator=seeded())
    for shape in ((20, 30), (1, 20, 30), torch.Size([1, 1, 20, 30]), [20, 30]):
        assert torch.equal(gaussian_random_field(shape, generator=seeded()), expected)
    double = gaussian_random_field((20, 30), generator=seeded(), dtype=torch.float64)
    torch.testing.assert_close(expected.double(), double, rtol=0, atol=1e-5)
    assert gaussian_random_field((0, 1, 20, 30)).shape == (0, 1, 20, 30)
    for size, low, high in (((3, 1, 1), 0.5, 1.5), ((8, 9), 1.0, 1.0)):
        field = gaussian_random_field(size, low=low, high=high)
        assert torch.equal(field, torch.ones_like(field))


@pytest.mark.parametrize(
    "name, value",
    [
        *[("low", low) for low in (1.5, -0.1, math.nan)],
        *[("exponent", exponent) for exponent in (-1.0, math.inf)],
        *[("shape", shape) for shape in ((2, 3, 8, 8), (8,), (2, 0, 8), (1, 1, 32.5, 32))],
    ],
)
def test_a_field_refuses(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=name):
        gaussian_random_field(**{"shape": (8, 8), name: value})
