import math

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
    expected = [[reference(each.numpy(), *size, exponent, 0.3, 1.7)] for each in noise]
    np.testing.assert_allclose(field.numpy(), np.array(expected), rtol=0, atol=1e-12)


def test_the_same_seed_gives_the_same_field_at_any_resolution() -> None:
    sizes = ((32, 48), (128, 192))
    small, large = (gaussian_random_field((2, *size), generator=seeded()) for size in sizes)
    assert (small - torch.nn.functional.avg_pool2d(large, 4)).abs().max() < 0.02


def test_mean_over_draws_is_the_middle() -> None:
    means = gaussian_random_field((2000, 16, 16), low=0, high=1, generator=seeded()).mean((1, 2, 3))
    assert means.mean() == pytest.approx(0.5, abs=4 * means.std().item() / math.sqrt(2000))


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
    assert ((field >= 0.3) & (field <= 1.7)).all()
    if height * width > 1:
        torch.testing.assert_close(field.amin((1, 2, 3)), torch.full((2,), 0.3))
        torch.testing.assert_close(field.amax((1, 2, 3)), torch.full((2,), 1.7))


def test_shapes_types_and_fields_without_a_range() -> None:
    expected = gaussian_random_field((1, 1, 20, 30), generator=seeded())
    for shape in ((20, 30), (1, 20, 30), [20, 30]):
        assert torch.equal(gaussian_random_field(shape, generator=seeded()), expected)
    double = gaussian_random_field((20, 30), generator=seeded(), dtype=torch.float64)
    torch.testing.assert_close(expected.double(), double, rtol=0, atol=1e-5)
    assert gaussian_random_field((0, 1, 20, 30)).shape == (0, 1, 20, 30)
    for size, low, high in (((3, 1, 1), 0.5, 1.5), ((8, 9), 1.0, 1.0)):
        assert (gaussian_random_field(size, low=low, high=high) == 1).all()
    for name, value in (("low", 1.5), ("low", -0.1), ("exponent", -1.0), ("shape", (2, 0, 8))):
        with pytest.raises(ValueError, match=name):
            gaussian_random_field(**{"shape": (8, 8), name: value})
