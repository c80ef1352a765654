"""sRGB values, which files hold, and linear light, in which water works (IEC 61966-2-1)."""

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import ColorSpace

LUMINANCE = (0.2126, 0.7152, 0.0722)  # weights of the channels of linear sRGB (IEC 61966-2-1)
_MAX_SRGB = 16.0  # sRGB values above this are taken for a scale of 0…255
# sRGB values below this are taken for normalised ones, which reach −2.1 with ImageNet's numbers.
# Resampling and another gamut stay above.
_MIN_SRGB = -0.1

# Where the curve's two pieces meet. The standard prints 0.04045 and 0.0031308, rounded, which
# leaves a step of 3e-8 and makes the two functions inverse to each other only to that.
_SRGB_KNEE = 0.0404482362771076
_LINEAR_KNEE = _SRGB_KNEE / 12.92
_LARGEST = 1e30  # finite, so that infinity / m stays infinity
_LN2 = math.log(2)

_Kernel = Callable[..., Tensor]

# Values, 256 KiB in float32. Larger temporaries may go back to the system after each call, which
# takes 3 to 5 times as long.
_PIECE_SIZE = 1 << 16


def require_values(
    image: Tensor, color_space: ColorSpace, name: str = "image"
) -> tuple[float, float]:
    """Smallest and largest value; NaN, infinite values and sRGB outside −.1…16 are refused."""
    if not image.is_floating_point() or not image.numel() or torch.compiler.is_compiling():
        return 0.0, 1.0
    low, high = checks.finite(name, image)
    if color_space == "srgb" and high > _MAX_SRGB:
        cure = "divide a 0…255 image by 255; of light with highlights (HDR), clamp(0, 1)"
        raise ValueError(f"{name} reaches {high:g}: expected 0…1; {cure}")
    if color_space == "srgb" and low < _MIN_SRGB:
        raise ValueError(f"{name} falls to {low:g}: expected 0…1; place it before Normalize")
    return low, high


def decoded(image: Tensor, color_space: ColorSpace) -> Tensor:
    """Linear light in float32 or float64 of a picture: uint8 (0…255), or floating point (0…1)."""
    if image.dtype == torch.uint8:
        unit = image.to(torch.float32) / 255
    else:
        unit = image.to(torch.promote_types(image.dtype, torch.float32))
    return unit if color_space == "linear" else srgb_to_linear(unit)


def headroom(image: Tensor) -> float | Tensor:
    """Largest sRGB value of a result: 1, or that of a brighter picture (HDR), (B, 1, 1, 1)."""
    if image.dtype == torch.uint8:
        return 1.0
    if checks.on_host(image) and float(image.detach().amax()) <= 1:
        return 1.0
    return image.detach().amax((-3, -2, -1), keepdim=True).clamp(min=1)


def encoded(
    light: Tensor, color_space: ColorSpace, dtype: torch.dtype, largest: float | Tensor
) -> Tensor:
    """The inverse of `decoded`: sRGB is clipped to 0…`largest`, linear light never is."""
    values = light
    if color_space == "srgb":
        values = _encode_positive(light) if torch.compiler.is_compiling() else linear_to_srgb(light)
        if isinstance(largest, Tensor):
            values = torch.minimum(values.clamp(min=0.0), largest)
        else:
            values = values.clamp(0.0, largest)  # an integer beside a float cannot be exported
    if dtype == torch.uint8:
        return (values * 255).round().clamp(0, 255).to(torch.uint8)
    return values.to(dtype)


def luminance(image: Tensor, color_space: ColorSpace) -> Tensor:
    """Picture (…x1xHxW) of the luminance of the light of another (…x3xHxW), of its type."""
    light = decoded(image, color_space)
    grey = (light * light.new_tensor(LUMINANCE)[:, None, None]).sum(-3, keepdim=True)
    return encoded(grey, color_space, image.dtype, headroom(image))


def srgb_to_linear(x: Tensor) -> Tensor:
    """Decode sRGB values to linear light: x/12.92 up to 0.04045, ((x + 0.055)/1.055)^2.4 above.

    Elementwise on a floating-point tensor of any shape; odd, f(−x) = −f(x); 0 and 1 stay exactly 0
    and 1. Half precision is computed in float32, within 1e-6 of the formula (IEC 61966-2-1:1999).
    Gradients are finite everywhere.

    Examples:
        >>> import torch
        >>> srgb_to_linear(torch.tensor([0.0, 0.5, 1.0]))
        tensor([0.0000, 0.2140, 1.0000])
    """
    return _apply(x, _decode, _decode_, _decode_grad)


def linear_to_srgb(x: Tensor) -> Tensor:
    """Encode linear light as sRGB values: 12.92·x up to 0.0031308, 1.055·x^(1/2.4) − 0.055 above.

    The inverse of `srgb_to_linear`, with its convention, types, precision and source.

    Examples:
        >>> import torch
        >>> linear_to_srgb(torch.tensor([0.0, 0.5, 1.0]))
        tensor([0.0000, 0.7354, 1.0000])
    """
    return _apply(x, _encode, _encode_, _encode_grad)


