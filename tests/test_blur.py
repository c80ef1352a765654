import math

import kornia
import numpy as np
import pytest
import reference
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from benchmarks.exact import blur_exact
from uwaug.blur.banded import PERIOD, along_columns, along_rows, operators, sampled_parameter
from uwaug.blur.plan import BlurPlan, plan_blur
from uwaug.blur.stack import varying_blur
from uwaug.formation import form_image
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

RANGES = [(0.9, 4.5), (0.75, 15.0), (2.0, 60.0)]
SIZES = [(1, 1), (1, 9), (9, 1), (2, 3), (7, 5), (33, 31), (64, 48)]


def node(sigma: float, cell: float = 1.0, reach: float = 4.0) -> BlurPlan:
    """One fixed blur."""
    return BlurPlan(sigma, sigma, (sigma,), (cell,), ((1.0,),), reach, 1e-3)


def blur(image: torch.Tensor, plan: BlurPlan, sigma: float = 1.0) -> torch.Tensor:
    return varying_blur(image, image.new_full((len(image), 1, *image.shape[-2:]), sigma), plan)


def constant(image: torch.Tensor, sigma: float, **kwargs: float) -> torch.Tensor:
    return varying_blur(image, image.new_full((len(image), 1, *image.shape[-2:]), sigma), **kwargs)


def rand(*shape: int, dtype: torch.dtype = torch.float64, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, dtype=dtype, generator=torch.Generator().manual_seed(seed))


def random_pixels(size: int) -> torch.Tensor:
    return torch.randperm(size, generator=torch.Generator().manual_seed(1))[:4000]


def nodes() -> list[tuple[float, float, float]]:
    """Every (width, cell, reach) that a range of plans uses, thinned out."""
    plans = [
        plan_blur(low, high, tolerance)
        for low, high in [*RANGES, (0.0, 8.0)]
        for tolerance in (0.002, 0.0005)
    ]
    used = sorted(
        {(s, c, p.reach) for p in plans for s, c in zip(p.sigmas, p.cells, strict=True) if s > 0}
    )
    return used[::6]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("sigma", [0.6, 1.0, 3.3, 25.0])
def test_exact_blur_is_scipys_at_constant_width(size, sigma) -> None:
    image = rand(2, *size)
    parameter = float(
        sampled_parameter(np.array(sigma))
    )  # of variance sigma²; sigma itself from 1 px on
    expected = gaussian_filter(
        image.numpy(), (0, parameter, parameter), mode="reflect", truncate=14
    )
    result = blur_exact(image, torch.full(size, sigma, dtype=torch.float64)).reshape(2, *size)
    np.testing.assert_allclose(result.numpy(), expected, rtol=0, atol=1e-12)


def test_exact_blur_reads_each_pixel_with_its_own_width() -> None:
    image, sigma = rand(3, 20, 26), 0.75 + 5 * rand(20, 26)
    at = torch.tensor([0, 25, 100, 519])
    expected = reference.varying_gaussian(image.numpy(), sigma.numpy(), at.numpy())
    np.testing.assert_allclose(blur_exact(image, sigma, at).numpy(), expected, rtol=0, atol=1e-12)
    assert blur_exact(image, sigma).shape == (3, 520)


def test_exact_blur_of_no_width_is_the_image() -> None:
    image = rand(3, 5, 7)
    assert torch.equal(blur_exact(image, torch.zeros(5, 7)).reshape(3, 5, 7), image)


@pytest.mark.parametrize("light", ["srgb", "linear"])
@pytest.mark.parametrize("low, high", RANGES)
def test_decibels_on_a_real_scene(motorcycle, light, low, high) -> None:
    image, z = getattr(motorcycle, light), motorcycle.distance[0]
    sigma = low + (high - low) * (z - z.min()) / (z.max() - z.min())
    at = random_pixels(z.numel())
    exact = reference.varying_gaussian(image.numpy(), sigma.numpy(), at.numpy())
    for tolerance, decibel in ((0.002, 60), (0.0005, 70)):
        plan = plan_blur(low, high, tolerance)
        result = varying_blur(image[None].float(), sigma[None, None].float(), plan)[0].flatten(1)[
            :, at
        ]
        assert reference.psnr(result, exact) >= decibel, f"tolerance {tolerance}: {plan}"


