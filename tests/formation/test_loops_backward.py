"""Gradients by the compiled loops against PyTorch's in double precision, and who computes which.

The rounding of a sum grows with Σ|numbers|, whatever is left of them: a gradient that is summed up
over pixels is held against Σ|what each pixel adds|, which forward mode gives in double precision.
"""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from scenes import coefficients, rand, stepped
from torch import Tensor

import uwaug
from uwaug import Medium, PointSpread, fused
from uwaug.blur.plan import plan_blur
from uwaug.blur.stack import blurred
from uwaug.formation.loops import backend, backward

pytest.importorskip("numba")
pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit")  # of forward mode in torch itself

EPS = torch.finfo(torch.float32).eps
ROUNDINGS = 64
"""In a row, at a pixel: exponential, logarithm, Chebyshev series and the sum of the blurs."""

Picture = Callable[..., Tensor]


@pytest.fixture(autouse=True)
def by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(backend.VARIABLE, raising=False)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The gradients of the loops."""
    assert backend.ready(gradients=True)
    made: list[Any] = []
    adjoint = backend.loaded("adjoint")
    run = adjoint.slope_rows
    monkeypatch.setattr(adjoint, "slope_rows", lambda *a: (made.append(a), run(*a)))
    return made


def scene(
    batches: tuple[int, int, int] = (1, 1, 1),
    size: tuple[int, int] = (12, 16),
    shape: Any = "gaussian",
) -> tuple[list[Tensor], Picture]:
    """Image, distance and all of a medium, in double precision, and the picture made of them."""
    rows = batches[2]
    medium = Medium.stack([coefficients()] * rows)
    near = Medium.of_tensors(medium.tensors(), PointSpread(1.2, 0.8, shape), medium.notes)
    module = uwaug.Underwater(near, (0.05, 30.0), color_space="linear")

    def picture(image: Tensor, z: Tensor, *parts: Tensor) -> Tensor:
        law = PointSpread(parts[6], parts[7], shape)
        learned = Medium.of_tensors(parts[:6], law, medium.notes)
        return module.formed(image, z, None, learned, module.plan(size))

    law = torch.full((rows,), 1.2), torch.full((rows,), 0.8)
    maps = rand(batches[0], 3, *size), stepped(batches[1], 1, *size)
    return [t.double() for t in (*maps, *medium.tensors(), *law)], picture


def leaves(values: list[Tensor], dtype: torch.dtype = torch.float32) -> list[Tensor]:
    return [t.to(dtype).requires_grad_() for t in values]


def gradients(
    values: list[Tensor], picture: Picture, weights: Tensor, dtype: torch.dtype
) -> list[Tensor]:
    tracked = leaves(values, dtype)
    return list(torch.autograd.grad(picture(*tracked), tracked, weights.to(dtype)))


def summed(values: list[Tensor], picture: Picture, weights: Tensor, n: int) -> Tensor:
    """Σ|what each pixel adds| to the gradient of the n-th input."""
    each = torch.eye(values[n].numel(), dtype=torch.float64).reshape(-1, *values[n].shape)

    def alone(value: Tensor) -> Tensor:
        return picture(*values[:n], value, *values[n + 1 :])

    slopes = [torch.func.jvp(alone, (values[n],), (one,))[1] for one in each]
    return torch.stack([(weights * slope).abs().sum() for slope in slopes]).reshape(values[n].shape)


def assert_exact(
    ours: list[Tensor], values: list[Tensor], picture: Picture, weights: Tensor
) -> None:
    exact = gradients(values, picture, weights, torch.float64)
    for n, (one, other) in enumerate(zip(ours, exact, strict=True)):
        if n < 2:  # of image and distance: of a few pixels each
            limit = 8 * EPS * other.abs().max()
        else:
            limit = ROUNDINGS * EPS * summed(values, picture, weights, n)
        assert bool(((one - other).abs() <= limit).all()), n


@pytest.mark.parametrize(
    "batches, size, shape",
    [
        ((1, 1, 1), (40, 56), "gaussian"),
        ((2, 2, 2), (7, 300), "gaussian"),
        ((1, 2, 1), (130, 9), "exponential"),
        ((2, 1, 1), (20, 20), "exponential"),
    ],
)
def test_gradients(
    batches: tuple[int, int, int], size: tuple[int, int], shape: str, calls: list[Any]
) -> None:
    values, picture = scene(batches, size, shape)
    weights = torch.linspace(-1, 1, max(batches) * 3 * size[0] * size[1]).double().exp()
    weights = weights.reshape(-1, 3, *size)
    ours = gradients(values, picture, weights, torch.float32)
    assert len(calls) == max(batches)
    assert_exact(ours, values, picture, weights)
    assert len(calls) == max(batches)


@pytest.mark.parametrize("kept", [0, 1, 4, 8])
def test_what_needs_no_gradient_has_none_and_changes_none(kept: int) -> None:
    values, picture = scene()
    whole = gradients(values, picture, torch.ones(1, 3, 12, 16), torch.float32)
    tracked = [t.float().requires_grad_(n == kept) for n, t in enumerate(values)]
    picture(*tracked).sum().backward()
    assert [n for n, t in enumerate(tracked) if t.grad is not None] == [kept]
    assert torch.equal(tracked[kept].grad, whole[kept])


@pytest.mark.parametrize(
    "size, widths",
    [
        ((1, 1), (0.0, 9.0)),
        ((5, 40), (6.0, 70.0)),
        ((40, 270), (0.2, 1.2)),
        ((40, 270), (0.0, 70.0)),
    ],
)
def test_blurs_and_their_transpose(size: tuple[int, int], widths: tuple[float, float]) -> None:
    plan = plan_blur(*widths)
    image = rand(1, 3, *size).requires_grad_()
    stack = blurred(image, plan)
    by = rand(len(stack), size[0], 3, size[1], seed=1).float() - 0.5
    product = sum((one * g.transpose(0, 1)).sum() for one, g in zip(stack, by, strict=True))
    (expected,) = torch.autograd.grad(product, image)
    light = image.detach()[0].float()
    assert backend.ready(gradients=True)
    blurs, back = torch.empty_like(by), torch.zeros_like(light)
    backward.blur_all(light.numpy(), plan, blurs.numpy())
    backward.add_transposed(by.numpy(), plan, back.numpy())
    for one, other in zip(blurs, stack, strict=True):
        assert (one.transpose(0, 1) - other[0]).abs().max() < 2e-6
    assert (back - expected[0]).abs().max() <= 8 * EPS * expected.abs().max()


def test_threads_do_not_change_bits() -> None:
    values, picture = scene(size=(300, 260))
    threads, found = torch.get_num_threads(), []
    try:
        for count in (1, 2, 4):
            torch.set_num_threads(count)
            tracked = leaves(values)
            result = picture(*tracked)
            found.append((result, *torch.autograd.grad(result.sum(), tracked)))
    finally:
        torch.set_num_threads(threads)
    for other in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], other, strict=True))


def test_gradients_of_gradients() -> None:
    values, picture = scene()
    found = []
    for dtype in (torch.float32, torch.float64):
        tracked = leaves(values, dtype)
        first = torch.autograd.grad(picture(*tracked).square().sum(), tracked, create_graph=True)
        norm = sum((t.square().sum() for t in first), torch.zeros((), dtype=dtype))
        found.append(torch.autograd.grad(norm, tracked))
    for one, other in zip(*found, strict=True):
        assert (one - other).abs().max() <= 1e-4 * other.abs().max()


def test_backward_twice_and_many_gradients_at_once() -> None:
    values, picture = scene()
    tracked = leaves(values)
    result = picture(*tracked)
    once, again = (torch.autograd.grad(result.sum(), tracked, retain_graph=True) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(once, again, strict=True))
    many = torch.stack([torch.ones_like(result), result.detach()])
    together = torch.autograd.grad(result, tracked, many, is_grads_batched=True)
    for n, weights in enumerate(many):
        assert_exact([t[n] for t in together], values, picture, weights.double())


def test_the_rest_is_by_pytorch(calls: list[Any]) -> None:
    values, picture = scene()
    image, *others = (t.float() for t in values)

    def of_image(x: Tensor) -> Tensor:
        return picture(x, *others).sum()

    ours = torch.func.grad(of_image)(image)
    torch.func.jvp(of_image, (image,), (image,))
    with fused.use(False):
        of_image(image.clone().requires_grad_()).backward()
    assert not calls
    weights = torch.ones(1, 3, 12, 16, dtype=torch.float64)
    (exact, *_) = gradients(values, picture, weights, torch.float64)
    assert (ours - exact).abs().max() <= 8 * EPS * exact.abs().max()
