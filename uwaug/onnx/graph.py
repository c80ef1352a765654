"""The model as a graph for any batch, height and width: what `uwaug.onnx` exports.

Curves, width law, weights and sum are the package's own functions. Of its own a graph has the
blurs, see `uwaug.onnx.blurs`; `uwaug.onnx.check_onnx` holds what is exported against them.

A graph works at once (`Graph.forward`), or in two parts: what is done once on the whole picture
(`before`), then strips of rows (`strip`), so that what a pixel does by itself stays in the caches.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from uwaug._support import checks
from uwaug.blur.kernels import PERIOD
from uwaug.blur.plan import BlurPlan
from uwaug.formation.colour import encoded, from_light, headroom, to_light
from uwaug.formation.demand import SIDES
from uwaug.formation.development import finished, linear_part, seen_sums
from uwaug.formation.scene import mixture, total
from uwaug.formation.underwater import Underwater
from uwaug.light.lit import Lit, lit_of, transmittance
from uwaug.onnx.blurs import Blurs
from uwaug.optics.curves import FARTHEST, Sums, curves
from uwaug.optics.medium import Medium


@dataclass(frozen=True)
class Options:
    """What a file is exported for; see `uwaug.onnx.export_onnx`."""

    parameters: Literal["frozen", "inputs"] = "frozen"
    field: Literal["none", "input"] = "none"
    image: Literal["float32", "uint8"] = "float32"

    def __post_init__(self) -> None:
        checks.one_of("parameters", self.parameters, ("frozen", "inputs"))
        checks.one_of("field", self.field, ("none", "input"))
        checks.one_of("image", self.image, ("float32", "uint8"))


def parameters_of(medium: Medium) -> dict[str, Tensor]:
    """The inputs of a file exported with `parameters="inputs"`, by name: `Medium.parameters` in
    float32.
    """
    return {
        name: value.detach().to("cpu", torch.float32).contiguous()
        for name, value in medium.parameters().items()
    }


def plan_of(module: Underwater) -> BlurPlan:
    """The plan of a module's file, which is the module's own for pictures of any size.

    Raises:
        ValueError: if the module has no such plan.
    """
    if module.distance_range is None:
        cure = "give Underwater(…, distance_range=(near, far)), which fixes the plan"
        raise ValueError(f"module has no distance_range: {cure}")
    if module.sides is None:
        cure = f"give Underwater(…, sides={SIDES}), so that module and file share one plan"
        raise ValueError(f"module has no sides and plans its blur for each picture's size: {cure}")
    # as it would be at the next picture, after parameters have changed
    module.keep_up(module.medium)
    plan = module.plan((module.sides[0], module.sides[0]))
    assert plan is not None
    return plan


class Graph(nn.Module):
    """An `Underwater` module as a function of tensors alone.

    Attributes:
        inputs: their names, in order: image, distance, then the field and the parameters if those
            are inputs.
        in_strips: whether it works in two parts, too; a light is made for the whole picture.
    """

    rates: Tensor
    weights: Tensor

    def __init__(self, module: Underwater, options: Options) -> None:
        super().__init__()
        checks.instance("module", module, Underwater)
        _require_exportable(module, options)
        self.plan = plan_of(module)
        self.blurs = Blurs(self.plan)
        self.options, self.frozen = options, options.parameters == "frozen"
        self.color_space, self.exposure = module.color_space, module.exposure
        self.development = module.development
        self.medium = module.medium.map(lambda t: t.detach().to("cpu", torch.float32))
        self.light = module.light and module.light.map(lambda t: t.detach().to("cpu"))
        self.lamps, self.pinhole = module.lamps, module.pinhole
        self.in_strips = self.light is None
        field = ("field",) if options.field == "input" else ()
        self.parameters_in = () if self.frozen else tuple(self.medium.parameters())
        self.inputs = ("image", "distance", *field, *self.parameters_in)
        # exact_at_lens=False: ONNX has no e^x − 1
        sums = self.medium.sums(exact_at_lens=False)
        measures = self.exposure == "auto" or self.development.measures
        self.curves_fixed = self.frozen and not measures
        if self.curves_fixed:
            nothing = sums.weights.new_zeros(1, 3, 1, 1)
            sums, _ = seen_sums(nothing, nothing, sums, self.exposure, self.development)
        self.register_buffer("rates", sums.rates)
        self.register_buffer("weights", sums.weights)

    def forward(self, *values: Tensor) -> Tensor:
        """Image (Bx3xHxW), distance (Bx1xHxW) and the rest of `inputs` → image."""
        inputs = dict(zip(self.inputs, values, strict=True))
        light, z, field = self._maps(inputs)
        medium = self._medium(inputs)
        sums, black = self._sums(light, z, medium)
        size = (z.shape[2], z.shape[3])
        down, across = (torch.arange((n + PERIOD - 1) // PERIOD * PERIOD) for n in size)
        _, stack = self.blurs.strip(self.blurs.before(light, down, across), down, across)
        stack = [blur.narrow(2, 0, size[0]) for blur in stack]
        T = transmittance(sums, z, self._lit(inputs["distance"], field, medium))
        (result,) = total(T, light, mixture(stack, z, medium, self.plan, size))
        result = finished(self.development, result, black)
        return from_light(result, self.color_space, inputs["image"])

    def before(
        self, inputs: Mapping[str, Tensor], down: Tensor, across: Tensor
    ) -> dict[str, Tensor]:
        """What `strip` needs of the whole picture, by name.

        Args:
            inputs: by name.
            down, across: tensors of the length of whole periods that cover its rows, its columns.
        """
        light, z, _ = self._maps(inputs)
        prepared = {**self.blurs.before(light, down, across), "z": z}
        if self.color_space == "srgb" and self.options.image == "float32":
            # eager mode gives a number where no value is above 1
            brightest = torch.as_tensor(headroom(inputs["image"]), dtype=light.dtype)
            prepared["brightest"] = brightest.expand(light.shape[0], 1, 1, 1)
        sums, black = self._sums(light, z, self._medium(inputs))
        if self.development.black_point > 0:
            prepared["black"] = black
        if not self.frozen:
            prepared["rates"] = sums.rates
        if not self.curves_fixed:
            # a black point alone is of each picture, and leaves one medium's weights
            prepared["weights"] = sums.weights.expand(light.shape[0], *sums.weights.shape[1:])
        return prepared

    def strip(self, inputs: Mapping[str, Tensor], numbers: Tensor, across: Tensor) -> Tensor:
        """A strip of the result (Bx3xRxW).

        Args:
            inputs: by name, what `before` gives, and the parameters if those are inputs.
            numbers: of its rows (R), whole periods, which may go beyond the picture.
            across: as for `before`.
        """
        z = inputs["z"]
        size = (z.shape[2], z.shape[3])
        z = z.index_select(2, numbers.clamp(max=size[0] - 1))
        light, stack = self.blurs.strip(inputs, numbers, across)
        rates, weights = inputs.get("rates", self.rates), inputs.get("weights", self.weights)
        blurred = mixture(stack, z, self._medium(inputs), self.plan, size)
        sums = Sums(rates, weights, self.medium.beta.shape[1], None)
        (result,) = total(curves(sums, z), light, blurred)
        result = finished(self.development, result, inputs.get("black", result.new_zeros(1)))
        dtype = getattr(torch, self.options.image)
        return encoded(result, self.color_space, dtype, inputs.get("brightest", 1.0))

    def _maps(self, inputs: Mapping[str, Tensor]) -> tuple[Tensor, Tensor, Tensor | None]:
        """Linear light, effective distance and field."""
        light = to_light(inputs["image"], self.color_space)
        z = inputs["distance"].clamp(0.0, FARTHEST)
        if "field" not in inputs:
            return light, z, None
        # either is limited first: a graph cannot refuse, and 0·inf is NaN
        field = inputs["field"].clamp(0.0, FARTHEST)
        return light, z * field, field

    def _medium(self, inputs: Mapping[str, Tensor]) -> Medium:
        """The medium, of the parameters if those are inputs."""
        if self.frozen:
            return self.medium
        return Medium.of({name: inputs[name] for name in self.parameters_in}, self.medium)

    def _sums(self, light: Tensor, z: Tensor, medium: Medium) -> tuple[Sums, Tensor]:
        """The medium's sums of exponentials as the camera sees them, and what becomes black."""
        sums = Sums(self.rates, self.weights, self.medium.beta.shape[1], None)
        if self.curves_fixed:
            return sums, light.new_zeros(1, 1, 1, 1)
        if not self.frozen:
            sums = medium.sums(exact_at_lens=False)
        return seen_sums(light, z, sums, self.exposure, self.development)

    def _lit(self, distance: Tensor, field: Tensor | None, medium: Medium) -> Lit | None:
        """The light on the scene; None for daylight as the medium has it."""
        lamps = None if self.lamps is None else self.lamps()
        lit = lit_of(self.light, distance, field, medium, *self.pinhole, lamps)
        if lit is None:
            return None
        stops = 0.0 if isinstance(self.exposure, str) else self.exposure
        linear = linear_part(self.development, medium.beta.new_zeros(1, 3, 1, 1))
        return lit.brightened(2.0**stops * linear)


def _require_exportable(module: Underwater, options: Options) -> None:
    """Refuse what a file cannot hold."""
    frozen, light = options.parameters == "frozen", module.light
    if frozen and len(module.medium) != 1:
        held = f"{len(module.medium)} media, of which only one can be frozen"
        raise ValueError(f"module holds {held}: use parameters='inputs'")
    if module.order != "line_of_sight":
        raise ValueError(
            f"module.order must be 'line_of_sight' to be exported, got {module.order!r}"
        )
    if light is None:
        return
    if light.rows() > 1:
        raise ValueError(f"module.light is for {light.rows()} pictures, of which one can be frozen")
    if not frozen:
        what = "a light is written with its water"
        raise ValueError(f"parameters must be 'frozen' where module.light is given: {what}")
    if module.exposure == "auto":
        cure = "give a number of stops"
        raise ValueError(f"module.exposure is 'auto', which a file with a light has not: {cure}")
    if module.development.measures:
        what = "measures the picture, which a file with a light does not"
        cure = "leave out white_balance and black_point"
        raise ValueError(f"module.development {what}: {cure}")
