"""Media from channels and from media: several as one batch, one seen brighter or with another veil;
and the curves at given distances.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug import checks
from uwaug.optics.bands import given_rows
from uwaug.optics.curves import FARTHEST, Curves, curves
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.reduction import Forward, forward_from_direct, joined, require_forward

if TYPE_CHECKING:
    from uwaug.optics.medium import Medium

__all__ = ["Veil", "brightened", "curves_at", "of_channels", "stacked", "with_veil"]

Veil = Literal["veil", "signal"]
"""The curve that a given veil follows."""


def of_channels(given: Mapping[str, Any], forward: Forward) -> list[Tensor]:
    """Rates, weights and b̄ of `Medium.from_coefficients`, from its arguments by name."""
    require_forward(forward)
    dtype = torch.float64
    for value in reversed(list(given.values())):
        if isinstance(value, Tensor) and value.is_floating_point():
            dtype = value.dtype
    rows, batches = {}, {}
    for name, value in given.items():
        rows[name] = given_rows(name, value, () if name == "b_mean" else (3,), dtype)
        batches[name] = len(rows[name])
    checks.batches(batches)
    b = max(batches.values())
    for name, row in rows.items():
        rows[name] = row.expand(b, *row.shape[1:])
    beta, G, b_mean = rows["beta"], rows["G"], rows["b_mean"]
    light, veil = torch.diag_embed(rows["light"]), torch.diag_embed(rows["veil"])
    if "veil_rate" not in rows and forward == "image":
        return [beta, light, G, light, veil, b_mean]
    signal = [(G, light)]
    if forward == "direct":
        signal = forward_from_direct((beta, light), (beta + G, light))
    return [*joined((beta, light), signal, (rows.get("veil_rate", G), veil)), b_mean]


def stacked(media: "Sequence[Medium]") -> "Medium":
    """See `Medium.stack`."""
    if not media:
        raise ValueError("media is empty: stack needs at least one Medium")
    first = media[0]
    rows = [len(medium) for medium in media]
    law = PointSpread.stack([medium.point_spread for medium in media], rows, first.beta.dtype)
    columns = zip(*(medium.tensors() for medium in media), strict=True)
    notes = sum((medium.notes for medium in media), ())
    return first.of_tensors([_joined(parts) for parts in columns], law, notes)


def _joined(parts: Sequence[Tensor]) -> Tensor:
    """One attribute of several media; the missing rates and weights of some are 0."""
    if parts[0].ndim == 1:
        return torch.cat(list(parts))
    width = max(part.shape[-1] for part in parts)
    return torch.cat([F.pad(part, (0, width - part.shape[-1])) for part in parts])


def brightened(medium: "Medium", gain: Tensor) -> "Medium":
    """See `Medium.brightened`."""
    rows = max(len(medium), len(gain))
    notes = medium.notes if len(medium) == rows else medium.notes * rows
    medium = medium.map(lambda t: t.expand(rows, *t.shape[1:]))
    factor = gain.reshape(-1, 1, 1).to(medium.beta)
    return replace(
        medium,
        direct_weights=factor * medium.direct_weights,
        signal_weights=factor * medium.signal_weights,
        veil_weights=factor * medium.veil_weights,
        notes=notes,
    )


def with_veil(medium: "Medium", veil: Tensor | Sequence[float], curve: Veil) -> "Medium":
    """See `Medium.with_veil`."""
    checks.one_of("curve", curve, get_args(Veil))
    wanted = given_rows("veil", veil, (3,), medium.beta.dtype).to(medium.beta.device)
    checks.batches({"veil": len(wanted), "medium": len(medium)})
    rows = max(len(medium), len(wanted))
    notes = medium.notes if len(medium) == rows else medium.notes * rows
    medium = medium.map(lambda t: t.expand(rows, *t.shape[1:]))
    weights = medium.veil_weights if curve == "veil" else medium.signal_weights
    total = weights.sum(-1, keepdim=True)
    if not bool((total.detach() > 0).all()):
        cure = 'try curve="signal"' if curve == "veil" else "no light is left at that depth"
        raise ValueError(f"veil must follow the medium's own {curve}, which is 0: {cure}")
    return replace(medium, veil_weights=wanted[..., None] * weights / total, notes=notes)


def curves_at(medium: "Medium", z: Tensor, *, exact_at_lens: bool = False) -> Curves:
    """The curves at distances in any of the shapes that `Medium.transmission` takes."""
    with torch.autocast(z.device.type, enabled=False):
        x = z.to(torch.promote_types(z.dtype, torch.float32)).clamp(max=FARTHEST)
        plane = x if z.ndim > 2 else x.reshape(1, 1, -1)
        batch = plane if plane.ndim == 4 else plane[None]
        found = curves(medium.to(x).sums(exact_at_lens=exact_at_lens), batch)
    if z.ndim > 2:
        return found
    return Curves(*(curve.reshape(len(curve), 3, *z.shape) for curve in found))
