"""`Underwater`: a medium and a plan as an `nn.Module`."""

import json
import math
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from operator import index
from typing import TYPE_CHECKING, Any, get_args

import torch
from torch import Tensor, nn

from uwaug._support import checks
from uwaug._support.types import ColorSpace, Order
from uwaug.blur.plan import BlurPlan
from uwaug.formation.demand import (
    EVERY_SIDE,
    BlurDemand,
    blur_demand,
    constant_plan,
    distance_range_of,
    same_plan,
    sides_of,
)
from uwaug.formation.development import NEUTRAL, Development
from uwaug.formation.engine import expected_engine
from uwaug.formation.exposure import Exposure, exposed_for_planning, require_exposure
from uwaug.formation.inputs import MapRanges, validate
from uwaug.formation.learnable import FixedLamps, FixedMedium, LearnableMedium, Part
from uwaug.formation.scene import Scene
from uwaug.formation.setup import Setup
from uwaug.light.light import Light
from uwaug.light.lit import checked_light, lamps_in_water, planning_medium
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium

_FEW = 0.01
"""Share of the pixels that may lie outside of the range that is planned for without a word."""

_ROOM = 2.0
"""Either way, for the width that is learned, until it is planned anew."""


class Underwater(nn.Module):
    """Degrade pictures as a given water would.

    Args:
        medium: one medium, or one for each image of a batch.
        distance_range: (nearest, farthest) effective distance m·z, m, for which the blur is planned
            once; beyond it widths stop changing. None plans for each call's own distances, which
            cannot be compiled or exported.
        tolerance: RMSE of the blur that may pass, in linear light, on pictures with power ∝ 1/f²;
            single pixels may be off by 3 to 5 times as much.
        color_space: "srgb" decodes, works in linear light, encodes again and clips to 0…1 (to the
            picture's own largest value if that is above 1); "linear" takes values as they are and
            never clips.
        learnable: make rates, light, veil and width scale parameters, see
            `uwaug.formation.LearnableMedium` for what stays true of them; or some of ("rates",
            "light", "veil", "width"), where the others are known. A width that leaves the plan is
            planned for anew, except in a compiled module.
        order: "line_of_sight", or "source" for the paper's equation, see `uwaug.form_image`.
        exposure: "none": light is lost as it is in the water. "auto": as a camera does, one gain
            for each picture keeps the mean luminance of the scene, from 1/8 to 64. A number: a gain
            in stops.
        sides: (smallest, largest) short side, px, of the pictures: one plan of the blur then serves
            them all, and a file exported from the module (`uwaug.onnx.export_onnx`) computes the
            same.
            Other pictures get the nearest width of that plan. None plans for each size, which is
            faster: one plan for (32, 2160) takes 15 to 70 % more time. A width law that knows no
            size, such as `PointSpread(2.0)`, has one plan in any case.
        light: what shines, one for all images or one for each; None for daylight as the medium has
            it. Numbers of it that require gradients are learned with, and stay the caller's: they
            are no part of the state, but must be those of the module that is loaded.
        focal_px, centre: as for `uwaug.form_image`; wanted where the light differs from ray to ray.
        development: what the camera makes of the light, see `uwaug.Development`; nothing by
            default.
        plan: of the blur, for pictures of all sizes, such as a file has that another version wrote;
            by default one is made for `distance_range`.

    Keep torch's default matmul precision. With `torch.set_float32_matmul_precision("medium")`, CPUs
    that support it multiply in bfloat16, and the error is visible.

    A state dict carries the colour space, the order, the width law and what the blur is planned
    for. `load_state_dict` refuses that of a module in which they differ.

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
        learnable: bool | Sequence[Part] = False,
        order: Order = "line_of_sight",
        exposure: Exposure = "none",
        sides: tuple[int, int] | None = None,
        light: Light | None = None,
        focal_px: float | None = None,
        centre: tuple[float, float] | None = None,
        plan: BlurPlan | None = None,
        development: Development = NEUTRAL,
    ) -> None:
        super().__init__()
        checks.instance("medium", medium, Medium, "; see Medium.from_water")
        checks.one_of("color_space", color_space, get_args(ColorSpace))
        checks.one_of("order", order, get_args(Order))
        checks.tolerance(tolerance)
        require_exposure(exposure)
        self.light = None if light is None else checked_light(light, focal_px, centre)
        self.pinhole = focal_px, centre
        self.distance_range = None if distance_range is None else distance_range_of(distance_range)
        self.tolerance = tolerance
        self.color_space = color_space
        self.order: Order = order
        self.exposure: Exposure = exposure
        checks.instance("development", development, Development)
        self.development = development
        self.learnable = bool(learnable)
        self._sides = None if sides is None else sides_of(sides)
        self.demand: BlurDemand | None = None
        self._warned = False
        self._plan = plan
        if self.distance_range is not None:
            self.demand = self._demand_of(medium, margin=_ROOM if learnable else 1.0)
        elif sides is not None:
            raise ValueError(f"sides need a distance_range to plan for, got sides={sides} alone")
        self.coefficients: FixedMedium | LearnableMedium = FixedMedium(medium)
        if learnable:
            parts = get_args(Part) if learnable is True else tuple(learnable)
            # without a blur, its width does nothing
            blurs = self.demand is None or self.demand.high > 0
            learnt = [part for part in parts if blurs or part != "width"]
            if not learnt:
                raise ValueError("learnable: width alone cannot be learnt, as no blur shows")
            self.coefficients = LearnableMedium(medium, learnt)
        # what is learned changes what lamps give
        fixed = None if light is None or learnable else lamps_in_water(light, medium)
        self.lamps = FixedLamps(fixed) if fixed else None

    @property
    def medium(self) -> Medium:
        """The medium at hand; if learnable, of tensors that carry gradients to the parameters."""
        medium: Medium = self.coefficients()
        return medium

    @property
    def setup(self) -> Setup:
        """What pictures are taken with."""
        return self._setup_of(self.medium)

    def _setup_of(self, medium: Medium) -> Setup:
        space, pinhole = self.color_space, self.pinhole
        return Setup(
            medium,
            self.light,
            self.exposure,
            space,
            *pinhole,
            tolerance=self.tolerance,
            order=self.order,
            development=self.development,
        )

    @property
    def sides(self) -> tuple[int, int] | None:
        """Short sides, px, of pictures that share a plan; None if each size has its own."""
        if self._sides is None and self.demand and self.demand.serves_every_size:
            return EVERY_SIDE
        return self._sides

    def plan(self, size: tuple[int, int]) -> BlurPlan | None:
        """The blur plan for images of (height, width) `size`; None without a `distance_range`."""
        if self._plan is not None:
            return same_plan(self._plan)
        if self.demand is None:
            return None
        if self.sides is not None:
            return constant_plan(self.demand, self.sides, 1, 1)
        # index(): a compiled module is compiled again for another size, which has another plan
        return constant_plan(self.demand, None, index(size[0]), index(size[1]))

    if TYPE_CHECKING:  # nn.Module's own returns Any

        def __call__(self, image: Tensor, distance: Tensor, field: Tensor | None = None) -> Tensor:
            """As `forward`."""
            ...

    def forward(self, image: Tensor, distance: Tensor, field: Tensor | None = None) -> Tensor:
        """Degrade an image; see the class."""
        medium = self.medium
        ranges = validate(image, distance, medium, field, also_bytes=True, light=self.light)
        self.keep_up(medium)
        plan = self.plan((image.shape[-2], image.shape[-1]))
        planned_for = self.distance_range
        if ranges is not None and planned_for is not None and not ranges.lie_within(*planned_for):
            self._warn_outside(distance, field, *planned_for)
        return self.formed(image, distance, field, medium, plan, ranges)

    def _warn_outside(
        self, distance: Tensor, field: Tensor | None, near: float, far: float
    ) -> None:
        """Warn, once, if more than 1 % of the pixels lie outside of the range that is planned for;
        open water does not count.
        """
        if self._warned:
            return
        # half precision does not reach as far as open water
        z = distance.detach().to(torch.promote_types(distance.dtype, torch.float32))
        open_water = z >= FARTHEST
        if field is not None:
            z = z * field.detach()
        outside = {"nearer": z < near, "farther": (z > far) & ~open_water}
        shares = {
            where: float(pixels.count_nonzero()) / max(1, pixels.numel())
            for where, pixels in outside.items()
        }
        clauses = [
            f"{share:.0%} of the pixels lie {where}"
            for where, share in shares.items()
            if share > _FEW
        ]
        if clauses:
            self._warned = True
            warnings.warn(
                f"{' and '.join(clauses)} than the {near:g}…{far:g} m that the blur is planned "
                "for, and get the width of its end; plan for them with Underwater(…, "
                "distance_range=(near, far)), or with None for each call",
                stacklevel=5,  # behind two functions of torch that call forward
            )

    def keep_up(self, medium: Medium) -> None:
        """Plan anew if what was learned has left the plan, at whose ends widths would stop changing
        and learning would stick. A compiled module keeps the plan that it was compiled with.
        """
        if not self.learnable or self.demand is None or torch.compiler.is_compiling():
            return
        demand = self._demand_of(medium)
        if not self.demand.covers(demand):
            self.demand = demand.widened(_ROOM)

    def _demand_of(self, medium: Medium, margin: float = 1.0) -> BlurDemand:
        assert self.distance_range is not None
        return blur_demand(
            planning_medium(
                exposed_for_planning(medium, self.exposure, self.development.linear_gain),
                self.light,
            ),
            self.distance_range,
            self.tolerance,
            order=self.order,
            learned=self.learnable,
            margin=margin,
        )

    def formed(
        self,
        image: Tensor,
        distance: Tensor,
        field: Tensor | None,
        medium: Medium,
        plan: BlurPlan | None,
        ranges: MapRanges | None = None,
    ) -> Tensor:
        """Results like the image, of input that `validate` has seen, which gives its `ranges`."""
        setup = self._setup_of(medium)
        farthest = math.inf if ranges is None else ranges.farthest
        lamps = None if self.lamps is None else self.lamps()
        with torch.autocast(image.device.type, enabled=False):
            return Scene.of(
                image, distance, setup, field, plan=plan, lamps=lamps, farthest=farthest
            ).picture()

    def get_extra_state(self) -> Tensor:
        """What a state dict says of the module besides its tensors, as text in a tensor: file
        formats for state dicts take nothing else.
        """
        text = json.dumps(self._settings()).encode()
        return torch.frombuffer(bytearray(text), dtype=torch.uint8)

    def set_extra_state(self, state: Tensor) -> None:
        """Refuse the state of a module that is set up differently: its tensors would be used with
        this module's plan.
        """
        # files of older versions know of no development
        theirs = {"development": asdict(NEUTRAL), **json.loads(state.cpu().numpy().tobytes())}
        differences = []
        for name, mine in self._settings().items():
            adopted = name == "demand" and self.learnable and mine and theirs.get(name)
            if not adopted and not checks.alike(mine, theirs.get(name)):
                differences.append(f"{name} is {theirs.get(name)} there and {mine} here")
        if differences:
            got = "; ".join(differences)
            raise ValueError(f"state_dict is of an Underwater of another kind: {got}")
        if self.learnable and self.demand is not None:
            # while it learned, that module may have planned anew
            self.demand = BlurDemand(**theirs["demand"])

    def _settings(self) -> dict[str, Any]:
        """What `load_state_dict` compares."""
        law = self.coefficients.start.point_spread
        settings: dict[str, Any] = {"color_space": self.color_space, "order": self.order}
        settings["exposure"] = self.exposure
        settings |= {"shape": law.shape, "reference_size": law.reference_size}
        state = self.coefficients.state_dict()
        for name, value in law.numbers().items():
            if name not in state and not (self.learnable and name == "scale"):
                settings[name] = float(value)
        settings |= {"light": None, "camera": None}
        if self.light is not None:
            settings |= {"light": self.light.to_list(), "camera": self.pinhole}
        settings["development"] = asdict(self.development)
        settings |= {"sides": self._sides, "tolerance": self.tolerance}
        settings["demand"] = None if self.demand is None else asdict(self.demand)
        return settings

    def extra_repr(self) -> str:
        """What is modelled, and what is skipped."""
        blur = "planned at each call"
        if self.distance_range is not None:
            near, far = self.distance_range
            at = " at 512 px"
            if self.sides is not None:
                every = self.sides == EVERY_SIDE
                at = "" if every else " for short sides of {}…{} px".format(*self.sides)
            blur = f"{near:g}…{far:g} m, {self.plan((512, 512))}{at}"
        settings = f"tolerance={self.tolerance:g}, {self.color_space}, {self.order}"
        if self.exposure != "none":
            settings += f", exposure={self.exposure!r}"
        if self.development != NEUTRAL:
            settings += f", {self.development!r}"
        if self.light is not None:
            settings += f", {self.light!r}"
        settings += f", {expected_engine((512, 512), self.order, self.light)}"
        return f"{self.medium!r},\n{blur},\n{settings}"
