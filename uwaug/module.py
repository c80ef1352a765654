"""`Underwater`: a medium and a plan as an `nn.Module`."""

from dataclasses import replace
from operator import index
from typing import TYPE_CHECKING, Any, get_args

import torch
from torch import Tensor, nn

from uwaug import checks
from uwaug.blur.demand import BlurDemand, blur_demand
from uwaug.blur.plan import BlurPlan
from uwaug.colour import ColorSpace, from_light, headroom, to_light
from uwaug.exposure import Exposure, brightest, exposed, require_exposure
from uwaug.formation import Order, form, plan_at_hand, prepare, together, unbatched, validate
from uwaug.optics.medium import Medium
from uwaug.parameters import LearnableMedium

__all__ = ["FixedMedium", "Underwater"]


class FixedMedium(nn.Module):
    """A medium whose tensors are buffers: it moves and is saved with a module.

    Args:
        medium: any batch.
    """

    def __init__(self, medium: Medium) -> None:
        super().__init__()
        self.start = _detached(medium)
        for name, value in self.start.parameters().items():
            self.register_buffer(name, value.clone())

    def forward(self) -> Medium:
        """The medium at hand."""
        medium = Medium.of(dict(self.named_buffers()), self.start)
        law, start = medium.point_spread, self.start.point_spread
        # what is one number for the whole batch stays a number: x² is faster than a power
        fixed: dict[str, Any] = {}
        for name, value in start.numbers().items():
            if not isinstance(value, Tensor):
                fixed[name] = value
        return replace(medium, point_spread=replace(law, **fixed))


def _detached(medium: Medium) -> Medium:
    return medium.map(lambda t: t.detach().clone())


class Underwater(nn.Module):
    """Degrade pictures as a given water would.

    Args:
        medium: one medium, or one for each image of a batch.
        distance_range: (nearest, farthest) effective distance m·z, m, for which the blur is planned
            once; beyond it widths stop changing. None plans for each call's own distances, which
            cannot be compiled or exported.
        tolerance: largest error of the blur in the image, on a scale of 0…1.
        color_space: "srgb" decodes, works in linear light, encodes again and clips to 0…1 (to the
            picture's own largest value if that is above 1); "linear" takes values as they are and
            never clips.
        learnable: make rates, light, veil and width scale parameters, see
            `uwaug.parameters.LearnableMedium` for what stays true of them.
        order: "line_of_sight", or "source" for the paper's equation, see `uwaug.form_image`.
        exposure: "none": light is lost as it is in the water. "auto": as a camera does, one gain
            for each picture keeps the mean luminance of the scene, from 1/8 to 64. A number: a gain
            in stops.
        demand: what the plan has to serve, by default what `medium` asks for over `distance_range`.

    Keep torch's default matmul precision. With `torch.set_float32_matmul_precision("medium")`, CPUs
    that support it multiply in bfloat16, and the error is visible.

    Shapes:
        image (Bx3xHxW or 3xHxW; uint8 0…255, or floating point 0…1), distance (Bx1xHxW or 1xHxW,
            m), field (as distance, or None) → image, of the same type.

    Raises:
        TypeError, ValueError: as `uwaug.form_image`; and if an sRGB image exceeds 16, which is
            taken for a scale of 0…255.

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
        color_space: ColorSpace = "srgb",
        learnable: bool = False,
        order: Order = "line_of_sight",
        exposure: Exposure = "none",
        demand: BlurDemand | None = None,
    ) -> None:
        super().__init__()
        checks.instance("medium", medium, Medium, "; see Medium.from_water")
        checks.one_of("color_space", color_space, get_args(ColorSpace))
        checks.one_of("order", order, get_args(Order))
        checks.tolerance(tolerance)
        require_exposure(exposure)
        if distance_range is not None and not 0 <= distance_range[0] < distance_range[1]:
            expected = "0 ≤ nearest < farthest in metres"
            raise ValueError(f"distance_range must be {expected}, got {distance_range}")
        self.distance_range = distance_range
        self.tolerance = tolerance
        self.color_space = color_space
        self.order: Order = order
        self.exposure: Exposure = exposure
        self.learnable = learnable
        self.demand = demand
        if demand is not None and distance_range is None:
            raise ValueError("demand needs the distance_range that it is for, got None")
        if demand is None and distance_range is not None:
            # an octave either way, for the width that is learned
            margin = 2.0 if learnable else 1.0
            self.demand = blur_demand(
                brightest(medium, exposure),
                distance_range,
                tolerance,
                order=order,
                learned=learnable,
                margin=margin,
            )
        self.coefficients: FixedMedium | LearnableMedium = FixedMedium(medium)
        if learnable:
            # without a blur, its width does nothing
            width = self.demand is None or self.demand.high > 0
            self.coefficients = LearnableMedium(medium, width)

    @property
    def medium(self) -> Medium:
        """The medium at hand; if learnable, of tensors that carry gradients to the parameters."""
        medium: Medium = self.coefficients()
        return medium

    def plan(self, size: tuple[int, int]) -> BlurPlan | None:
        """The blur plan for images of (height, width) `size`; None without a `distance_range`."""
        if self.demand is None:
            return None
        # index(): a compiled module is compiled again for another size, which has another plan
        return _plan(self.demand, index(size[0]), index(size[1]))

    if TYPE_CHECKING:  # nn.Module's own returns Any

        def __call__(self, image: Tensor, distance: Tensor, field: Tensor | None = None) -> Tensor:
            """As `forward`."""
            ...

    def forward(self, image: Tensor, distance: Tensor, field: Tensor | None = None) -> Tensor:
        """Degrade an image; see the class."""
        medium = self.medium
        validate(image, distance, medium, field, also_bytes=True)
        plan = self.plan((image.shape[-2], image.shape[-1]))
        result = self.formed(image, distance, field, medium, plan)
        return result[0] if unbatched(image, distance, medium) else result

    def formed(
        self,
        image: Tensor,
        distance: Tensor,
        field: Tensor | None,
        medium: Medium,
        plan: BlurPlan | None,
    ) -> Tensor:
        """A batch of results, of input that is known to be valid."""
        with torch.autocast(image.device.type, enabled=False):
            light = to_light(image, self.color_space)
            light, z, medium = prepare(light, distance, medium, field)
            medium = exposed(light, z, medium, self.exposure)
            if plan is None:
                plan = plan_at_hand(z, medium, self.tolerance, self.order)
            (result,) = form(light, z, medium, plan, self.order, together)
            return from_light(result, self.color_space, image.dtype, headroom(image))

    def extra_repr(self) -> str:
        """What is modelled, and what is skipped."""
        planned = "planned at each call"
        if self.distance_range is not None:
            near, far = self.distance_range
            law = self.coefficients.start.point_spread
            scaled = law.reference_size is not None or law.shape == "exponential"
            at = " at 512 px" if scaled else ""
            planned = f"{near:g}…{far:g} m, {self.plan((512, 512))}{at}"
        settings = f"tolerance={self.tolerance:g}, {self.color_space}, {self.order}"
        if self.exposure != "none":
            settings += f", exposure={self.exposure!r}"
        return f"{self.medium!r},\n{planned},\n{settings}"


def _plan(demand: BlurDemand, height: int, width: int) -> BlurPlan:
    return demand.plan((height, width))


# what torch.compiler.assume_constant_result does, without its import of torch._dynamo (.7 s)
_plan._dynamo_marked_constant = True  # type: ignore[attr-defined]
