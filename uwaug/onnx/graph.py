"""The model as one graph for any batch, height and width: what `uwaug.onnx` exports.

Curves, width law, weights and sum are the package's own functions. Of its own a graph has the
blurs, see `uwaug.onnx.blurs`; `uwaug.onnx.check_onnx` holds what is exported against them. A file
has the graph in two parts, `Before` and `Strip`, see `uwaug.onnx.strips`; with a light, in one.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from uwaug.blur.plan import BlurPlan
from uwaug.colour import encoded, from_light, headroom, to_light
from uwaug.exposure import exposed_sums
from uwaug.formation import scattered, together
from uwaug.light.lit import Lit, lit_of, seen
from uwaug.module import Underwater
from uwaug.onnx.blurs import Blur, blur_of
from uwaug.onnx.strips import strips_of
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
        self.limited = module.color_space == "srgb" and not quantised  # by the picture's brightest
        self.fixed = frozen and module.exposure != "auto"  # the curves
        self.medium = module.medium.map(lambda t: t.detach().to("cpu", torch.float32))
        self.blurs = nn.ModuleList(
            blur_of(sigma, cell, plan.reach)
            for sigma, cell in zip(plan.sigmas, plan.cells, strict=True)
        )
        # exact_at_lens=False: ONNX has no e^x − 1
        rates, weights, _ = self.medium.sums(exact_at_lens=False)
        self.light = module.light and module.light.map(lambda t: t.detach().to("cpu"))
        self.legs, self.camera = module.legs, module.camera
        self.register_buffer("rates", rates)
        self.register_buffer("weights", weights)

    def forward(self, image: Tensor, distance: Tensor, *rest: Tensor) -> Tensor:
        """Image (Bx3xHxW) and distance (Bx1xHxW) → image."""
        light, z, field, medium, sums = self.given(image, distance, *rest)
        found = seen(sums, z, self._lit(distance, field, medium))
        stack = [blur(light) for blur in self.blurs]
        size = (z.shape[2], z.shape[3])
        (result,) = together(light, found, scattered(stack, z, medium, self.plan, size))
        return from_light(result, self.color_space, image)

    def given(
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
        return light, z, field, medium, exposed_sums(light, z, sums, self.exposure)

    def stack(self) -> list[Blur]:
        """The blurs."""
        return list(self.blurs)  # type: ignore[arg-type]

    def numbers(self, rest: Sequence[Tensor]) -> Sequence[Tensor]:
        """The parameters (none, if frozen) among the inputs that follow the distance."""
        return rest[1:] if self.field else rest

    def medium_of(self, numbers: Sequence[Tensor]) -> Medium:
        """The medium, of its parameters if those are inputs."""
        if self.frozen:
            return self.medium
        return Medium.of(dict(zip(self.medium.parameters(), numbers, strict=True)), self.medium)

    def _lit(self, distance: Tensor, field: Tensor | None, medium: Medium) -> Lit | None:
        """The light on the scene; None for daylight as the medium has it."""
        legs = None if self.legs is None else self.legs()
        lit = lit_of(self.light, distance, field, medium, *self.camera, legs)
        if lit is None or isinstance(self.exposure, str):
            return lit and lit.whole()
        return lit.whole().brightened(medium.beta.new_full((1,), 2.0**self.exposure))


class Before(nn.Module):
    """What a graph does once, on the whole picture: takes what the graph takes, and gives the
    tensors of `strips_of`, then all that `Strip` takes but the rows of one.
    """

    def __init__(self, graph: Graph) -> None:
        super().__init__()
        self.parent = graph

    def names(self) -> list[str]:
        """What it gives, after the tensors of `strips_of`: what is fixed, a strip has itself."""
        graph = self.parent
        count = sum(blur.prepared for blur in graph.stack())
        prepared = [f"prepared_{i}" for i in range(count)]
        most = ["most"] if graph.limited else []
        rates = [] if graph.frozen else ["rates"]
        weights = [] if graph.fixed else ["weights"]
        parameters = [] if graph.frozen else list(graph.medium.parameters())
        return ["light", "distance", *prepared, *most, *rates, *weights, *parameters]

    def forward(self, image: Tensor, distance: Tensor, *rest: Tensor) -> tuple[Tensor, ...]:
        """As `Graph.forward`."""
        graph = self.parent
        light, z, _, _, sums = graph.given(image, distance, *rest)
        found = [*strips_of(image.shape[0], (z.shape[2], z.shape[3])), light, z]
        found += [blur.before(light) for blur in graph.stack() if blur.prepared]
        if graph.limited:
            # eager mode gives a number where no value is above 1
            most = torch.as_tensor(headroom(image), dtype=light.dtype)
            found.append(most.expand(image.shape[0], 1, 1, 1))
        found += [] if graph.frozen else [sums.rates]
        found += [] if graph.fixed else [sums.weights]
        return (*found, *graph.numbers(rest))


class Strip(nn.Module):
    """A strip of a graph's result."""

    def __init__(self, graph: Graph) -> None:
        super().__init__()
        self.parent = graph

    def forward(self, rows: Tensor, light: Tensor, z: Tensor, *rest: Tensor) -> Tensor:
        """The numbers of its rows (R), and what `Before` gives → strip (Bx3xRxW)."""
        graph, given = self.parent, iter(rest)
        stack = []
        for blur in graph.stack():
            source = next(given) if blur.prepared else light
            stack.append(blur.within(blur.rows.of(source, rows)))
        most = next(given) if graph.limited else 1.0
        sums = Sums(graph.rates if graph.frozen else next(given), graph.weights, None)
        if graph.fixed:
            sums = exposed_sums(light, z, sums, graph.exposure)
        else:
            sums = sums._replace(weights=next(given))
        size, plain = (z.shape[2], z.shape[3]), Blur.rows
        light, z = plain.of(light, rows), plain.of(z, rows)
        blurred = scattered(stack, z, graph.medium_of(list(given)), graph.plan, size)
        (result,) = together(light, curves(sums, z), blurred)
        dtype = torch.uint8 if graph.quantised else torch.float32
        return encoded(result, graph.color_space, dtype, most)
