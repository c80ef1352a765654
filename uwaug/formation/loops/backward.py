"""Pictures with gradients by the compiled loops. Forward keeps nothing but its input: backward
makes the blurs anew, in memory that one picture after the other uses, and puts their gradients in
their place. (To keep them took longer, as they are read from memory twice. The same in PyTorch, in
strips that fit the cache, took .85 to 1.35 times as long as autograd: too many small operations.)
"""

from functools import lru_cache, partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug._support.torch_func import mapped
from uwaug._support.types import Array
from uwaug.blur.plan import BlurPlan, place_line
from uwaug.blur.stack import blurred, mixed, node_weights
from uwaug.formation.loops.backend import loaded
from uwaug.formation.loops.render import NO_LOOK, coarse_grids, in_bands, render_into
from uwaug.formation.loops.tables import (
    Floats,
    MediumTable,
    adjoint_table,
    medium_tables,
    plan_table,
    series_table,
    stack_order,
)
from uwaug.optics.curves import curves
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread, pixel_scale, width_at


def render_with_gradients(light: Tensor, z: Tensor, medium: Medium, plan: BlurPlan) -> Tensor:
    """D + F + B of a batch, in the line of sight, in linear light. Gradients go to all tensors;
    gradients of gradients are by PyTorch alone.

    Args:
        light (Bx3xHxW tensor), z (Bx1xHxW tensor): of the scene; effective distances, m; float32.
        medium: of float32 and any number of rows.
        plan: of two or more blurs.
    """
    size, law = (light.shape[-2], light.shape[-1]), medium.point_spread
    media = medium_tables(medium, plan, size)
    scale, exponent = law.rows(len(medium), z).values()
    scale = scale * pixel_scale(law.reference_size, size)
    tensors = (z, *medium.tensors(), scale, exponent)
    batch = max(len(t) for t in (light, *tensors))
    rows = [t.expand(batch, *t.shape[1:]) for t in tensors]
    result: Tensor = _Render.apply(plan, media, light, *rows)  # type: ignore[no-untyped-call]
    return result


class _Render(torch.autograd.Function):
    """Of light, z, rates and weights, b̄, and scale and exponent of the width. One picture of light
    may serve all others.
    """

    @staticmethod
    def forward(ctx: Any, plan: BlurPlan, media: list[MediumTable], *tensors: Tensor) -> Tensor:
        ctx.save_for_backward(*tensors)
        ctx.plan, ctx.media = plan, media
        light, z = tensors[:2]
        result = z.new_empty(len(z), *light.shape[1:])
        largest = np.ones(len(z), np.float32)
        looks = np.array(NO_LOOK.expand(len(z), -1).numpy(), order="C")
        render_into(result, light, z, plan, media, False, largest, looks)
        return result

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        tensors, plan, needed = ctx.saved_tensors, ctx.plan, ctx.needs_input_grad[2:]
        if torch.is_grad_enabled() or mapped(gradient):
            return (None, None, *_by_autograd(tensors, plan, gradient, needed))
        light, z, beta = tensors[:3]
        by_light, by_z, sums = gradients(light, z, plan, ctx.media, gradient, of_light=needed[0])
        by_medium = _by_medium(sums, beta.shape[1])
        slopes = (by_light, by_z, *by_medium)
        return (None, None, *(t if need else None for t, need in zip(slopes, needed, strict=True)))


