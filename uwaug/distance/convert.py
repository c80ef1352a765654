"""Metres along the ray, from what people have: metric depth, disparity, relative or inverse depth,
a depth network.

Convention: maps are (..., H, W) tensors, float32 or float64 (half precision is taken up to
float32). NaN stands for an unknown distance and stays NaN until `check_distance` or `fill_unknown`;
+inf stands for open water. A pixel's index (i, j) has its centre at (i + 0.5, j + 0.5).
"""

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.distance.behind import filled_behind
from uwaug.distance.complete import filled, warn_of_unknown


def from_relative(
    t: Tensor, near: float | Tensor, far: float | Tensor, gamma: float | Tensor = 1.0
) -> Tensor:
    """Scale normalised relative distance to metres: z = near + (far − near)·t^gamma.

    Args:
        t: (..., H, W), relative distance in [0, 1], 0 = near; NaN = unknown. Networks give
            *inverse* depth instead: see `from_inverse`.
        near: metres at t = 0, ≥ 0; a number, or a tensor that broadcasts against `t`, such as (B,
            1, 1, 1).
        far: metres at t = 1, ≥ `near` and finite; likewise.
        gamma: > 0; above 1 moves the middle distance nearer; likewise.

    Returns:
        Distance in metres, shape of `t` (broadcast). t^gamma is continued as a straight line below
        t = 1e-6, so that the gradient is finite at 0 for gamma < 1 too.

    Raises:
        ValueError: `t` leaves [0, 1], or `near`, `far`, `gamma` are out of range.
        TypeError: `t` is no floating-point tensor.

    Examples:
        >>> from_relative(torch.tensor([[0.0, 0.5, 1.0]]), near=1.0, far=5.0, gamma=2.0)
        tensor([[1., 2., 5.]])
    """
    t = _maps("t", t)
    require_relative(t, near, far, gamma)
    return scaled_relative(t, near, far, gamma)


def from_inverse(inverse: Tensor, near: float | Tensor, far: float | Tensor) -> Tensor:
    """Scale inverse relative depth, as monocular networks give it (near = large), to metres.

    MiDaS, DPT and Depth Anything predict 1/z up to an unknown scale *and* shift, so neither 1/value
    nor 1 − value is a distance. Each map is therefore normalised by its own least and largest value
    to s in [0, 1], and s is mapped affinely in 1/z, where it is affine: 1/z = 1/far + (1/near −
    1/far)·s.

    Args:
        inverse: (..., H, W), any scale and shift; NaN or infinite = unknown.
        near: metres at the map's largest value, > 0; a number, or a tensor that broadcasts against
            `inverse`.
        far: metres at its least value, ≥ `near`; inf for open water or sky; likewise.

    Returns:
        Distance in metres, shape of `inverse` (broadcast), NaN where unknown.

    Raises:
        ValueError: a map is constant or has no finite value, or `near`, `far` are out of range.
        TypeError: `inverse` is no floating-point tensor.

    Source: Ranftl et al. 2022, Towards robust monocular depth estimation: scale- and
    shift-invariant losses.

    Examples:
        >>> from_inverse(torch.tensor([[0.0, 30.0, 90.0]]), near=1.0, far=4.0)
        tensor([[4., 2., 1.]])
    """
    inverse = _maps("inverse", inverse)
    require_range(near, far, inverse=True)
    return scaled_inverse(inverse, ends_of_inverse(inverse), near, far)


def from_disparity(
    disparity: Tensor, focal_px: float, baseline_m: float, offset_px: float = 0.0
) -> Tensor:
    """Turn the disparity of a rectified stereo pair into planar metric depth: focal·baseline /
    (disparity + offset).

    The result is depth along the optical axis; pass it through `along_ray` for distance.

    Args:
        disparity: (..., H, W), pixels. NaN or infinite = unknown. If your files mark unknown pixels
            with 0 and `offset_px` is not 0, set them to NaN first.
        focal_px: focal length, pixels.
        baseline_m: distance between the cameras, metres.
        offset_px: difference of the principal points' columns ("doffs" of the Middlebury data
            sets), pixels.

    Returns:
        Depth in metres, shape of `disparity`; NaN where the disparity is unknown or disparity +
        offset ≤ 0.

    Raises:
        ValueError: `focal_px` or `baseline_m` is not positive, or `offset_px` not finite.
        TypeError: `disparity` is no floating-point tensor.

    Examples:
        >>> from_disparity(torch.tensor([[10.0, 20.0, 0.0]]), focal_px=1000.0, baseline_m=0.1)
        tensor([[10.,  5., nan]])
    """
    disparity = _maps("disparity", disparity)
    checks.positive("focal_px", focal_px)
    checks.positive("baseline_m", baseline_m)
    checks.within("offset_px", offset_px)
    shifted = disparity + offset_px
    known = shifted.isfinite() & (shifted > 0)
    return torch.where(known, focal_px * baseline_m / torch.where(known, shifted, 1.0), torch.nan)


