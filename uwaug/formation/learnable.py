"""A medium inside a module: as buffers, or as parameters for an optimiser."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from uwaug._support import checks
from uwaug.optics.medium import Medium

Part = Literal["rates", "veil", "width"]

_LEAST = 1e-6
"""Where learning starts from 0: a smaller number would hardly learn."""

_SLOWEST = 1e-9
"""1/m, of G: the gradient of V(0) = slope/G has no end as G falls to 0."""


class FixedMedium(nn.Module):
    """A medium whose tensors are buffers: it moves and is saved with a module."""

    def __init__(self, medium: Medium) -> None:
        super().__init__()
        self.start = medium.map(lambda t: t.detach().clone())
        # what is one number for the whole batch in a width law stays a number: x² is faster than a
        # power
        law = self.start.point_spread.numbers()
        for name, value in self.start.parameters().items():
            if isinstance(law.get(name, value), Tensor):
                self.register_buffer(name, value.clone())

    def forward(self) -> Medium:
        """The medium at hand."""
        tensors: dict[str, Any] = dict(self.named_buffers())
        law = self.start.point_spread
        numbers = {name: tensors.pop(name) for name in law.NUMBERS if name in tensors}
        # a law is looked at when it is made, which torch.compile cannot do with numbers of its own
        law = replace(law, **numbers) if numbers else law
        return replace(self.start, **tensors, point_spread=law)


class LearnableMedium(nn.Module):
    """A medium of coefficients, made of unconstrained parameters. Whatever they are, G ≥ 0, β ≥ G,
    the veil and the width's scale are ≥ 0. The veil is learned by its slope at the lens, G·V(0),
    which has a limit as G falls to 0 (with V(0) for a parameter, G → 0 and V(0) → ∞ would fit as
    well).

    Args:
        medium: where learning starts; from `Medium.from_coefficients`, or `Medium.as_coefficients`.
        learned: what is learned: "rates" (β and G), "veil" (V(0)), "width" (scale of the width
            law). All else stays as it is at the start.

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
        self.start = medium.map(lambda t: t.detach().clone())
        self.learned = tuple(learned)
        beta, G = self.start.beta, self.start.G
        slopes = G * self.start.veil_weights.sum(-1)
        scale = self.start.point_spread.rows(len(medium), beta)["scale"]
        self._add("G", G, "rates")
        self._add("excess", beta - G, "rates")
        self._add("veil_slope", slopes, "veil")
        self._add("scale", scale, "width")

    def _add(self, name: str, value: Tensor, part: Part) -> None:
        """A parameter that becomes this value by `softplus`; a buffer if it is known."""
        value = value.clamp(min=_LEAST)
        raw = value + torch.log(-torch.expm1(-value))
        if part in self.learned:
            self.register_parameter(f"raw_{name}", nn.Parameter(raw))
        else:
            self.register_buffer(f"raw_{name}", raw)

    def forward(self) -> Medium:
        """The medium at hand."""
        G, excess, slopes, scale = (
            F.softplus(getattr(self, f"raw_{name}"))
            for name in ("G", "excess", "veil_slope", "scale")
        )
        G = G + _SLOWEST
        beta, veil = G + excess, torch.diag_embed(slopes / G)
        if "rates" not in self.learned:
            beta, G = self.start.beta.to(beta), self.start.G.to(beta)
        if "veil" not in self.learned:
            veil = self.start.veil_weights.to(beta)
        law = self.start.point_spread
        law = replace(law, scale=scale) if "width" in self.learned else law
        weights, b_mean = self.start.direct_weights.to(beta), self.start.b_mean.to(beta)
        return Medium(beta, weights, G, weights, veil, b_mean, law, self.start.notes)
