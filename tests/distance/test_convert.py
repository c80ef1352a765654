import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from refusing import refusals
from scenes import rand

from uwaug.distance import along_ray, from_disparity, from_inverse, from_relative

NAN, INF = math.nan, math.inf
OF_EACH = 0.1 + rand(2, 1, 1, 1)


@pytest.mark.parametrize(
    "near, far, gamma", [(0.5, 10, 5), (0, 20, 0.5), (3, 3, 2), (OF_EACH, 1 + OF_EACH, 2 * OF_EACH)]
)
def test_relative_is_the_formula(near, far, gamma) -> None:
    t = rand(2, 1, 5, 7)
    expected = near + (far - near) * t**gamma
    torch.testing.assert_close(from_relative(t, near, far, gamma), expected, rtol=1e-13, atol=0)


@pytest.mark.parametrize("gamma", [0.25, 1.0, 3.0])
def test_gradients_of_relative_are_right_and_finite_at_zero(gamma) -> None:
    options = {"dtype": torch.float64, "requires_grad": True}
    inside = [torch.tensor(value, **options) for value in ([[0.2, 0.7]], 0.5, 4.0, gamma)]
    assert torch.autograd.gradcheck(from_relative, inside)
    t = torch.tensor([[0.0, 1e-7]], **options)
    (slope,) = torch.autograd.grad(from_relative(t, 1.0, 3.0, gamma).sum(), t)
    assert slope.isfinite().all()


@given(st.floats(0.1, 1e3), st.floats(-1e3, 1e3))
def test_inverse_undoes_any_scale_and_shift(scale, shift) -> None:
    z = 1 + 9 * rand(2, 6, 5)
    z[:, 0, 0], z[:, 3, 2] = 1.0, 10.0
    torch.testing.assert_close(from_inverse(scale / z + shift, 1.0, 10.0), z, rtol=1e-6, atol=0)


def test_each_inverse_map_has_its_own_scale_and_limits() -> None:
    maps = torch.stack([rand(1, 4, 4), 50 * rand(1, 4, 4, seed=1) - 7])
    near, far = torch.tensor([[1.0, 2.0], [5.0, 9.0]]).view(2, 2, 1, 1, 1)
    z = from_inverse(maps, near, far)
    for b in range(2):
        alone = from_inverse(maps[b], near[b].item(), far[b].item())
        torch.testing.assert_close(z[b], alone, check_dtype=False)


def test_disparity_is_the_formula() -> None:
    d = 100 * rand(1, 4, 5)
    z = from_disparity(d, 994.978, 0.193001, 31.086)
    np.testing.assert_allclose(z.numpy(), 994.978 * 0.193001 / (d.numpy() + 31.086), rtol=1e-14)


@pytest.mark.parametrize("focal, centre", [((40.0, 60.0), None), (50.0, (3.5, 2.25))])
def test_along_ray_is_the_length_of_the_ray(focal, centre) -> None:
    depth = 1 + rand(2, 1, 6, 9)
    z = along_ray(depth, focal, centre)
    fx, fy = focal if isinstance(focal, tuple) else (focal, focal)
    cx, cy = centre or (4.5, 3.0)
    for i, j in np.ndindex(6, 9):
        point = np.array([(j + 0.5 - cx) / fx, (i + 0.5 - cy) / fy, 1.0])
        expected = depth[:, 0, i, j] * np.linalg.norm(point)
        np.testing.assert_allclose(z[:, 0, i, j], expected, rtol=1e-14)


@pytest.mark.parametrize(
    "convert, arguments, given, expected",
    [
        (from_relative, (0.25, 2.0, 0.3), [0.0, 1.0, NAN], [0.25, 2.0, NAN]),
        (from_relative, (0.25, 2.0, 6.0), [0.0, 1.0, NAN], [0.25, 2.0, NAN]),
        (from_inverse, (1.0, 4.0), [NAN, 0, INF, 3, -INF, 1], [NAN, 4, NAN, 1, NAN, 2]),
        (from_inverse, (1.5, INF), [0.0, 1.0, 2.0], [INF, 3.0, 1.5]),
        (from_disparity, (100.0, 0.5, 2.0), [NAN, INF, -INF, 0], [NAN, NAN, NAN, 25]),
        (from_disparity, (100.0, 0.5, 2.0), [-3, -2, 8], [NAN, NAN, 5]),
        (along_ray, (4.0,), [INF, NAN, 0.0], [INF, NAN, 0.0]),
    ],
)
def test_ends_are_exact_and_unknown_stays_unknown(convert, arguments, given, expected) -> None:
    for dtype in (torch.float32, torch.bfloat16):  # which is taken up
        z = convert(torch.tensor([given], dtype=dtype), *arguments)
        torch.testing.assert_close(z, torch.tensor([expected]).float(), equal_nan=True)


def test_gradients_of_inverse_and_disparity() -> None:
    inverse = rand(2, 3, 3).requires_grad_()
    assert torch.autograd.gradcheck(lambda v: from_inverse(v, 1.0, 4.0), inverse)
    assert torch.autograd.gradcheck(lambda v: from_disparity(v, 4.0, 1.0), 1 + inverse)
    # unknown pixels and open water spoil no other slope
    for convert, far in ((from_inverse, 4.0), (from_inverse, INF), (from_disparity, 4.0)):
        holed = torch.tensor([[NAN, 0.0, 1.0, 3.0]], requires_grad=True)
        z = convert(holed, 1.0, far)
        (slope,) = torch.autograd.grad(z[z.isfinite()].sum(), holed)
        assert slope.isfinite().all()
        assert (slope != 0).any()


ONE = torch.ones(1, 1)
HALF = 0.5 * ONE
EYE = torch.eye(2)
SAYS_NOTHING = torch.arange(60.0).reshape(3, 1, 4, 5).index_fill(0, torch.tensor(1), 7.0)
ENDS = "near and far must be 0 <= near <= far < inf, got"
test_what_is_refused = refusals(
    (from_relative, 1.5 * ONE, 1.0, 2.0, r"t must lie in \[0, 1\], got 1.5 to 1.5"),
    (from_relative, torch.tensor([[-0.1, NAN]]), 1.0, 2.0, "got -0.1 to -0.1"),
    (from_relative, HALF, 2.0, 1.0, ENDS),
    (from_relative, HALF, 1.0, INF, ENDS),
    (from_relative, HALF, torch.tensor([1.0, NAN]).view(2, 1, 1), 3.0, ENDS),
    (from_relative, HALF, 1.0, 2.0, 0.0, "gamma must be positive and finite, got 0"),
    (from_inverse, SAYS_NOTHING, 1.0, 2.0, "vary within each map, got 1 of 3 const"),
    (from_inverse, NAN * ONE, 1.0, 2.0, "inverse must vary within each map"),
    (from_inverse, EYE, 0.0, 2.0, "must be 0 < near <= far"),
    (from_inverse, EYE, INF, INF, "must be 0 < near <= far"),
    (from_inverse, torch.ones(2), 1.0, 2.0, r"must have shape \(\.\.\., H, W\), got \(2,\)"),
    (from_disparity, ONE, 0.0, 1.0, "focal_px must be finite"),
    (from_disparity, ONE, 1.0, NAN, "baseline_m must be finite"),
    (from_disparity, ONE, 1.0, 1.0, NAN, "offset_px must be finite"),
    (along_ray, ONE, (1.0, 0.0), "focal_px must be finite and > 0, got"),
    (along_ray, ONE, 1.0, (NAN, 0.0), "centre must be finite"),
    (along_ray, ONE.int(), 1.0, r"floating-point tensor, got torch\.int32.*millimetres"),
)
