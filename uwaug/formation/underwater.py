"""`Underwater`: image formation as a module, with its blur planned once."""

import warnings
from collections.abc import Sequence
from dataclasses import fields, replace
from operator import index
from typing import TYPE_CHECKING, Any, get_args

import torch
from torch import Tensor, nn

from uwaug._support import checks
from uwaug._support.codec import changed, from_plain
from uwaug._support.types import ColorSpace
from uwaug.blur.plan import BlurPlan
from uwaug.formation.colour import LUMINANCE
from uwaug.formation.demand import (
    EVERY_SIDE,
    BlurDemand,
    blur_demand,
    constant_plan,
    distance_range_of,
    sides_of,
)
from uwaug.formation.development import GAINS, NEUTRAL, Development
from uwaug.formation.image import form
from uwaug.formation.inputs import effective_distance, validate
from uwaug.formation.learnable import FixedMedium, LearnableMedium, Part, as_tensor, of_tensor
from uwaug.formation.setting import Setting
from uwaug.light import Light
from uwaug.optics.medium import Medium
from uwaug.optics.view import WIDE, View

_MAX_SHARE_OUTSIDE = 0.01  # of the pixels, beyond the planned range, without a warning
_WIDTH_MARGIN = 2.0  # factor by which a learned width may leave its start before a new plan
_RANGE_ROUNDING = 1e-6  # share by which float32 may exceed a range, as with a field
_OF_SETTING = [field.name for field in fields(Setting) if field.name not in ("medium", "span")]
# older releases were tried: they neither compile the module nor trace free sizes
EXPORTS = tuple(map(int, torch.__version__.split(".")[:2])) >= (2, 13)


