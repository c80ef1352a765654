"""Maps of another size than their pictures: telephones and networks give small ones."""

import torch
from torch import Tensor
from torch.nn.functional import interpolate, max_pool2d

from uwaug._support.once import Once

_STEP = 1.1
"""Times its neighbour's, a value is that of something else: nothing lies between them."""

_small = Once()


def same_aspect(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether two sizes (height, width) differ in scale alone, but for a pixel."""
    (height, width), (h, w) = size, other
    return abs(h * width - w * height) <= max(height, width)


def brought_to(size: tuple[int, int], z: Tensor) -> Tensor:
    """A map (…, h, w) of the same aspect at another (height, width): linear where it is smooth, the
    nearest pixel at steps and beside unknown pixels and open water.

    Warns:
        UserWarning: once in a process, with both sizes.
    """
    if z.shape[-2:] == size:
        return z
    (h, w), (height, width) = z.shape[-2:], size
    _small.warn(f"a map of {w}×{h} px is brought to {width}×{height} px, as its picture is")
    small = z.reshape(-1, 1, h, w)
    nearest = interpolate(small, size, mode="nearest-exact")
    linear = interpolate(small.nan_to_num(posinf=0.0), size, mode="bilinear")
    values = torch.where((small > 0) & small.isfinite(), small, 0.0)
    largest = max_pool2d(values, 3, 1, 1)
    least = 1 / max_pool2d(torch.where(values > 0, 1 / values, torch.inf), 3, 1, 1)
    smooth = interpolate((largest <= _STEP * least).to(small.dtype), size, mode="nearest-exact") > 0
    return torch.where(smooth, linear, nearest).reshape(*z.shape[:-2], *size)