def gradients(
    light: Tensor,
    z: Tensor,
    plan: BlurPlan,
    media: list[MediumTable],
    gradient: Tensor,
    *,
    of_light: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    """Gradients of light and z, and the sums (B, 3 + 7R) that give those of the medium.

    of_light: whether the gradient of light is wanted, which has to pass the blurs.
    """
    light, z, gradient = (t.detach().contiguous() for t in (light, z, gradient))
    by_light, by_z = torch.empty_like(gradient), torch.empty_like(z)
    batch, _, height, width = gradient.shape
    blurs = np.empty((len(plan.sigmas), height, 3, width), np.float32)
    sums = []
    for n in range(batch):
        scene, to_light = light[n % len(light)].numpy(), by_light[n].numpy()
        blur_all(scene, plan, blurs)
        maps = gradient[n].numpy(), scene, z[n, 0].numpy()
        outs = blurs, to_light, by_z[n, 0].numpy()
        sums.append(_pass_pixels(plan, media[n % len(media)], maps, outs))
        if of_light:
            add_transposed(blurs, plan, to_light)
    if len(light) < batch:
        by_light = by_light.sum(0, keepdim=True)
    return by_light, by_z, torch.from_numpy(np.array(sums, np.float32))


def _pass_pixels(
    plan: BlurPlan, medium: MediumTable, maps: tuple[Floats, ...], outs: tuple[Floats, ...]
) -> Array:
    """Run the loops over one picture, see `uwaug.formation.loops.adjoint.slope_rows`: the sums."""
    adjoint, (height, width) = loaded("adjoint"), maps[2].shape
    count, tile = 3 + 7 * medium.rates.size, loaded("kernels").TILE
    sums = np.zeros((-(-height // adjoint.ROWS), count * tile), np.float32)
    tables = medium, plan_table(plan, (height, width)).stack, _steeper(plan)
    run = partial(adjoint.slope_rows, *maps, *tables, *outs, sums)
    in_bands(run, range(height), width, adjoint.ROWS)
    total: Array = sums.reshape(-1, count, tile).sum((0, 2), dtype=np.float64)
    return total


def blur_all(light: Floats, plan: BlurPlan, out: Floats) -> None:
    """Into out (KxHx3xW): the plan's blurs of a picture (3xHxW), in the order of `StackTable`."""
    _, height, width = light.shape
    table = plan_table(plan, (height, width))
    grid, starts = coarse_grids(light, table, range(height))
    stack = table.stack._replace(starts=starts)
    run = partial(loaded("adjoint").blurred_rows, light, stack, grid, out)
    in_bands(run, range(height), width)


def add_transposed(by: Floats, plan: BlurPlan, out: Floats) -> None:
    """To out (3xHxW), add Σ_k B_kᵀ by_k, for by (KxHx3xW) in the order of `StackTable`."""
    adjoint, (_, height, width) = loaded("adjoint"), out.shape
    stack, table = plan_table(plan, (height, width)).stack, adjoint_table(plan, (height, width))
    lines = by.reshape(len(by), 3 * height, width)
    counts = [3 * len(cells.rows) for cells in table.cells]
    grid = np.empty((sum(counts), width), np.float32)
    wide = lines[len(lines) - len(counts) :]
    for blur, start, count, cells in zip(wide, stack.starts, counts, table.cells, strict=True):
        run = partial(adjoint.cell_lines, blur, grid[start : start + count], cells)
        in_bands(run, range(count), width, loaded("kernels").LANES)
    run = partial(adjoint.gathered_rows, lines, stack, grid, table.back, out)
    in_bands(run, range(height), width)


def _by_medium(sums: Tensor, direct: int) -> list[Tensor]:
    """Gradients of rates and weights, b̄, scale and exponent from the sums of the loops, of which
    `direct` rates are of T_β.
    """
    by_law, by_rates = sums[:, :3], sums[:, 3:].reshape(len(sums), -1, 7)
    by_scatter, by_other = by_rates[..., :3].mT, by_rates[..., 3:6].mT
    by_rate = -by_rates[..., 6]
    return [
        by_rate[:, :direct],
        by_other[..., :direct] - by_scatter[..., :direct],
        by_rate[:, direct:],
        by_scatter[..., direct:],
        -by_other[..., direct:],
        *by_law.T,
    ]


@lru_cache(maxsize=16)
def _steeper(plan: BlurPlan) -> Floats:
    """Series of the slopes of the weights by ln(1 + x), see `uwaug.blur.plan.place_line`."""
    series = np.array(plan.coefficients)[stack_order(plan)]
    by_place = np.polynomial.chebyshev.chebder(series, axis=1)
    slope, _ = place_line(plan)
    return series_table(slope * by_place)


def _by_autograd(
    tensors: tuple[Tensor, ...], plan: BlurPlan, gradient: Tensor, needed: tuple[bool, ...]
) -> list[Tensor | None]:
    """Gradients by PyTorch, of which there are gradients again."""
    again = torch.is_grad_enabled()
    with torch.enable_grad():
        # each by itself: the caller's may be made of each other
        views = [t.view_as(t) for t in tensors]
        light, z, *medium = views
        b_mean, scale, exponent = (t[:, None, None, None] for t in medium[5:])
        sums = Medium.of_tensors(medium[:6], PointSpread.none(), ()).sums(exact_at_lens=True)
        curve, sigma = curves(sums, z), width_at(b_mean * z, scale, exponent)
        blur = mixed(blurred(light, plan), node_weights(sigma, plan))
        result = curve.veil + curve.direct * light + curve.scatter * blur
        inputs = [t for t, need in zip(views, needed, strict=True) if need]
        slopes = iter(torch.autograd.grad(result, inputs, gradient, create_graph=again))
    return [next(slopes) if need else None for need in needed]