class Underwater(nn.Module):
    """Degrade pictures as a given water would.

    Args:
        medium: one medium, or one for each image of a batch.
        distance_range: (nearest, farthest) effective distance m·z, m, for which the blur is planned
            once; beyond it widths stop changing. None plans for each call's own distances, which
            cannot be compiled or exported.
        tolerance: as of `uwaug.form_image`.
        color_space: "srgb" decodes, works in linear light, encodes again and clips to 0…1 (to the
            picture's own largest value if that is above 1); "linear" takes values as they are and
            never clips.
        learnable: True to make β, G, veil and width of a medium of coefficients parameters, see
            `uwaug.formation.LearnableMedium`; or some of ("rates", "veil", "width"). A width that
            leaves the plan gets a new plan, except in a compiled module. The medium is copied: to
            its own tensors gradients go by `uwaug.form_image` alone.
        sides: (smallest, largest) short side, px, of the pictures: one plan of the blur then serves
            them all, as an exported file needs. None plans for each size, which is faster.
        development: steps of the camera; none by default.
        light: lamps and direction of daylight; None for that of the medium.
        view: of the camera, a `uwaug.View` or its angle in degrees.

    A state (`state_dict`) holds the whole `setting`, and the module that loads it takes it all;
    distance_range, tolerance and sides stay its own. Keep torch's default matmul precision: the
    error of bfloat16 is visible. `torch.compile` needs torch 2.13.

    Shapes:
        image (Bx3xHxW or 3xHxW; uint8 0…255, or floating point 0…1), distance (Bx1xHxW or 1xHxW,
            m), field (as distance, or None) → image, of the same type.

    Raises:
        TypeError, ValueError: as `uwaug.form_image`; and if an sRGB image leaves −.1…16.

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
        sides: tuple[int, int] | None = None,
        development: Development = NEUTRAL,
        light: Light | None = None,
        view: View | float = WIDE,
    ) -> None:
        super().__init__()
        checks.instance("medium", medium, Medium, "; see Medium.from_water")
        checks.one_of("color_space", color_space, get_args(ColorSpace))
        checks.tolerance(tolerance)
        checks.instance("development", development, Development)
        if light is not None:
            checks.instance("light", light, Light)
        self.distance_range = None if distance_range is None else distance_range_of(distance_range)
        self.tolerance = tolerance
        self.color_space: ColorSpace = color_space
        self.learnable = bool(learnable)
        self.development, self.light, self.view = development, light, View.of(view)
        self._sides = None if sides is None else sides_of(sides)
        self._warned = False
        self.coefficients: FixedMedium | LearnableMedium = FixedMedium(medium)
        if learnable:
            parts = get_args(Part) if learnable is True else tuple(learnable)
            self.coefficients = LearnableMedium(medium, parts)
        if self.distance_range is None and sides is not None:
            raise ValueError(f"sides need a distance_range to plan for, got sides={sides} alone")
        self.demand: BlurDemand | None = None
        self._plan_anew()
        self.register_load_state_dict_post_hook(Underwater._plan_anew)  # type: ignore[no-untyped-call]

    @staticmethod
    def of(
        setting: Setting,
        distance_range: tuple[float, float] | None = (0.1, 20.0),
        tolerance: float = 0.002,
        sides: tuple[int, int] | None = None,
    ) -> "Underwater":
        """The module of a setting; further arguments as of the class."""
        options: Any = {name: getattr(setting, name) for name in _OF_SETTING}
        return Underwater(setting.medium, distance_range, tolerance, sides=sides, **options)

    @property
    def setting(self) -> Setting:
        """Water, light and camera of the module."""
        return Setting(self.medium, **{name: getattr(self, name) for name in _OF_SETTING})

    @property
    def medium(self) -> Medium:
        """The medium; if learnable, of tensors that carry gradients to the parameters."""
        medium: Medium = self.coefficients()
        return medium

    @property
    def sides(self) -> tuple[int, int] | None:
        """Short sides, px, of pictures that share a plan; None if each size has its own."""
        if self._sides is None and self.demand and self.demand.serves_every_size:
            return EVERY_SIDE
        return self._sides

    def plan(self, size: tuple[int, int]) -> BlurPlan | None:
        """The blur plan for images of (height, width) `size`; None without a `distance_range`."""
        if self.demand is None:
            return None
        # index(): a compiled module is compiled again for another size, which has another plan
        height, width = (1, 1) if self.sides else map(index, size)
        return constant_plan(self.demand, self.sides, height, width)

    if TYPE_CHECKING:  # nn.Module's own returns Any

        def __call__(self, image: Tensor, distance: Tensor, field: Tensor | None = None) -> Tensor:
            """As `forward`."""
            ...

    def forward(self, image: Tensor, distance: Tensor, field: Tensor | None = None) -> Tensor:
        """Degrade an image."""
        if torch.compiler.is_compiling() and not EXPORTS:
            raise RuntimeError("torch.compile of Underwater needs torch 2.13 or newer")
        setting = self.setting
        medium, light = setting.medium, setting.light
        options: Any = {"color_space": setting.color_space, "light": light, "view": setting.view}
        validate(image, distance, medium, field, **options)
        dtype = torch.promote_types(image.dtype, torch.float32)
        with checks.full_precision(image):
            z = effective_distance(distance, field, dtype)
            metres = None
            if field is not None and (light is not None or medium.snow):
                metres = effective_distance(distance, None, dtype).expand_as(z)
            if not torch.compiler.is_compiling():
                # beyond the ends of a plan learning gets stuck
                plan = self.demand if self.learnable else None
                if plan and not plan.covers(self._demand_of(medium)):
                    self._plan_anew()
                self._warn_outside(z)
            result = form(
                image if image.ndim == 4 else image[None],
                z,
                replace(setting, medium=medium.to(dtype=dtype, device=image.device)),
                metres=metres,
                plan=self.plan((image.shape[-2], image.shape[-1])),
                tolerance=self.tolerance,
            )
        return result[0] if image.ndim == 3 and len(result) == 1 else result

    def get_extra_state(self) -> Tensor:
        """The setting but for its medium, which `coefficients` hold."""
        return as_tensor({name: getattr(self, name) for name in _OF_SETTING})

    def set_extra_state(self, state: Tensor) -> None:
        """Take the setting of a state. A pitch that may learn stays the tensor that it is."""
        pitch = self.light and self.light.pitch
        setting: Setting = from_plain({**of_tensor(state), "medium": self.medium}, Setting)
        for name in _OF_SETTING:
            setattr(self, name, getattr(setting, name))
        if self.light and isinstance(pitch, Tensor) and isinstance(self.light.pitch, Tensor):
            with torch.no_grad():
                self.light = replace(self.light, pitch=pitch.copy_(self.light.pitch))

    def _warn_outside(self, z: Tensor) -> None:
        """Warn, once, of pixels outside of the planned range; open water does not count."""
        if self._warned or self.distance_range is None or not z.numel():
            return
        near, far = self.distance_range
        nearest, farthest = checks.extent(z)
        if near <= nearest * (1 + _RANGE_ROUNDING) and farthest <= far * (1 + _RANGE_ROUNDING):
            return
        outside = (z < near) | ((z > far) & (z < checks.OPEN))
        share = float(outside.count_nonzero()) / z.numel()
        if share > _MAX_SHARE_OUTSIDE:
            self._warned = True
            warnings.warn(
                f"{share:.0%} of the pixels lie outside of the {near:g}…{far:g} m that the blur is "
                "planned for, and get the width of its end; plan for them with Underwater(…, "
                "distance_range=(near, far)), or with None for each call",
                stacklevel=5,  # behind two functions of torch that call forward
            )

    def _plan_anew(self, *_: Any) -> None:
        """Plan for the medium; also a hook, for a state that has been loaded."""
        medium = self.medium
        if self.distance_range is not None and not medium.beta.is_meta:
            self.demand = self._demand_of(medium, margin=_WIDTH_MARGIN if self.learnable else 1.0)

    def plans_for(self, medium: Medium) -> bool:
        """True if the widths of another medium of this law lie within the plan."""
        return self.demand is None or self.demand.holds(self._demand_of(medium))

    def _demand_of(self, medium: Medium, margin: float = 1.0) -> BlurDemand:
        assert self.distance_range is not None
        light, development = self.light, self.development
        medium = medium if light is None else light.planned(medium)
        gain = medium.beta.new_full((1,), development.brightening)
        if development.metered:
            # without a picture, the meter is taken to make up for the light lost above the scene
            ambient = medium.ambient().detach()
            luminance = (ambient * ambient.new_tensor(LUMINANCE)).sum(-1)
            gain = gain * (1 / luminance.clamp(min=1e-30)).clamp(*GAINS)
        return blur_demand(
            medium.brightened(gain),
            self.distance_range,
            self.tolerance,
            view=self.view,
            learned=self.learnable,
            margin=margin,
        )

    def extra_repr(self) -> str:
        """Medium, plan of the blur and settings."""
        blur = f"distance_range={self.distance_range}, sides={self.sides}"
        if self.distance_range is not None:
            blur += f", at 512 px {self.plan((512, 512))}"
        names = [f.name for f in changed(self.setting) if f.name not in ("medium", "color_space")]
        options = "".join(f", {getattr(self, name)!r}" for name in names)
        settings = f"tolerance={self.tolerance:g}, {self.color_space}{options}"
        return f"{self.medium!r},\n{blur},\n{settings}"
