"""The medium field m(x): relative density of the water along each ray, a factor of the distance."""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwaug._support import checks


def gaussian_random_field(
    shape: Sequence[int],
    *,
    exponent: float = 4.0,
    low: float = 0.7,
    high: float = 1.3,
    generator: torch.Generator | None = None,
    dtype: torch.dtype | None = None,
    device: torch.device | str | None = None,
) -> Tensor:
    """Draw scale-free Gaussian random fields, one per image.

    Each field is a sum of cosines and sines on a square torus of twice the image's longest side:
    isotropic, and not periodic at the image's borders. A seed gives the same field at every size
    whose longest side is 32 px or more. It is mapped affinely so that its smallest and largest
    value are `low` and `high`, which bounds the distance; so its mean varies from draw to draw.

    Args:
        shape: (B, 1, H, W) as a distance map has it, (B, H, W), or (H, W) for one field; pixels.
        exponent: α ≥ 0 of the power spectrum |k|^−α; more is smoother.
        low: smallest value, ≥ 0.
        high: largest value, ≥ `low`.
        generator: source of randomness; the global generator of the device if None. In a DataLoader
            leave it None: your own generator repeats the same numbers in every worker.
        dtype, device: of the result; torch's defaults if None.

    Returns:
        (B, 1, H, W), each field reaching from `low` to `high`; (low + high)/2 for a single pixel.

    Raises:
        ValueError: if an argument is none of the above.

    Examples:
        >>> m = gaussian_random_field((2, 1, 48, 64), generator=torch.Generator().manual_seed(0))
        >>> m.shape, m.amin((1, 2, 3)), m.amax((1, 2, 3))
        (torch.Size([2, 1, 48, 64]), tensor([0.7000, 0.7000]), tensor([1.3000, 1.3000]))
    """
    batch, height, width = _parse(shape)
    checks.within("exponent", exponent, 0.0)
    if not 0 <= low <= high < math.inf:
        raise ValueError(f"low and high must be 0 ≤ low ≤ high < inf, got {low} and {high}")
    n = 2 * _cutoff(exponent, max(height, width)) + 1
    noise = torch.randn(batch, n, n, generator=generator, device=device, dtype=torch.float32)
    dtype = dtype or torch.get_default_dtype()
    working = torch.promote_types(dtype, torch.float32)
    with checks.full_precision(noise):
        return field_of(noise.to(working), height, width, exponent, low, high).to(dtype)


def random_fields(
    seeds: Sequence[int],
    size: tuple[int, int],
    low: float,
    high: float,
    like: Tensor,
    moved: Sequence[tuple[float, float]],
) -> Tensor:
    """Fields (Bx1xHxW, float32) of seeds, on the device of `like`, moved right and down by px."""
    n = 2 * _cutoff(4.0, max(size)) + 1
    noise = torch.empty(len(seeds), n, n, dtype=torch.float32, device="cpu")
    generator = torch.Generator()
    for row, seed in zip(noise, seeds, strict=True):
        row.normal_(generator=generator.manual_seed(seed))
    return field_of(noise.to(like.device), *size, 4.0, low, high, moved)


