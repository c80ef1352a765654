"""Pictures with gradients: autograd has the blurs, and the compiled loops what is done at each
pixel. Forward keeps no intermediates; backward computes them anew. (The same in PyTorch, in strips
that fit the cache, took .85 to 1.35 times as long as autograd: too many small operations.)
"""

from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug.blur.plan import BlurPlan, range_in_v
from uwaug.blur.stack import mixed, node_weights
from uwaug.functional import mapped
from uwaug.fused import loops
from uwaug.fused.serving import takes
from uwaug.fused.tables import (
    Floats,
    Indices,
    Stack,
    Water,
    plan_tables,
    series_table,
    water_tables,
)
from uwaug.fused.threads import in_bands
from uwaug.optics.curves import curves
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

__all__ = ["recorded", "records"]


def records(image: Tensor, z: Tensor, medium: Medium, stack: list[Tensor]) -> bool:
    """Whether the loops take this input, prepared as for `uwaug.formation.form`."""
    return len(stack) > 1 and takes((image, z, *medium.tensors(), *stack))


def recorded(
    image: Tensor, z: Tensor, medium: Medium, stack: list[Tensor], plan: BlurPlan
) -> Tensor:
    """D + F + B of a batch, in the line of sight. Gradients go to all tensors; gradients of
    gradients are by PyTorch alone.

    Args:
        image, z, medium: as for `uwaug.formation.form`.
        stack: the plan's blurs of the image, two or more.
        plan: of the blurs.
    """
    sigma = medium.point_spread.sigma(medium.lengths(z), (image.shape[-2], image.shape[-1]))
    tensors = (image, z, sigma, *medium.tensors()[:5], *stack)
    batch = max(len(t) for t in tensors)
    whole = [t.expand(batch, *t.shape[1:]) for t in tensors]
    result: Tensor = _Recorded.apply(plan, *whole)  # type: ignore[no-untyped-call]
    return result


class _Recorded(torch.autograd.Function):
    """Of image, z, widths, rates and weights, and blurs."""

    @staticmethod
    def forward(ctx: Any, plan: BlurPlan, *tensors: Tensor) -> Tensor:
        ctx.save_for_backward(*tensors)
        ctx.plan = plan
        image = tensors[0]
        result = torch.empty(image.shape, dtype=torch.float32)
        run = loops.get().slopes.recorded_rows
        blurs, tables = _in_lines(tensors[8:]), _stack_tables(plan)
        places, lines = _places(blurs), blurs[0].shape[1]
        for n, out in enumerate(result.numpy()):
            given = (*_maps(tensors, n), _water(tensors, n, plan), tables, places, lines, 3 * n)
            in_bands(lambda *rows, g=given, o=out: run(*g, o, *rows), *image.shape[2:])
        return result

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        tensors, plan, needed = ctx.saved_tensors, ctx.plan, ctx.needs_input_grad[1:]
        if torch.is_grad_enabled() or mapped(gradient):
            return (None, *_by_autograd(tensors, plan, gradient, needed))
        found = _slopes(tensors, plan, gradient.contiguous().numpy())
        kept = (one if wanted else None for one, wanted in zip(found, needed, strict=True))
        return (None, *kept)


