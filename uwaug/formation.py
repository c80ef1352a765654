"""Image formation: direct, forward-scattered and backscattered light, from a medium. Linear light in and out.

    I = T_β(z)·J + (T_G(z) − T_β(z))·blur_σ(z){J} + V(0) − V(z),    z := m·z

Order "line_of_sight" blurs J and weights it with the curves of the pixel that looks; order "source", the paper's
equation, weights first and blurs the product. Monte Carlo light transport (two planes, edge region) stands .0268 from
the first and .0290 from the second.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug.blur import NO_BLUR, BlurPlan, Shape, blurred, blurred_rows, node_weights, plan_blur, weighted_sum
from uwaug.medium import FARTHEST, Medium

Order = Literal["line_of_sight", "source"]
_LOG2E = math.log2(math.e)
_CANCELS = 1 / 256  # of an optical depth: nearer, 1 − e^−x keeps less than 16 of the 24 bits of single precision


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


@dataclass(frozen=True)
class BlurDemand:
    """What a medium asks of the blur over a range of distances, before the image size is known.

    Attributes:
        low, high: range of widths that show, px of the point spread's own scale; both 0 if none does.
        tolerance: largest error of the blurred picture, on a scale of 0…1.
        shape, reference_size: of the point spread.
    """

    low: float
    high: float
    tolerance: float
    shape: Shape
    reference_size: float | None

    def plan(self, size: tuple[int, int], shared: bool = False) -> BlurPlan:
        """The plan for an image of (height, width) `size`.

        `shared` rounds the ends of the range outwards to half octaves, so that similar demands share a plan and its
        matrices: for media that change from call to call.
        """
        return self.plan_sizes(min(size), min(size), max(size), shared)

    def plan_sizes(self, smallest: int, largest: int, longest: int, shared: bool = False) -> BlurPlan:
        """The plan for all images with a short side of `smallest` to `largest` px and no side beyond `longest`."""
        scales = [1.0 if self.reference_size is None else side / self.reference_size for side in (smallest, largest)]
        low, high = self.low * scales[0], min(self.high * scales[1], 8.0 * longest)  # wider blurs all give the mean
        if high < 1e-6:
            return NO_BLUR
        if shared:
            high = 2 ** (math.ceil(2 * math.log2(high)) / 2)
            low = 2 ** (math.floor(2 * math.log2(low)) / 2) if low > 0.2 else 0.0
        return plan_blur(min(low, high), high, self.tolerance, self.shape, longest)


def blur_demand(
    medium: Medium,
    distance_range: tuple[float, float],
    tolerance: float = 0.002,
    *,
    order: Order = "line_of_sight",
    learned: bool = False,
    margin: float = 1.0,
) -> BlurDemand:
    """What a medium needs of the blur over a range of effective distances, and no more.

    Distances at which forward scatter is fainter than the tolerance do not count (in source order all do, as a pixel
    there reads light that was weighted elsewhere), and its strength scales the error that may pass.

    Args:
        medium: any batch; the demand covers all rows.
        distance_range: (nearest, farthest) of m·z, m; 0 ≤ nearest ≤ farthest, inf allowed.
        tolerance: largest error in the image, on a scale of 0…1.
        order: as for `form_image`.
        learned: if none of it shows (g = 1), plan for what it may become: its gradient is not faint.
        margin: widen the range of widths by this factor either way, for parameters that will be learned.
    """
    if not 0 < tolerance < 1:
        raise ValueError(f"tolerance must lie in (0, 1) (image scale 0…1), got {tolerance}")
    near, far = (min(max(d, 0.0), FARTHEST) for d in distance_range)
    law = medium.point_spread
    beta, direct_weights, G, signal_weights, b_mean, scale, exponent = (
        v.detach().double().cpu().numpy() if isinstance(v, Tensor) else np.asarray(v)
        for v in (
            medium.beta, medium.direct_weights, medium.G, medium.signal_weights, medium.b_mean, law.scale, law.exponent
        )
    )  # fmt: skip
    # by then the signal has faded below any tolerance, if all of it fades
    slowest = float(G[(signal_weights > 0).any(1)].min(initial=np.inf))
    spent = 40 / slowest if slowest > 0 else FARTHEST
    z = np.geomspace(max(near, 1e-3), max(min(far, spent), near, 1e-3), 65)
    share = signal_weights @ np.exp(-G[:, :, None] * z) - direct_weights @ np.exp(-beta[:, :, None] * z)
    strength = np.abs(share).max(axis=(0, 1))
    if learned and strength.max() <= tolerance:
        strength = np.maximum(strength, (direct_weights @ np.exp(-beta[:, :, None] * z)).max(axis=(0, 1)))
    visible = np.flatnonzero(strength > tolerance)
    if len(visible) == 0:
        return BlurDemand(0.0, 0.0, tolerance, law.shape, law.reference_size)
    first, last = max(visible[0] - 1, 0), min(visible[-1] + 1, len(z) - 1)
    ends = np.array([near if first == 0 else z[first], z[last]])
    if order == "source":
        ends = np.array([near, max(z[-1], min(far, spent))])
    widths = scale * np.maximum(np.multiply.outer(ends, b_mean), 1e-6) ** exponent
    low, high = float(widths.min()) / margin, float(widths.max()) * margin
    # 1.4 times what the strongest pixel allows: few are as strong, and linear light has less contrast than the plan
    # assumes. At 1.75 a picture of nothing but forward scatter fell below 60 dB at a tolerance of .002.
    # In half octaves, so that similar media may share a plan
    slack = 1.4 * 2.0 ** (math.floor(-2 * math.log2(float(strength.max()))) / 2)
    return BlurDemand(low, high, min(tolerance * slack, 0.5), law.shape, law.reference_size)


def form_image(
    image: Tensor,
    distance: Tensor,
    medium: Medium,
    field: Tensor | None = None,
    *,
    order: Order = "line_of_sight",
    tolerance: float = 0.002,
    plan: BlurPlan | None = None,
) -> Terms:
    """Form an underwater image.

    Args:
        image (Bx3xHxW or 3xHxW tensor): J, linear light, 1 = white plate at the surface; may exceed [0, 1]. Half
            precision is computed in float32.
        distance (Bx1xHxW or 1xHxW tensor): z, metres along the ray, ≥ 0; +inf is open water. A batch of 1 serves all
            images.
        medium: one row, or as many as images. One image and B media give B images.
        field (Bx1xHxW or 1xHxW tensor): m, multiplies z; None for homogeneous water.
        order: "line_of_sight" or "source" (see the module).
        tolerance: largest error of the blur in the image, on a scale of 0…1.
        plan: from `blur_demand(…).plan(size)`; by default one for the distances at hand, which costs a look at them.

    Returns:
        The terms, of the image's dtype, with its batch dimension or without.

    Raises:
        TypeError: if an argument is not a floating-point tensor.
        ValueError: if shapes disagree, a distance is NaN or negative, or the order is unknown.

    Source: "Sea-ing Through Scattered Rays" (2025), equations for the three terms, with the sign in the exponent of
    the forward term corrected.
    """
    pieces = check(image, distance, medium, field, order)
    dtype = image.dtype
    with torch.autocast(image.device.type, enabled=False):
        parts = [part.to(dtype) for part in form(*pieces, order, tolerance, plan)]
    return Terms(*(part[0] for part in parts)) if unbatched(image, distance, medium) else Terms(*parts)


def unbatched(image: Tensor, distance: Tensor, medium: Medium) -> bool:
    """Whether the caller gave one image without a batch dimension, and gets one back."""
    return image.ndim == 3 and len(medium) == 1 and (distance.ndim == 3 or len(distance) == 1)


def check(
    image: Tensor, distance: Tensor, medium: Medium, field: Tensor | None, order: str
) -> tuple[Tensor, Tensor, Medium]:
    """Validate; return image (BxCxHxW) and effective distance in float32 or float64, and the medium in the same
    dtype.
    """
    if not isinstance(medium, Medium):
        raise TypeError(f"medium must be a uwaug.Medium, got {type(medium).__name__}; see Medium.from_water")
    for name, value in (("image", image), ("distance", distance), ("field", field)):
        if value is None and name == "field":
            continue
        if not isinstance(value, Tensor) or not value.is_floating_point():
            got = value.dtype if isinstance(value, Tensor) else type(value).__name__
            hint = "; scale 0…255 to 0…1 first" if got == torch.uint8 else ""
            raise TypeError(f"{name} must be a floating-point tensor, got {got}{hint}")
        if value.ndim not in (3, 4):
            raise ValueError(
                f"{name} must have 3 or 4 dimensions, (B, C, H, W) or (C, H, W), got shape {tuple(value.shape)}"
            )
        if value.device != image.device:
            raise ValueError(f"{name} is on {value.device} but image is on {image.device}: move it with .to(…)")
        channels = 3 if name == "image" else 1
        if value.shape[-3] != channels:
            raise ValueError(
                f"{name} must be (…, {channels}, H, W), {channels} channel{'s'[: channels - 1]}; "
                f"got shape {tuple(value.shape)}"
            )
        if value.shape[-2:] != image.shape[-2:]:
            raise ValueError(
                f"{name} is {tuple(value.shape[-2:])} but image is {tuple(image.shape[-2:])}: "
                "height and width must agree"
            )
    if order not in ("line_of_sight", "source"):
        raise ValueError(f"order must be 'line_of_sight' or 'source', got {order!r}")
    dtype = torch.promote_types(image.dtype, torch.float32)
    image = image.to(dtype) if image.ndim == 4 else image.to(dtype)[None]
    z = distance.to(dtype) if distance.ndim == 4 else distance.to(dtype)[None]
    m = None if field is None else field.to(dtype) if field.ndim == 4 else field.to(dtype)[None]
    sizes = {"image": len(image), "distance": len(z), "medium": len(medium), "field": 1 if m is None else len(m)}
    if len({n for n in sizes.values() if n != 1}) > 1:
        raise ValueError(f"batch sizes must agree or be 1, got {sizes}")
    if not torch.compiler.is_compiling():
        if z.numel() and not z.detach().min() >= 0:  # NaN if any is
            unknown, negative = int(z.isnan().sum()), int((z < 0).sum())
            raise ValueError(
                f"distance is NaN at {unknown} and negative at {negative} of {z.numel()} pixels: expected metres ≥ 0 "
                "(+inf for open water); fill unknown pixels first, see uwaug.distance.fill_unknown"
            )
        if m is not None and m.numel():
            low, high = m.detach().aminmax()
            if not (low >= 0 and high < math.inf):
                unknown, negative = int(m.isnan().sum()), int((m < 0).sum())
                raise ValueError(
                    f"field is NaN at {unknown}, negative at {negative} and infinite at {int(m.isinf().sum())} of "
                    f"{m.numel()} pixels: expected finite values ≥ 0"
                )
    z = z.clamp(max=FARTHEST)
    return image, z if m is None else z * m, medium.to(dtype=dtype, device=image.device)


def _range(z: Tensor, medium: Medium) -> tuple[float, float]:
    """Nearest and farthest effective distance that may scatter light: not open water, unless a channel never fades."""
    low, high = (float(v) for v in z.detach().aminmax())
    fades = (medium.G > 0) | (medium.signal_weights == 0).all(1)
    if high >= FARTHEST and bool(fades.all()):
        finite = z.detach()[z < FARTHEST]
        high = float(finite.max()) if finite.numel() else low
    return low, high


def form(
    image: Tensor,
    z: Tensor,
    medium: Medium,
    order: Order,
    tolerance: float,
    plan: BlurPlan | None,
    *,
    total: bool = False,
) -> tuple[Tensor, ...]:
    """The model on checked input: direct, forward, backscatter; or only their sum."""
    b = max(len(image), len(z), len(medium)) if len(image) and len(z) and len(medium) else 0
    size = (image.shape[-2], image.shape[-1])
    if b * size[0] * size[1] == 0:
        return (image[:b].expand(b, -1, -1, -1),) * (1 if total else 3)
    law = medium.point_spread
    learned = torch.is_grad_enabled() and _learns(law.scale, law.exponent, *medium.tensors())
    records = learned or (torch.is_grad_enabled() and _learns(image, z))
    if plan is None:
        demand = blur_demand(medium, _range(z, medium), tolerance, order=order, learned=learned)
        plan = demand.plan(size, shared=True)
    if records or torch.compiler.is_compiling() or order == "source":
        curves = _curves(z, medium)
        source = curves[1] * image if order == "source" else image
        return combine(image, z, medium, curves, blurred(source, plan), plan, size, order, total)
    outputs = tuple(image.new_empty(b, 3, *size) for _ in range(1 if total else 3))
    far, rows_of = _far(z, medium), [medium[i] for i in range(len(medium))]
    sums_of = [curve_sums(row) for row in rows_of] if any(far) else []
    for i, j in enumerate(image):
        # one picture in several waters is blurred once
        samples = range(b) if len(image) == 1 else (i,)
        for rows, stack in blurred_rows(j, plan):
            for n in samples:
                part, m = z[n if len(z) > 1 else 0, :, rows][None], n % len(medium)
                curves = summed(part, *sums_of[m]) if far[n % len(far)] else _curves(part, rows_of[m])
                results = combine(j[None, :, rows], part, rows_of[m], curves, stack, plan, size, order, total)
                for out, result in zip(outputs, results):
                    out[n, :, rows] = result[0]
    return outputs


def _learns(*values: float | Tensor) -> bool:
    return any(isinstance(v, Tensor) and v.requires_grad for v in values)


def combine(
    image: Tensor,
    z: Tensor,
    medium: Medium,
    curves: tuple[Tensor, Tensor, Tensor],
    stack: list[Tensor],
    plan: BlurPlan,
    size: tuple[int, int],
    order: Order,
    total: bool,
) -> tuple[Tensor, ...]:
    """What each pixel does by itself, once its T_β, T_G − T_β and V(0) − V are known: weights of the blurs, sum. `z` is
    rows of an image of `size`.
    """
    transmission, share, veil = curves
    if len(stack) > 1:
        lengths = medium.b_mean.reshape(-1, 1, 1, 1) * z
        scattered = weighted_sum(node_weights(medium.point_spread.variance(lengths, size), plan), stack)
    else:
        scattered = stack[0]
    if order == "source":
        share = torch.ones_like(share)
    if total:
        return (veil.addcmul(share, scattered).addcmul_(transmission, image),)
    return transmission * image, share * scattered, veil


def _curves(z: Tensor, medium: Medium) -> tuple[Tensor, Tensor, Tensor]:
    """T_β, T_G − T_β and V(0) − V at every pixel; T_β and the veil to full relative precision near and far."""
    flat, shape = z.flatten(1)[:, None], (-1, 3, *z.shape[-2:])
    # exp2 is four times as fast as exp
    transmission = medium.direct_weights @ (medium.beta[:, :, None] * -_LOG2E * flat).exp2_()
    # a veil of a millimetre of water is small, not zero; the signal shares its exponentials: e^−Gz = 1 + expm1(−Gz)
    spent = (-medium.G[:, :, None] * flat).expm1_()
    signal = (medium.signal_weights @ spent).add_(medium.signal_weights.sum(-1, keepdim=True))
    veil = -medium.veil_weights @ spent
    return transmission.reshape(shape), (signal - transmission).reshape(shape), veil.reshape(shape)


def _far(z: Tensor, medium: Medium) -> list[bool]:
    """For each sample, whether V(0) − V is large enough everywhere to be had by subtraction."""
    slowest = medium.G.masked_fill(medium.G <= 0, math.inf).amin(1)
    far: list[bool] = (slowest * z.flatten(1).amin(1) > _CANCELS).tolist()
    return far


def curve_sums(medium: Medium) -> tuple[Tensor, Tensor, Tensor]:
    """Rates (BxRx1), weights (Bx9xR) and constants (Bx9x1) that give T_β, T_G − T_β and V(0) − V as one matrix product
    of exponentials.
    """
    k, n = medium.beta.shape[1], medium.G.shape[1]
    rates = torch.cat([medium.beta, medium.G], 1)[..., None] * -_LOG2E
    of_beta = F.pad(torch.cat([medium.direct_weights, -medium.direct_weights], 1), (0, n, 0, 3))
    of_G = F.pad(torch.cat([medium.signal_weights, -medium.veil_weights], 1), (k, 0, 3, 0))
    return rates, of_beta + of_G, F.pad(medium.veil_weights.sum(-1, keepdim=True), (0, 0, 6, 0))


def summed(z: Tensor, rates: Tensor, weights: Tensor, constants: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """As `_curves`, in a third of its time for clear water; the veil to 2e-5 of itself. (No faster with gradients.)"""
    decay = (rates * z.flatten(1)[:, None]).exp2_()
    b = len(decay)
    curves = torch.baddbmm(constants.expand(b, -1, -1), weights.expand(b, -1, -1), decay)
    direct, share, veil = curves.reshape(b, 3, 3, *z.shape[-2:]).unbind(1)
    return direct, share, veil