# The curves are (x/m)·curve(m) with m = max(|x|, knee): the straight piece is a constant
# curve(m)/m, the odd extension is free, and no branch left out can spoil a gradient. exp and log1p
# are exact where a power is 1, at white.
def _decode(x: Tensor) -> Tensor:
    m = x.abs().clamp(_SRGB_KNEE, _LARGEST)
    return x / m * torch.exp(torch.log(m * (1 / 1.055) + 0.055 / 1.055) * 2.4)


def _encode(x: Tensor) -> Tensor:
    m = x.abs().clamp(_LINEAR_KNEE, _LARGEST)
    return x / m * (1.055 * (torch.exp(torch.log(m) * (1 / 2.4)) - 1) + 1)


def _encode_positive(x: Tensor) -> Tensor:
    """What clips negative values needs no odd extension: from the knee on the line lies above."""
    m = x.clamp(min=_LINEAR_KNEE)
    return torch.minimum(12.92 * x, 1.055 * torch.exp(torch.log(m) * (1 / 2.4)) - 0.055)


# The same for eager mode: in place on pieces that stay in the cache, with x alone kept for the
# backward pass, where the straight piece's slope is the power piece's at another place. This takes
# half of the time of other ways (benchmarks/CHOICES.md).
_DECODE_STRAIGHT = 1.055 * (1.055 / (2.4 * 12.92)) ** (1 / 1.4) - 0.055
_ENCODE_STRAIGHT = (2.4 * 12.92 / 1.055) ** (-2.4 / 1.4)


def _decode_(x: Tensor) -> Tensor:
    m = x.abs().clamp_(_SRGB_KNEE, _LARGEST)
    curve = m.sub(1).mul_(1 / 1.055).log1p_().mul_(2.4 / _LN2).exp2_()
    return m.reciprocal_().mul_(x).mul_(curve)


def _encode_(x: Tensor) -> Tensor:
    m = x.abs().clamp_(_LINEAR_KNEE, _LARGEST)
    power = m.sub(1).log1p_().mul_(1 / 2.4 / _LN2).exp2_()
    return m.reciprocal_().mul_(x).mul_(power.lerp_(power.new_ones(()), -0.055))


def _decode_grad(x: Tensor, grad: Tensor) -> Tensor:
    m = torch.threshold(x.abs(), _SRGB_KNEE, _DECODE_STRAIGHT)
    power = m.sub_(1).mul_(1 / 1.055).log1p_().mul_(1.4 / _LN2)
    return power.add_(math.log2(2.4 / 1.055)).exp2_() * grad


def _encode_grad(x: Tensor, grad: Tensor) -> Tensor:
    m = torch.threshold(x.abs(), _LINEAR_KNEE, _ENCODE_STRAIGHT)
    power = m.sub_(1).log1p_().mul_(-1.4 / 2.4 / _LN2)
    return power.add_(math.log2(1.055 / 2.4)).exp2_() * grad


def _piecewise(kernel: _Kernel, *inputs: Tensor) -> Tensor:
    x = inputs[0]
    dense = x.device.type == "cpu" and all(v.is_contiguous() for v in inputs)
    if not dense or x.numel() <= _PIECE_SIZE or torch.is_grad_enabled():
        return kernel(*inputs)
    result = torch.empty_like(x)
    count = -(-x.numel() // _PIECE_SIZE)
    flat = (v.view(-1).chunk(count) for v in (result, *inputs))
    for piece, *parts in zip(*flat, strict=True):
        piece.copy_(kernel(*parts))
    return result


class _Curve(torch.autograd.Function):
    """A curve whose slope is a function of its input."""

    generate_vmap_rule = True  # for torch.func

    @staticmethod
    def forward(x: Tensor, value: _Kernel, slope: _Kernel) -> Tensor:
        return _piecewise(value, x)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, _Kernel, _Kernel], output: Tensor) -> None:
        x, _, ctx.slope = inputs
        ctx.save_for_backward(x)
        ctx.save_for_forward(x)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None]:
        return _piecewise(ctx.slope, *ctx.saved_tensors, grad), None, None

    @staticmethod
    def jvp(ctx: Any, tangent: Tensor, *_: None) -> Tensor:
        return _piecewise(ctx.slope, *ctx.saved_tensors, tangent)


def _apply(x: Tensor, traced: _Kernel, value: _Kernel, slope: _Kernel) -> Tensor:
    checks.floating("x", x, ", nominally in [0, 1]: divide by 255 first?")
    v = x.float() if x.dtype.itemsize < 4 else x
    if torch.compiler.is_compiling():
        # a compiler fuses and differentiates the plain formula; autograd functions make it warn
        return traced(v).to(x.dtype)
    y: Tensor = _Curve.apply(v, value, slope)  # type: ignore[no-untyped-call]
    return y.to(x.dtype)
