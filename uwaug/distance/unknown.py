"""Numbers in maps that are no distance: they stand for unknown pixels, or for the sky.

Several pixels hold exactly such a number, and it is alone: a gap away from all others. So is many a
true distance: that of a facade that faces the camera, or of the last row of ground before the
horizon. A number of metres is a stand-in only if it looks like one, too, as 65.535 or 1000 do. In
metres 0, negative and NaN are unknown anyway, and from `checks.OPEN` on all is open water.
"""

import torch
from torch import Tensor

FARTHEST_SEEN = 50.0
"""m: beyond, the largest value of a map is asked whether it is a distance."""

_SEVERAL_PX = 8
"""Pixels that hold such a number, at least; wild ones differ."""

_FEWEST = 3
"""Different values that a map must have besides."""

_GAP, _WIDE_GAP = 0.2, 0.8
"""Of the range of a map, between such a number and all others; the wide one where it may also be
what is nearest in a scene.
"""

_ZERO_GAP = 0.02
"""The same above 0. A network's maps are stretched to 0 without a gap."""

_ENDS = tuple(end * unit for end in (32767, 65504, 65535) for unit in (1.0, 0.1, 0.01, 0.001))
"""m: the largest numbers that types of 16 bits hold, in usual units; of these no gap is asked."""

NO_RANGE = 100.0
"""m: from here on a stand-in is the sky of a renderer, nearer it may be what a depth camera did not
see.
"""

_END_SHARE, _END_TIMES = 0.01, 20.0
"""Of the pixels, that hold the largest distance, and times the median of all others, from which on
that is where a renderer ends. Of contrast no more than .12 would be left there, by default.
"""


def of_metres(z: Tensor) -> Tensor:
    """Which pixels of a map (1xHxW) hold a stand-in for a distance."""
    top = float(torch.where(z.isfinite(), z.detach(), 0.0).amax())
    if top <= FARTHEST_SEEN or not (is_end := _is_end(top)) | _is_round(top):
        return torch.zeros_like(z, dtype=torch.bool)
    return alone_of_metres(z, 0.0 if is_end else _GAP)


def alone_of_metres(z: Tensor, gap: float = _GAP) -> Tensor:
    """Which pixels of a map (1xHxW) hold the largest distance, if that is alone."""
    return _alone(torch.where(z > 0, z, torch.nan), gap)


def _is_end(metres: float) -> bool:
    """Whether this is the largest number of a type."""
    return any(abs(metres - end) < 1e-5 * end for end in _ENDS)


def _is_round(metres: float) -> bool:
    """Whether this is a number of one or two digits, or of nines."""
    digits = f"{metres:.6g}".replace(".", "").strip("0")
    return len(digits) <= 2 or set(digits) == {"9"}


def of_shares(x: Tensor) -> Tensor:
    """The same of a map of relative or inverse depth, or of disparities: booleans."""
    alone, x = _alone(x, _WIDE_GAP), x.detach()
    if bool((x <= 0).any()):
        alone |= _alone(-x.clamp(min=0), _ZERO_GAP) & (x <= 0)  # −1 and 0, and whatever else
        alone |= _alone(-x, _GAP) & (x < 0)
    return alone


def range_end(z: Tensor) -> Tensor:
    """Which pixels of a map (1xHxW, m) lie at the largest distance if that is where a renderer
    ends, which others may come near: booleans.
    """
    z = torch.where((z > 0) & z.isfinite(), z.detach(), 0.0)
    top = z.amax()
    is_end = (z == top) & (top > FARTHEST_SEEN)
    if float(is_end.float().mean()) >= _END_SHARE:
        others = z[(z > 0) & (z < top)]
        if others.numel() and bool(top >= _END_TIMES * others.median()):
            return is_end
    return torch.zeros_like(is_end)


def in_words(x: Tensor, alone: Tensor, cure: str = "") -> str:
    """What to ask of numbers that are alone, with the cure."""
    got = f"{100 * float(alone.float().mean()):.2g} % of a map are {float(x[alone][0]):g}"
    cure = cure or "unknown? --holes behind (holes='behind'); sky? --holes far"
    return f"{got}, a gap away from all other values: {cure}"


def _alone(x: Tensor, gap: float) -> Tensor:
    """Which pixels hold the largest value of a map, if that is alone by so much of its range."""
    values, top = x.detach(), x.detach().amax()
    if not top.isfinite():
        values = torch.where(values.isfinite(), values, -torch.inf)
        top = values.amax()
    is_top = values == top
    none = torch.zeros_like(is_top)
    if int(is_top.sum()) < _SEVERAL_PX:
        return none
    others = values[(values < top) & values.isfinite()]
    if len(set(others[:: max(1, others.numel() // 4096)].tolist())) < _FEWEST:
        return none
    low, high = others.aminmax()
    return is_top if bool(top - high > gap * (top - low)) else none