def along_ray(
    depth: Tensor, focal_px: float | tuple[float, float], centre: tuple[float, float] | None = None
) -> Tensor:
    """Turn planar depth (along the optical axis, as depth maps hold it) into distance along each
    pixel's ray.

    Pixel (i, j) looks along ((j + 0.5 − cx)/fx, (i + 0.5 − cy)/fy, 1), so z = depth·√(1 + x² + y²).
    OpenCV counts from the centre of the first pixel: add 0.5 to its principal point.

    Args:
        depth: (..., H, W), metres.
        focal_px: focal length in pixels of this image, or (fx, fy).
        centre: principal point (cx, cy) in pixels from the image's top left corner; (W/2, H/2) if
            None.

    Returns:
        Distance along the ray in metres, shape of `depth`.

    Raises:
        ValueError: a focal length is not positive, or `centre` not finite.
        TypeError: `depth` is no floating-point tensor.

    Examples:
        >>> along_ray(torch.full((1, 3), 2.0), focal_px=1.0)
        tensor([[2.8284, 2.0000, 2.8284]])
    """
    depth = _maps("depth", depth)
    fx, fy = focal_px if isinstance(focal_px, tuple) else (focal_px, focal_px)
    height, width = depth.shape[-2:]
    cx, cy = (width / 2, height / 2) if centre is None else centre
    for focal, middle in ((fx, cx), (fy, cy)):
        checks.positive("focal_px", focal)
        checks.within("centre", middle)
    x = (torch.arange(width).to(depth) + (0.5 - cx)) / fx
    y = (torch.arange(height).to(depth) + (0.5 - cy)) / fy
    return depth * (1 + x**2 + y[:, None] ** 2).sqrt()


def check_distance(distance: Tensor) -> Tensor:
    """Make sure that every pixel is known: above 0 m, or +inf for open water.

    Args:
        distance: (..., H, W), metres.

    Returns:
        `distance`.

    Raises:
        ValueError: pixels are NaN, negative or zero (says how many of each).
        TypeError: `distance` is no floating-point tensor.
    """
    distance = _maps("distance", distance)
    # NaN if any is; a mask of all pixels takes several times as long
    if distance.numel() and not distance.detach().amin() > 0:
        counts = checks.counted(distance, "NaN", "negative", "zero")
        cure = "mask them, or fill them with uwaug.distance.fill_unknown"
        raise ValueError(f"distance must be above 0 m (inf = open water), but is {counts}: {cure}")
    return distance


def fill_unknown(distance: Tensor, *, behind: bool = False) -> Tensor:
    """Give each unknown pixel (NaN, negative or zero) a distance from the known ones of its map.

    Holes of real maps are mostly thin: occlusions beside edges, reflections, the rim that
    rectification leaves. Within 4 pixels of what is known the nearest value keeps edges sharp and
    invents no distance in between. Farther inside, a membrane over 1/z spans the hole smoothly.

    Maps of depth cameras want `behind=True`: their holes are shadows that edges throw on what is
    behind, and all that lies beyond the sensor's range. A hole is then filled from the farther
    side of its rim, and the middle of a wide one gets the farthest distance of its rim. Where
    there is open water beyond the range, set it: `torch.where(distance > 0, distance, torch.inf)`.

    Fill a whole map before it is cropped: a crop may hold no known pixel.

    Args:
        distance: (..., H, W), metres. +inf is known: open water.
        behind: fill holes with what is behind.

    Returns:
        Shape of `distance`, every pixel above 0 and between the least and the largest known value;
        differentiable in the known pixels (which of them is the nearest is held fixed, and so is
        the farthest of a rim). `distance` itself if none is unknown.

    Raises:
        ValueError: a map has no known pixel.
        TypeError: `distance` is no floating-point tensor.

    Warns:
        UserWarning: once in a process, if more than 20 % of a map is unknown, but for `behind`.

    Examples:
        >>> fill_unknown(torch.tensor([[2.0, 2.0, 2.0, 2.0, 0.0, 0.0, 3.0, 3.0, 3.0, 3.0]]))
        tensor([[2., 2., 2., 2., 2., 3., 3., 3., 3., 3.]])
        >>> fill_unknown(torch.tensor([[2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 3.0, 3.0]]), behind=True)
        tensor([[2., 2., 3., 3., 3., 3., 3., 3.]])
    """
    distance = _maps("distance", distance)
    unknown = ~(distance > 0)
    if not bool(unknown.any()):
        return distance
    holes = unknown.flatten(-2)
    empty = holes.all(-1)
    if bool(empty.any()):
        expected = "at least one known pixel (above 0 m) in each map"
        cure = "fill whole maps before they are cropped"
        raise ValueError(f"distance must have {expected}, got {_which(empty)} without any: {cure}")
    if not behind:
        warn_of_unknown(float(holes.double().mean(-1).max()))
    size = distance.shape[-2:]
    fill = filled_behind if behind else filled
    return fill(distance.reshape(-1, *size), unknown.reshape(-1, *size)).view(distance.shape)


