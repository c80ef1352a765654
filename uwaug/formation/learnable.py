"""A medium inside a module: as buffers, or as parameters for an optimiser."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from uwaug._support import checks
from uwaug._support.types import Shape
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

Part = Literal["rates", "veil", "width"]

_MIN_START = 1e-6
"""Smallest value at which learning starts: a smaller one would hardly learn."""

_MIN_G = 1e-9
"""Smallest G, 1/m: the gradient of V(0) = slope/G grows without end as G falls to 0."""


class FixedMedium(nn.Module):
    """A medium whose tensors are buffers, so that it moves and is saved with a module. The rest of
    its width law is saved, too, and a state with another law is refused.
    """

    def __init__(self, medium: Medium) -> None:
        super().__init__()
        self.start = medium.map(lambda t: t.detach().clone())
        # a number for the whole batch in a width law stays a number: x² is faster than a power
        law = self.start.point_spread.numbers()
        for name, value in self.start.parameters().items():
            if isinstance(law.get(name, value), Tensor):
                self.register_buffer(name, value.clone())

    def forward(self) -> Medium:
        """The medium of the buffers."""
        tensors: dict[str, Any] = dict(self.named_buffers())
        law = self.start.point_spread
        numbers = {name: tensors.pop(name) for name in law.NUMBERS if name in tensors}
        # a new law looks at its numbers, which torch.compile cannot do
        law = replace(law, **numbers) if numbers else law
        return replace(self.start, **tensors, point_spread=law)

    def get_extra_state(self) -> Tensor:
        """The width law: shape, reference size (0 for none) and numbers (NaN for tensors)."""
        law = self.start.point_spread
        numbers = [math.nan if isinstance(x, Tensor) else x for x in law.numbers().values()]
        size, shape = law.reference_size or 0.0, get_args(Shape).index(law.shape)
        return torch.tensor([shape, size, *numbers], dtype=torch.float64)

    def set_extra_state(self, state: Tensor) -> None:
        """Refuse the state of another width law."""
        state = state.to("cpu", torch.float64)
        if torch.allclose(state, self.get_extra_state(), rtol=1e-3, equal_nan=True):
            return
        shape, size, *numbers = state.tolist()
        scale, exponent = (torch.tensor(1.0) if math.isnan(x) else x for x in numbers)
        law = PointSpread(scale, exponent, get_args(Shape)[int(shape)], size or None)
        wanted = f"this module's is {self.start.point_spread}: give it a medium with that law"
        raise ValueError(f"state_dict is of the law {law}, {wanted}")


class LearnableMedium(nn.Module):
    """A medium of coefficients, made of unconstrained parameters. Whatever they are, β ≥ G ≥ 0, and
    the veil and the width's scale are ≥ 0. The veil is learned by its slope at the lens, G·V(0),
    which has a limit as G falls to 0. (With V(0) for a parameter, G → 0 and V(0) → ∞ would fit as
    well.)

    Args:
        medium: start of learning, from `Medium.from_coefficients` or `Medium.as_coefficients`.
        learned: parts to learn: "rates" (β and G), "veil" (V(0)), "width" (scale of the width law).
            All else stays as it is at the start.

    Raises:
        ValueError: if the medium has other rates than one for each channel, or a part is unknown.
    """

    def __init__(self, medium: Medium, learned: Sequence[Part] = get_args(Part)) -> None:
        super().__init__()
        for part in learned:
            checks.one_of("learnable", part, get_args(Part))
        if not medium.is_of_coefficients:
            cure = "medium.as_coefficients() makes one rate of them"
            raise ValueError(f"learnable: the medium must have one rate for each channel; {cure}")
        self.learned = tuple(learned)
        beta, G, law = medium.beta, medium.G, medium.point_spread
        if "rates" in learned:
            self._add("G", G)
            self._add("excess", beta - G)
        if "veil" in learned:
            self._add("veil_slope", G * medium.veil_weights.sum(-1))
        if "width" in learned:
            scale = law.rows(len(medium), beta)["scale"].detach()
            self._add("scale", scale)
            medium = replace(medium, point_spread=replace(law, scale=scale))
        self.start = FixedMedium(medium)

    def _add(self, name: str, value: Tensor) -> None:
        """Add a parameter that becomes this value by `softplus`."""
        value = value.detach().clamp(min=_MIN_START)
        self.register_parameter(
            f"raw_{name}", nn.Parameter(value + torch.log(-torch.expm1(-value)))
        )

    def forward(self) -> Medium:
        """The medium of the parameters."""
        medium: Medium = self.start()
        positive = {name: F.softplus(raw) for name, raw in self.named_parameters()}
        learned: dict[str, Any] = {}
        G = medium.G.clamp(min=_MIN_START)
        if "rates" in self.learned:
            G = positive["raw_G"] + _MIN_G
            learned |= {"G": G, "beta": G + positive["raw_excess"]}
        if "veil" in self.learned:
            learned["veil_weights"] = torch.diag_embed(positive["raw_veil_slope"] / G)
        if "width" in self.learned:
            learned["point_spread"] = replace(medium.point_spread, scale=positive["raw_scale"])
        return replace(medium, **learned, bands=())
