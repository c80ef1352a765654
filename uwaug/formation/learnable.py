"""A medium inside a module: as buffers, or as unconstrained parameters, of which it stays one
whatever an optimiser does to them.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from operator import is_
from typing import Any, Literal, Self, get_args

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from uwaug._support import checks
from uwaug._support.torch_func import transformed
from uwaug.light.lit import LampInWater
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

Part = Literal["rates", "light", "veil", "width"]

_OF_PARTS = {
    "rates": ("raw_G", "raw_excess"),
    "light": ("raw_light", "raw_shares"),
    "veil": ("raw_veil_rates",),
    "width": ("raw_scale",),
}
"""The parameters of each part that may be known."""

_LEAST_RATE = 1e-6
"""1/m, where learning starts from a rate of 0: a smaller one would hardly learn."""

_SLOWEST = 1e-12
"""1/m, stands for less, as the veil is divided by it."""

_LEAST_SHARE = 1e-9
"""Of the light; what is shared by less is rounding."""


class _InFullPrecision(nn.Module):
    """A module whose tensors never get less precise than float32: `half()` of a network must not
    round a water. The result has the image's type all the same.
    """

    def _apply(self, function: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        def converted(value: Tensor) -> Tensor:
            changed = function(value)
            narrow = changed.is_floating_point() and changed.dtype.itemsize < 4
            return value.to(changed.device) if narrow else changed

        super()._apply(converted, recurse)  # type: ignore[no-untyped-call]
        return self


class FixedMedium(_InFullPrecision):
    """A medium whose tensors are buffers: it moves and is saved with a module.

    What is one number for the whole batch in its width law stays a number, of the module and not
    of its state: x² is faster than a power.

    Args:
        medium: any batch.
    """

    def __init__(self, medium: Medium) -> None:
        super().__init__()
        self.start = medium.map(lambda t: t.detach().clone())
        numbers = self.start.point_spread.numbers()
        for name, value in self.start.parameters().items():
            if isinstance(numbers.get(name, value), Tensor):
                self.register_buffer(name, value.clone())
        # the buffers that the last medium was made of, and that medium: its tensors are these, so
        # that it stays right where their values change
        self._last: tuple[tuple[Tensor | None, ...], Medium] | None = None

    def forward(self) -> Medium:
        """The medium at hand."""
        # a law checks the values of its tensors whenever it is made
        has_law = any(name in self._buffers for name in PointSpread.NUMBERS)
        if has_law or torch.compiler.is_compiling() or transformed():
            return self._of_buffers()
        buffers = tuple(self._buffers.values())
        if self._last is not None:
            before, medium = self._last
            if len(before) == len(buffers) and all(map(is_, before, buffers)):
                return medium
        self._last = buffers, self._of_buffers()
        return self._last[1]

    def _of_buffers(self) -> Medium:
        tensors: dict[str, Any] = dict(self.named_buffers())
        law = self.start.point_spread
        numbers = {name: tensors.pop(name) for name in law.NUMBERS if name in tensors}
        # a law is looked at when it is made, which torch.compile cannot do with numbers of its own
        law = replace(law, **numbers) if numbers else law
        return replace(self.start, **tensors, point_spread=law)


class FixedLamps(nn.Module):
    """What a medium does to the light of lamps, as buffers: it moves and is saved with a module.

    Args:
        lamps: see `uwaug.light.lit.lamps_in_water`.
    """

    def __init__(self, lamps: Sequence[LampInWater]) -> None:
        super().__init__()
        self.lamps = tuple(lamps)
        self.waters = nn.ModuleList(FixedMedium(lamp.water) for lamp in lamps)

    def forward(self) -> list[LampInWater]:
        """Each lamp in the water at hand."""
        return [
            lamp._replace(water=water())
            for lamp, water in zip(self.lamps, self.waters, strict=True)
        ]


class LearnableMedium(_InFullPrecision):
    """A medium made of unconstrained parameters. Whatever they are:

    * rates, light, veil weights and width scale are ≥ 0;
    * direct and signal light are equal at z = 0;
    * the veil grows by Σ G·V(0) per metre at the lens, which is a parameter, so that it has a limit
      as G falls to 0 (with V(0) for a parameter, G → 0 and V(0) → ∞ would fit as well);
    * forward light T_G − T_β is ≥ 0 at any distance, if the medium to start from has β ≥ G wherever
      light is shared: all media from coefficients with β ≥ G, and the types II…9C with g ≤ .5.
      Otherwise, as in the clear types, whose few rates of T_β and T_G lie where either curve needs
      them, it is ≥ −`deficit`.

    The light is shared between pairs of a rate β and a rate G, smallest with smallest, as each
    wavelength has one of either. A pair's β is its G and more; where it is less at the start, the
    ratio of the two may only grow, and the pair's share of the light is fixed.

    Args:
        medium: where learning starts.
        learnt: what is learnt: "rates" (all β and G), "light" (what is left of it at z = 0, and how
            it is shared between the rates), "veil" (V(0)), "width" (scale of the width law). All
            else is known, and stays as it is at the start.

    Attributes:
        deficit (Bx3 tensor): how far forward light may fall below 0, at most, in shares of the
            light at z = 0.

    Raises:
        ValueError: if the light at z = 0 is one in `direct_weights`, another in `signal_weights`,
            or a weight is negative, as of forward scatter from the direct light; if surfaces have
            spectra; if a part is none of these.
    """

    b_mean: Tensor
    deficit: Tensor
    fixed: Tensor
    ratio: Tensor
    shared: Tensor
    veil: Tensor | None
    veil_used: Tensor

    def __init__(self, medium: Medium, learnt: Sequence[Part] = get_args(Part)) -> None:
        super().__init__()
        for part in learnt:
            checks.one_of("learnable", part, get_args(Part))
        self.learnt = tuple(part for part in get_args(Part) if part in learnt)
        self.start = medium.map(lambda t: t.detach().clone())
        values = self.start.parameters()
        direct, signal = values["direct_weights"], values["signal_weights"]
        if medium.is_spectral:
            raise ValueError('a learnable medium needs surfaces="grey", got surfaces="spectral"')
        if bool((signal < 0).any()):
            raise ValueError(
                'a learnable medium needs signal_weights ≥ 0: forward="direct" cannot be learned'
            )
        light = direct.sum(-1)
        difference = float((light - signal.sum(-1)).abs().max())
        if difference > 1e-5:
            raise ValueError(
                "a learnable medium needs direct_weights and signal_weights of one sum, "
                f"the light at z = 0; they differ by {difference:.2g}"
            )
        beta = values["beta"].clamp(min=_LEAST_RATE)
        G = values["G"].clamp(min=_LEAST_RATE)
        pairs = _pairs(beta, direct, G, signal)
        shared = pairs > _LEAST_SHARE
        # in all channels alike, as the rates are
        ratio = (beta[..., None] / G[:, None]).clamp(max=1.0)
        crossed = (ratio < 1.0)[:, None] & shared
        self.register_buffer("shared", shared & ~crossed)
        self.register_buffer("fixed", torch.where(crossed, pairs, 0.0))
        self.register_buffer("ratio", torch.where(shared.any(1), ratio, 0.0))
        self.register_buffer("deficit", (self.fixed * _gap(ratio)[:, None]).sum((-1, -2)))
        self.register_buffer("b_mean", values["b_mean"].clone())
        if isinstance(self.start.point_spread.exponent, Tensor):
            self.register_buffer("exponent", values["exponent"].clone())
        self.register_buffer("veil_used", values["veil_weights"] > 0)
        self.raw_G = _positive(G)
        self.raw_excess = _positive(beta - self._floor(G))
        self.raw_veil_rates = _positive(values["veil_weights"] * G[:, None])
        self.raw_light = _positive(light)
        self.raw_shares = nn.Parameter(torch.log(pairs.clamp(min=_LEAST_SHARE)).contiguous())
        self.raw_scale = _positive(values["scale"]) if "width" in learnt else None
        # V(0) that is known stays where the rates do not: its growth is no number of its own then
        known_veil = None if "veil" in learnt else values["veil_weights"].clone()
        self.register_buffer("veil", known_veil)
        for part in set(get_args(Part)) - set(learnt):
            for name in _OF_PARTS[part]:
                parameter = getattr(self, name)
                if parameter is not None:
                    parameter.requires_grad_(False)

    def forward(self) -> Medium:
        """The medium at hand, of tensors that carry gradients to the parameters."""
        law = self.start.point_spread
        if self.raw_scale is not None:
            law = replace(law, scale=F.softplus(self.raw_scale))
        if isinstance(law.exponent, Tensor):
            law = replace(law, exponent=self.get_buffer("exponent"))
        light = F.softplus(self.raw_light)[..., None]
        shares = self._shares()
        slowest = max(_SLOWEST, torch.finfo(self.raw_G.dtype).tiny)
        G = F.softplus(self.raw_G).clamp(min=slowest)
        veil = self.veil
        if veil is None:
            veil = F.softplus(self.raw_veil_rates) / G[:, None] * self.veil_used
        return Medium(
            beta=self._floor(G) + F.softplus(self.raw_excess),
            direct_weights=light * shares.sum(-1),
            G=G,
            signal_weights=light * shares.sum(-2),
            veil_weights=veil,
            b_mean=self.b_mean,
            point_spread=law,
        )  # without notes, which are of the start: it is shown by its numbers

    def _floor(self, G: Tensor) -> Tensor:
        """The least that each β may be."""
        return (self.ratio * G[:, None]).amax(-1)

    def _shares(self) -> Tensor:
        """The share of the light of each pair (B, 3, K, L)."""
        raw = self.raw_shares
        hidden = raw.masked_fill(~self.shared, torch.finfo(raw.dtype).min)
        free = torch.softmax(hidden.flatten(-2), -1).reshape(raw.shape)
        free_light = 1 - self.fixed.sum((-1, -2), keepdim=True)
        return self.fixed + free_light * free * self.shared


def _pairs(beta: Tensor, direct: Tensor, G: Tensor, signal: Tensor) -> Tensor:
    """The shares of the light (B, 3, K, L) that decay with a rate β and a rate G: the smallest with
    the smallest, the largest with the largest.
    """
    low, high, k = _spans(beta, direct)
    least, most, n = _spans(G, signal)
    overlap = torch.minimum(high[..., None], most[..., None, :])
    overlap = overlap - torch.maximum(low[..., None], least[..., None, :])
    # back into the order of the rates
    k, n = k.argsort(-1), n.argsort(-1)
    rows = torch.arange(len(beta), device=beta.device)[:, None, None]
    pairs = overlap.clamp(min=0.0).movedim(1, -1)[rows, k[:, :, None], n[:, None]]
    return pairs.movedim(-1, 1).to(direct)


def _spans(rates: Tensor, weights: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Rates in ascending order: where the share of each begins and ends in 0…1 (B, 3, K), and
    which rate it is (B, K).
    """
    order = rates.argsort(-1)
    shares = weights.double() / weights.double().sum(-1, keepdim=True).clamp(min=1e-300)
    ordered = shares.gather(-1, order[:, None].expand_as(shares))
    end = ordered.cumsum(-1)
    return end - ordered, end, order


def _gap(ratio: Tensor) -> Tensor:
    """The largest e^(−r·x) − e^(−x) of any x ≥ 0, for r ≤ 1."""
    r = ratio.clamp(max=1 - 1e-6)
    return torch.where(ratio < 1, (1 - r) * r ** (r / (1 - r)), 0.0)


def _positive(value: Tensor) -> nn.Parameter:
    """A parameter whose softplus is `value`; of a value near 0, such that it can learn."""
    y = value.clamp(min=1e-9)
    return nn.Parameter(y + torch.log(-torch.expm1(-y)))
