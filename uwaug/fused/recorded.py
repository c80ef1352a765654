"""Pictures with gradients by the compiled loops. Forward keeps the blurs and no other intermediates;
backward computes them anew. (The same in PyTorch, in strips that fit the cache, took .85 to 1.35
times as long as autograd: too many small operations.)
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug.blur.plan import BlurPlan, range_in_v
from uwaug.blur.stack import blurred, mixed, node_weights
from uwaug.functional import mapped
from uwaug.fused import loops
from uwaug.fused.blurring import add_transposed, blur_all
from uwaug.fused.serving import takes
from uwaug.fused.tables import Floats, Indices, Water, order_of, plan_tables, water_tables
from uwaug.fused.threads import in_bands
from uwaug.optics.curves import curves
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

__all__ = ["recorded", "records"]


def records(image: Tensor, z: Tensor, medium: Medium, plan: BlurPlan) -> bool:
    """Whether the loops take this input, prepared as for `uwaug.formation.form`."""
    return len(plan.sigmas) > 1 and takes((image, z, *medium.tensors()))


def recorded(image: Tensor, z: Tensor, medium: Medium, plan: BlurPlan) -> Tensor:
    """D + F + B of a batch, in the line of sight. Gradients go to all tensors; gradients of
    gradients are by PyTorch alone.

    Args:
        image, z, medium: as for `uwaug.formation.form`.
        plan: of two or more blurs.
    """
    sigma = medium.point_spread.sigma(medium.lengths(z), (image.shape[-2], image.shape[-1]))
    tensors = (z, sigma, *medium.tensors()[:5])
    batch = max(len(t) for t in (image, *tensors))
    whole = [t.expand(batch, *t.shape[1:]) for t in tensors]
    result: Tensor = _Recorded.apply(plan, image, *whole)  # type: ignore[no-untyped-call]
    return result


class _Recorded(torch.autograd.Function):
    """Of image, z, widths, rates and weights. One image may serve all others."""

    @staticmethod
    def forward(ctx: Any, plan: BlurPlan, *tensors: Tensor) -> Tensor:
        image, z = tensors[:2]
        _, _, height, width = image.shape
        blurs = torch.empty(len(image), len(plan.sigmas), height, 3, width)
        for light, out in zip(image.detach().contiguous().numpy(), blurs.numpy(), strict=True):
            blur_all(light, plan, out)
        ctx.save_for_backward(*tensors, blurs)
        ctx.plan, ctx.waters = plan, [_water(tensors, n, plan) for n in range(len(z))]
        result = torch.empty(len(z), 3, height, width)
        run, stack = loops.get().slopes.recorded_rows, plan_tables(plan, (height, width)).stack
        for n, out in enumerate(result.numpy()):
            given = (*_maps(tensors, n), ctx.waters[n], stack, _places(blurs, n), 3, 0, out)
            in_bands(lambda *rows, g=given: run(*g, *rows), height, width)
        return result

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        (*tensors, blurs), plan, needed = ctx.saved_tensors, ctx.plan, ctx.needs_input_grad[1:]
        if torch.is_grad_enabled() or mapped(gradient):
            return (None, *_by_autograd(tensors, plan, gradient, needed))
        found = _slopes(tensors, blurs, ctx.waters, plan, gradient.contiguous().numpy(), needed[0])
        kept = (one if wanted else None for one, wanted in zip(found, needed, strict=True))
        return (None, *kept)


def _slopes(
    tensors: list[Tensor],
    blurs: Tensor,
    waters: list[Water],
    plan: BlurPlan,
    gradient: Floats,
    to_image: bool,
) -> list[Tensor]:
    """Gradients of all tensors; of the image, what has passed the blurs if that is wanted."""
    run = loops.get().slopes.slope_rows
    rows, tile = loops.get().slopes.ROWS, loops.get().pixels.TILE
    batch, _, height, width = gradient.shape
    stack, steeper = plan_tables(plan, (height, width)).stack, _steeper(plan)
    by_image = torch.empty(gradient.shape)
    maps = [torch.empty(t.shape) for t in tensors[1:3]]
    by_blurs = np.empty(blurs.shape[1:], np.float32)
    rates = tensors[3].shape[1] + tensors[5].shape[1]
    by_water = []
    for n in range(batch):
        sums = np.zeros((-(-height // rows), 7 * rates * tile), np.float32)
        given = (gradient[n], *_maps(tensors, n), waters[n], stack, steeper, _places(blurs, n))
        light = by_image[n].numpy()
        outs = (light, maps[0].numpy()[n, 0], maps[1].numpy()[n, 0], by_blurs, sums)
        in_bands(lambda *r, g=(*given, 3, 0, outs): run(*g, *r), height, width, rows)
        if to_image:
            add_transposed(by_blurs, plan, light)
        by_water.append(sums.reshape(-1, rates, 7, tile).sum((0, 3), dtype=np.float64))
    if len(tensors[0]) < batch:
        by_image = by_image.sum(0, keepdim=True)
    found = torch.from_numpy(np.array(by_water, np.float32))
    return [by_image, *maps, *_by_medium(found, tensors[3].shape[1])]


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
    tensors: list[Tensor], plan: BlurPlan, gradient: Tensor, needed: tuple[bool, ...]
) -> list[Tensor | None]:
    """The same by PyTorch, from which there are gradients again."""
    again = torch.is_grad_enabled()
    with torch.enable_grad():
        # each by itself: widths may be made of distances
        apart = [t.view_as(t) for t in tensors]
        image, z, sigma, *water = apart
        medium = Medium.of_tensors([*water, water[0][:, 0]], PointSpread.none(), ())
        found = curves(medium.sums(exact_at_lens=True), z)
        blur = mixed(blurred(image, plan), node_weights(sigma, plan))
        result = found.veil + found.direct * image + found.scatter * blur  # `together`
        wanted = [t for t, one in zip(apart, needed, strict=True) if one]
        slopes = iter(torch.autograd.grad(result, wanted, gradient, create_graph=again))
    return [next(slopes) if one else None for one in needed]


def _places(blurs: Tensor, n: int) -> Indices:
    """Where the blurs of a picture begin."""
    its = blurs[n % len(blurs)]
    return np.array([blur.data_ptr() for blur in its], np.int64)


def _maps(tensors: Sequence[Tensor], n: int) -> tuple[Floats, Floats, Floats]:
    """Image, distances and widths of one picture."""
    image, z, sigma = (t.detach()[n % len(t)].contiguous().numpy() for t in tensors[:3])
    return image, z[0], sigma[0]


def _water(tensors: Sequence[Tensor], n: int, plan: BlurPlan) -> Water:
    """The medium of one picture, whose widths are given: a law that leaves them as they are."""
    water = [t.detach()[n : n + 1] for t in tensors[3:8]]
    given = Medium.of_tensors([*water, water[0].new_ones(1)], PointSpread(1.0), ())
    return water_tables(given, plan, (1, 1))


@lru_cache(maxsize=16)
def _steeper(plan: BlurPlan) -> Floats:
    """Series of the slopes of the weights by ln(1 + x), x the 2σ or 2σ² of `BlurPlan`'s shape."""
    low, high = range_in_v(plan)
    series = np.array(plan.coefficients)[order_of(plan)]
    by_place = np.polynomial.chebyshev.chebder(series, axis=1)
    slope = (2 if plan.shape == "exponential" else 1) / (high - low) if high > low else 0.0
    return np.asarray(slope * by_place, np.float32, order="C")
