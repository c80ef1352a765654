"""Execution of a plan: the stack of fixed blurs, and the mixture of them at each pixel."""

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.blur.banded import HALF, Kind, Node, along_columns, along_rows, operator
from uwaug.blur.plan import V_FLOOR, BlurPlan, place_line


def varying_blur(image: Tensor, sigma: Tensor, plan: BlurPlan) -> Tensor:
    """Blur every pixel with a Gaussian of its own width; edges are half-sample symmetric.

    Args:
        image (BxCxHxW tensor): floating point, any scale; half precision is computed in float32.
        sigma (Bx1xHxW tensor): widths, px, finite, ≥ 0.
        plan: from `plan_blur`; widths outside of its range get the nearer end.

    Returns:
        (BxCxHxW) tensor of the image's dtype, differentiable in both.

    Raises:
        TypeError, ValueError: if types, sizes or a width do not suit.
    """
    _validate(image, sigma)
    if image.numel() == 0 or sigma.numel() == 0:
        return image.clone() if len(sigma) else image[:0].clone()
    dtype = torch.promote_types(torch.promote_types(image.dtype, sigma.dtype), torch.float32)
    with checks.full_precision(image):
        widths = sigma.to(dtype)
        return mixed(blurred(image.to(dtype), plan), node_weights(widths, plan)).to(image.dtype)


def _validate(image: Tensor, sigma: Tensor) -> None:
    checks.floating("image", image)
    checks.floating("sigma", sigma)
    if image.ndim != 4:
        raise ValueError(f"image must have shape (B, C, H, W), got {tuple(image.shape)}")
    if sigma.ndim != 4 or sigma.shape[1] != 1:
        raise ValueError(f"sigma must have shape (B, 1, H, W), got {tuple(sigma.shape)}")
    checks.same_size("sigma", sigma, image)
    checks.batches({"image": len(image), "sigma": len(sigma)})
    if torch.compiler.is_compiling() or not sigma.numel():
        return
    low, high = checks.extent(sigma)
    if not (low >= 0 and high < math.inf):
        raise ValueError(f"sigma must be finite and ≥ 0 px everywhere, got {low:g}…{high:g}")


def mixed(stack: list[Tensor], weights: Tensor) -> Tensor:
    """Sum Σ_k weights[:, k]·stack[k] of K images (BxCxHxW) with weights (BxKxHxW)."""
    shares = torch.split(weights, 1, 1)  # gradients of slices would each fill all K with zeros
    total = shares[0] * stack[0]
    for share, image in zip(shares[1:], stack[1:], strict=True):
        total.addcmul_(share, image)
    return total


def node_weights(sigma: Tensor, plan: BlurPlan) -> Tensor:
    """Weights (BxKxHxW), with sum 1 over K, of a plan's K blurs for widths σ (Bx1xHxW, px, ≥ 0)."""
    coefficients = sigma.new_tensor(plan.coefficients)
    if coefficients.shape[1] == 1:
        return coefficients[:, :, None].expand(len(sigma), -1, *sigma.shape[-2:])
    slope, offset = place_line(plan)
    x = (sigma if plan.shape == "exponential" else sigma * sigma) * (1 / V_FLOOR)
    places = torch.log1p(x).mul_(slope).add_(offset).clamp(-1, 1)
    return _series(coefficients, places)


def _series(coefficients: Tensor, x: Tensor) -> Tensor:
    """Values (BxKxHxW) of K Chebyshev series (KxN) at places (Bx1xHxW)."""
    # by their recurrence, T_n = 2x·T_(n−1) − T_(n−2)
    twice = 2 * x
    terms = [torch.ones_like(x), x]
    while len(terms) < coefficients.shape[1]:
        terms.append((twice * terms[-1]).sub_(terms[-2]))
    b, _, h, w = x.shape
    powers = torch.cat(terms[: coefficients.shape[1]], 1).reshape(b, -1, h * w)
    return (coefficients[None] @ powers).reshape(b, -1, h, w)