def _maps(name: str, x: Tensor) -> Tensor:
    """Check a tensor of maps; half precision is taken up to float32."""
    checks.floating(name, x, ": 8-bit values need / 255, millimetres / 1000")
    if x.ndim < 2:
        raise ValueError(f"{name} must have shape (..., H, W), got {tuple(x.shape)}")
    return single(x)


def require_relative(
    t: Tensor, near: float | Tensor, far: float | Tensor, gamma: float | Tensor
) -> None:
    """Refuse arguments of `from_relative` outside their domains."""
    if bool(((t < 0) | (t > 1)).any()):
        cure = "normalise first, (t - t.min()) / (t.max() - t.min())"
        raise ValueError(f"t must lie in [0, 1], got {checks.span(t)}: {cure}")
    require_range(near, far, inverse=False)
    power = torch.as_tensor(gamma, dtype=torch.float64)
    if not bool(((power > 0) & power.isfinite()).all()):
        raise ValueError(f"gamma must be positive and finite, got {gamma}")


def scaled_relative(
    t: Tensor, near: float | Tensor, far: float | Tensor, gamma: float | Tensor
) -> Tensor:
    """`from_relative` at each pixel of checked maps."""
    safe = t.clamp(min=1e-6)
    return near + (far - near) * (t / safe * safe**gamma)


def ends_of_inverse(inverse: Tensor) -> tuple[Tensor, Tensor]:
    """The least and the largest value of each map; refuses maps without."""
    known = inverse.isfinite()
    least = torch.where(known, inverse, torch.inf).amin((-2, -1), keepdim=True)
    largest = torch.where(known, inverse, -torch.inf).amax((-2, -1), keepdim=True)
    flat = ~(largest > least)
    if bool(flat.any()):
        got = f"{_which(flat)} that is constant or has no finite value"
        cure = "scale whole maps before they are cropped"
        raise ValueError(f"inverse must vary within each map, got {got}: {cure}")
    return least, largest


def scaled_inverse(
    inverse: Tensor, ends: tuple[Tensor, Tensor], near: float | Tensor, far: float | Tensor
) -> Tensor:
    """`from_inverse` at each pixel of checked maps, with the ends of the whole ones."""
    known, (least, largest) = inverse.isfinite(), ends
    # halves, whose difference no pair of finite values can make infinite
    low = least / 2
    s = (torch.where(known, inverse / 2, low) - low) / (largest / 2 - low)
    return torch.where(known, 1 / (1 / far + (1 / near - 1 / far) * s), torch.nan)


def require_range(near: float | Tensor, far: float | Tensor, *, inverse: bool) -> None:
    """Refuse distances that no map can be scaled to."""
    n, f = (torch.as_tensor(end, dtype=torch.float64) for end in (near, far))
    if inverse:
        domain, good = "0 < near <= far, near finite", (n > 0) & (f >= n) & n.isfinite()
    else:
        domain, good = "0 <= near <= far < inf", (n >= 0) & (f >= n) & f.isfinite()
    if not bool(good.all()):
        raise ValueError(f"near and far must satisfy {domain}, got near={near}, far={far}")


def single(x: Tensor) -> Tensor:
    """Half precision in float32; all else as it is."""
    return x.float() if x.dtype.itemsize < 4 else x


def _which(bad: Tensor) -> str:
    """The first map that is bad, in words."""
    if bad.numel() == 1:
        return "a map"
    return f"map {int(bad.flatten().nonzero()[0])} of {bad.numel()}, counted from 0,"
