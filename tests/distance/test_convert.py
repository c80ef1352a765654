import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import rand

from uwaug.distance import along_ray, from_disparity, from_inverse, from_relative

NAN, INF = math.nan, math.inf
OF_EACH = 0.1 + rand(2, 1, 1, 1)


class TestFromRelative:
    @pytest.mark.parametrize(
        "near, far, gamma",
        [(0.5, 10, 5), (0.3, 0.7, 1), (0, 20, 0.5), (3, 3, 2), (OF_EACH, 1 + OF_EACH, 2 * OF_EACH)],
    )
    def test_is_the_formula(self, near, far, gamma) -> None:
        t = rand(2, 1, 5, 7)
        expected = near + (far - near) * t**gamma
        torch.testing.assert_close(from_relative(t, near, far, gamma), expected, rtol=1e-13, atol=0)

    def test_ends_are_exact_and_unknown_stays_unknown(self) -> None:
        for gamma in (0.3, 1.0, 6.0):
            z = from_relative(torch.tensor([[0.0, 1.0, NAN]]), 0.25, 2.0, gamma)
            expected = torch.tensor([[0.25, 2.0, NAN]])
            torch.testing.assert_close(z, expected, rtol=0, atol=0, equal_nan=True)

    @pytest.mark.parametrize("gamma", [0.25, 1.0, 3.0])
    def test_gradient_is_finite_at_zero_and_right_elsewhere(self, gamma) -> None:
        t = torch.tensor([[0.0, 1e-7, 0.3, 1.0]], dtype=torch.float64, requires_grad=True)
        (slope,) = torch.autograd.grad(from_relative(t, 1.0, 3.0, gamma).sum(), t)
        assert slope.isfinite().all()
        expected = 2 * gamma * np.array([0.3, 1.0]) ** (gamma - 1)
        np.testing.assert_allclose(slope[0, 2:].numpy(), expected, rtol=1e-12)
        interior = torch.tensor([[0.2, 0.7]], dtype=torch.float64, requires_grad=True)
        options = {"dtype": torch.float64, "requires_grad": True}
        others = [torch.tensor(value, **options) for value in (0.5, 4.0, gamma)]
        assert torch.autograd.gradcheck(from_relative, (interior, *others))

    def test_half_precision_is_taken_up(self) -> None:
        t = torch.tensor([[0.0, 0.5, 1.0]], dtype=torch.bfloat16)
        assert torch.equal(from_relative(t, 1.0, 10.0), torch.tensor([[1.0, 5.5, 10.0]]))


class TestFromInverse:
    @given(st.floats(0.1, 1e3), st.floats(-1e3, 1e3))
    @settings(deadline=None)
    def test_undoes_any_scale_and_shift_of_the_inverse_depth(self, scale, shift) -> None:
        z = 1 + 9 * rand(2, 6, 5)
        z[:, 0, 0], z[:, 3, 2] = 1.0, 10.0
        torch.testing.assert_close(from_inverse(scale / z + shift, 1.0, 10.0), z, rtol=1e-6, atol=0)

    def test_each_map_has_its_own_scale_and_limits(self) -> None:
        maps = torch.stack([rand(1, 4, 4), 50 * rand(1, 4, 4, seed=1) - 7])
        near = torch.tensor([1.0, 2.0]).view(2, 1, 1, 1)
        far = torch.tensor([5.0, 9.0]).view(2, 1, 1, 1)
        z = from_inverse(maps, near, far)
        for b in range(2):
            alone = from_inverse(maps[b], near[b].item(), far[b].item())
            torch.testing.assert_close(z[b], alone, check_dtype=False)
            assert z[b].min() == pytest.approx(near[b].item())
            assert z[b].max() == pytest.approx(far[b].item())
            assert z[b].argmin() == maps[b].argmax()

    def test_unknown_pixels_stay_out(self) -> None:
        z = from_inverse(torch.tensor([[NAN, 0.0, INF, 3.0, -INF, 1.0]]), 1.0, 4.0)
        expected = torch.tensor([[NAN, 4.0, NAN, 1.0, NAN, 2.0]])
        torch.testing.assert_close(z, expected, equal_nan=True)

    def test_far_may_be_open_water(self) -> None:
        z = from_inverse(torch.tensor([[0.0, 1.0, 2.0]]), 1.5, INF)
        assert torch.equal(z, torch.tensor([[INF, 3.0, 1.5]]))

    def test_gradients(self) -> None:
        inverse = rand(2, 3, 3).requires_grad_()
        assert torch.autograd.gradcheck(lambda v: from_inverse(v, 1.0, 4.0), inverse)
        holed = torch.tensor([[NAN, 0.0, 1.0, 3.0]], requires_grad=True)
        (slope,) = torch.autograd.grad(from_inverse(holed, 1.0, 4.0).nan_to_num().sum(), holed)
        assert slope.isfinite().all()


