import itertools
import math

import numpy as np
import pytest
import torch
from referees import reference
from refusing import refusals
from scenes import SIZES, constant, rand

from uwaug import Medium, PointSpread, form_image
from uwaug.blur import banded
from uwaug.blur.banded import Node, along_columns, along_rows, operator
from uwaug.blur.plan import NO_BLUR, BlurPlan, plan_blur
from uwaug.blur.stack import varying_blur

RANGES = [(0.9, 4.5), (0.75, 15.0), (2.0, 60.0)]


@pytest.mark.parametrize("low, high", RANGES)
def test_decibels_of_an_image_that_is_all_forward_scatter(motorcycle, low, high) -> None:
    # T_β = 0 and T_G = 1 leave nothing but the blur, by the path that form_image takes without
    # gradients
    image, z = motorcycle.linear, motorcycle.distance
    exponent = math.log(high / low) / math.log(float(z.max() / z.min()))
    law = PointSpread(low / float(z.min()) ** exponent, exponent)
    medium = Medium.from_coefficients((1e3,) * 3, (0,) * 3, (0,) * 3, b_mean=1.0, point_spread=law)
    at = torch.randperm(z.numel(), generator=torch.Generator().manual_seed(1))[:4000]
    sigma = law.scale * z[0].numpy() ** exponent
    exact = reference.varying_gaussian(image.numpy(), sigma, at.numpy())
    for tolerance, decibel in ((0.002, 60), (0.0005, 70)):
        result = form_image(image.float(), z.float(), medium, tolerance=tolerance).forward
        assert reference.psnr(result.flatten(1)[:, at], exact) >= decibel


@pytest.mark.parametrize("sigma", [0.2, 0.5, 0.7, 1.0, 2.0, 16.0])
@pytest.mark.parametrize("shape", ["gaussian", "exponential"])
def test_one_width_for_the_whole_image(shape, sigma) -> None:
    image = reference.picture(60, 80)
    exact = getattr(reference, shape)(image, sigma)
    x = torch.from_numpy(image)[None]
    result = constant(x, sigma, plan_blur(sigma, sigma, 0.002, shape))
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
    spread = constant(impulse, sigma, plan_blur(0.0, 2.0, 0.0005))[0, 0]
    offsets = torch.arange(-20.0, 21.0, dtype=torch.float64)
    assert float(spread.sum()) == pytest.approx(1, abs=1e-3)
    for axis in (0, 1):
        variance = float((spread.sum(axis) * offsets**2).sum())
        assert variance == pytest.approx(sigma**2, rel=0.06, abs=0.02)


@pytest.mark.parametrize("size", [*SIZES, (500, 741)])
@pytest.mark.parametrize("low, high", [*RANGES, (0.0, 3.0), (100.0, 3000.0)])
def test_a_constant_image_stays_constant(size, low, high) -> None:
    sigma = (low + (high - low) * rand(1, 1, *size)).float()
    result = varying_blur(torch.full((1, 3, *size), 0.7), sigma, plan_blur(low, high))
    assert (result - 0.7).abs().max() < 1e-5


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("sigma", [0.0, 0.8, 2.5, 7.0, 60.0, 5000.0])
def test_small_and_odd_sizes(size, sigma) -> None:
    image = reference.picture(*size)
    exact = reference.gaussian(image, sigma)
    x = torch.from_numpy(image)[None]
    result = constant(x, sigma, plan_blur(sigma, sigma, 0.0005))[0]
    assert np.abs(result.numpy() - exact).max() < 0.004
    if 1 < sigma < 10:  # on the image's grid
        plan = BlurPlan(sigma, sigma, (sigma,), (1.0,), ((1.0,),), reach=8.0, error=1e-3)
        np.testing.assert_allclose(constant(x, sigma, plan)[0], exact, rtol=0, atol=1e-12)


@pytest.mark.parametrize("low, high", [*RANGES, (0.0, 3.0)])
@pytest.mark.parametrize("tolerance", [0.002, 0.0005])
def test_float32_is_close_to_float64(low, high, tolerance) -> None:
    image, sigma = rand(1, 3, 90, 70), low + (high - low) * rand(1, 1, 90, 70, seed=1)
    plan = plan_blur(low, high, tolerance)
    double = varying_blur(image, sigma, plan)
    single = varying_blur(image.float(), sigma.float(), plan)
    assert single.dtype == torch.float32
    assert (single.double() - double).abs().max() < 2e-5


