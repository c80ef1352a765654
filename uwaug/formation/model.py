"""Image formation: direct, forward-scattered and backscattered light. Linear light in and out.

    I = D + F + B                             z := m·z
    D = T_β(z)·J                              direct
    F = (T_G(z) − T_β(z))·blur_σ(z){J}        forward scatter
    B = V(0) − V(z)                           backscatter, the veil

Light from lamps, or from a sun, changes what T_β, T_G and V(0) − V are at a pixel (see
`uwaug.light.lit`), and nothing else.

The curves T_β, T_G and V and the width σ are the medium's, see `uwaug.optics.medium`. J is the
scene without water, z the distance along the ray [m], m the medium field.

Order "line_of_sight" blurs J and weights it with the curves of the pixel that looks; order
"source", the paper's equation, weights first and blurs the product. Monte Carlo light transport
(two planes, edge region) has an RMSE of .0268 to the first and of .0290 to the second.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, get_args

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.tiles import held
from uwaug._support.torch_func import refuse_mapped, transformed
from uwaug._support.types import Order
from uwaug.blur.plan import BlurPlan
from uwaug.blur.stack import blurred, mixed, node_weights
from uwaug.blur.tiled import blurred_pieces
from uwaug.formation.at_hand import plan_at_hand
from uwaug.formation.loops.recorded import recorded, records
from uwaug.light.light import Light
from uwaug.light.lit import Lit, lit_of, planned, seen
from uwaug.optics.curves import FARTHEST, Curves
from uwaug.optics.medium import Medium

__all__ = ["Order", "Terms", "form_image"]

Combine = Callable[[Tensor, Curves, Tensor], tuple[Tensor, ...]]
"""What makes the result of image, curves and blurred image: `separately` or `together`."""

_CANCELS = 1 / 256
"""Optical depth; nearer, 1 − e^−x keeps less than 16 of the 24 bits of single precision, and the
veil less than 2e-5 of itself.
"""


@dataclass(frozen=True, eq=False)
class Terms:
    """The three terms of an image, each (BxCxHxW) in linear light; `image` is their sum."""

    direct: Tensor
    forward: Tensor
    backscatter: Tensor

    @property
    def image(self) -> Tensor:
        """Direct + forward + backscatter."""
        return self.direct + self.forward + self.backscatter


class Reach(NamedTuple):
    """The least and the largest distance, m, and the same of the field, 1 without one."""

    nearest: float
    farthest: float
    low: float = 1.0
    high: float = 1.0

    def lies_in(self, near: float, far: float) -> bool:
        """Whether no effective distance can lie outside of a range, m."""
        return near <= self.nearest * self.low and self.farthest * self.high <= far


def form_image(
    image: Tensor,
    distance: Tensor,
    medium: Medium,
    field: Tensor | None = None,
    *,
    order: Order = "line_of_sight",
    tolerance: float = 0.002,
    plan: BlurPlan | None = None,
    light: Light | None = None,
    focal_px: float | None = None,
    centre: tuple[float, float] | None = None,
) -> Terms:
    """Form an underwater image.

    Args:
        image (Bx3xHxW or 3xHxW tensor): J, linear light, 1 = white plate at the surface; may exceed
            [0, 1]. Half precision is computed in float32.
        distance (Bx1xHxW or 1xHxW tensor): z, metres along the ray, ≥ 0; +inf is open water. A
            batch of 1 serves all images.
        medium: one row, or as many as images. One image and B media give B images.
        field (Bx1xHxW or 1xHxW tensor): m, multiplies z; None for homogeneous water.
        order: "line_of_sight" or "source" (see the module).
        tolerance: RMSE of the blur that may pass, in linear light, on pictures with power ∝ 1/f²;
            single pixels may be off by 3 to 5 times as much.
        plan: from `blur_demand(…).plan(size)`; by default one for the distances at hand, which
            costs a look at them.
        light: what shines, one for all images or one for each; None for daylight as the medium has
            it.
        focal_px: focal length, px of the image; wanted where the light differs from ray to ray.
        centre: (column, row) of the pixel that looks along the camera's axis; None for the middle.

    Returns:
        The terms, of the image's dtype, with its batch dimension or without.

    Raises:
        TypeError: if an argument is not a floating-point tensor.
        ValueError: if shapes disagree, a value of the image is NaN or infinite, a distance NaN or
            negative, most distances lie beyond 1000 m, the order is unknown, or the tolerance needs
            too many blurs.

    Source: "Sea-ing Through Scattered Rays" (2025), equations for the three terms, with the sign in
    the exponent of the forward term corrected.
    """
    checks.one_of("order", order, get_args(Order))
    validate(image, distance, medium, field, light=light)
    if image.numel() and not torch.compiler.is_compiling():
        checks.finite("image", image)
    with torch.autocast(image.device.type, enabled=False):
        scene, z, prepared = prepare(image, distance, medium, field)
        lit = lit_of(light, distance, field, prepared, focal_px, centre)
        if plan is None:
            plan = plan_at_hand(z, planned(prepared, light), tolerance, order)
        parts = form(scene, z, prepared, plan, order, separately, lit)
        parts = tuple(part.to(image.dtype) for part in parts)
    if unbatched(image, distance, medium, field, light):
        parts = tuple(part[0] for part in parts)
    return Terms(*parts)


def unbatched(
    image: Tensor,
    distance: Tensor,
    medium: Medium,
    field: Tensor | None,
    light: Light | None = None,
) -> bool:
    """Whether the caller gave one image without a batch dimension, and gets one back."""
    maps = (distance,) if field is None else (distance, field)
    alone = len(medium) == 1 and (light is None or light.rows() == 1)
    alone = alone and all(one.ndim == 3 or len(one) == 1 for one in maps)
    return image.ndim == 3 and alone


def validate(
    image: Tensor,
    distance: Tensor,
    medium: Medium | None,
    field: Tensor | None,
    *,
    also_bytes: bool = False,
    light: Light | None = None,
) -> Reach | None:
    """Refuse what `form_image` cannot take: types, shapes, batches, devices, wrong distances.

    medium: None if it is none of the caller's, as that of a file.
    also_bytes: take a uint8 picture, as files hold it.

    Returns:
        What has been seen of the maps; None in a graph, which is for others as well.
    """
    if medium is not None:
        checks.instance("medium", medium, Medium, "; see Medium.from_water")
    maps = {"distance": distance} if field is None else {"distance": distance, "field": field}
    sizes = {"medium": 1 if medium is None else len(medium)}
    if light is not None:
        checks.instance("light", light, Light)
        sizes["light"] = light.rows()
    for name, value in {"image": image, **maps}.items():
        if not (name == "image" and also_bytes and _holds_bytes(image)):
            checks.floating(name, value)
        checks.picture(name, value, 3 if name == "image" else 1)
        checks.same_size(name, value, image)
        checks.same_device(name, value, image)
        refuse_mapped(name, value)
        sizes[name] = len(value) if value.ndim == 4 else 1
    checks.batches(sizes)
    if torch.compiler.is_compiling():
        return None
    nearest, farthest = checks.distances("distance", distance)
    low = high = 1.0
    if field is not None and field.numel():
        low, high = checks.extent(field)
        if not (low >= 0 and high < math.inf):
            counts = checks.counted(field, "NaN", "negative", "infinite")
            raise ValueError(f"field is {counts}: expected finite values ≥ 0")
    tracing = torch.jit.is_tracing()  # type: ignore[attr-defined, no-untyped-call]
    return None if tracing else Reach(nearest, farthest, low, high)


def _holds_bytes(image: object) -> bool:
    return isinstance(image, Tensor) and image.dtype == torch.uint8


def prepare(
    image: Tensor, distance: Tensor, medium: Medium, field: Tensor | None
) -> tuple[Tensor, Tensor, Medium]:
    """Image (BxCxHxW), effective distance m·z (Bx1xHxW) and medium, all in one type of float32 and
    float64.
    """
    light, z = prepared_maps(image, distance, field)
    return light, z, medium.to(dtype=z.dtype, device=z.device)


def prepared_maps(
    image: Tensor, distance: Tensor, field: Tensor | None, reach: Reach | None = None
) -> tuple[Tensor, Tensor]:
    """The same without the medium; `reach` is what `validate` has seen of the maps."""
    dtype = torch.promote_types(image.dtype, torch.float32)

    def batch(value: Tensor) -> Tensor:
        return (value if value.ndim == 4 else value[None]).to(dtype)

    z = batch(distance)
    if reach is None or reach.farthest > FARTHEST:
        # compiled code does not look at its input: at least no distance is negative there
        z = z.clamp(0.0, FARTHEST)
    if field is not None:
        z = z * batch(field)
    return batch(image), z


def form(
    image: Tensor,
    z: Tensor,
    medium: Medium,
    plan: BlurPlan,
    order: Order,
    combine: Combine,
    lit: Lit | None = None,
) -> tuple[Tensor, ...]:
    """The model on prepared input (see `prepare`); `combine` is `separately` or `together`."""
    lengths = (len(image), len(z), len(medium), 1 if lit is None else lit.light.rows())
    b, size = max(lengths) if all(lengths) else 0, (image.shape[-2], image.shape[-1])
    if b == 0 or 0 in size:
        none = image[:b].expand(b, -1, -1, -1)
        return combine(none, Curves(none, none, none), none)
    recorded = image.requires_grad or z.requires_grad or medium.requires_grad
    recorded = recorded or (lit is not None and lit.light.requires_grad)
    records = torch.is_grad_enabled() and recorded
    if records or transformed() or torch.compiler.is_compiling() or order == "source":
        return _form_at_once(image, z, medium, plan, order, combine, lit)
    media = [medium[i] for i in range(len(medium))] if len(medium) > 1 else [medium]
    exact = any_at_lens(z, medium)
    sums = [one.sums(exact_at_lens=exact) for one in media]
    lights = None if lit is None else [lit.row(n) for n in range(b)]
    outputs: list[Tensor] = []
    for i, picture in enumerate(image):
        # one picture in several waters is blurred once
        samples = range(b) if len(image) == 1 else (i,)
        for rows, columns, stack in blurred_pieces(held(picture), (3, *size), picture, plan):
            for n in samples:
                m, part = n % len(media), z[n % len(z), :, rows, columns][None]
                blur = scattered(stack, part, media[m], plan, size)
                here = None if lights is None else lights[n].part(rows, columns)
                found = seen(sums[m], part, here)
                results = combine(picture[None, :, rows, columns], found, blur)
                outputs = outputs or [result.new_empty(b, 3, *size) for result in results]
                for output, result in zip(outputs, results, strict=True):
                    output[n, :, rows, columns] = result[0]
    return tuple(outputs)


def _form_at_once(
    image: Tensor,
    z: Tensor,
    medium: Medium,
    plan: BlurPlan,
    order: Order,
    combine: Combine,
    lit: Lit | None,
) -> tuple[Tensor, ...]:
    """`form` without strips: for gradients, for compilers, for curves that precede the blur."""
    simple = combine is together and order == "line_of_sight" and lit is None
    if simple and records(image, z, medium, plan):
        return (recorded(image, z, medium, plan),)
    # a compiler cannot look at the distances
    exact = torch.compiler.is_compiling() or any_at_lens(z, medium)
    here = None if lit is None else lit.whole()
    found = seen(medium.sums(exact_at_lens=exact), z, here)
    source = image
    if order == "source":
        source, found = found.scatter * image, found._replace(scatter=image.new_ones(()))
    stack = blurred(source, plan)
    blur = scattered(stack, z, medium, plan, (image.shape[-2], image.shape[-1]))
    return combine(image, found, blur)


def any_at_lens(z: Tensor, medium: Medium) -> bool:
    """Whether a pixel is so near that V(0) − V(z) cannot be subtracted without cancellation."""
    return at_lens(z.flatten(1).amin(1), medium)


def at_lens(nearest: Tensor, medium: Medium) -> bool:
    """The same from the nearest distance of each picture (B)."""
    slowest = medium.G.masked_fill(medium.G <= 0, math.inf).amin(1)
    return bool((slowest * nearest <= _CANCELS).any())


def scattered(
    stack: list[Tensor], z: Tensor, medium: Medium, plan: BlurPlan, size: tuple[int, int]
) -> Tensor:
    """The blurred image: each pixel's own mixture of the plan's blurs.

    z (Bx1xRxW tensor): effective distances of rows of an image of (height, width) `size`.
    """
    records = torch.is_grad_enabled() and medium.requires_grad
    if len(stack) == 1 and not (records or transformed()):
        return stack[0]
    sigma = medium.point_spread.sigma(medium.lengths(z), size)
    if len(stack) == 1:  # the width does nothing: its gradient is 0, not missing
        return stack[0] + 0 * sigma
    return mixed(stack, node_weights(sigma, plan))


def separately(image: Tensor, found: Curves, blur: Tensor) -> tuple[Tensor, ...]:
    """D, F and B."""
    direct = found.direct * image
    return direct, found.scatter * blur, found.veil.expand_as(direct)


def together(image: Tensor, found: Curves, blur: Tensor) -> tuple[Tensor, ...]:
    """D + F + B."""
    return (found.veil.addcmul(found.direct, image).addcmul_(found.scatter, blur),)