@pytest.mark.parametrize("low, high", RANGES)
def test_decibels_of_an_image_that_is_all_forward_scatter(motorcycle, low, high) -> None:
    # T_β = 0 and T_G = 1 leave nothing but the blur, by the path that form_image takes without gradients
    image, z = motorcycle.linear, motorcycle.distance
    exponent = math.log(high / low) / math.log(float(z.max() / z.min()))
    law = PointSpread(low / float(z.min()) ** exponent, exponent)
    medium = Medium.from_coefficients((1e3,) * 3, (0,) * 3, (0,) * 3, b_mean=1.0, point_spread=law)
    at = random_pixels(z.numel())
    exact = reference.varying_gaussian(
        image.numpy(), law.scale * z[0].numpy() ** exponent, at.numpy()
    )
    for tolerance, decibel in ((0.002, 60), (0.0005, 70)):
        result = form_image(image.float(), z.float(), medium, tolerance=tolerance).forward
        assert reference.psnr(result.flatten(1)[:, at], exact) >= decibel


@pytest.mark.parametrize("shape", ["gaussian", "exponential"])
@pytest.mark.parametrize(
    "low, high",
    [
        (0.0, 0.5),
        (0.0, 1.0),
        (0.0, 4.0),
        (0.6, 1.0),
        (2.0, 4.0),
        (0.9, 4.5),
        (0.75, 15.0),
        (2.0, 60.0),
        (0.0, 200.0),
    ],
)
def test_error_on_a_picture_is_the_predicted_one(shape, low, high) -> None:
    image = reference.picture(160, 200)
    for tolerance in (0.01, 0.002):
        plan = plan_blur(low, high, tolerance, shape)
        assert plan.error <= 0.6 * tolerance
        squares = []
        for sigma in np.geomspace(max(low, 0.2), high, 7):
            exact = getattr(reference, shape)(image, sigma)
            result = constant(torch.from_numpy(image)[None].float(), float(sigma), plan=plan)[0]
            squares.append(float(((result.double().numpy() - exact) ** 2).mean()))
        assert math.sqrt(np.mean(squares)) <= tolerance, f"{plan}: {np.sqrt(squares)}"
        assert math.sqrt(max(squares)) <= 2.5 * tolerance


@pytest.mark.parametrize("sigma", [0.2, 0.5, 0.7, 1.0, 2.0, 16.0])
@pytest.mark.parametrize("shape", ["gaussian", "exponential"])
def test_one_width_for_the_whole_image(shape, sigma) -> None:
    image = reference.picture(60, 80)
    exact = getattr(reference, shape)(image, sigma)
    x = torch.from_numpy(image)[None]
    result = constant(x, sigma, plan=plan_blur(sigma, sigma, 0.002, shape))
    assert reference.psnr(result[0], exact) >= 54
    # the same through a medium, whose widths happen to be a single number
    law = PointSpread(sigma, 1.0, shape)
    medium = Medium.from_coefficients((1e4,) * 3, (0,) * 3, (0,) * 3, b_mean=1.0, point_spread=law)
    assert reference.psnr(form_image(x, torch.ones(1, 1, 60, 80), medium).forward[0], exact) >= 54


@pytest.mark.parametrize("sigma", [0.1, 0.3, 0.5, 0.7, 1.0, 2.0])
def test_a_narrow_blur_has_the_variance_asked_for(sigma) -> None:
    # a sampled Gaussian of σ = .5 px has a variance of .215, one of .3 px hardly any
    impulse = torch.zeros(1, 1, 41, 41, dtype=torch.float64)
    impulse[..., 20, 20] = 1
    spread = constant(impulse, sigma, plan=plan_blur(0.0, 2.0, 0.0005))[0, 0]
    offsets = torch.arange(-20.0, 21.0, dtype=torch.float64)
    assert float(spread.sum()) == pytest.approx(1, abs=1e-3)
    for axis in (0, 1):
        assert float((spread.sum(axis) * offsets**2).sum()) == pytest.approx(
            sigma**2, rel=0.06, abs=0.02
        )


