"""The two curves of sRGB against the standard."""

import math

import numpy as np
import pytest
import torch

from uwaug.formation.colour import linear_to_srgb, srgb_to_linear

BOTH = pytest.mark.parametrize("function", [srgb_to_linear, linear_to_srgb])


def decode(x: np.ndarray) -> np.ndarray:
    a = np.abs(x)
    return np.sign(x) * np.where(a <= 0.04045, a / 12.92, ((a + 0.055) / 1.055) ** 2.4)


def encode(x: np.ndarray) -> np.ndarray:
    a = np.abs(x)
    return np.sign(x) * np.where(a <= 0.0031308, 12.92 * a, 1.055 * a ** (1 / 2.4) - 0.055)


REFERENCE = {srgb_to_linear: decode, linear_to_srgb: encode}
# every 8-bit and 16-bit value, negatives, values above 1, and both printed thresholds
VALUES = (np.linspace(-1, 1, 200_003), np.arange(256) / 255, np.arange(65536) / 65535)
GRID = np.concatenate([*VALUES, [0.04045, 0.0031308]])


@BOTH
def test_float64_is_the_standard_up_to_its_rounded_constants(function) -> None:
    for x in (GRID, np.geomspace(1, 1e6, 1001)):
        ours = function(torch.from_numpy(x)).numpy()
        np.testing.assert_allclose(ours, REFERENCE[function](x), rtol=1e-12, atol=4e-8)


@BOTH
def test_float32_is_within_1e_6(function) -> None:
    x = torch.from_numpy(GRID).float()
    ours, exact = function(x).double().numpy(), REFERENCE[function](x.double().numpy())
    assert np.abs(ours - exact).max() <= 1e-6
    hdr = torch.logspace(0, 6, 1001)
    ours, exact = function(hdr).double().numpy(), REFERENCE[function](hdr.double().numpy())
    np.testing.assert_allclose(ours, exact, rtol=5e-6)


@pytest.mark.parametrize("dtype, tolerance", [(torch.float32, 2e-6), (torch.float64, 1e-14)])
def test_inverse_of_each_other(dtype, tolerance) -> None:
    x = torch.from_numpy(GRID).to(dtype)
    torch.testing.assert_close(linear_to_srgb(srgb_to_linear(x)), x, rtol=0, atol=tolerance)
    torch.testing.assert_close(srgb_to_linear(linear_to_srgb(x)), x, rtol=0, atol=tolerance)


@BOTH
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_fixed_points(function, dtype) -> None:
    x = torch.tensor([0.0, 1.0, -1.0, math.inf, -math.inf, math.nan], dtype=dtype)
    torch.testing.assert_close(function(x), x, rtol=0, atol=0, equal_nan=True)


@BOTH
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradient_is_the_slope_of_the_curve_also_at_singular_points(function, dtype) -> None:
    knee = 0.0404482362771076 if function is srgb_to_linear else 0.0404482362771076 / 12.92
    values = [0.0, -0.0, 1e-30, 0.001, knee, 0.04045, 0.0031308, 0.5, 1.0, 50.0]
    x = torch.tensor(values + [-v for v in values], dtype=dtype, requires_grad=True)
    (slope,) = torch.autograd.grad(function(x).sum(), x)
    a = x.detach().double().abs().numpy()
    if function is srgb_to_linear:
        straight, power = 1 / 12.92, 2.4 / 1.055 * ((a + 0.055) / 1.055) ** 1.4
    else:
        straight, power = 12.92, 1.055 / 2.4 * np.maximum(a, 1e-3) ** (1 / 2.4 - 1)
    at_knee = np.isclose(a, knee, rtol=1e-6)  # either one-sided slope will do there
    expected = np.where(at_knee, slope.numpy(), np.where(a < knee, straight, power))
    np.testing.assert_allclose(slope.numpy(), expected, rtol=2e-5)
    for s in slope[torch.from_numpy(at_knee)]:
        assert min(abs(s / straight - 1), abs(s / power[at_knee][0] - 1)) < 2e-5


@BOTH
def test_large_images_are_worked_on_in_pieces_that_fit_together(function) -> None:
    x = torch.linspace(-1, 2, 3 * 217 * 303).view(3, 217, 303)
    expected = torch.cat([function(x_) for x_ in x.flatten().split(20_000)]).view_as(x)
    torch.testing.assert_close(function(x), expected, rtol=0, atol=1e-6)
    torch.testing.assert_close(function(x.mT), expected.mT, rtol=0, atol=1e-6)
    leaf, weight = x.clone().requires_grad_(), torch.linspace(-1, 1, x.numel()).view_as(x)
    (grad,) = torch.autograd.grad(function(leaf), leaf, weight)
    (slope,) = torch.autograd.grad(function(leaf).sum(), leaf)
    torch.testing.assert_close(grad, slope * weight)


@BOTH
def test_input_is_left_alone_and_any_layout_will_do(function) -> None:
    x = torch.rand(2, 3, 5, 7, generator=torch.Generator().manual_seed(0))
    kept = x.clone()
    function(x)
    assert torch.equal(x, kept)
    turned, last = x.transpose(-1, -2), x.to(memory_format=torch.channels_last)
    for view in (turned, last, x[..., ::2], x[:1].expand(4, 3, 5, 7)):
        torch.testing.assert_close(function(view), function(view.contiguous()), rtol=0, atol=1e-6)
    assert function(x[:0]).shape == (0, 3, 5, 7)
    assert function(x[0, 0, 0, 0]).shape == ()


@BOTH
@pytest.mark.parametrize("values", [torch.zeros(3, dtype=torch.uint8), np.zeros(3)])
def test_rejects_what_it_cannot_mean(function, values) -> None:
    with pytest.raises(TypeError, match="x must be a floating-point tensor"):
        function(values)
