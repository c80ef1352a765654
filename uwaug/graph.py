"""The model written for a graph: plain tensor operations, few and large, for any batch, height and width.

Same equations, plan and matrices as `uwaug.formation`, `uwaug.blur` and `uwaug.banded`, which work in strips, blocks
and caches that a graph has no room for. `uwaug.onnx.check_onnx` holds what is exported against them.
"""

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from uwaug.banded import (
    MARGIN,
    PERIOD,
    blur_kernel,
    enlarge_kernels,
    per_cell,
    reflect,
    shrink_kernels,
)
from uwaug.blur import BlurPlan, ends
from uwaug.colour import linear_to_srgb, srgb_to_linear
from uwaug.medium import FARTHEST, Medium
from uwaug.module import Underwater

PARAMETERS = ("beta", "direct_weights", "G", "signal_weights", "veil_weights", "b_mean", "scale", "exponent")


def parameters_of(medium: Medium) -> dict[str, Tensor]:
    """What a file exported with `parameters="inputs"` takes, by name; each with a row for every medium.

    Shapes: beta (B, K), direct_weights (B, 3, K), G (B, L), signal_weights and veil_weights (B, 3, L), b_mean, scale
    and exponent (B,); all float32.
    """
    law = medium.point_spread
    rows = [torch.as_tensor(v).expand(len(medium)) for v in (law.scale, law.exponent)]
    return {n: v.detach().to("cpu", torch.float32).contiguous() for n, v in zip(PARAMETERS, (*medium.tensors(), *rows))}


class Graph(nn.Module):
    """An `Underwater` module as a function of tensors alone: image, distance, then the field and the parameters if
    those are inputs.
    """

    def __init__(self, module: Underwater, plan: BlurPlan, *, frozen: bool, field: bool, quantised: bool) -> None:
        super().__init__()
        self.plan, self.frozen, self.field, self.quantised = plan, frozen, field, quantised
        self.srgb = module.color_space == "srgb"
        medium = module.medium.to(torch.float64)
        law = medium.point_spread
        self.reference_size = law.reference_size
        # a known exponent makes a simpler graph
        self.power = law.exponent if frozen and not isinstance(law.exponent, Tensor) else None
        self.blurs = nn.ModuleList(_blur(s, c, plan.reach) for s, c in zip(plan.sigmas, plan.cells))
        values = parameters_of(medium)
        rates, weights = _curves(*list(values.values())[:5])
        for name, value in {**values, "rates": rates, "weights": weights}.items():
            self.register_buffer(name, value)

    def forward(self, image: Tensor, distance: Tensor, *rest: Tensor) -> Tensor:
        """Image (Bx3xHxW) and distance (Bx1xHxW) → image."""
        inputs = list(rest)
        z = distance.clamp(0.0, FARTHEST)
        if self.field:
            z = z * inputs.pop(0)
        if self.frozen:
            rates, weights = self.get_buffer("rates"), self.get_buffer("weights")
            b_mean, scale, exponent = (self.get_buffer(name) for name in PARAMETERS[5:])
        else:
            rates, weights = _curves(*inputs[:5])
            b_mean, scale, exponent = inputs[5:]
        j = image.to(torch.float32) / 255 if self.quantised else image
        j = srgb_to_linear(j) if self.srgb else j
        b, h, w = z.shape[0], z.shape[2], z.shape[3]
        decay = torch.exp(-rates[:, :, None] * z.reshape(b, 1, h * w))
        transmission, share, veil = ((weights[i] @ decay).reshape(b, 3, h, w) for i in range(3))
        stack = [blur(j) for blur in self.blurs]
        scattered = stack[0]
        if len(stack) > 1:
            shares = self._shares(z, b_mean, scale, exponent)
            scattered = shares[:, :1] * stack[0]
            for k in range(1, len(stack)):
                scattered = scattered + shares[:, k : k + 1] * stack[k]
        result = transmission * j + share * scattered + veil
        result = linear_to_srgb(result) if self.srgb else result
        return torch.round(result * 255).clamp(0.0, 255.0).to(torch.uint8) if self.quantised else result

    def _shares(self, z: Tensor, b_mean: Tensor, scale: Tensor, exponent: Tensor) -> Tensor:
        """Weights of the plan's blurs, BxKxHxW: see `uwaug.blur.node_weights`."""
        plan = self.plan
        b, h, w = z.shape[0], z.shape[2], z.shape[3]
        degree = len(plan.coefficients[0]) - 1
        coefficients = torch.tensor(plan.coefficients, dtype=torch.float32)
        if degree == 0:
            return coefficients[None, :, :, None]
        b_mean, scale, exponent = (v.reshape(-1, 1, 1, 1) for v in (b_mean, scale, exponent))
        if self.reference_size is not None:
            scale = scale * (torch.minimum(_number(h), _number(w)) / self.reference_size)
        lengths = (b_mean * z).clamp(1e-6, 1e4)
        power = exponent if self.power is None else self.power
        low, high = ends(plan)
        slope = (2 if plan.shape == "exponential" else 1) / (high - low)
        if plan.shape == "exponential":
            x = 2 * scale * lengths**power
        else:
            squared = lengths * lengths
            x = (2 * scale * scale) * (squared if self.power == 1 else squared**power)
        x = torch.log1p(x) * slope + (slope * math.log(0.5) - (low + high) / (high - low))  # v, see node_weights
        x = x.clamp(-1, 1)
        twice = 2 * x
        terms = [torch.ones_like(x), x]
        for _ in range(degree - 1):
            terms.append(twice * terms[-1] - terms[-2])  # Chebyshev
        return (coefficients @ torch.cat(terms, 1).reshape(b, degree + 1, h * w)).reshape(b, len(coefficients), h, w)