@pytest.mark.parametrize("shape", ["gaussian", "exponential"])
@pytest.mark.parametrize("low, high", [(0.0, 3.0), (0.9, 4.5), (0.75, 15.0), (2.0, 60.0)])
def test_one_blur_fewer_would_miss_the_tolerance(shape, low, high) -> None:
    # the error of a number of blurs does not depend on the tolerance it was planned for
    error = {}
    for tolerance in np.geomspace(0.5, 0.002, 70):
        plan = plan_blur(low, high, float(tolerance), shape)
        error[len(plan.sigmas)] = plan.error
    for tolerance in (0.01, 0.002):
        plan = plan_blur(low, high, tolerance, shape)
        fewer = [e for k, e in error.items() if 1 < k < len(plan.sigmas)]
        assert fewer
        assert min(fewer) > 0.48 * tolerance


def test_few_blurs_serve_a_wide_range() -> None:
    # Lagrange weights at Chebyshev nodes need 4, 7 and 9 for 60 dB; a linear interpolation in σ 8, and more than 16
    assert [len(plan_blur(low, high, 0.002).sigmas) for low, high in RANGES] == [4, 7, 8]


def test_wide_blurs_live_on_small_grids() -> None:
    plan = plan_blur(2.0, 60.0, 0.002)
    # pitches are 16/m or 16·m px, which costs no time: 8 instead of 10.7 px takes 3 % more for that blur
    assert all(0.5 < c / s <= 1 for s, c in zip(plan.sigmas, plan.cells, strict=True) if s > 4)


@pytest.mark.parametrize("dtype, tolerance", [(torch.float32, 1e-6), (torch.float64, 1e-13)])
@pytest.mark.parametrize("sigma", [1.0, 1.5, 4.1])
@pytest.mark.parametrize("size", [(7, 5), (20, 1), (64, 93)])
def test_a_full_resolution_blur_is_kornias(dtype, tolerance, sigma, size) -> None:
    image = rand(2, 3, *size, dtype=dtype)
    radius = math.ceil(4.0 * sigma)
    kernel = kornia.filters.get_gaussian_kernel1d(2 * radius + 1, sigma, dtype=torch.float64).to(
        dtype
    )
    padded = torch.from_numpy(
        np.pad(
            image.numpy(), ((0, 0), (0, 0), (radius, radius), (radius, radius)), mode="symmetric"
        )
    )
    twin = kornia.filters.filter2d_separable(padded, kernel, kernel, padding="valid")
    torch.testing.assert_close(blur(image, node(sigma)), twin, rtol=0, atol=tolerance)


@pytest.mark.parametrize("sigma, cell, reach", nodes())
def test_adjoint_of_every_node(sigma, cell, reach) -> None:
    plan = node(sigma, cell, reach)
    for size in [*SIZES, (130, 97)]:
        x, y = rand(1, 2, *size).requires_grad_(), rand(1, 2, *size, seed=1)
        blurred = blur(x, plan)
        (adjoint,) = torch.autograd.grad((blurred * y).sum(), x)
        torch.testing.assert_close((blurred * y).sum(), (x * adjoint).sum(), rtol=1e-12, atol=0)
        if cell == 1:
            torch.testing.assert_close(adjoint, blur(y, plan), rtol=0, atol=1e-13)


def test_adjoint_on_a_photograph() -> None:
    plan = plan_blur(0.75, 15.0)
    x, y = rand(1, 3, 500, 741).requires_grad_(), rand(1, 3, 500, 741, seed=1)
    sigma = 0.75 + 14.25 * rand(1, 1, 500, 741, seed=2)
    blurred = varying_blur(x, sigma, plan)
    (adjoint,) = torch.autograd.grad((blurred * y).sum(), x)
    torch.testing.assert_close((blurred * y).sum(), (x * adjoint).sum(), rtol=1e-12, atol=0)


