"""Gradients by the compiled loops against PyTorch's in double precision, and who computes which."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from forming import coefficients, distances
from inputs import rand
from torch import Tensor

import uwaug
from uwaug import Medium, PointSpread, fused
from uwaug.blur.plan import plan_blur
from uwaug.blur.stack import blurred
from uwaug.formation.demand import blur_demand
from uwaug.formation.loops import blurring, loops, recorded, switch

pytestmark = pytest.mark.skipif(not switch._is_found(), reason="numba is not installed")

LAW = ("scale", "exponent")


@pytest.fixture(autouse=True)
def by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(switch.VARIABLE, raising=False)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The pictures of the loops."""
    found: list[Any] = []
    run = recorded._Recorded.forward
    told = lambda ctx, *given: (found.append(given), run(ctx, *given))[1]  # noqa: E731
    monkeypatch.setattr(recorded._Recorded, "forward", staticmethod(told))
    return found


def leaves(
    batches: tuple[int, int, int], size: tuple[int, int], shape: str = "gaussian"
) -> tuple[list[Tensor], Callable[..., Tensor]]:
    """Image, distance and all of a medium, and the picture made of them."""
    medium = Medium.stack([coefficients()] * batches[2])
    given = [
        rand(batches[0], 3, *size),
        distances(batches[1], 1, *size),
        *medium.tensors(),
        torch.full((batches[2],), 1.2),
        torch.full((batches[2],), 0.8),
    ]
    law = PointSpread(1.2, 0.8, shape)
    near = Medium.of_tensors(medium.tensors(), law, medium.notes)
    range_m = (0.05, 30.0)
    module = uwaug.Underwater(near, range_m, color_space="linear")

    def picture(image: Tensor, z: Tensor, *parts: Tensor) -> Tensor:
        spread = PointSpread(parts[6], parts[7], shape)
        learned = Medium.of_tensors(parts[:6], spread, medium.notes)
        return module.formed(image, z, None, learned, module.plan(size))

    return given, picture


def gradients(
    given: list[Tensor], picture: Callable[..., Tensor], dtype: torch.dtype
) -> list[Tensor]:
    tracked = [t.detach().to(dtype).requires_grad_() for t in given]
    result = picture(*tracked)
    weights = torch.linspace(-1, 1, result.numel(), dtype=dtype).reshape(result.shape).exp()
    return list(torch.autograd.grad(result, tracked, weights))


@pytest.mark.parametrize("shape", ["gaussian", "exponential"])
@pytest.mark.parametrize(
    "batches, size",
    [((1, 1, 1), (40, 56)), ((2, 2, 2), (7, 300)), ((1, 2, 1), (130, 9)), ((2, 1, 1), (20, 20))],
)
def test_gradients_are_those_of_double_precision(
    batches: tuple[int, int, int], size: tuple[int, int], shape: str, calls: list[Any]
) -> None:
    given, picture = leaves(batches, size, shape)
    exact = gradients(given, picture, torch.float64)
    assert not calls
    ours = gradients(given, picture, torch.float32)
    assert len(calls) == 1
    for n, (one, other) in enumerate(zip(ours, exact, strict=True)):
        # of image and distance; then sums over all pixels, of which much cancels
        most = 1e-6 if n < 2 else 5e-4
        assert (one - other).abs().max() <= most * other.abs().max()


