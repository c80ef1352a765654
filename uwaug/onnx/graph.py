"""The model as a graph for any batch, height and width: what `uwaug.onnx` exports.

Curves, width law, weights and sum are the package's own functions. Of its own a graph has the
blurs, see `uwaug.onnx.blurs`; `uwaug.onnx.check_onnx` holds what is exported against them. A file
has the graph in two parts, `Before` and `Strip`, see `uwaug.onnx.strips`; with a light, and as a
program of torch.export, it is `Graph`.
"""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn

from uwaug.blur.plan import BlurPlan
from uwaug.formation.colour import encoded, from_light, headroom, to_light
from uwaug.formation.exposure import exposed_sums, fixed_gain
from uwaug.formation.scene import mixture, total
from uwaug.formation.underwater import Underwater
from uwaug.light.lit import Lit, lit_of, transmittance
from uwaug.onnx.blurs import Blur, blur_of
from uwaug.onnx.strips import PICTURE, strips_of
from uwaug.optics.curves import FARTHEST, Sums, curves
from uwaug.optics.medium import Medium

__all__ = ["Before", "Graph", "Strip", "parameters_of"]


def parameters_of(medium: Medium) -> dict[str, Tensor]:
    """What a file exported with `parameters="inputs"` takes, by name: `Medium.parameters` in
    float32.
    """
    return {
        name: value.detach().to("cpu", torch.float32).contiguous()
        for name, value in medium.parameters().items()
    }


class Graph(nn.Module):
    """An `Underwater` module as a function of tensors alone: image, distance, then the field and
    the parameters if those are inputs.
    """

    rates: Tensor
    weights: Tensor

    def __init__(
        self, module: Underwater, plan: BlurPlan, *, frozen: bool, field: bool, quantised: bool
    ) -> None:
        super().__init__()
        self.plan = plan
        self.frozen = frozen
        self.field = field
        self.quantised = quantised
        self.color_space = module.color_space
        self.exposure = module.exposure
        self.keeps_brightest = module.color_space == "srgb" and not quantised
        self.curves_fixed = frozen and module.exposure != "auto"
        self.medium = module.medium.map(lambda t: t.detach().to("cpu", torch.float32))
        self.blurs = nn.ModuleList(
            blur_of(sigma, cell, plan.reach)
            for sigma, cell in zip(plan.sigmas, plan.cells, strict=True)
        )
        # exact_at_lens=False: ONNX has no e^x − 1
        rates, weights, _ = self.medium.sums(exact_at_lens=False)
        if self.curves_fixed:
            weights = weights * fixed_gain(self.medium, module.exposure)
        self.light = module.light and module.light.map(lambda t: t.detach().to("cpu"))
        self.lamps, self.camera = module.lamps, module.camera
        self.register_buffer("rates", rates)
        self.register_buffer("weights", weights)

    def forward(self, image: Tensor, distance: Tensor, *rest: Tensor) -> Tensor:
        """Image (Bx3xHxW) and distance (Bx1xHxW) → image."""
        light, z, field, medium, sums = self.scene(image, distance, *rest)
        found = transmittance(sums, z, self._lit(distance, field, medium))
        stack = [blur(light) for blur in self.blurs]
        size = (z.shape[2], z.shape[3])
        (result,) = total(found, light, mixture(stack, z, medium, self.plan, size))
        return from_light(result, self.color_space, image)

    def scene(
        self, image: Tensor, distance: Tensor, *rest: Tensor
    ) -> tuple[Tensor, Tensor, Tensor | None, Medium, Sums]:
        """Linear light, effective distance, field, medium, and its sums as the camera sees them."""
        z, field = distance.clamp(0.0, FARTHEST), None
        if self.field:
            # either is limited first: a graph cannot refuse, and 0·inf is NaN
            field = rest[0].clamp(0.0, FARTHEST)
            z = z * field
        medium = self.medium_of(self.numbers(rest))
        sums = Sums(self.rates, self.weights, None)
        if not self.frozen:
            sums = medium.sums(exact_at_lens=False)
        light = to_light(image, self.color_space)
        if not self.curves_fixed:
            sums = exposed_sums(light, z, sums, self.exposure)
        return light, z, field, medium, sums

    def stack(self) -> list[Blur]:
        """The blurs."""
        return list(self.blurs)  # type: ignore[arg-type]

    def numbers(self, rest: Sequence[Tensor]) -> dict[str, Tensor]:
        """The parameters (none, if frozen) among the inputs that follow the distance, by name."""
        if self.frozen:
            return {}
        return dict(zip(self.medium.parameters(), rest[1:] if self.field else rest, strict=True))

    def medium_of(self, numbers: Mapping[str, Tensor]) -> Medium:
        """The medium, of its parameters if those are inputs; among `numbers` may be others."""
        if self.frozen:
            return self.medium
        return Medium.of({name: numbers[name] for name in self.medium.parameters()}, self.medium)

    def _lit(self, distance: Tensor, field: Tensor | None, medium: Medium) -> Lit | None:
        """The light on the scene; None for daylight as the medium has it."""
        lamps = None if self.lamps is None else self.lamps()
        lit = lit_of(self.light, distance, field, medium, *self.camera, lamps)
        if lit is None or isinstance(self.exposure, str):
            return lit
        return lit.brightened(medium.beta.new_full((1,), 2.0**self.exposure))