@pytest.mark.parametrize("size", [*SIZES, (500, 741)])
@pytest.mark.parametrize("low, high", [*RANGES, (0.0, 3.0), (100.0, 3000.0)])
def test_a_constant_image_stays_constant(size, low, high) -> None:
    sigma = (low + (high - low) * rand(1, 1, *size)).float()
    result = varying_blur(torch.full((1, 3, *size), 0.7), sigma, plan_blur(low, high))
    assert (result - 0.7).abs().max() < 1e-5


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("sigma", [0.7, 2.0, 9.0, 40.0])
def test_light_is_neither_made_nor_lost(size, sigma) -> None:
    image = rand(1, 3, *size)
    before, after = image.mean((2, 3)), constant(image, sigma, tolerance=0.0005).mean((2, 3))
    torch.testing.assert_close(after, before, rtol=0, atol=1e-3)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(1, 40), st.integers(1, 40), st.floats(0, 30), st.floats(1, 40), st.floats(-3, 3))
def test_linear_in_the_image(height, width, low, more, factor) -> None:
    x, y = rand(2, 1, 1, height, width)
    sigma, plan = low + (more - 1) * rand(1, 1, height, width), plan_blur(low, low + more)
    both = varying_blur(x + factor * y, sigma, plan)
    torch.testing.assert_close(
        both,
        varying_blur(x, sigma, plan) + factor * varying_blur(y, sigma, plan),
        rtol=0,
        atol=1e-11,
    )


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(1, 30), st.integers(1, 30), st.floats(0.7, 50))
def test_turning_and_mirroring_the_image_turns_and_mirrors_the_blur(height, width, sigma) -> None:
    image = rand(1, 1, height, width)
    plan = plan_blur(sigma, sigma + 1)
    result = blur(image, plan, sigma)
    # not exactly: where a kernel of a coarse grid is cut depends on how its centre rounds
    torch.testing.assert_close(blur(image.mT, plan, sigma), result.mT, rtol=0, atol=1e-3)
    torch.testing.assert_close(
        blur(image.flip(2, 3), plan, sigma), result.flip(2, 3), rtol=0, atol=1e-3
    )


@pytest.mark.parametrize(
    "plan", [None, *(plan_blur(0.0, high) for high in (0.3, 1.0, 4.0, 60.0))], ids=str
)
def test_no_width_gives_the_image(plan) -> None:
    image = torch.from_numpy(reference.picture(40, 50))[None]
    assert reference.psnr(varying_blur(image, torch.zeros(1, 1, 40, 50), plan), image) >= 60


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("sigma", [300.0, 5000.0])
def test_a_huge_width_gives_the_mean(size, sigma) -> None:
    image = rand(1, 3, *size)
    result = constant(image, sigma, tolerance=0.0005)
    torch.testing.assert_close(
        result, image.mean((2, 3), keepdim=True).expand_as(image), rtol=0, atol=1e-3
    )


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("sigma", [0.8, 2.5, 7.0, 60.0])
def test_small_and_odd_sizes(size, sigma) -> None:
    image = reference.picture(*size)
    exact = reference.gaussian(image, sigma)
    result = constant(torch.from_numpy(image)[None], sigma, tolerance=0.0005)[0]
    assert np.abs(result.numpy() - exact).max() < 0.004


def test_each_image_of_a_batch_is_blurred_by_itself() -> None:
    images, sigma = rand(3, 2, 30, 41), 4 * rand(3, 1, 30, 41)
    plan = plan_blur(0.0, 4.0)
    together = varying_blur(images, sigma, plan)
    for image, s, result in zip(images, sigma, together, strict=True):
        torch.testing.assert_close(
            varying_blur(image[None], s[None], plan)[0], result, rtol=0, atol=1e-13
        )


