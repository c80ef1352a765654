"""Relative and inverse depth to metres, pixel by pixel, and what maps must be for that. See
`uwaug.distance`, which checks whole maps with it, and `uwaug.distance.sample`, which
scales parts of them.
"""

import torch
from torch import Tensor

from uwaug._support import checks

__all__ = [
    "ends_of_inverse",
    "require_range",
    "require_relative",
    "scaled_inverse",
    "scaled_relative",
    "single",
    "which_of",
]


def require_relative(
    t: Tensor, near: float | Tensor, far: float | Tensor, gamma: float | Tensor
) -> None:
    """Refuse what `from_relative` cannot take."""
    if bool(((t < 0) | (t > 1)).any()):
        cure = "normalise first, (t - t.min()) / (t.max() - t.min())"
        raise ValueError(f"t must lie in [0, 1], got {checks.span(t)}: {cure}")
    require_range(near, far, inverse=False)
    power = torch.as_tensor(gamma)
    if not bool(((power > 0) & power.isfinite()).all()):
        raise ValueError(f"gamma must be positive and finite, got {gamma}")


def scaled_relative(
    t: Tensor, near: float | Tensor, far: float | Tensor, gamma: float | Tensor
) -> Tensor:
    """`from_relative` at each pixel, of maps that are known to be good."""
    safe = t.clamp(min=1e-6)
    return near + (far - near) * (t / safe * safe**gamma)


def ends_of_inverse(inverse: Tensor) -> tuple[Tensor, Tensor]:
    """The least and the largest value of each map; refuses maps without."""
    known = inverse.isfinite()
    least = torch.where(known, inverse, torch.inf).amin((-2, -1), keepdim=True)
    largest = torch.where(known, inverse, -torch.inf).amax((-2, -1), keepdim=True)
    flat = ~(largest > least)
    if bool(flat.any()):
        got = f"{which_of(flat)} that is constant or has no finite value"
        cure = "scale whole maps before they are cropped"
        raise ValueError(f"inverse must vary within each map, got {got}: {cure}")
    return least, largest


def scaled_inverse(
    inverse: Tensor, ends: tuple[Tensor, Tensor], near: float | Tensor, far: float | Tensor
) -> Tensor:
    """`from_inverse` at each pixel, of maps that are known to be good."""
    known, (least, largest) = inverse.isfinite(), ends
    # halves, whose difference no pair of finite values can make infinite
    low = least / 2
    s = (torch.where(known, inverse / 2, low) - low) / (largest / 2 - low)
    return torch.where(known, 1 / (1 / far + (1 / near - 1 / far) * s), torch.nan)


def require_range(near: float | Tensor, far: float | Tensor, *, inverse: bool) -> None:
    """Refuse distances that no map can be scaled to."""
    n, f = torch.as_tensor(near), torch.as_tensor(far)
    if inverse:
        wanted, good = "0 < near <= far, near finite", (n > 0) & (f >= n) & n.isfinite()
    else:
        wanted, good = "0 <= near <= far < inf", (n >= 0) & (f >= n) & f.isfinite()
    if not bool(good.all()):
        raise ValueError(f"near and far must satisfy {wanted}, got near={near}, far={far}")


def single(x: Tensor) -> Tensor:
    """Half precision taken up to float32; all else as it is."""
    return x.float() if x.dtype.itemsize < 4 else x


def which_of(bad: Tensor) -> str:
    """The first map that is bad, in words."""
    if bad.numel() == 1:
        return "a map"
    return f"map {int(bad.flatten().nonzero()[0])} of {bad.numel()}, counted from 0,"