class Before(nn.Module):
    """What a graph does once, on the whole picture: takes what the graph takes, and gives the
    tensors of `strips_of`, then those of `made`.
    """

    def __init__(self, graph: Graph) -> None:
        super().__init__()
        self.parent = graph

    def forward(self, image: Tensor, distance: Tensor, *rest: Tensor) -> tuple[Tensor, ...]:
        """As `Graph.forward`."""
        strips = strips_of(image.shape[0], (image.shape[2], image.shape[3]))
        return (*strips, *self.made(image, distance, *rest).values())

    def made(self, image: Tensor, distance: Tensor, *rest: Tensor) -> dict[str, Tensor]:
        """What a `Strip` takes besides its rows, by name."""
        graph = self.parent
        light, z, _, _, sums = graph.scene(image, distance, *rest)
        found = {"light": light, "z": z}
        for i, blur in enumerate(graph.stack()):
            if blur.prepared:
                found[f"prepared_{i}"] = blur.before(light)
        if graph.keeps_brightest:
            # eager mode gives a number where no value is above 1
            brightest = torch.as_tensor(headroom(image), dtype=light.dtype)
            found["brightest"] = brightest.expand(image.shape[0], 1, 1, 1)
        if not graph.frozen:
            found["rates"] = sums.rates
        if not graph.curves_fixed:
            found["weights"] = sums.weights
        return found | graph.numbers(rest)


class Strip(nn.Module):
    """A strip of a graph's result; `names` are those of what `Before` makes."""

    def __init__(self, graph: Graph, names: Sequence[str]) -> None:
        super().__init__()
        self.parent = graph
        self.names = tuple(names)

    def forward(self, rows: Tensor, *made: Tensor) -> Tensor:
        """The numbers of its rows (R), and what `Before` makes → strip (Bx3xRxW)."""
        graph, given = self.parent, dict(zip(self.names, made, strict=True))
        light, z = given["light"], given["z"]
        stack = []
        for i, blur in enumerate(graph.stack()):
            source = given[f"prepared_{i}"] if blur.prepared else light
            stack.append(blur.within(blur.rows.of(source, rows)))
        rates, weights = given.get("rates", graph.rates), given.get("weights", graph.weights)
        size = (z.shape[2], z.shape[3])
        light, z = PICTURE.of(light, rows), PICTURE.of(z, rows)
        blurred = mixture(stack, z, graph.medium_of(given), graph.plan, size)
        (result,) = total(curves(Sums(rates, weights, None), z), light, blurred)
        dtype = torch.uint8 if graph.quantised else torch.float32
        return encoded(result, graph.color_space, dtype, given.get("brightest", 1.0))
