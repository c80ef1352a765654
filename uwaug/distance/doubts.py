"""Doubts that maps hold metres: what their numbers are instead."""

from collections.abc import Sequence

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.once import Once
from uwaug.distance.unknown import in_words, of_metres

# ends of a map that is divided by its largest distance, or stretched: no camera sees 2 cm
_NEAREST_SHARE, _LARGEST_SHARE = 0.02, (0.3, 1.0001)

first_maps = Once(looks=8)
"""The warning that maps lie in 0…1. What is wrong with all maps shows in the first."""


def doubts(distance: Tensor | Sequence[Tensor]) -> list[str]:
    """Tell why maps may not be metres along the ray: their median lies beyond 1000 m, they lie in
    0…1, or many pixels hold the largest number of a type, such as 65.535 of 16 bits in mm.

    Args:
        distance: a map (1xHxW; 0, negative and NaN = unknown, +inf = open water), several of any
            size, or a batch (Bx1xHxW).

    Returns:
        Sentences, each with its cure, of the first map that is so.
    """
    maps = [distance] if isinstance(distance, Tensor) and distance.ndim == 3 else list(distance)
    sentences: dict[str, str] = {}
    for z in maps:
        checks.floating("distance", z)
        checks.picture("distance", z, 1)
        if (median := checks.too_far(z)) is not None:
            cure = "in millimetres, divide by 1000 (--unit mm)"
            sentences.setdefault("far", f"distances have a median of {median:.4g} m: {cure}")
        if sentence := _relative(z):
            sentences.setdefault("relative", sentence)
        stand_in = of_metres(z)
        if bool(stand_in.any()):
            sentences.setdefault("end", in_words(z, stand_in))
    return list(sentences.values())


def question(distance: Tensor, stacklevel: int = 2) -> None:
    """Warn, once in a process, if one of its first maps (1xHxW) lies in 0…1."""
    if first_maps.due() and (sentence := _relative(distance)):
        first_maps.warn(sentence, stacklevel + 1)


def _relative(z: Tensor) -> str:
    is_known = (z > 0) & (z < torch.inf)
    if not bool(is_known.any()):
        return ""
    low, high = checks.extent(z[is_known])
    least, most = _LARGEST_SHARE
    if low >= _NEAREST_SHARE or not least < high <= most:
        return ""
    cure = "Inverse(near, far) (--set distance.kind=Inverse) where large is near, else Relative"
    return f"distances lie in 0…1, which looks relative: give {cure}"