def test_layout_does_not_matter() -> None:
    image, sigma = rand(2, 3, 24, 36), 5 * rand(2, 1, 24, 36)
    expected = varying_blur(image, sigma)
    for x in (
        image.contiguous(memory_format=torch.channels_last),
        image.mT.contiguous().mT,
        image.flip(3).flip(3),
    ):
        torch.testing.assert_close(varying_blur(x, sigma), expected, rtol=0, atol=1e-13)
    torch.testing.assert_close(
        varying_blur(image[:, :1].expand(-1, 3, -1, -1), sigma)[:, 2:],
        expected[:, :1],
        rtol=0,
        atol=1e-13,
    )


@pytest.mark.parametrize("low, high", [*RANGES, (0.0, 3.0)])
@pytest.mark.parametrize("tolerance", [0.002, 0.0005])
def test_float32_is_close_to_float64(low, high, tolerance) -> None:
    image, sigma = rand(1, 3, 90, 70), low + (high - low) * rand(1, 1, 90, 70, seed=1)
    plan = plan_blur(low, high, tolerance)
    double, single = (
        varying_blur(image, sigma, plan),
        varying_blur(image.float(), sigma.float(), plan),
    )
    assert single.dtype == torch.float32
    assert (single.double() - double).abs().max() < 2e-5