# a quarter to half of the time of an FFT (benchmarks/CHOICES.md)
def field_of(
    noise: Tensor,
    height: int,
    width: int,
    exponent: float,
    low: float,
    high: float,
    moved: Sequence[tuple[float, float]] = (),
) -> Tensor:
    """Fields (Bx1xHxW) of white noise (Bxnxn, n odd). Index i of its last two axes stands for
    (i + 1)//2 cycles per torus, as a sine if i is odd, else a cosine.
    """
    count = noise.shape[-1]
    is_kept = type(noise) is Tensor and count <= _FEW and not torch.compiler.is_compiling()
    make = _kept_waves if is_kept else _waves
    waves = make(height, width, exponent, count, noise.dtype, noise.device)
    amplitudes = noise * waves.amplitude
    fields = still = (waves.down @ amplitudes @ waves.across)[:, None]
    if any(map(any, moved)):
        sizes = max(height, width), count, noise
        across = torch.stack([_cosines(width, *sizes, right) for right, _ in moved])
        down = torch.stack([_cosines(height, *sizes, px) for _, px in moved])
        fields = (down @ amplitudes @ across.mT)[:, None]
    # by the ends of the field that has not moved: else all of it would change as it moves
    if checks.on_host(still) and len(still):
        ends = [checks.extent(field) for field in torch.split(still, 1)]
        for field, (least, most) in zip(torch.split(fields, 1), ends, strict=True):
            # tensors as ends take five times as long
            factor = (high - low) / (most - least) if most > least else 0.0
            summand = (low + high) / 2 - (least + most) / 2 * factor
            field.mul_(factor).add_(summand).clamp_(low, high)
        return fields
    smallest, largest = still.amin((-2, -1), keepdim=True), still.amax((-2, -1), keepdim=True)
    span = largest - smallest
    scale = torch.where(span > 0, (high - low) / span, 0.0)
    # (torch.addcmul takes three times as long)
    offset = (low + high) / 2 - (smallest + largest) / 2 * scale
    return (fields * scale).add_(offset).clamp_(low, high)


class _Waves(NamedTuple):
    """Cosines along the rows (HxN) and columns (NxW), and their amplitudes (NxN)."""

    down: Tensor
    amplitude: Tensor
    across: Tensor


_FEW = 100  # waves of smooth fields, which take as long to make as a field of 256²


@lru_cache(maxsize=16)
def _kept_waves(*key: Any) -> _Waves:
    # tensors of inference mode cannot be used outside
    with torch.inference_mode(False), torch.no_grad():
        return _waves(*key)


def _waves(
    height: int, width: int, exponent: float, count: int, dtype: torch.dtype, device: torch.device
) -> _Waves:
    index = torch.arange(count, dtype=dtype, device=device)
    cycles, longest = ((index + 1) / 2).floor(), max(height, width)
    square = cycles**2 + cycles[:, None] ** 2
    square[0, 0] = math.inf  # no constant term: the affine map would take it out again
    # the constant in x or y stands for one wave, all others for two: k and −k
    twofold = (1 + cycles.clamp(max=1)).sqrt()
    amplitude = square ** (-exponent / 4) * twofold * twofold[:, None]
    down, across = (_cosines(side, longest, count, index) for side in (height, width))
    return _Waves(down, amplitude, across.mT)


def _cosines(side: int, longest: int, count: int, like: Tensor, moved: float = 0.0) -> Tensor:
    """Waves (side, count) at pixel centres, with 0 in the middle, moved by so many px."""
    pixel, index = (torch.arange(n, dtype=like.dtype, device=like.device) for n in (side, count))
    cycles, phase = ((index + 1) / 2).floor(), index % 2 * (math.pi / 2)
    centred = (pixel - (side - 1) / 2 - moved)[:, None]
    return torch.cos(centred * cycles * (math.pi / longest) - phase)


def _cutoff(exponent: float, longest: int) -> int:
    """Number of cycles per torus to model: all that show, or until the rest has 5 % of the rms."""
    # the share of the variance beyond K is (K/0.7)^(2−α): the integral of |k|^−α outside K over its
    # sum on the lattice
    if exponent <= 2:
        return longest
    log_cutoff = 2 * math.log(1 / 0.05) / (exponent - 2)
    return min(longest, math.ceil(0.7 * math.exp(min(log_cutoff, 50.0))))


def _parse(shape: Sequence[int]) -> tuple[int, int, int]:
    sides = tuple(shape)
    for side in sides:
        if not hasattr(side, "__index__"):
            raise ValueError(f"shape must hold whole numbers, got {sides}")
    if len(sides) not in (2, 3, 4) or (len(sides) == 4 and sides[1] != 1):
        raise ValueError(f"shape must be (B, 1, H, W), (B, H, W) or (H, W), got {sides}")
    if min(sides[-2:]) < 1 or sides[0] < 0:
        raise ValueError(f"shape must have at least one pixel per side, got {sides}")
    return (sides[0] if len(sides) > 2 else 1), sides[-2], sides[-1]
