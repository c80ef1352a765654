"""Stand-ins: numbers in maps that mean unknown, or sky. Several pixels hold exactly such a number:
the largest of a type; a gap away from all others; or the end of a renderer's range.
"""

import numpy as np
import torch
from torch import Tensor

FARTHEST_SEEN = 50.0  # m, beyond which the largest distance of a map may be a stand-in
NO_RANGE = 100.0  # m, from which on it is a renderer's sky, and no pixel that a camera did not see

_LEAST_PIXELS = 8  # that hold a stand-in: wild pixels differ from each other
_LEAST_VALUES = 3  # that a map has besides
# gap to all other values, as a share of the map's range, of numbers below 0, and of the largest,
# which may also be the nearest thing of a scene
_GAP_SHARE, _WIDE_GAP_SHARE = 0.2, 0.8
_ZERO_GAP_SHARE = 0.02  # above 0: a network's maps are stretched to 0 without a gap
# largest numbers of 16 bits, in usual units (m)
_TYPE_ENDS_M = np.outer((32767, 65504, 65535), (1.0, 0.1, 0.01, 0.001)).ravel().tolist()
# share of the pixels at the largest distance, and its ratio to the median of all others, from which
# on a renderer ends there; by default at most .12 of the contrast would be left so far away
_END_SHARE, _END_TIMES = 0.01, 20.0
_SCATTERED_SHARE = 0.3  # of the pixels with a distance, that touch infinity where it is no water


def of_metres(z: Tensor) -> Tensor:
    """True where a map (1xHxW, m) holds the largest number of a type."""
    top = float(torch.where(z.isfinite(), z.detach(), 0.0).amax()) if z.numel() else 0.0
    if top <= FARTHEST_SEEN or not any(abs(top - end) < 1e-5 * end for end in _TYPE_ENDS_M):
        return torch.zeros_like(z, dtype=torch.bool)
    return _alone(torch.where(z > 0, z, torch.nan), 0.0)


def of_shares(x: Tensor) -> Tensor:
    """True where a map of relative depth, inverse depth or disparity holds a stand-in."""
    alone, x = _alone(x, _WIDE_GAP_SHARE), x.detach()
    low = x[x <= 0]
    if low.numel():
        if bool(((low == 0) | (low == low.min())).all()):  # both −1 and 0
            alone |= _alone(-x.clamp(min=0), _ZERO_GAP_SHARE) & (x <= 0)
        alone |= _alone(-x, _GAP_SHARE) & (x < 0)
    return alone


def range_end(z: Tensor) -> Tensor:
    """True where a map (1xHxW, m) holds its largest distance, if a renderer ends there."""
    z = torch.where((z > 0) & z.isfinite(), z.detach(), 0.0)
    top = z.amax()
    is_end = (z == top) & (top > FARTHEST_SEEN)
    if float(is_end.float().mean()) >= _END_SHARE:
        others = z[(z > 0) & (z < top)]
        if others.numel() and bool(top >= _END_TIMES * others.median()):
            return is_end
    return torch.zeros_like(is_end)


def scattered(z: Tensor) -> Tensor:
    """True where a map (1xHxW) is infinite, if many of the pixels with a distance touch such ones:
    open water lies together.
    """
    z = z.detach()
    is_open, is_seen = z == torch.inf, (z > 0) & (z < torch.inf)
    touches = is_open
    for axis in (-2, -1):  # several times as fast as a pooling
        before, after = touches.roll(1, axis), touches.roll(-1, axis)
        before.select(axis, 0).fill_(False)
        after.select(axis, -1).fill_(False)
        touches = touches | before | after
    is_scattered = int((touches & is_seen).sum()) > _SCATTERED_SHARE * int(is_seen.sum())
    return is_open if is_scattered else torch.zeros_like(is_open)


def in_words(x: Tensor, alone: Tensor, cure: str = "") -> str:
    """Ask what the numbers that are alone mean, with the cure."""
    got = f"{100 * float(alone.float().mean()):.2g} % of a map are {float(x[alone][0]):g}"
    cure = cure or "unknown? --holes behind (holes='behind'); sky? --holes far"
    return f"{got}, a gap away from all other values: {cure}"


def _alone(x: Tensor, gap: float) -> Tensor:
    """True where a map holds its largest value, if that is alone by a share of its range."""
    values, top = x.detach(), x.detach().amax()
    if not top.isfinite():
        values = torch.where(values.isfinite(), values, -torch.inf)
        top = values.amax()
    is_top = values == top
    none = torch.zeros_like(is_top)
    if int(is_top.sum()) < _LEAST_PIXELS:
        return none
    others = values[(values < top) & values.isfinite()]
    if len(set(others[:: max(1, others.numel() // 4096)].tolist())) < _LEAST_VALUES:
        return none
    low, high = others.aminmax()
    return is_top if bool(top - high > gap * (top - low)) else none