def _curves(beta: Tensor, direct: Tensor, G: Tensor, signal: Tensor, veil: Tensor) -> tuple[Tensor, Tensor]:
    """Rates (B, K + L + 1), and weights (3, B, 3, K + L + 1) that make T_β, T_G − T_β and V(0) − V of e^(−rate·z).

    The last rate is 0 and carries V(0).
    """
    none, nothing = torch.zeros_like(direct), torch.zeros_like(signal)
    total = veil.sum(-1, keepdim=True)
    rates = torch.cat([beta, G, torch.zeros_like(beta[:, :1])], 1)
    rows = (
        torch.cat([direct, nothing, torch.zeros_like(total)], 2),
        torch.cat([-direct, signal, torch.zeros_like(total)], 2),
        torch.cat([none, -veil, total], 2),
    )
    return rates, torch.stack(rows)


def _number(side: int) -> Tensor:
    """A size as a tensor: the quotient of two symbolic numbers would enter a graph in single precision."""
    return torch.full((1,), side, dtype=torch.float64).to(torch.float32)


def _blur(sigma: float, cell: float, reach: float) -> nn.Module:
    """One blur of the stack."""
    if sigma == 0:
        return nn.Identity()
    return (_Fine if cell == 1 else _Coarse if cell <= PERIOD else _Wide)(sigma, cell, reach)


class _Fine(nn.Module):
    """On the image's own grid: one convolution along each axis."""

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        self.register_buffer("kernel", blur_kernel(sigma, reach).to(torch.float32))

    def forward(self, x: Tensor) -> Tensor:
        margin = self.get_buffer("kernel").shape[1] // 2
        for axis in (2, 3):
            x = _strided(_extended(x, -margin, x.shape[axis] + margin, axis), self.get_buffer("kernel"), 1, axis)
        return x


