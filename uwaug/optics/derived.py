"""Media from media: several as one batch, one seen brighter; and the curves at given distances."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug.optics.curves import FARTHEST, Curves, curves
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.unlit import joined

if TYPE_CHECKING:
    from uwaug.optics.medium import Medium

__all__ = ["brightened", "curves_at", "stacked"]


def stacked(media: "Sequence[Medium]") -> "Medium":
    """See `Medium.stack`."""
    if not media:
        raise ValueError("media is empty: stack needs at least one Medium")
    first = media[0]
    rows = [len(medium) for medium in media]
    law = PointSpread.stack([medium.point_spread for medium in media], rows, first.beta.dtype)
    columns = zip(*(medium.tensors() for medium in media), strict=True)
    notes = sum((medium.notes for medium in media), ())
    unlit = joined([medium.unlit for medium in media])
    return first.of_tensors([_joined(parts) for parts in columns], law, notes, unlit)


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
