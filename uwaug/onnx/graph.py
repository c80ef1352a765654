"""The model as one graph for any batch, height and width: what `uwaug.onnx` exports.

Curves, width law, weights and sum are the package's own functions. Of its own a graph has the
blurs: `uwaug.blur` works in strips, blocks and caches that a graph has no room for.
`uwaug.onnx.check_onnx` holds what is exported against them.
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
from uwaug.onnx.blurs import Blur
from uwaug.onnx.blurs import blur_of as _blur
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
        self.medium = module.medium.map(lambda t: t.detach().to("cpu", torch.float32))
        self.blurs = nn.ModuleList(
            _blur(sigma, cell, plan.reach)
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

    def numbers(self, rest: Sequence[Tensor]) -> Sequence[Tensor]:
        """The parameters among the inputs that follow the distance."""
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
    """What a graph does once, on the whole picture.

    Takes what the graph takes. Gives the tensors of `strips_of`, and all that `Strip` takes but the
    rows of one: light, distance, what the blurs have prepared, the largest sRGB value if there is
    one, rates and weights as far as they are not fixed, and the parameters if those are inputs.
    """

    def __init__(self, graph: Graph) -> None:
        super().__init__()
        self.parent = graph

    def forward(self, image: Tensor, distance: Tensor, *rest: Tensor) -> tuple[Tensor, ...]:
        """As `Graph.forward`."""
        graph = self.parent
        light, z, _, _, sums = graph.given(image, distance, *rest)
        prepared = [blur.before(light) for blur in graph.blurs if blur.prepared]
        most = headroom(image) if graph.color_space == "srgb" else 1.0
        limit = [most] if isinstance(most, Tensor) else []
        # what is fixed, a strip has itself
        curved = [] if graph.frozen else [sums.rates]
        curved += [] if graph.frozen and graph.exposure != "auto" else [sums.weights]
        strips = strips_of(image.shape[0], (z.shape[2], z.shape[3]))
        return (*strips, light, z, *prepared, *limit, *curved, *graph.numbers(rest))


class Strip(nn.Module):
    """A strip of a graph's result."""

    def __init__(self, graph: Graph) -> None:
        super().__init__()
        self.parent = graph

    def forward(self, rows: Tensor, light: Tensor, z: Tensor, *rest: Tensor) -> Tensor:
        """The numbers of its rows (R), and what `Before` gives → strip (Bx3xRxW)."""
        graph, given = self.parent, list(rest)
        stack = []
        for blur in graph.blurs:
            source = given.pop(0) if blur.prepared else light
            stack.append(blur.within(blur.rows.of(source, rows)))
        dtype = torch.uint8 if graph.quantised else torch.float32
        limited = graph.color_space == "srgb" and not graph.quantised
        most = given.pop(0) if limited else 1.0
        sums = Sums(graph.rates if graph.frozen else given.pop(0), graph.weights, None)
        if graph.frozen and graph.exposure != "auto":
            sums = exposed_sums(light, z, sums, graph.exposure)
        else:
            sums = sums._replace(weights=given.pop(0))
        size, plain = (z.shape[2], z.shape[3]), Blur.rows
        light, z = plain.of(light, rows), plain.of(z, rows)
        blur = scattered(stack, z, graph.medium_of(given), graph.plan, size)
        (result,) = together(light, curves(sums, z), blur)
        return encoded(result, graph.color_space, dtype, most)