def _slopes(tensors: tuple[Tensor, ...], plan: BlurPlan, gradient: Floats) -> list[Tensor]:
    """Gradients of all tensors."""
    run = loops.get().slopes.slope_rows
    rows, tile = loops.get().slopes.ROWS, loops.get().pixels.TILE
    batch, _, height, width = gradient.shape
    blurs, tables, steeper = _in_lines(tensors[8:]), _stack_tables(plan), _steeper(plan)
    places, lines = _places(blurs), blurs[0].shape[1]
    maps = [torch.empty(t.shape, dtype=torch.float32) for t in tensors[:3]]
    by_blurs = torch.empty(len(blurs), *blurs[0].shape)
    rates = tensors[3].shape[1] + tensors[5].shape[1]
    by_water = []
    for n in range(batch):
        sums = np.zeros((-(-height // rows), 7 * rates * tile), np.float32)
        given = (gradient[n], *_maps(tensors, n), _water(tensors, n, plan), tables, steeper)
        outs = (maps[0].numpy()[n], maps[1].numpy()[n, 0], maps[2].numpy()[n, 0])
        rest = (places, lines, 3 * n, (*outs, by_blurs.numpy(), sums))
        in_bands(lambda *r, g=(*given, *rest): run(*g, *r), height, width, rows)
        by_water.append(sums.reshape(-1, rates, 7, tile).sum((0, 3), dtype=np.float64))
    shape = (height, batch, 3, width)
    by_stack = [one.reshape(shape).permute(1, 2, 0, 3) for one in by_blurs]
    found = torch.from_numpy(np.array(by_water, np.float32))
    return [*maps, *_by_medium(found, tensors[3].shape[1]), *by_stack]


def _by_medium(sums: Tensor, direct: int) -> list[Tensor]:
    """Gradients of rates and weights from the sums (B, R, 7) of the loops."""
    by_scatter, by_other = sums[..., :3].mT, sums[..., 3:6].mT
    by_rates = -sums[..., 6]
    return [
        by_rates[:, :direct],
        by_other[..., :direct] - by_scatter[..., :direct],
        by_rates[:, direct:],
        by_scatter[..., direct:],
        -by_other[..., direct:],
    ]


def _by_autograd(
    tensors: tuple[Tensor, ...], plan: BlurPlan, gradient: Tensor, needed: tuple[bool, ...]
) -> list[Tensor | None]:
    """The same by PyTorch, from which there are gradients again."""
    again = torch.is_grad_enabled()
    with torch.enable_grad():
        # each by itself: widths may be made of distances, blurs of the image
        apart = [t.view_as(t) for t in tensors]
        image, z, sigma, *water = apart[:8]
        medium = Medium.of_tensors([*water, water[0][:, 0]], PointSpread.none(), ())
        found = curves(medium.sums(exact_at_lens=True), z)
        blur = mixed(apart[8:], node_weights(sigma, plan))
        result = found.veil + found.direct * image + found.scatter * blur  # `together`
        wanted = [t for t, one in zip(apart, needed, strict=True) if one]
        slopes = iter(torch.autograd.grad(result, wanted, gradient, create_graph=again))
    return [next(slopes) if one else None for one in needed]


def _in_lines(stack: tuple[Tensor, ...]) -> list[Tensor]:
    """Blurs as (H, 3B, W), as the blur has made them: rows of all pictures side by side."""
    lines = []
    for blur in stack:
        b, c, h, w = blur.shape
        lines.append(blur.detach().permute(2, 0, 1, 3).reshape(h, b * c, w).contiguous())
    return lines


def _places(blurs: list[Tensor]) -> Indices:
    return np.array([blur.data_ptr() for blur in blurs], np.int64)


def _maps(tensors: tuple[Tensor, ...], n: int) -> tuple[Floats, Floats, Floats]:
    """Image, distances and widths of one picture."""
    image, z, sigma = (t.detach()[n].contiguous().numpy() for t in tensors[:3])
    return image, z[0], sigma[0]


def _water(tensors: tuple[Tensor, ...], n: int, plan: BlurPlan) -> Water:
    """The medium of one picture, whose widths are given: a law that leaves them as they are."""
    water = [t.detach()[n : n + 1] for t in tensors[3:8]]
    given = Medium.of_tensors([*water, water[0].new_ones(1)], PointSpread(1.0), ())
    return water_tables(given, plan, (1, 1))


@lru_cache(maxsize=16)
def _stack_tables(plan: BlurPlan) -> Stack:
    """Of which the loops look at the series alone, in the order of the plan."""
    empty = plan_tables(plan, (1, 1)).stack
    return empty._replace(series=series_table(plan.coefficients))


@lru_cache(maxsize=16)
def _steeper(plan: BlurPlan) -> Floats:
    """Series of the slopes of the weights by ln(1 + x), x the 2σ or 2σ² of `BlurPlan`'s shape."""
    low, high = range_in_v(plan)
    by_place = np.polynomial.chebyshev.chebder(np.array(plan.coefficients), axis=1)
    slope = (2 if plan.shape == "exponential" else 1) / (high - low) if high > low else 0.0
    return series_table(slope * by_place)
