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
from typing import NamedTuple, get_args

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.torch_func import refuse_mapped
from uwaug._support.types import Order
from uwaug.blur.plan import BlurPlan
from uwaug.formation.scene import Scene, Terms
from uwaug.formation.setup import Setup
from uwaug.light.light import Light
from uwaug.optics.medium import Medium

_ROUNDING = 1e-6
"""Of float32. A field of .7…1.3 on a range that was planned for it would be looked at each time:
4 ms of 30 at 1024².
"""


class Reach(NamedTuple):
    """The least and the largest distance, m, and the same of the field, 1 without one."""

    nearest: float
    farthest: float
    low: float = 1.0
    high: float = 1.0

    def lies_in(self, near: float, far: float) -> bool:
        """Whether no effective distance can lie outside of a range, m, by more than rounding."""
        nearest, farthest = self.nearest * self.low, self.farthest * self.high
        return near <= nearest * (1 + _ROUNDING) and farthest <= far * (1 + _ROUNDING)


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
    setup = Setup(medium, light, "none", "linear", focal_px, centre, tolerance, order)
    with torch.autocast(image.device.type, enabled=False):
        scene = Scene.of(image, distance, setup, field, "eager", plan=plan)
        parts = [part.to(image.dtype) for part in scene.terms()]
    if image.ndim == 3 and len(scene) == 1:
        parts = [part[0] for part in parts]
    return Terms(*parts)


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
