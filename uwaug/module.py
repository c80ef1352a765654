"""`Underwater`: a medium and a plan as an `nn.Module`."""

from dataclasses import replace
from operator import index
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from uwaug.blur import BlurPlan
from uwaug.colour import linear_to_srgb, srgb_to_linear
from uwaug.formation import BlurDemand, Order, blur_demand, check, form, unbatched
from uwaug.medium import Medium, assemble

_HDR_LIMIT = 16.0  # sRGB values above this are taken for 0…255


class Underwater(nn.Module):
    """Degrade pictures as a given water would.

    Args:
        medium: one medium, or one for each image of a batch.
        distance_range: (nearest, farthest) effective distance m·z, m, for which the blur is planned once; beyond it
            widths stop changing, curves stay exact. None plans for each call's own distances, which cannot be compiled
            or exported.
        tolerance: largest error of the blur in the image, on a scale of 0…1.
        color_space: "srgb" decodes, works in linear light, and encodes again; "linear" takes values as they are.
        learnable: make rates, light, veil and width scale parameters; they stay positive, and direct and signal light
            stay equal at z = 0.
        order: "line_of_sight", or "source" for the paper's equation, see `uwaug.formation`.

    Matrix products want torch's default float32 precision: `torch.set_float32_matmul_precision("medium")` would round
    them to bfloat16 where the processor can, which shows.

    Shapes:
        image (Bx3xHxW or 3xHxW), distance (Bx1xHxW or 1xHxW, m), field (as distance, or None) → image.

    Raises:
        TypeError, ValueError: as `uwaug.form_image`; and if an sRGB image exceeds 16, which is taken for a scale of
            0…255.

    Examples:
        >>> import torch, uwaug
        >>> degrade = uwaug.Underwater(uwaug.Medium.from_water(uwaug.Water.jerlov("7C")))
        >>> degrade(torch.rand(2, 3, 32, 48), torch.full((2, 1, 32, 48), 4.0)).shape
        torch.Size([2, 3, 32, 48])
    """

    def __init__(
        self,
        medium: Medium,
        distance_range: tuple[float, float] | None = (0.1, 20.0),
        tolerance: float = 0.002,
        color_space: Literal["srgb", "linear"] = "srgb",
        learnable: bool = False,
        order: Order = "line_of_sight",
    ) -> None:
        super().__init__()
        if not isinstance(medium, Medium):
            raise TypeError(f"medium must be a uwaug.Medium, got {type(medium).__name__}; see Medium.from_water")
        for name, choice, allowed in (
            ("color_space", color_space, ("srgb", "linear")),
            ("order", order, ("line_of_sight", "source")),
        ):
            if choice not in allowed:
                raise ValueError(f"{name} must be one of {allowed}, got {choice!r}")
        if not 0 < tolerance < 1:
            raise ValueError(f"tolerance must lie in (0, 1) (image scale 0…1), got {tolerance}")
        if distance_range is not None and not 0 <= distance_range[0] < distance_range[1]:
            raise ValueError(f"distance_range must be 0 ≤ nearest < farthest in metres, got {distance_range}")
        self.distance_range = distance_range
        self.tolerance = tolerance
        self.color_space = color_space
        self.order: Order = order
        self.learnable = learnable
        self._law, self._notes = medium.point_spread.map(lambda v: v.detach().clone()), medium.notes
        self.demand: BlurDemand | None = None
        if distance_range is not None:
            margin = 2.0 if learnable else 1.0
            self.demand = blur_demand(medium, distance_range, tolerance, order=order, learned=learnable, margin=margin)
        scale, exponent = (
            torch.as_tensor(v, dtype=medium.beta.dtype).detach().expand(len(medium)).clone()
            for v in (self._law.scale, self._law.exponent)
        )
        detached = {name: value.detach().clone() for name, value in zip(_NAMES, medium.tensors())}
        if not learnable:
            for name, value in {**detached, "scale": scale, "exponent": exponent}.items():
                self.register_buffer(name, value)
            return
        light = detached["direct_weights"].sum(-1)
        apart = float((light - detached["signal_weights"].sum(-1)).abs().max())
        if apart > 1e-5:
            raise ValueError(
                f"a learnable medium needs direct_weights and signal_weights of one sum, the light at z = 0; "
                f"they differ by {apart:.2g}"
            )
        for name in ("direct_weights", "signal_weights", "veil_weights"):
            self.register_buffer(f"{name}_used", detached[name] > 0)
        self.register_buffer("b_mean", detached["b_mean"])
        self.register_buffer("exponent", exponent)
        for name, value in {
            "beta": detached["beta"],
            "G": detached["G"],
            "veil_weights": detached["veil_weights"],
            "light": light,
            **({} if self.demand is not None and self.demand.high == 0 else {"scale": scale}),
        }.items():
            self.register_parameter(f"raw_{name}", nn.Parameter(_inverse_softplus(value)))
        for name in ("direct_weights", "signal_weights"):
            self.register_parameter(f"raw_{name}", nn.Parameter(torch.log(detached[name].clamp(min=1e-30))))

    @property
    def medium(self) -> Medium:
        """The medium at hand; for a learnable module, of tensors that carry gradients to its parameters."""
        law = self._law
        if not self.learnable:
            if isinstance(law.scale, Tensor):
                law = replace(law, scale=self.get_buffer("scale"))
            if isinstance(law.exponent, Tensor):
                law = replace(law, exponent=self.get_buffer("exponent"))
            return assemble([self.get_buffer(name) for name in _NAMES], law, self._notes)
        light = F.softplus(self.get_parameter("raw_light"))[..., None]
        shares = {}
        for name in ("direct_weights", "signal_weights"):
            logits = self.get_parameter(f"raw_{name}").masked_fill(~self.get_buffer(f"{name}_used"), -1e30)
            shares[name] = light * torch.softmax(logits, -1)
        veil = F.softplus(self.get_parameter("raw_veil_weights")) * self.get_buffer("veil_weights_used")
        if isinstance(law.exponent, Tensor):
            law = replace(law, exponent=self.get_buffer("exponent"))
        if "raw_scale" in self._parameters:
            law = replace(law, scale=F.softplus(self.get_parameter("raw_scale")))
        beta, G = (F.softplus(self.get_parameter(f"raw_{name}")) for name in ("beta", "G"))
        b_mean = self.get_buffer("b_mean")
        return Medium(beta, shares["direct_weights"], G, shares["signal_weights"], veil, b_mean, law, self._notes)

    def plan(self, size: tuple[int, int]) -> BlurPlan | None:
        """The blur plan for images of (height, width) `size`; None without a `distance_range`."""
        if self.demand is None:
            return None
        height, width = size
        # index(): a compiled module is compiled again for another size, which has another plan
        return _plan(self.demand, index(height), index(width))

    def forward(self, image: Tensor, distance: Tensor, field: Tensor | None = None) -> Tensor:
        """Degrade an image; see the class."""
        medium = self.medium
        picture, z, medium = check(image, distance, medium, field, self.order)
        if self.color_space == "srgb":
            if not torch.compiler.is_compiling() and picture.numel() and picture.detach().max() > _HDR_LIMIT:
                top = float(picture.detach().max())
                raise ValueError(f"image reaches {top:g}: expected sRGB of about 0…1; divide a 0…255 image by 255")
            picture = srgb_to_linear(picture)
        plan = self.plan((image.shape[-2], image.shape[-1]))
        with torch.autocast(image.device.type, enabled=False):
            (result,) = form(picture, z, medium, self.order, self.tolerance, plan, total=True)
            if self.color_space == "srgb":
                result = linear_to_srgb(result)
        result = result.to(image.dtype)
        return result[0] if unbatched(image, distance, medium) else result

    def extra_repr(self) -> str:
        """What is modelled, and what is skipped."""
        if self.distance_range is None:
            planned = "planned at each call"
        else:
            near, far = self.distance_range
            planned = f"{near:g}…{far:g} m, {self.plan((512, 512))}"
            if self._law.reference_size is not None or self._law.shape == "exponential":
                planned += " at 512 px"
        return f"{self.medium!r},\n{planned},\ntolerance={self.tolerance:g}, {self.color_space}, {self.order}"


_NAMES = ("beta", "direct_weights", "G", "signal_weights", "veil_weights", "b_mean")


def _plan(demand: BlurDemand, height: int, width: int) -> BlurPlan:
    return demand.plan((height, width))


# what torch.compiler.assume_constant_result does, without its import of torch._dynamo, which takes .7 s
_plan._dynamo_marked_constant = True  # type: ignore[attr-defined]


def _inverse_softplus(y: Tensor) -> Tensor:
    y = y.clamp(min=1e-6)
    return y + torch.log(-torch.expm1(-y))
