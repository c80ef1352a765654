"""Numbers in a map that are no distance: what stands for unknown pixels, or for the sky."""

from typing import Literal

import torch
from torch import Tensor

End = Literal["least", "largest"]

_GAP = 0.25
"""Of the range of all other values: a value that is so far from them stands for something else."""

_NEXT_TO_ZERO = 0.02
"""Of the largest value: where the least above 0 is more, 0 stands for something else. A network's
maps are stretched to 0 without a gap.
"""

_FEWEST = 3
"""Different values that a map must have besides."""


def standing_alone(x: Tensor, end: End) -> Tensor:
    """Which pixels have the least or the largest value of a map, if that stands alone, a gap away
    from all others: 65535, 1000 m, −1, 0 in a disparity. None, if it does not.

    Args:
        x (…, H, W): one map, finite or not; what is not finite does not count.

    Returns:
        Booleans of its shape.
    """
    sign = 1.0 if end == "largest" else -1.0
    values = torch.where(x.isfinite(), sign * x.detach(), -torch.inf)
    top = values.amax()
    others = values[(values < top) & values.isfinite()]
    if others.numel() == 0:
        return torch.zeros_like(x, dtype=torch.bool)
    low, high = others.aminmax()
    gap = _GAP * (high - low)
    if end == "least" and float(top) == 0:
        gap = _NEXT_TO_ZERO * -low
    several = len(set(others[:: max(1, others.numel() // 4096)].tolist())) >= _FEWEST
    is_alone = several and bool(top - high > gap)
    return (values == top) if is_alone else torch.zeros_like(x, dtype=torch.bool)


def alone_in_words(x: Tensor, end: End) -> str:
    """What to ask of a value that stands alone, with the cure; "" where none does."""
    alone = standing_alone(x, end)
    if not bool(alone.any()):
        return ""
    got = f"{100 * float(alone.float().mean()):.2g} % of a map are {float(x[alone][0]):g}"
    cure = "unknown? --holes behind (holes='behind'); sky? --holes far"
    return f"{got}, a gap away from all other values: {cure}"