@torch.library.custom_op("uwaug::node_blur", mutates_args=())
def _node_blur(
    x: Tensor, h: int, w: int, sigma: float, cell: float, reach: float, adjoint: bool
) -> Tensor:
    """Apply one blur of a stack for pictures of h × w px, or its adjoint, to x (H, N, W).
    torch.compile keeps it whole.
    """
    return _products(x.contiguous(), Node(sigma, cell, reach), (h, w), adjoint)


@_node_blur.register_fake
def _(x: Tensor, h: int, w: int, sigma: float, cell: float, reach: float, adjoint: bool) -> Tensor:
    # one that halves ends on the half picture, one on a coarser grid begins there
    if cell != 1 and (sigma == 0) != adjoint:
        h, w = (h + 1) // 2, (w + 1) // 2
    return x.new_empty(h, x.shape[1], w)


def _remember(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    ctx.arguments = inputs[1:]


def _node_blur_backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
    *arguments, adjoint = ctx.arguments
    return _node_blur(gradient, *arguments, not adjoint), *[None] * 6


_node_blur.register_autograd(_node_blur_backward, setup_context=_remember)


class _Blur(torch.autograd.Function):
    """`_node_blur` for torch.func, which differentiates no operators of ours."""

    @staticmethod
    def forward(x: Tensor, *arguments: Any) -> Any:
        blur: Tensor = _node_blur(x, *arguments)
        return blur

    setup_context = staticmethod(_remember)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        *arguments, adjoint = ctx.arguments
        return _applied(gradient, *arguments, not adjoint), *[None] * 6

    @staticmethod
    def jvp(ctx: Any, tangent: Tensor, *_: None) -> Tensor:
        return _applied(tangent, *ctx.arguments)

    @staticmethod
    def vmap(info: Any, in_dims: Any, x: Tensor, *arguments: Any) -> tuple[Tensor, int]:
        x = x.movedim(in_dims[0], 1)
        h, batch, n, w = x.shape
        result = _applied(x.reshape(h, -1, w), *arguments)
        return result.reshape(len(result), batch, n, -1), 1


_applied: Callable[..., Tensor] = _Blur.apply


def _products(x: Tensor, node: Node, size: tuple[int, int], adjoint: bool) -> Tensor:
    """Apply the matrices of one blur of a stack, in the order of the fewest operations."""
    order: list[tuple[int, Kind]] = [(0, "blur"), (1, "blur")]
    if node == HALF:
        order = [(0, "halve"), (1, "halve")]
    elif node.cell != 1:
        order = [(0, "shrink"), (1, "shrink"), (1, "enlarge"), (0, "enlarge")]
    for axis, kind in reversed(order) if adjoint else order:
        matrix = operator(kind, axis, size[axis], node, x.dtype, x.device, adjoint)
        h, n, w = x.shape
        if axis == 0:
            x = along_rows(matrix, x.reshape(h, n * w)).reshape(-1, n, w)
        else:
            x = along_columns(matrix, x.reshape(h * n, w)).reshape(h, n, -1)
    return x


def blurred(image: Tensor, plan: BlurPlan) -> list[Tensor]:
    """Blurs of a batch by a plan: K tensors like `image` (BxCxHxW), differentiable."""
    b, c, h, w = image.shape
    of_node = _applied if torch._C._are_functorch_transforms_active() else _node_blur
    x = half = image.permute(2, 0, 1, 3).reshape(h, b * c, w)
    if max(plan.cells) > 1:
        half = of_node(x, h, w, *HALF, False)
    stack = []
    for sigma, cell in zip(plan.sigmas, plan.cells, strict=True):
        source = x if cell == 1 else half
        blur = of_node(source, h, w, sigma, cell, plan.reach, False) if sigma > 0 else x
        stack.append(blur.reshape(h, b, c, w).permute(1, 2, 0, 3))
    return stack
