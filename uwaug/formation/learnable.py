"""A medium inside a module: as buffers, or as parameters for an optimiser."""

import json
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, Literal, get_args

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from uwaug._support import checks
from uwaug._support.codec import from_plain, to_plain
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import Law
from uwaug.optics.snow import MarineSnow

Part = Literal["rates", "veil", "width"]

_MIN_START = 1e-6  # smallest value at which learning starts: a smaller one would hardly learn
_MIN_G = 1e-9  # smallest G, 1/m: the gradient of V(0) = slope/G grows without end as G falls to 0


class FixedMedium(nn.Module):
    """A medium whose tensors are buffers, so that it moves and is saved with a module; its law,
    notes and snow are saved, too.
    """

    def __init__(self, medium: Medium) -> None:
        super().__init__()
        self.start = medium.map(lambda t: t.detach().clone())
        for name, value in self.start.named_tensors().items():
            self.register_buffer(name, value.clone())

    def forward(self) -> Medium:
        """The medium of the buffers."""
        tensors: dict[str, Any] = dict(self.named_buffers())
        return replace(self.start, **tensors)

    def _load_from_state_dict(self, state: dict[str, Any], prefix: str, *args: Any) -> None:
        buffers = dict(self.named_buffers(recurse=False))
        stored = {name: state.get(prefix + name, buffer) for name, buffer in buffers.items()}
        if all(_but_rates(stored[name]) == _but_rates(buffers[name]) for name in buffers):
            for name, buffer in buffers.items():  # of another number of rates
                setattr(self, name, buffer.new_empty(stored[name].shape))
        super()._load_from_state_dict(state, prefix, *args)

    def get_extra_state(self) -> Tensor:
        """What of the medium is no tensor: law, notes and snow."""
        names = (field.name for field in fields(Medium) if field.name not in Medium.TENSORS)
        return as_tensor({name: getattr(self.start, name) for name in names})

    def set_extra_state(self, state: Tensor) -> None:
        """Take law, notes and snow of a state."""
        stored = of_tensor(state).items()
        values: Any = {name: from_plain(value, Law, MarineSnow) for name, value in stored}
        self.start = replace(self.start, **values)


def as_tensor(values: dict[str, Any]) -> Tensor:
    """Values as the codec writes them, as a tensor of the bytes of their JSON: who averages, casts
    or writes states takes all entries for tensors of numbers.
    """
    return torch.tensor([*json.dumps(to_plain(values)).encode()], dtype=torch.float64)


def of_tensor(state: Tensor) -> dict[str, Any]:
    """Plain values from what `as_tensor` has made of them."""
    plain: dict[str, Any] = json.loads(bytes(state.round().int().tolist()))
    return plain


def _but_rates(tensor: Tensor) -> torch.Size:
    return tensor.shape[:-1] if tensor.ndim > 1 else tensor.shape


class LearnableMedium(nn.Module):
    """A medium of coefficients, made of unconstrained parameters. Whatever they are, β ≥ G ≥ 0, and
    the veil and the width's scale are ≥ 0. The veil is learned by its slope at the lens, G·V(0),
    which has a limit as G falls to 0.

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
        beta, G = medium.beta, medium.G
        if "rates" in learned:
            self._add("G", G)
            self._add("excess", beta - G)
        if "veil" in learned:
            self._add("veil_slope", G * medium.veil_weights.sum(-1))
        if "width" in learned:
            self._add("scale", medium.scale)
        self.start = FixedMedium(medium.without_lamps())

    def _add(self, name: str, value: Tensor) -> None:
        value = value.detach().clamp(min=_MIN_START)
        raw = nn.Parameter(value + torch.log(-torch.expm1(-value)))
        self.register_parameter(f"raw_{name}", raw)

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
            learned["scale"] = positive["raw_scale"]
        return replace(medium, **learned)
