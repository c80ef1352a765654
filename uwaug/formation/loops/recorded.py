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
from uwaug.blur.plan import BlurPlan, range_in_v
from uwaug.blur.stack import blurred, mixed, node_weights
from uwaug.formation.loops import loops
from uwaug.formation.loops.blurring import add_transposed, blur_all
from uwaug.formation.loops.picture import form_light
from uwaug.formation.loops.serving import takes
from uwaug.formation.loops.tables import (
    Floats,
    Water,
    order_of,
    plan_tables,
    series_table,
    water_tables,
)
from uwaug.formation.loops.threads import in_bands
from uwaug.optics.curves import curves
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread, pixel_scale, width_at

__all__ = ["recorded", "records"]


def records(image: Tensor, z: Tensor, medium: Medium, plan: BlurPlan) -> bool:
    """Whether the loops take this input, prepared as for `uwaug.formation.form`."""
    law = (v for v in medium.point_spread.numbers().values() if isinstance(v, Tensor))
    return len(plan.sigmas) > 1 and takes((image, z, *medium.tensors(), *law))


def recorded(image: Tensor, z: Tensor, medium: Medium, plan: BlurPlan) -> Tensor:
    """D + F + B of a batch, in the line of sight. Gradients go to all tensors; gradients of
    gradients are by PyTorch alone.

    Args:
        image, z, medium: as for `uwaug.formation.form`.
        plan: of two or more blurs.
    """
    size, law = (image.shape[-2], image.shape[-1]), medium.point_spread
    media = [medium[n] for n in range(len(medium))] if len(medium) > 1 else [medium]
    waters = [water_tables(one, plan, size) for one in media]
    scale, exponent = law.rows(len(medium), z).values()
    scale = scale * pixel_scale(law.reference_size, size)
    tensors = (z, *medium.tensors(), scale, exponent)
    batch = max(len(t) for t in (image, *tensors))
    whole = [t.expand(batch, *t.shape[1:]) for t in tensors]
    result: Tensor = _Recorded.apply(plan, waters, image, *whole)  # type: ignore[no-untyped-call]
    return result


class _Recorded(torch.autograd.Function):
    """Of image, z, rates and weights, b̄, and scale and exponent of the width. One image may serve
    all others.
    """

    @staticmethod
    def forward(ctx: Any, plan: BlurPlan, waters: list[Water], *tensors: Tensor) -> Tensor:
        ctx.save_for_backward(*tensors)
        ctx.plan, ctx.waters = plan, waters
        image, z = (t.detach().contiguous() for t in tensors[:2])
        return form_light(image, z, plan, waters)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        tensors, plan, needed = ctx.saved_tensors, ctx.plan, ctx.needs_input_grad[2:]
        if torch.is_grad_enabled() or mapped(gradient):
            return (None, None, *_by_autograd(tensors, plan, gradient, needed))
        found = _slopes(tensors, plan, ctx.waters, gradient.contiguous(), needed[0])
        kept = (one if wanted else None for one, wanted in zip(found, needed, strict=True))
        return (None, None, *kept)


def _slopes(
    tensors: tuple[Tensor, ...],
    plan: BlurPlan,
    waters: list[Water],
    gradient: Tensor,
    to_image: bool,
) -> list[Tensor]:
    """Gradients of all tensors; of the image, what has passed the blurs if that is wanted."""
    image, z = (t.detach().contiguous() for t in tensors[:2])
    batch, _, height, width = gradient.shape
    by_image, by_z = torch.empty(gradient.shape), torch.empty(z.shape)
    blurs = np.empty((len(plan.sigmas), height, 3, width), np.float32)
    found = []
    for n in range(batch):
        light, to_light = image[n % len(image)].numpy(), by_image[n].numpy()
        blur_all(light, plan, blurs)
        given, outs = (gradient[n].numpy(), light, z[n, 0].numpy()), (to_light, by_z[n, 0].numpy())
        found.append(_slopes_of_one(plan, given, waters[n % len(waters)], outs, blurs))
        if to_image:
            add_transposed(blurs, plan, to_light)
    if len(image) < batch:
        by_image = by_image.sum(0, keepdim=True)
    sums, by_law = (torch.from_numpy(np.array(one, np.float32)) for one in zip(*found, strict=True))
    return [by_image, by_z, *_by_medium(sums, tensors[2].shape[1]), *by_law.T]


def _slopes_of_one(
    plan: BlurPlan,
    given: tuple[Floats, Floats, Floats],
    water: Water,
    outs: tuple[Floats, Floats],
    blurs: Floats,
) -> tuple[Array, Array]:
    """Run the loops for one picture: gradient, image and z; to image and z. Blurs give way to their
    slopes.

    Returns:
        sums (R, 7) of its medium, and the gradients of b̄, scale and exponent.
    """
    loop, (height, width), rates = loops.get(), given[2].shape, water.rates.size
    rows, tile = loop.slopes.ROWS, loop.pixels.TILE
    sigma, by_sigma = np.empty((2, height, width), np.float32)
    in_bands(partial(loop.widths.width_rows, given[2], water.law, sigma), height, width)
    bands = -(-height // rows)
    sums = np.zeros((bands, 7 * rates * tile), np.float32)
    tables = (_as_given(water), plan_tables(plan, (height, width)).stack, _steeper(plan))
    run = partial(loop.slopes.slope_rows, *given, sigma, *tables, blurs, (*outs, by_sigma, sums))
    in_bands(run, height, width, rows)
    law_sums = np.zeros((bands, 3 * tile), np.float32)
    law = (given[2], water.law, outs[1], law_sums, rows)
    in_bands(partial(loop.widths.width_slope_rows, by_sigma, *law), height, width, rows)
    by_water = sums.reshape(-1, rates, 7, tile).sum((0, 3), dtype=np.float64)
    return by_water, law_sums.reshape(-1, 3, tile).sum((0, 2), dtype=np.float64)


def _widths(z: Tensor, b_mean: Tensor, scale: Tensor, exponent: Tensor) -> Tensor:
    b_mean, scale, exponent = (t[:, None, None, None] for t in (b_mean, scale, exponent))
    return width_at(b_mean * z, scale, exponent)


def _as_given(water: Water) -> Water:
    """The same medium where widths are given: a law that leaves them as they are."""
    law = water.law.copy()
    law[:3] = 1
    return water._replace(law=law)


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
        # each by itself: the caller's may be made of each other
        apart = [t.view_as(t) for t in tensors]
        image, z, *water = apart
        medium = Medium.of_tensors(water[:6], PointSpread.none(), ())
        found = curves(medium.sums(exact_at_lens=True), z)
        blur = mixed(blurred(image, plan), node_weights(_widths(z, *water[5:]), plan))
        result = found.veil + found.direct * image + found.scatter * blur  # `together`
        wanted = [t for t, one in zip(apart, needed, strict=True) if one]
        slopes = iter(torch.autograd.grad(result, wanted, gradient, create_graph=again))
    return [next(slopes) if one else None for one in needed]


@lru_cache(maxsize=16)
def _steeper(plan: BlurPlan) -> Floats:
    """Series of the slopes of the weights by ln(1 + x), x the 2σ or 2σ² of `BlurPlan`'s shape."""
    low, high = range_in_v(plan)
    series = np.array(plan.coefficients)[order_of(plan)]
    by_place = np.polynomial.chebyshev.chebder(series, axis=1)
    slope = (2 if plan.shape == "exponential" else 1) / (high - low) if high > low else 0.0
    return series_table(slope * by_place)