@pytest.mark.parametrize("low, high", [(0.2, 1.4), (1.0, 9.0), (0.1, 30.0)])
def test_gradcheck(low, high) -> None:
    image = rand(2, 1, 3, 5).requires_grad_()
    sigma = (low + (high - low) * (0.1 + 0.8 * rand(2, 1, 3, 5, seed=1))).requires_grad_()
    plan = plan_blur(low, high, 0.01)
    for check in (torch.autograd.gradcheck, torch.autograd.gradgradcheck):
        assert check(lambda x, s: varying_blur(x, s, plan), (image, sigma))


IMAGE, SIGMA = torch.rand(2, 3, 6, 8), torch.rand(2, 1, 6, 8)
BATCHES = IMAGE, SIGMA.repeat(2, 1, 1, 1)[:3]
test_wrong_values_are_refused = refusals(
    (varying_blur, IMAGE, SIGMA * math.nan, NO_BLUR, "sigma"),
    (varying_blur, IMAGE, -SIGMA, NO_BLUR, "sigma"),
    (varying_blur, IMAGE, SIGMA + math.inf, NO_BLUR, "sigma"),
    (varying_blur, IMAGE, SIGMA[..., :4], NO_BLUR, "sigma"),
    (varying_blur, IMAGE, SIGMA[0, 0], NO_BLUR, "sigma"),
    (varying_blur, IMAGE, SIGMA.expand(-1, 3, -1, -1), NO_BLUR, "sigma"),
    (varying_blur, *BATCHES, NO_BLUR, "sigma"),
    (varying_blur, IMAGE[0], SIGMA, NO_BLUR, "image"),
    error=ValueError,
)
test_wrong_types_are_refused = refusals(
    (varying_blur, (IMAGE * 255).byte(), SIGMA, NO_BLUR, "image"),
    (varying_blur, IMAGE.numpy(), SIGMA, NO_BLUR, "image"),
    (varying_blur, IMAGE, 2.0, NO_BLUR, "sigma"),
    error=TypeError,
)


def test_varying_blur_of_an_empty_batch() -> None:
    nothing = varying_blur(IMAGE[:0], SIGMA[:0], NO_BLUR)
    assert nothing.shape == (0, 3, 6, 8)


# ---- the matrices


@pytest.mark.parametrize("cell", [1.0, 2.0, 16 / 7, 16 / 5, 8.0, 16.0, 48.0])
def test_products_and_adjoints_are_those_of_the_whole_matrix(cell) -> None:
    node = Node(1.4 if cell == 1 else 1.3 * cell, cell, 3.0)
    where = torch.float64, torch.device("cpu")
    for size, axis in itertools.product((1, 7, 16, 33, 130), (0, 1)):
        for kind in ("blur",) if cell == 1 else ("halve", "shrink", "enlarge"):
            matrix = operator(kind, axis, size, node, *where)
            transpose = operator(kind, axis, size, node, *where, adjoint=True)
            columns = transpose.rows
            # a slice: neither the first nor all of its storage
            x = torch.rand(columns + 5, 6, dtype=torch.float64)[3 : 3 + columns]
            whole = along_rows(matrix, x)
            dense = along_rows(matrix, torch.eye(columns, dtype=torch.float64))
            turned = along_columns(matrix, x.t().contiguous())
            torch.testing.assert_close(whole, dense @ x, rtol=0, atol=1e-12)
            torch.testing.assert_close(turned, whole.t(), rtol=0, atol=1e-12)
            back = along_rows(transpose, whole)
            torch.testing.assert_close(back, dense.t() @ whole, rtol=0, atol=1e-12)


def test_operators_are_made_once_and_take_no_more_than_their_budget() -> None:
    operators, most = banded._CACHE, 0
    for size in range(100, 1100, 7):
        for cell in (1.0, 16 / 5, 16.0):
            node = Node(1.3 * cell, cell, 3.0)
            for kind in ("blur",) if cell == 1 else ("halve", "shrink", "enlarge"):
                arguments = (kind, 1, size, node, torch.float64, torch.device("cpu"))
                assert operator(*arguments) is operator(*arguments)
                most = max(most, operators.held)
    assert most <= operators.budget
