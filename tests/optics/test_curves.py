import math

import numpy as np
import pytest
import torch
from optical import CURVES
from referees import reference

from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import JERLOV_TYPES, Water


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_exact_at_zero(type: str) -> None:
    water = Water.jerlov(type)
    medium = Medium.from_water(water, vertical_depth=1.0)
    exact = reference.spectral_curves(water, np.zeros(()), depth=1.0, g=0.2, mu=0.3)
    light = torch.from_numpy(exact.direct)
    zero = torch.zeros((), dtype=torch.float64)
    torch.testing.assert_close(medium.transmission(zero)[0], light, rtol=0, atol=1e-13)
    torch.testing.assert_close(medium.signal(zero)[0], light, rtol=0, atol=1e-13)
    assert (medium.backscatter(zero) == 0).all()


@pytest.mark.parametrize("type", JERLOV_TYPES)
@pytest.mark.parametrize("g", [0.0, 0.2, 1.0])
def test_monotone_bounded_and_positive_at_any_distance(type: str, g: float) -> None:
    medium = Medium.from_water(Water.jerlov(type), vertical_depth=0.0, g=g)
    assert all((t >= 0).all() for t in medium.tensors())
    z = torch.cat([torch.zeros(1), torch.logspace(-6, 6, 300), torch.tensor([math.inf])]).double()
    assert (medium.transmission(z).diff() <= 1e-15).all()
    assert (medium.signal(z).diff() <= 1e-15).all()
    assert (medium.backscatter(z).diff() >= -1e-15).all()
    assert (medium.transmission(z)[..., -1] == 0).all()
    assert (medium.signal(z)[..., -1] == 0).all()
    torch.testing.assert_close(medium.backscatter(z)[..., -1], medium.veil_weights.sum(-1))


def test_a_thin_layer_of_water_has_a_veil_in_float32() -> None:
    medium = Medium.from_water(Water.jerlov("3C"), vertical_depth=0.0)
    z = torch.logspace(-9, -3, 13)
    expected = torch.from_numpy(reference.medium_curves(medium, z.double().numpy()).veil)
    veil = medium.backscatter(z)[0].double()
    torch.testing.assert_close(veil, expected, rtol=1e-5, atol=0)


@pytest.mark.parametrize("shape", [(), (5,), (1, 4, 6), (1, 1, 4, 6), (3, 1, 4, 6)], ids=str)
def test_shapes(shape: tuple[int, ...]) -> None:
    media = Medium.stack([Medium.from_water(Water.jerlov(t)) for t in ("I", "3C", "9C")])
    z = 5 * torch.rand(shape, dtype=torch.float64)
    for name in CURVES:
        curve = getattr(media, name)(z)
        assert curve.shape == (3, 3, *shape[-2:])
        for row in range(3):
            own = z[row, 0] if shape[:1] == (3,) else z.reshape(shape[-2:])
            expected = reference.medium_curves(media, own.numpy(), row)[CURVES.index(name)]
            np.testing.assert_allclose(curve[row].numpy(), expected, rtol=0, atol=1e-13)


def test_autocast_changes_nothing() -> None:
    coastal, z = Medium.from_water("3C"), 10 * torch.rand(1, 1, 6, 7)
    with torch.autocast("cpu", torch.bfloat16):
        results = [getattr(coastal, name)(z) for name in CURVES]
    for name, result in zip(CURVES, results, strict=True):
        torch.testing.assert_close(result, getattr(coastal, name)(z), rtol=0, atol=1e-6)


def test_gradients_of_every_tensor() -> None:
    def evaluate(*tensors: torch.Tensor) -> torch.Tensor:
        *medium, scale, exponent, z = tensors
        m = Medium(*medium, PointSpread(scale, exponent))
        width = m.width(z, (3, 4)).expand(2, 3, 3, 4)
        return torch.cat([m.transmission(z), m.signal(z), m.backscatter(z), width])

    tensors = [(2, 2), (2, 3, 2), (2, 3), (2, 3, 3), (2, 3, 3), (2,)]
    law, distance = [(2,), (2,)], (1, 1, 3, 4)
    inputs = []
    for shape in (*tensors, *law, distance):
        inputs.append((0.1 + torch.rand(*shape, dtype=torch.float64)).requires_grad_())
    assert torch.autograd.gradcheck(evaluate, inputs)


@pytest.mark.parametrize("z", [0.0, 1e-30, 1e4, math.inf])
@pytest.mark.parametrize("rate", [0.0, 0.5, 1e4])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_at_the_ends(z: float, rate: float, dtype: torch.dtype) -> None:
    rates = torch.full((3,), rate, dtype=dtype, requires_grad=True)
    veil = torch.full((3,), 0.3, dtype=dtype, requires_grad=True)
    distance = torch.full((1, 1, 2, 2), z, dtype=dtype, requires_grad=True)
    b_mean = torch.full((1,), rate, dtype=dtype, requires_grad=True)
    scale = torch.full((1,), 2.0, dtype=dtype, requires_grad=True)
    exponent = torch.full((1,), 0.5, dtype=dtype, requires_grad=True)
    law = PointSpread(scale, exponent)
    medium = Medium.from_coefficients(rates, rates, veil, b_mean=b_mean, point_spread=law)
    total = sum(getattr(medium, name)(distance).sum() for name in CURVES)
    total.backward()
    tensors = (rates, veil, distance)
    assert all(t.grad is not None and t.grad.isfinite().all() for t in tensors)
    assert not medium.width(distance, (9, 9)).isnan().any()