class _Coarse(nn.Module):
    """On a grid of whole cells for every `PERIOD` px: one strided convolution along each axis and back, with a channel
    for each cell of a period, or each px.
    """

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        a, q = per_cell(cell)
        self.cells = a * (PERIOD // q)
        first, kernel = shrink_kernels(torch.arange(-MARGIN, self.cells - MARGIN), self.cells, PERIOD, sigma, reach)
        self.first = int(first[0])
        self.register_buffer("shrink", _windows(first, kernel))
        self.register_buffer("enlarge", _windows(*enlarge_kernels(torch.arange(PERIOD), self.cells, PERIOD)))

    def forward(self, x: Tensor) -> Tensor:
        shrink, enlarge = self.get_buffer("shrink"), self.get_buffer("enlarge")
        more = -(-enlarge.shape[1] // self.cells) - 1  # periods of cells that the last px need beyond their own
        sizes = x.shape
        for axis in (2, 3):
            # one to spare: torch.export assumes that a free size is not 1
            last = (sizes[axis] + PERIOD - 1) // PERIOD + more
            end = self.first + PERIOD * last + shrink.shape[1]
            x = _strided(_extended(x, self.first, end, axis), shrink, PERIOD, axis)
        for axis in (3, 2):
            x = _strided(x, enlarge, self.cells, axis).narrow(axis, 0, sizes[axis])
        return x


class _Wide(nn.Module):
    """On a grid with cells of several periods: dense matrices, which are small; the kernel may exceed the image."""

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        self.pitch = round(cell)
        first, kernel = shrink_kernels(torch.zeros(1, dtype=torch.int64), 1, self.pitch, sigma, reach)
        self.first = int(first[0])
        self.register_buffer("shrink", kernel.to(torch.float32))
        starts, spline = enlarge_kernels(torch.arange(self.pitch), 1, self.pitch)
        self.starts: list[int] = starts.tolist()
        self.register_buffer("enlarge", spline.to(torch.float32))

    def forward(self, x: Tensor) -> Tensor:
        (shrink_rows, enlarge_rows), (shrink_columns, enlarge_columns) = (self._matrices(n) for n in x.shape[-2:])
        x = (shrink_rows @ x) @ shrink_columns.t()
        return enlarge_rows @ (x @ enlarge_columns.t())

    def _matrices(self, size: int) -> tuple[Tensor, Tensor]:
        """(cells, size) and (size, cells)."""
        kernel = self.get_buffer("shrink")
        cells = (size + self.pitch - 1) // self.pitch + 2 * MARGIN  # of positive numbers: ONNX's division truncates
        first = self.first + self.pitch * torch.arange(-MARGIN, cells - MARGIN)
        taps = torch.arange(size + kernel.shape[1])[: kernel.shape[1]]  # by way of the size, lest the file hold them
        columns = reflect(first[:, None] + taps, size)
        shrink = torch.zeros(cells, size, dtype=torch.float32).scatter_add(1, columns, kernel.expand(cells, -1))
        px = torch.arange(size)
        pitch = torch.full((1,), self.pitch, dtype=torch.int64)
        within = torch.remainder(px, pitch)
        first = torch.tensor(self.starts)[within] + (px - within) // pitch + MARGIN
        enlarge = torch.zeros(size, cells, dtype=torch.float32)
        return shrink, enlarge.scatter_add(1, first[:, None] + torch.arange(4), self.get_buffer("enlarge")[within])


def _windows(first: Tensor, kernel: Tensor) -> Tensor:
    """(n, taps) kernels that begin at `first` as rows of one window that begins at the first of them."""
    offset = first - first[0]
    rows = torch.zeros(len(first), int(offset[-1]) + kernel.shape[1], dtype=torch.float64)
    return rows.scatter_(1, offset[:, None] + torch.arange(kernel.shape[1]), kernel).to(torch.float32)


def _extended(x: Tensor, first: int, end: int, axis: int) -> Tensor:
    """An axis from px `first` ≤ 0 to `end` ≥ its size, half-sample symmetric."""
    size = x.shape[axis]
    if axis == 2:
        return x.index_select(2, reflect(torch.arange(first, end), size))
    # to gather whole rows would copy them value by value
    left, right = (x.index_select(3, reflect(torch.arange(*range_), size)) for range_ in ((first, 0), (size, end)))
    return torch.cat([left, x, right], 3)


def _strided(x: Tensor, kernels: Tensor, stride: int, axis: int) -> Tensor:
    """The n kernels (n, taps) at every `stride` along an axis, their results in turn."""
    n, taps = kernels.shape
    weights = kernels.repeat(3, 1).reshape(3 * n, 1, *((taps, 1) if axis == 2 else (1, taps)))
    y = F.conv2d(x, weights, stride=(stride, 1) if axis == 2 else (1, stride), groups=3)
    if n == 1:
        return y
    y = torch.unflatten(y, 1, (3, n))
    return y.transpose(2, 3).flatten(2, 3) if axis == 2 else y.permute(0, 1, 3, 4, 2).flatten(3, 4)