@pytest.mark.parametrize("kept", range(10))
def test_each_alone(kept: int) -> None:
    """What needs no gradient has none, and changes none."""
    given, picture = leaves((1, 1, 1), (24, 40))
    whole = gradients(given, picture, torch.float32)
    tracked = [t.float().detach().requires_grad_(n == kept) for n, t in enumerate(given)]
    result = picture(*tracked)
    weights = torch.linspace(-1, 1, result.numel()).reshape(result.shape).exp()
    result.backward(weights)
    for n, t in enumerate(tracked):
        assert (t.grad is None) == (n != kept)
    found = tracked[kept].grad
    assert found is not None
    torch.testing.assert_close(found, whole[kept], rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("widths", [(0.2, 1.2), (0.0, 9.0), (6.0, 70.0)])
@pytest.mark.parametrize("size", [(1, 1), (5, 40), (40, 270)])
def test_blurs_and_their_transpose(size: tuple[int, int], widths: tuple[float, float]) -> None:
    plan = plan_blur(*widths)
    image = rand(1, 3, *size).double().requires_grad_()
    stack = blurred(image, plan)
    by = rand(len(stack), size[0], 3, size[1], seed=1).float() - 0.5
    product = sum((one * g.transpose(0, 1)).sum() for one, g in zip(stack, by, strict=True))
    (expected,) = torch.autograd.grad(product, image)
    light = image.detach()[0].float()
    assert loops.ready(gradients=True)
    blurs, back = torch.empty_like(by), torch.zeros_like(light)
    blurring.blur_all(light.numpy(), plan, blurs.numpy())
    blurring.add_transposed(by.numpy(), plan, back.numpy())
    for one, other in zip(blurs, stack, strict=True):
        assert (one.transpose(0, 1) - other[0]).abs().max() < 2e-6
    assert (back - expected[0]).abs().max() <= 1e-6 * expected.abs().max()
    # ⟨Bx, y⟩ = ⟨x, Bᵀy⟩
    there, here = (blurs.double() * by).sum(), (light.double() * back).sum()
    assert abs(there - here) <= 1e-6 * (blurs * by).abs().sum()


def test_threads_do_not_change_bits() -> None:
    medium = coefficients().to(torch.float32)
    image, z = rand(1, 3, 300, 260).float(), distances(1, 1, 300, 260).float()
    plan = blur_demand(medium, (0.2, 8.0), 0.01).plan((300, 260))
    assert recorded.records(image, z, medium, plan)
    tracked = [t.detach().requires_grad_() for t in (image, z, *medium.tensors())]
    learned = Medium.of_tensors(tracked[2:], medium.point_spread, ())
    threads = torch.get_num_threads()
    found = []
    try:
        for count in (1, 2, 4):
            torch.set_num_threads(count)
            result = recorded.recorded(tracked[0], tracked[1], learned, plan)
            found.append((result, *torch.autograd.grad(result.sum(), tracked)))
    finally:
        torch.set_num_threads(threads)
    for other in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], other, strict=True))


def test_gradients_of_gradients() -> None:
    given, picture = leaves((1, 1, 1), (12, 16))
    found = []
    for dtype in (torch.float32, torch.float64):
        tracked = [t.detach().to(dtype).requires_grad_() for t in given]
        first = torch.autograd.grad(picture(*tracked).square().sum(), tracked, create_graph=True)
        norm = sum((t.square().sum() for t in first), torch.zeros((), dtype=dtype))
        found.append(torch.autograd.grad(norm, tracked))
    for one, other in zip(*found, strict=True):
        assert (one - other).abs().max() <= 1e-4 * other.abs().max()


def test_backward_twice() -> None:
    given, picture = leaves((1, 2, 1), (12, 16))
    tracked = [t.float().detach().requires_grad_() for t in given]
    result = picture(*tracked)
    once, again = (torch.autograd.grad(result.sum(), tracked, retain_graph=True) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(once, again, strict=True))


def test_many_gradients_at_once() -> None:
    given, picture = leaves((1, 1, 1), (12, 16))
    tracked = [t.float().detach().requires_grad_() for t in given]
    result = picture(*tracked)
    many = torch.stack([torch.ones_like(result), result.detach()])
    together = torch.autograd.grad(result, tracked, many, True, is_grads_batched=True)
    for n, one in enumerate(many):
        alone = torch.autograd.grad(result, tracked, one, True)
        for ours, theirs in zip(together, alone, strict=True):
            assert (ours[n] - theirs).abs().max() <= 3e-5 * theirs.abs().max()


@pytest.mark.filterwarnings("ignore:.*torch.jit")  # of torch itself
def test_the_rest_is_by_pytorch(calls: list[Any]) -> None:
    given, picture = leaves((1, 1, 1), (12, 16))
    image, *others = [t.float() for t in given]

    def of_image(x: Tensor) -> Tensor:
        return picture(x, *others).sum()

    expected = torch.func.grad(of_image)(image)
    torch.func.jvp(of_image, (image,), (image,))
    tracked = image.clone().requires_grad_()
    with fused.use(False):
        of_image(tracked).backward()
    assert not calls
    again = image.clone().requires_grad_()
    of_image(again).backward()
    assert len(calls) == 1
    torch.testing.assert_close(tracked.grad, expected)
    torch.testing.assert_close(again.grad, expected, rtol=1e-5, atol=1e-6)