def test_autocast_changes_nothing() -> None:
    image, sigma = rand(1, 3, 40, 40).float(), 4 * rand(1, 1, 40, 40).float()
    expected = varying_blur(image, sigma)
    with torch.autocast("cpu", torch.bfloat16):
        result = varying_blur(image, sigma)
    torch.testing.assert_close(result, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("low, high", [(0.2, 1.4), (1.0, 9.0), (0.1, 30.0)])
def test_gradcheck(low, high) -> None:
    image = rand(2, 1, 5, 6).requires_grad_()
    sigma = (low + (high - low) * (0.1 + 0.8 * rand(2, 1, 5, 6, seed=1))).requires_grad_()
    plan = plan_blur(low, high, 0.01)
    assert torch.autograd.gradcheck(lambda x, s: varying_blur(x, s, plan), (image, sigma))
    assert torch.autograd.gradgradcheck(lambda x, s: varying_blur(x, s, plan), (image, sigma))


def test_gradient_of_the_width_is_that_of_the_exact_blur() -> None:
    image, at = reference.picture(48, 48), 1e-3
    for sigma in (0.3, 0.6, 1.0, 2.0, 4.0):
        wide, narrow = (reference.gaussian(image, math.sqrt(sigma**2 + s * at)) for s in (1, -1))
        slope = (wide - narrow) / (2 * at) * 2 * sigma  # dσ² = 2σ dσ
        width = torch.full((1, 1, 48, 48), sigma, dtype=torch.float64, requires_grad=True)
        varying_blur(
            torch.from_numpy(image)[None], width, plan_blur(0.0, 5.0, 0.0005)
        ).sum().backward()
        error = width.grad[0, 0].numpy() - slope.sum(0)
        assert np.sqrt((error**2).mean()) < 0.1 * np.sqrt((slope.sum(0) ** 2).mean())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_at_the_ends(dtype) -> None:
    plan = plan_blur(0.0, 8.0)
    sigma = torch.tensor([0.0, 1e-30, 8.0, 1e6], dtype=dtype).reshape(1, 1, 2, 2).requires_grad_()
    image = torch.rand(1, 3, 2, 2, dtype=dtype, requires_grad=True)
    varying_blur(image, sigma, plan).sum().backward()
    assert sigma.grad.isfinite().all()
    assert image.grad.isfinite().all()


def test_works_after_inference_mode() -> None:
    # matrices made and remembered in inference mode must serve training later
    image, plan = rand(1, 3, 19, 23).float(), plan_blur(0.7, 9.0, 0.0123)
    with torch.inference_mode():
        expected = blur(image, plan, 3.0)
    x = image.clone().requires_grad_()
    result = blur(x, plan, 3.0)
    result.sum().backward()
    assert torch.equal(result, expected)
    assert x.grad.isfinite().all()


def test_widths_outside_the_plan_get_the_nearer_end() -> None:
    image, plan = rand(1, 3, 40, 40), plan_blur(1.0, 4.0)
    for outside, end in ((0.0, 1.0), (9.0, 4.0)):
        torch.testing.assert_close(
            blur(image, plan, outside), blur(image, plan, end), rtol=0, atol=1e-12
        )


def test_no_blur_where_it_would_not_show() -> None:
    plan = plan_blur(0.0, 0.02)
    assert plan.sigmas == (0.0,)
    image = rand(1, 3, 8, 8)
    assert torch.equal(varying_blur(image, torch.full((1, 1, 8, 8), 0.02), plan), image)
    assert "no blur" in str(plan)


def test_plans_are_values() -> None:
    plan = plan_blur(0.9, 4.5, 0.002)
    assert plan == plan_blur(0.9, 4.5, 0.002)
    assert hash(plan) == hash(plan_blur(0.9, 4.5, 0.002))
    assert "4 blurs for σ 0.9…4.5 px" in str(plan)


def test_the_plan_says_what_it_achieves() -> None:
    # cutting the kernels and coarse grids count too
    image = reference.picture(128, 128)
    for low, high in [(2.0, 2.0), (5.0, 5.0), *RANGES]:
        plan = plan_blur(low, high)
        worst = 0.0
        for sigma in np.geomspace(low, high, 5):
            exact = reference.gaussian(image, sigma)
            worst = max(
                worst,
                10
                ** (
                    -reference.psnr(
                        constant(torch.from_numpy(image)[None], sigma, plan=plan)[0], exact
                    )
                    / 20
                ),
            )
        assert worst <= 3 * plan.error, str(plan)  # the plan's error is the RMS over the range


def test_widths_of_the_exponential_vary_too() -> None:
    image = reference.picture(60, 60)
    levels = np.array([1.0, 2.0, 4.0, 8.0])
    index = np.random.default_rng(0).integers(0, 4, (60, 60))
    exact = np.choose(index, [reference.exponential(image, s) for s in levels])
    result = varying_blur(
        torch.from_numpy(image)[None],
        torch.from_numpy(levels[index])[None, None],
        plan_blur(1.0, 8.0, 0.002, "exponential"),
    )
    assert reference.psnr(result[0], exact) >= 57


@pytest.mark.parametrize(
    "arguments, match",
    [
        ((-1.0, 2.0), "sigma_min.*-1"),
        ((3.0, 2.0), "sigma_min.*3.0 and 2.0"),
        ((0.0, math.inf), "sigma_max.*inf"),
        ((math.nan, 2.0), "sigma_min.*nan"),
        ((0.0, math.nan), "sigma_max.*nan"),
        ((0.0, 2.0, 0.0), r"tolerance.*\(0, 1\).*0"),
        ((0.0, 2.0, 1.0), "tolerance.*1"),
        ((0.0, 2.0, -0.1), "tolerance.*-0.1"),
        ((0.0, 2.0, math.nan), "tolerance.*nan"),
        ((0.0, 2.0, 0.002, "box"), "shape.*box"),
        ((1.0, 4.0, 1e-12), "tolerance 1e-12"),
    ],
)
def test_plan_rejects(arguments, match) -> None:
    with pytest.raises(ValueError, match=match):
        plan_blur(*arguments)


IMAGE, SIGMA = torch.rand(2, 3, 6, 8), torch.rand(2, 1, 6, 8)


def test_half_precision_is_computed_in_single() -> None:
    result = varying_blur(IMAGE.half(), SIGMA)
    assert result.dtype == torch.float16
    torch.testing.assert_close(
        result.float(), varying_blur(IMAGE.half().float(), SIGMA), rtol=0, atol=5e-4
    )


@pytest.mark.parametrize("plan", [None, plan_blur(0.0, 2.0)], ids=["planned", "given"])
@pytest.mark.parametrize(
    "image, sigma, error, match",
    [
        (IMAGE, SIGMA * math.nan, ValueError, "sigma"),
        (IMAGE, -SIGMA, ValueError, "sigma"),
        (IMAGE, SIGMA + math.inf, ValueError, "sigma"),
        (IMAGE, SIGMA[..., :4], ValueError, "sigma"),
        (IMAGE, SIGMA[0, 0], ValueError, "sigma"),
        (IMAGE, SIGMA.expand(-1, 3, -1, -1), ValueError, "sigma"),
        (IMAGE, SIGMA.repeat(2, 1, 1, 1)[:3], ValueError, "sigma"),
        (IMAGE[0], SIGMA, ValueError, "image"),
        ((IMAGE * 255).byte(), SIGMA, TypeError, "image"),
        (IMAGE.numpy(), SIGMA, TypeError, "image"),
        (IMAGE, 2.0, TypeError, "sigma"),
    ],
    ids=[
        "nan",
        "negative",
        "infinite",
        "size",
        "2-D",
        "channels",
        "batch",
        "3-D",
        "bytes",
        "array",
        "number",
    ],
)
def test_varying_blur_rejects(plan, image, sigma, error, match) -> None:
    with pytest.raises(error, match=match):
        varying_blur(image, sigma, plan)


def test_varying_blur_of_an_empty_batch() -> None:
    assert varying_blur(torch.rand(0, 3, 6, 8), torch.rand(0, 1, 6, 8)).shape == (0, 3, 6, 8)


@pytest.mark.parametrize("cell", [1.0, 2.0, 16 / 7, 16 / 5, 8.0, 16.0, 48.0])
def test_strips_are_parts_of_the_whole(cell) -> None:
    sigma = 1.4 if cell == 1 else 1.3 * cell
    for size in (1, 7, 15, 16, 17, 33, 70, 130):
        for axis in (0, 1):
            for matrix, transpose in operators(
                axis, size, sigma, cell, 3.0, torch.float64, torch.device("cpu")
            ):
                columns = transpose.rows
                # a slice: neither the first nor all of its storage
                x = torch.rand(columns + 5, 6, dtype=torch.float64)[3 : 3 + columns]
                whole = along_rows(matrix, x)
                dense = along_rows(matrix, torch.eye(columns, dtype=torch.float64))
                torch.testing.assert_close(whole, dense @ x, rtol=0, atol=1e-12)
                torch.testing.assert_close(
                    along_columns(matrix, x.t().contiguous()), whole.t(), rtol=0, atol=1e-12
                )
                torch.testing.assert_close(
                    along_rows(transpose, whole), dense.t() @ whole, rtol=0, atol=1e-12
                )
        if size > PERIOD:
            (*_, (last, back)) = operators(
                0, size, sigma, cell, 3.0, torch.float64, torch.device("cpu")
            )
            x = torch.rand(back.rows, 4, dtype=torch.float64)
            parts = [
                along_rows(last, x, first, first + 2 * PERIOD)
                for first in range(0, size, 2 * PERIOD)
            ]
            torch.testing.assert_close(torch.cat(parts), along_rows(last, x), rtol=0, atol=1e-12)


def test_plans_and_the_longest_side() -> None:
    for longest in (0, 0.5, math.inf, math.nan):
        with pytest.raises(ValueError, match="longest must be finite and ≥ 1"):
            plan_blur(1.0, 4.0, longest=longest)
    assert plan_blur(1.0, 4.0, longest=100) is plan_blur(1.0, 4.0, longest=5000)
    exponential = [
        plan_blur(3.0, 40.0, 0.002, "exponential", longest) for longest in (64, 300, 512, 2000)
    ]
    assert exponential[1] is exponential[2]
    assert max(exponential[0].sigmas) < 256 < max(exponential[-1].sigmas) < 2000


@pytest.mark.parametrize("height, width", [(32, 32), (40, 1500)])
def test_exponential_plans_hold_in_small_and_in_long_pictures(height, width) -> None:
    image = reference.picture(height, width)
    plan = plan_blur(2.0, 20.0, 0.002, "exponential", max(height, width))
    for sigma in (2.0, 6.0, 20.0):
        result = (
            constant(torch.from_numpy(image)[None].float(), sigma, plan=plan)[0].double().numpy()
        )
        assert np.sqrt(((result - reference.exponential(image, sigma)) ** 2).mean()) <= 0.002
