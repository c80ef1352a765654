"""Open water in a picture: where it is, and its light."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug.formation.colour import linear_to_srgb

__all__ = ["Found", "open_water", "smooth", "veil_of"]

_BLOCK = 4
"""px of the small copy, whose mean is compared with its neighbours': noise averages out, texture
does not.
"""

_EVEN = 0.006
"""sRGB: RMS of blocks about the mean of 5×5 of them; 1.5 of 255 levels."""

_SHARE = 0.01
"""Of the picture, that open water fills at least."""

_RED = 0.9
"""Of green and blue: what red may have at most."""

_CLIPPED, _BLACK = 0.97, 2e-3
"""Linear light that is none of open water: of a lamp or a sensor's end; of shadow."""

_TOP = 0.1
"""Share of the even blocks, of largest red-channel value, among which the one of least red is
taken.
"""

_OTHER = 0.15
"""Relative, by which another even part differs so that it is said."""


class Found(NamedTuple):
    """Where open water is (HxW, bool), and doubts about it."""

    mask: Tensor
    doubts: list[str]


def open_water(light: Tensor, z: Tensor | None) -> Found:
    """Find open water: by the distances where they say +inf, else by how the picture looks.

    Args:
        light (3xHxW tensor): linear light.
        z (HxW tensor): metres, +inf for open water; or None.

    Raises:
        ValueError: if there is none.
    """
    if z is not None and float(z.isposinf().double().mean()) >= _SHARE:
        return Found(z.isposinf(), [])
    blocks = F.avg_pool2d(light[None], _BLOCK)[0]
    even = _even(linear_to_srgb(blocks))
    if float(even.double().mean()) > 0.95:
        raise ValueError("picture is even all over: expected a scene with open water behind it")
    parts = _parts(even)
    if not parts:
        raise ValueError(
            f"picture: no open water in view (no even part of {_SHARE:.0%} of it): give a picture "
            "with open water; see uwaug.fitting.fit_veil for one with distances and no open water"
        )
    usual, shares = [], []
    for part in parts:
        colour = blocks[:, part].median(1).values
        if _like_water(colour):
            usual.append((part, colour))
        shares.append(", ".join(f"{x:.2g}" for x in colour.tolist()))
    if not usual:
        raise ValueError(
            f"picture: the even parts (red, green, blue of {'; of '.join(shares[:3])}) do not look "
            "like open water, where red is darkest: white-balanced, a wall, or a water that the "
            "red-channel prior does not know. Give distances, with +inf for open water"
        )
    chosen = _chosen(blocks, [part for part, _ in usual])
    doubts = []
    veil = usual[chosen][1]
    for part, colour in usual:
        if float((colour / veil - 1).abs().max()) > _OTHER:
            share = float(part.double().mean())
            doubts.append(f"the veil ({share:.0%} of the picture is as even, of another colour)")
            break
    return Found(_mask(usual[chosen][0], light), doubts)


def veil_of(light: Tensor, mask: Tensor) -> Tensor:
    """Median light (3) of open water over 3×3 neighbours; edges to surfaces are left out if there
    is more.
    """
    grown = F.max_pool2d((~mask)[None].float(), 5, 1, 2)[0] > 0
    inside = mask & ~grown
    veil = smooth(light)[:, inside if bool(inside.any()) else mask].median(1).values
    if bool((veil <= 0).any()):
        got = ", ".join(f"{x:.2g}" for x in veil.tolist())
        raise ValueError(f"picture: open water has the light {got}: expected some in each channel")
    return veil


def smooth(light: Tensor) -> Tensor:
    """Over 3×3 neighbours: single pixels would be the darkest for their noise."""
    return F.avg_pool2d(F.pad(light[None], (1, 1, 1, 1), mode="replicate"), 3, 1)[0]


def _even(blocks: Tensor) -> Tensor:
    """Blocks that differ from their neighbours by a slope at most, in all channels (hxw)."""

    def mean(values: Tensor) -> Tensor:
        return F.avg_pool2d(F.pad(values[None], (2, 2, 2, 2), mode="replicate"), 5, 1)[0]

    rough = mean((blocks - mean(blocks)).square()).sqrt().amax(0)
    return rough <= _EVEN


def _parts(even: Tensor) -> list[Tensor]:
    """Connected parts that are large enough, the largest first."""
    from scipy.ndimage import label

    numbers, count = label(even.cpu().numpy())
    labels = torch.from_numpy(numbers).to(even.device)
    sizes = torch.bincount(labels.flatten().long(), minlength=count + 1)[1:]
    found = []
    for k in sizes.argsort(descending=True).tolist():
        if int(sizes[k]) >= _SHARE * even.numel():
            found.append(labels == k + 1)
    return found


def _like_water(colour: Tensor) -> bool:
    red, green, blue = colour.tolist()
    if max(colour.tolist()) < _BLACK or max(colour.tolist()) > _CLIPPED:
        return False
    return bool(red < _RED * min(green, blue))


def _chosen(blocks: Tensor, parts: list[Tensor]) -> int:
    """Which part holds the block of least red among those whose red channel is highest, min(1 − R,
    G, B), as Galdran et al. choose.
    """
    prior = torch.minimum(1 - blocks[0], blocks[1:].amin(0))
    anywhere = torch.stack(parts).any(0)
    high = prior[anywhere].quantile(1 - _TOP)
    red = torch.where(anywhere & (prior >= high), blocks[0], torch.inf)
    place = int(red.argmin())
    return next(i for i, part in enumerate(parts) if bool(part.flatten()[place]))


def _mask(part: Tensor, light: Tensor) -> Tensor:
    """In px of the picture that is looked at; what the blocks leave over is none."""
    wide = part.repeat_interleave(_BLOCK, 0).repeat_interleave(_BLOCK, 1)
    height, width = light.shape[-2:]
    return F.pad(wide, (0, width - wide.shape[1], 0, height - wide.shape[0]))
