"""The two curves of sRGB against the standard."""

import math

import numpy as np
import pytest
import torch

from uwaug.formation.colour import linear_to_srgb, srgb_to_linear


def decode(x: np.ndarray) -> np.ndarray:
    a = np.abs(x)
    return np.sign(x) * np.where(a <= 0.04045, a / 12.92, ((a + 0.055) / 1.055) ** 2.4)


def encode(x: np.ndarray) -> np.ndarray:
    a = np.abs(x)
    return np.sign(x) * np.where(a <= 0.0031308, 12.92 * a, 1.055 * a ** (1 / 2.4) - 0.055)


BOTH = pytest.mark.parametrize("curve", [srgb_to_linear, linear_to_srgb])
TYPES = pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
REFERENCE = {srgb_to_linear: decode, linear_to_srgb: encode}
# every 8-bit and 16-bit value, negatives, values above 1, and both printed thresholds
VALUES = (np.linspace(-1, 1, 200_003), np.arange(256) / 255, np.arange(65536) / 65535)
GRID = torch.from_numpy(np.concatenate([*VALUES, [0.04045, 0.0031308]]))
HDR = torch.logspace(0, 6, 1001).double()


@BOTH
@TYPES
def test_it_is_the_standard_up_to_its_rounded_constants(curve, dtype) -> None:
    near, far = (1e-6, 5e-6) if dtype == torch.float32 else (4e-8, 1e-12)
    for x, atol, rtol in ((GRID.to(dtype), near, 0), (HDR.to(dtype), near, far)):
        exact = REFERENCE[curve](x.double().numpy())
        np.testing.assert_allclose(curve(x).double().numpy(), exact, rtol=rtol, atol=atol)
    ends = torch.tensor([0.0, 1.0, -1.0, math.inf, -math.inf, math.nan], dtype=dtype)
    torch.testing.assert_close(curve(ends), ends, rtol=0, atol=0, equal_nan=True)


@TYPES
def test_inverse_of_each_other(dtype) -> None:
    x, tolerance = GRID.to(dtype), 2e-6 if dtype == torch.float32 else 1e-14
    for first, second in ((srgb_to_linear, linear_to_srgb), (linear_to_srgb, srgb_to_linear)):
        torch.testing.assert_close(second(first(x)), x, rtol=0, atol=tolerance)


@BOTH
@TYPES
def test_gradient_is_the_slope_of_the_curve_also_at_singular_points(curve, dtype) -> None:
    knee = 0.0404482362771076 if curve is srgb_to_linear else 0.0404482362771076 / 12.92
    values = [0.0, -0.0, 1e-30, 0.001, knee, 0.04045, 0.0031308, 0.5, 1.0, 50.0]
    x = torch.tensor(values + [-v for v in values], dtype=dtype, requires_grad=True)
    (slope,) = torch.autograd.grad(curve(x).sum(), x)
    a = x.detach().double().abs().numpy()
    if curve is srgb_to_linear:
        straight, power = 1 / 12.92, 2.4 / 1.055 * ((a + 0.055) / 1.055) ** 1.4
    else:
        straight, power = 12.92, 1.055 / 2.4 * np.maximum(a, 1e-3) ** (1 / 2.4 - 1)
    at_knee = np.isclose(a, knee, rtol=1e-6)  # either one-sided slope will do there
    expected = np.where(at_knee, slope.numpy(), np.where(a < knee, straight, power))
    np.testing.assert_allclose(slope.numpy(), expected, rtol=2e-5)
    for s in slope[torch.from_numpy(at_knee)]:
        assert min(abs(s / straight - 1), abs(s / power[at_knee][0] - 1)) < 2e-5


@BOTH
def test_any_layout_will_do_in_pieces_that_fit_together_and_input_is_left_alone(curve) -> None:
    x = torch.linspace(-1, 2, 3 * 217 * 303).view(1, 3, 217, 303)  # more than one piece
    kept = x.clone()
    expected = torch.cat([curve(part) for part in x.flatten().split(20_000)]).view_as(x)
    for view, wanted in (
        (x, expected),
        (x.mT, expected.mT),
        (x.to(memory_format=torch.channels_last), expected),
        (x[..., ::2], expected[..., ::2]),
        (x.expand(2, 3, 217, 303), expected.expand(2, 3, 217, 303)),
    ):
        torch.testing.assert_close(curve(view), wanted, rtol=0, atol=1e-6)
    assert torch.equal(x, kept)
    assert (curve(x[:0]).shape, curve(x[0, 0, 0, 0]).shape) == ((0, 3, 217, 303), ())
    leaf, weight = x.clone().requires_grad_(), torch.linspace(-1, 1, x.numel()).view_as(x)
    (grad,) = torch.autograd.grad(curve(leaf), leaf, weight)
    (slope,) = torch.autograd.grad(curve(leaf).sum(), leaf)
    torch.testing.assert_close(grad, slope * weight)
    for values in (torch.zeros(3, dtype=torch.uint8), np.zeros(3)):
        with pytest.raises(TypeError, match="x must be a floating-point tensor"):
            curve(values)
