"""The model as one graph for any batch, height and width: what `uwaug.onnx` exports.

Curves, width law, weights and sum are the package's own functions. Of its own a graph has the
blurs: `uwaug.blur` works in strips, blocks and caches that a graph has no room for.
`uwaug.onnx.check_onnx` holds what is exported against them.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from uwaug.blur.kernels import (
    MARGIN,
    PERIOD,
    blur_kernel,
    enlarge_kernels,
    per_cell,
    reflect,
    shrink_kernels,
)
from uwaug.blur.plan import BlurPlan
from uwaug.colour import from_light, to_light
from uwaug.exposure import exposed_sums
from uwaug.formation import scattered, together
from uwaug.light.lit import Lit, lit_of, seen
from uwaug.module import Underwater
from uwaug.optics.curves import FARTHEST, Sums
from uwaug.optics.medium import Medium

__all__ = ["Graph", "parameters_of"]


def parameters_of(medium: Medium) -> dict[str, Tensor]:
    """What a file exported with `parameters="inputs"` takes, by name: `Medium.parameters` in
    float32.
    """
    return {
        name: value.detach().to("cpu", torch.float32).contiguous()
        for name, value in medium.parameters().items()
    }


class Graph(nn.Module):
    """An `Underwater` module as a function of tensors alone: image, distance, then the field and
    the parameters if those are inputs.
    """

    rates: Tensor
    weights: Tensor

    def __init__(
        self, module: Underwater, plan: BlurPlan, *, frozen: bool, field: bool, quantised: bool
    ) -> None:
        super().__init__()
        self.plan = plan
        self.frozen = frozen
        self.field = field
        self.quantised = quantised
        self.color_space = module.color_space
        self.exposure = module.exposure
        self.medium = module.medium.map(lambda t: t.detach().to("cpu", torch.float32))
        self.blurs = nn.ModuleList(
            _blur(sigma, cell, plan.reach)
            for sigma, cell in zip(plan.sigmas, plan.cells, strict=True)
        )
        # exact_at_lens=False: ONNX has no e^x − 1
        rates, weights, _ = self.medium.sums(exact_at_lens=False)
        self.light = module.light and module.light.map(lambda t: t.detach().to("cpu"))
        self.legs, self.camera = module.legs, module.camera
        self.register_buffer("rates", rates)
        self.register_buffer("weights", weights)

    def forward(self, image: Tensor, distance: Tensor, *rest: Tensor) -> Tensor:
        """Image (Bx3xHxW) and distance (Bx1xHxW) → image."""
        inputs = list(rest)
        z, field = distance.clamp(0.0, FARTHEST), None
        if self.field:
            # either is limited first: a graph cannot refuse, and 0·inf is NaN
            field = inputs.pop(0).clamp(0.0, FARTHEST)
            z = z * field
        if self.frozen:
            medium, sums = self.medium, Sums(self.rates, self.weights, None)
        else:
            medium = Medium.of(
                dict(zip(self.medium.parameters(), inputs, strict=True)), self.medium
            )
            sums = medium.sums(exact_at_lens=False)
        light = to_light(image, self.color_space)
        sums = exposed_sums(light, z, sums, self.exposure)
        found = seen(sums, z, self._lit(distance, field, medium))
        stack = [blur(light) for blur in self.blurs]
        (result,) = together(
            light, found, scattered(stack, z, medium, self.plan, (z.shape[2], z.shape[3]))
        )
        return from_light(result, self.color_space, image)

    def _lit(self, distance: Tensor, field: Tensor | None, medium: Medium) -> Lit | None:
        """The light on the scene; None for daylight as the medium has it."""
        legs = None if self.legs is None else self.legs()
        lit = lit_of(self.light, distance, field, medium, *self.camera, legs)
        if lit is None or isinstance(self.exposure, str):
            return lit and lit.whole()
        return lit.whole().brightened(medium.beta.new_full((1,), 2.0**self.exposure))


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
            x = _strided(
                _extended(x, -margin, x.shape[axis] + margin, axis),
                self.get_buffer("kernel"),
                1,
                axis,
            )
        return x


class _Coarse(nn.Module):
    """On a grid of whole cells for every `PERIOD` px: one strided convolution along each axis and
    back, with a channel for each cell of a period, or each px.
    """

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        a, q = per_cell(cell)
        self.cells = a * (PERIOD // q)
        first, kernel = shrink_kernels(
            torch.arange(-MARGIN, self.cells - MARGIN), self.cells, PERIOD, sigma, reach
        )
        self.first = int(first[0])
        self.register_buffer("shrink", _windows(first, kernel))
        self.register_buffer(
            "enlarge", _windows(*enlarge_kernels(torch.arange(PERIOD), self.cells, PERIOD))
        )

    def forward(self, x: Tensor) -> Tensor:
        shrink, enlarge = self.get_buffer("shrink"), self.get_buffer("enlarge")
        more = (
            -(-enlarge.shape[1] // self.cells) - 1
        )  # periods of cells that the last px need beyond their own
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
    """On a grid with cells of several periods: dense matrices, which are small; the kernel may
    exceed the image.
    """

    def __init__(self, sigma: float, cell: float, reach: float) -> None:
        super().__init__()
        self.pitch = round(cell)
        first, kernel = shrink_kernels(
            torch.zeros(1, dtype=torch.int64), 1, self.pitch, sigma, reach
        )
        self.first = int(first[0])
        self.register_buffer("shrink", kernel.to(torch.float32))
        starts, spline = enlarge_kernels(torch.arange(self.pitch), 1, self.pitch)
        self.starts: list[int] = starts.tolist()
        self.register_buffer("enlarge", spline.to(torch.float32))

    def forward(self, x: Tensor) -> Tensor:
        (shrink_rows, enlarge_rows), (shrink_columns, enlarge_columns) = (
            self._matrices(n) for n in x.shape[-2:]
        )
        x = (shrink_rows @ x) @ shrink_columns.t()
        return enlarge_rows @ (x @ enlarge_columns.t())

    def _matrices(self, size: int) -> tuple[Tensor, Tensor]:
        """(cells, size) and (size, cells)."""
        kernel = self.get_buffer("shrink")
        cells = (
            size + self.pitch - 1
        ) // self.pitch + 2 * MARGIN  # of positive numbers: ONNX's division truncates
        first = self.first + self.pitch * torch.arange(-MARGIN, cells - MARGIN)
        # derived from `size`, so that the exporter computes the indices at run time instead of
        # storing them
        taps = torch.arange(size + kernel.shape[1])[: kernel.shape[1]]
        columns = reflect(first[:, None] + taps, size)
        shrink = torch.zeros(cells, size, dtype=torch.float32).scatter_add(
            1, columns, kernel.expand(cells, -1)
        )
        px = torch.arange(size)
        pitch = torch.full((1,), self.pitch, dtype=torch.int64)
        within = torch.remainder(px, pitch)
        first = torch.tensor(self.starts)[within] + (px - within) // pitch + MARGIN
        enlarge = torch.zeros(size, cells, dtype=torch.float32)
        return shrink, enlarge.scatter_add(
            1, first[:, None] + torch.arange(4), self.get_buffer("enlarge")[within]
        )


def _windows(first: Tensor, kernel: Tensor) -> Tensor:
    """(n, taps) kernels that begin at `first` as rows of one window that begins at the first of
    them.
    """
    offset = first - first[0]
    rows = torch.zeros(len(first), int(offset[-1]) + kernel.shape[1], dtype=torch.float64)
    return rows.scatter_(1, offset[:, None] + torch.arange(kernel.shape[1]), kernel).to(
        torch.float32
    )


def _extended(x: Tensor, first: int, end: int, axis: int) -> Tensor:
    """An axis from px `first` ≤ 0 to `end` ≥ its size, half-sample symmetric."""
    size = x.shape[axis]
    if axis == 2:
        return x.index_select(2, reflect(torch.arange(first, end), size))
    # to gather whole rows would copy them value by value
    left, right = (
        x.index_select(3, reflect(torch.arange(*range_), size))
        for range_ in ((first, 0), (size, end))
    )
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
