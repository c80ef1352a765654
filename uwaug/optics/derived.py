"""Media from channels and from media: several as one batch, one seen brighter or with another veil;
and the curves at given distances.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support import checks
from uwaug.optics.bands import given_rows
from uwaug.optics.curves import FARTHEST, Curves, Sums, curves
from uwaug.optics.inherent import joined_bands
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.reduction import Forward, forward_from_direct, joined, require_forward

if TYPE_CHECKING:
    from uwaug.optics.medium import Medium

__all__ = [
    "Veil",
    "brightened",
    "channel_notes",
    "channel_rows",
    "channel_tensors",
    "curves_at",
    "stacked",
    "sums_of",
    "with_veil",
    "without_distance",
]

Veil = Literal["veil", "signal"]
"""The curve that a given veil follows."""

_AT_ONCE = 1e6
"""1/m, of a veil that is all there at any distance: at .1 mm, e^−100 of it is missing."""


def channel_rows(given: Mapping[str, Any]) -> dict[str, Tensor]:
    """The arguments of `Medium.from_coefficients` that are given, by name, as tensors of one type
    and batch.
    """
    given = {name: value for name, value in given.items() if value is not None}
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
    return {name: row.expand(b, *row.shape[1:]) for name, row in rows.items()}


def channel_tensors(rows: Mapping[str, Tensor], forward: Forward) -> list[Tensor]:
    """Rates, weights and b̄ of a medium, in the order of its attributes."""
    require_forward(forward)
    beta, G, b_mean = rows["beta"], rows["G"], rows["b_mean"]
    light, veil = torch.diag_embed(rows["light"]), torch.diag_embed(rows["veil"])
    if "veil_rate" not in rows and forward == "image":
        return [beta, light, G, light, veil, b_mean]
    signal = [(G, light)]
    if forward == "direct":
        signal = forward_from_direct((beta, light), (beta + G, light))
    return [*joined((beta, light), signal, (rows.get("veil_rate", G), veil)), b_mean]


def channel_notes(tensors: Sequence[Tensor]) -> tuple[str, ...]:
    """One line for each medium."""
    counts = f"{tensors[0].shape[1]} + {tensors[2].shape[1]}"
    return (f"coefficients: {counts} rates, one per channel",) * len(tensors[0])


def without_distance(transmission: Any, veil: Any) -> dict[str, Any]:
    """The arguments of `Medium.from_coefficients` for `Medium.from_transmission`."""
    rows = channel_rows({"transmission": transmission, "veil": veil})
    t, zeros = rows["transmission"], torch.zeros_like(rows["veil"])
    if not bool((t.detach() <= 1).all()):
        raise ValueError(f"transmission must be in [0, 1], got {t.detach().tolist()}")
    at_once = torch.full_like(zeros, _AT_ONCE)
    haze = (1 - t) * rows["veil"]
    return {"beta": zeros, "G": zeros, "veil": haze, "light": t, "veil_rate": at_once}


def stacked(media: "Sequence[Medium]") -> "Medium":
    """See `Medium.stack`."""
    if not media:
        raise ValueError("media is empty: stack needs at least one Medium")
    first = media[0]
    rows = [len(medium) for medium in media]
    law = PointSpread.stack([medium.point_spread for medium in media], rows, first.beta.dtype)
    columns = zip(*(medium.tensors() for medium in media), strict=True)
    notes = sum((medium.notes for medium in media), ())
    unlit = joined_bands([medium.unlit for medium in media])
    return first.of_tensors([_joined(parts) for parts in columns], law, notes, unlit)


def _joined(parts: Sequence[Tensor]) -> Tensor:
    """One attribute of several media; the missing rates and weights of some are 0."""
    if parts[0].ndim == 1:
        return torch.cat(list(parts))
    width = max(part.shape[-1] for part in parts)
    return torch.cat([F.pad(part, (0, width - part.shape[-1])) for part in parts])


def brightened(medium: "Medium", gain: Tensor) -> "Medium":
    """See `Medium.brightened`."""
    rows, notes = max(len(medium), len(gain)), medium.notes
    if len(medium) != rows:
        notes = medium.notes * rows
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


def sums_of(medium: "Medium", exact_at_lens: bool) -> Sums:
    """See `Medium.sums`."""
    direct, signal, veil = medium.direct_weights, medium.signal_weights, medium.veil_weights
    rates = torch.cat([torch.zeros_like(medium.beta[:, :1]), medium.beta, medium.G], 1)[..., None]
    no_direct, no_signal = torch.zeros_like(direct), torch.zeros_like(signal)
    nothing = torch.zeros_like(direct[..., :1])
    # if the exponentials of G stand for e^−x − 1, T_G(z) is T_G(0) + Σ s(e^−Gz − 1), and the
    # veil is −Σ v(e^−Gz − 1)
    signal_at_0 = signal.sum(-1, keepdim=True) if exact_at_lens else nothing
    veil_at_0 = nothing if exact_at_lens else veil.sum(-1, keepdim=True)
    weights = [
        torch.cat([nothing, direct, no_signal], 2),
        torch.cat([signal_at_0, -direct, signal], 2),
        torch.cat([veil_at_0, no_direct, -veil], 2),
    ]
    split = 1 + medium.beta.shape[1] if exact_at_lens else None
    return Sums(rates, torch.cat(weights, 1), split)
