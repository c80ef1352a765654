"""Conversions to metres along the ray.

Maps are (..., H, W) tensors; half precision becomes float32. NaN is an unknown distance, +inf is
open water. The pixel (i, j) has its centre at (i + 0.5, j + 0.5).
"""

import torch
from torch import Tensor

from uwaug._support import checks


def from_relative(
    t: Tensor, near: float | Tensor, far: float | Tensor, gamma: float | Tensor = 1.0
) -> Tensor:
    """Scale normalised relative distance to metres: z = near + (far − near)·t^gamma.

    Args:
        t: (..., H, W), relative distance in [0, 1], 0 = near; NaN = unknown. Networks give
            *inverse* depth instead: see `from_inverse`.
        near, far: metres at t = 0 and at t = 1, 0 ≤ near ≤ far < inf; numbers, or tensors that
            broadcast against `t`, such as (B, 1, 1, 1).
        gamma: exponent, > 0; likewise. Above 1 the middle distance is nearer.

    Returns:
        Metres, shape of `t` (broadcast); straight below t = 1e-6, so that gradients are finite.

    Examples:
        >>> from_relative(torch.tensor([[0.0, 0.5, 1.0]]), near=1.0, far=5.0, gamma=2.0)
        tensor([[1., 2., 5.]])
    """
    t = as_maps("t", t)
    if bool(((t < 0) | (t > 1)).any()):
        raise ValueError(f"t must lie in [0, 1], got {checks.span(t)}: normalise it first")
    n, f, power = (torch.as_tensor(number, dtype=torch.float64) for number in (near, far, gamma))
    if not bool(((n >= 0) & (f >= n) & (f < torch.inf)).all()):
        raise ValueError(f"near and far must be 0 <= near <= far < inf, got {near} and {far}")
    if not bool(((power > 0) & (power < torch.inf)).all()):
        raise ValueError(f"gamma must be positive and finite, got {gamma}")
    safe = t.clamp(min=1e-6)
    return near + (far - near) * (t / safe * safe**gamma)


def from_inverse(inverse: Tensor, near: float | Tensor, far: float | Tensor) -> Tensor:
    """Scale inverse relative depth, as monocular networks give it (near = large), to metres.

    Each map is normalised by its least and largest value to s in [0, 1], as networks predict 1/z up
    to scale and shift, and 1/z = 1/far + (1/near − 1/far)·s.

    Args:
        inverse: (..., H, W), any scale and shift; NaN or infinite = unknown.
        near, far: metres at the map's largest and at its least value, 0 < near ≤ far; inf for far
            is open water or sky; numbers, or tensors that broadcast against `inverse`.

    Returns:
        Metres, shape of `inverse` (broadcast), NaN where unknown. A ValueError if a map is constant
        or has no finite value.

    Source: Ranftl et al. 2022, Towards robust monocular depth estimation.

    Examples:
        >>> from_inverse(torch.tensor([[0.0, 30.0, 90.0]]), near=1.0, far=4.0)
        tensor([[4., 2., 1.]])
    """
    inverse = as_maps("inverse", inverse)
    n, f = (torch.as_tensor(end, dtype=torch.float64) for end in (near, far))
    if not bool(((n > 0) & (f >= n) & n.isfinite()).all()):
        raise ValueError(f"near and far must be 0 < near <= far, near finite, got {near} and {far}")
    finite = inverse.isfinite()
    least = torch.where(finite, inverse, torch.inf).amin((-2, -1), keepdim=True)
    largest = torch.where(finite, inverse, -torch.inf).amax((-2, -1), keepdim=True)
    flat = ~(largest > least)
    if bool(flat.any()):
        got = f"{int(flat.sum())} of {flat.numel()} constant or without a finite value"
        raise ValueError(f"inverse must vary within each map, got {got}: scale before you crop")
    # halves, whose difference no pair of finite values can make infinite
    low = least / 2
    s = (torch.where(finite, inverse / 2, low) - low) / (largest / 2 - low)
    return torch.where(finite, 1 / (1 / far + (1 / near - 1 / far) * s), torch.nan)


def from_disparity(
    disparity: Tensor, focal_px: float, baseline_m: float, offset_px: float = 0.0
) -> Tensor:
    """Turn the disparity of a rectified stereo pair into depth along the optical axis:
    focal·baseline / (disparity + offset).

    Args:
        disparity: (..., H, W), pixels. NaN or infinite = unknown; so is 0, without an offset.
        focal_px: focal length, pixels.
        baseline_m: distance between the cameras, metres.
        offset_px: difference of the principal points' columns (Middlebury's "doffs"), pixels.

    Returns:
        Metres, shape of `disparity`; NaN where that is unknown or disparity + offset ≤ 0.

    Examples:
        >>> from_disparity(torch.tensor([[10.0, 20.0, 0.0]]), focal_px=1000.0, baseline_m=0.1)
        tensor([[10.,  5., nan]])
    """
    disparity = as_maps("disparity", disparity)
    checks.positive("focal_px", focal_px)
    checks.positive("baseline_m", baseline_m)
    checks.within("offset_px", offset_px)
    shifted = disparity + offset_px
    matched = shifted.isfinite() & (shifted > 0)
    pixels = torch.where(matched, shifted, 1.0)
    return torch.where(matched, focal_px * baseline_m / pixels, torch.nan)


def along_ray(
    depth: Tensor, focal_px: float | tuple[float, float], centre: tuple[float, float] | None = None
) -> Tensor:
    """Turn depth along the optical axis, as depth maps hold it, into distance along each ray.

    Pixel (i, j) looks along ((j + 0.5 − cx)/fx, (i + 0.5 − cy)/fy, 1), so z = depth·√(1 + x² + y²).

    Args:
        depth: (..., H, W), metres.
        focal_px: focal length in pixels of this image, or (fx, fy).
        centre: principal point (cx, cy) in pixels from the image's top left corner, .5 more than
            OpenCV's; (W/2, H/2) if None.

    Returns:
        Metres, shape of `depth`.

    Examples:
        >>> along_ray(torch.full((1, 3), 2.0), focal_px=1.0)
        tensor([[2.8284, 2.0000, 2.8284]])
    """
    depth = as_maps("depth", depth)
    fx, fy = focal_px if isinstance(focal_px, tuple) else (focal_px, focal_px)
    height, width = depth.shape[-2:]
    cx, cy = (width / 2, height / 2) if centre is None else centre
    for focal, middle in ((fx, cx), (fy, cy)):
        checks.positive("focal_px", focal)
        checks.within("centre", middle)
    x = (torch.arange(width).to(depth) + (0.5 - cx)) / fx
    y = (torch.arange(height).to(depth) + (0.5 - cy)) / fy
    return depth * (1 + x**2 + y[:, None] ** 2).sqrt()


def as_maps(name: str, x: Tensor) -> Tensor:
    """Refuse what is no tensor of maps (..., H, W), and take half precision up to float32."""
    checks.floating(name, x, ": 8-bit values need / 255, millimetres / 1000")
    if x.ndim < 2:
        raise ValueError(f"{name} must have shape (..., H, W), got {tuple(x.shape)}")
    return x.float() if x.dtype.itemsize < 4 else x