class TestFromDisparity:
    def test_is_the_formula(self) -> None:
        d = 100 * rand(1, 4, 5)
        z = from_disparity(d, 994.978, 0.193001, 31.086)
        np.testing.assert_allclose(z.numpy(), 994.978 * 0.193001 / (d.numpy() + 31.086), rtol=1e-14)

    def test_unknown(self) -> None:
        z = from_disparity(torch.tensor([[NAN, INF, -INF, 0.0, -3.0, -2.0, 8.0]]), 100.0, 0.5, 2.0)
        expected = torch.tensor([[NAN, NAN, NAN, 25.0, NAN, NAN, 5.0]])
        torch.testing.assert_close(z, expected, equal_nan=True)

    def test_gradient_is_finite_where_unknown(self) -> None:
        d = torch.tensor([[0.0, NAN, 2.0]], requires_grad=True)
        (slope,) = torch.autograd.grad(from_disparity(d, 4.0, 1.0).nan_to_num().sum(), d)
        assert torch.equal(slope, torch.tensor([[0.0, 0.0, -1.0]]))


class TestAlongRay:
    @pytest.mark.parametrize(
        "focal, centre", [(50.0, None), ((40.0, 60.0), None), (50.0, (3.5, 2.25))]
    )
    def test_is_the_length_of_the_ray(self, focal, centre) -> None:
        depth = 1 + rand(2, 1, 6, 9)
        z = along_ray(depth, focal, centre)
        fx, fy = focal if isinstance(focal, tuple) else (focal, focal)
        cx, cy = centre or (4.5, 3.0)
        for i, j in np.ndindex(6, 9):
            point = np.array([(j + 0.5 - cx) / fx, (i + 0.5 - cy) / fy, 1.0])
            expected = depth[:, 0, i, j] * np.linalg.norm(point)
            np.testing.assert_allclose(z[:, 0, i, j], expected, rtol=1e-14)

    def test_open_water_and_unknown_pass(self) -> None:
        z = along_ray(torch.tensor([[INF, NAN, 0.0]]), 4.0)
        torch.testing.assert_close(z, torch.tensor([[INF, NAN, 0.0]]), equal_nan=True)


ONE = torch.ones(1, 1)
HALF = 0.5 * ONE
SAYS_NOTHING = torch.arange(60.0).reshape(3, 1, 4, 5).index_fill(0, torch.tensor(1), 7.0)
ENDS = "near and far must be 0 <= near <= far < inf, got"
REFUSED = [
    (from_relative, (1.5 * ONE, 1.0, 2.0), r"t must lie in \[0, 1\], got 1.5 to 1.5: normalise"),
    (from_relative, (torch.tensor([[-0.1, NAN]]), 1.0, 2.0), "got -0.1 to -0.1"),
    (from_relative, (HALF, -1.0, 2.0), ENDS),
    (from_relative, (HALF, 2.0, 1.0), ENDS),
    (from_relative, (HALF, 1.0, INF), ENDS),
    (from_relative, (HALF, torch.tensor([1.0, NAN]).view(2, 1, 1), 3.0), ENDS),
    (from_relative, (HALF, 1.0, 2.0, 0.0), "gamma must be positive and finite, got 0"),
    (from_relative, (HALF, 1.0, 2.0, NAN), "gamma must be positive and finite, got nan"),
    (from_inverse, (SAYS_NOTHING, 1.0, 2.0), "vary within each map, got 1 of 3 const.*crop"),
    (from_inverse, (NAN * ONE, 1.0, 2.0), "inverse must vary within each map"),
    (from_inverse, (torch.eye(2), 0.0, 2.0), "must be 0 < near <= far"),
    (from_inverse, (torch.eye(2), 2.0, 1.0), "must be 0 < near <= far"),
    (from_inverse, (torch.eye(2), INF, INF), "must be 0 < near <= far"),
    (from_inverse, (torch.eye(2), NAN, 1.0), "must be 0 < near <= far"),
    (from_inverse, (torch.ones(2), 1.0, 2.0), r"must have shape \(\.\.\., H, W\), got \(2,\)"),
    (from_disparity, (ONE, 0.0, 1.0), "focal_px must be finite.*, got"),
    (from_disparity, (ONE, 1.0, NAN), "baseline_m must be finite.*, got"),
    (from_disparity, (ONE, 1.0, 1.0, NAN), "offset_px must be finite.*, got"),
    (along_ray, (ONE, -1.0), "focal_px must be finite and > 0, got"),
    (along_ray, (ONE, (1.0, 0.0)), "focal_px must be finite and > 0, got"),
    (along_ray, (ONE, 1.0, (NAN, 0.0)), "centre must be finite"),
    (along_ray, (ONE.int(), 1.0), r"floating-point tensor, got torch\.int32.*millimetres"),
]


@pytest.mark.parametrize("convert, arguments, message", REFUSED)
def test_refused(convert, arguments, message) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        convert(*arguments)
