"""Distances for pixels that have none."""

from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support.once import Once
from uwaug.distance.convert import as_maps

# How these were chosen, and what lost: benchmarks/CHOICES.md, "Holes".

_THIN_PX = 4.0  # within which a pixel takes the nearest value; from twice as far on, the membrane's
_SWEEPS = 4  # of relaxation on each level of the membrane
_OPEN_PER_M = 1e-9  # inverse distance below which there is open water
_GUESSED_SHARE = 0.2  # of unknown pixels, above which filling is guessing
_RIM_PX = 3  # width of the rim from which a hole is filled: its edges are ragged
# half of the distance, in widths of a hole, over which the sides of its rim are compared: those of
# a shadow are one width apart
_REACH_WIDTHS = 4
_NEARER_TIMES = 1.25  # ratio across a hole from which on the nearer side throws a shadow
# depth of a hole, as a share of the map's shorter side, from which on its middle is no shadow:
# registered maps have frames of up to 1/16
_WIDE_SHARE = 1 / 20
_WIDE_LEAST_PX = 4  # of such a hole in the smallest maps
_FARTHEST_QUANTILE = 0.98  # of a rim: beyond are wild pixels at edges

_guess_warning = Once()


def fill_unknown(distance: Tensor, *, behind: bool = False) -> Tensor:
    """Give each unknown pixel (NaN, negative or zero) a distance from the known ones of its map.

    Within 4 pixels of known ones the nearest value keeps edges sharp. Farther inside, a membrane
    over 1/z spans the hole: in 1/z a plane of the scene is a plane, and open water is 0.

    Args:
        distance: (..., H, W), metres; +inf is open water, and known. Fill maps before cropping.
        behind: for depth cameras, whose holes are shadows that edges throw, and all beyond the
            range: fill from the farther side of a rim, and the middle of wide holes with the
            farthest distance there.

    Returns:
        Shape of `distance`; differentiable in the known pixels, with their choice held fixed. A
        ValueError if a map has none; a warning, once, if more than 20 % of a map is unknown without
        `behind`.

    Examples:
        >>> fill_unknown(torch.tensor([[2.0, 2.0, 2.0, 2.0, 0.0, 0.0, 3.0, 3.0, 3.0, 3.0]]))
        tensor([[2., 2., 2., 2., 2., 3., 3., 3., 3., 3.]])
        >>> fill_unknown(torch.tensor([[2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 3.0, 3.0]]), behind=True)
        tensor([[2., 2., 3., 3., 3., 3., 3., 3.]])
    """
    distance = as_maps("distance", distance)
    unknown = ~(distance > 0)
    if not bool(unknown.any()):
        return distance
    percent = 100 * float(unknown.flatten(-2).double().mean(-1).max())
    if percent == 100:
        raise ValueError("distance must have a known pixel in each map: fill before you crop")
    if not behind and percent > 100 * _GUESSED_SHARE:
        got = f"distance is unknown at {percent:.0f} % of a map, and guessed"
        _guess_warning.warn(f"{got}: depth cameras want holes 'behind', open water wants 'far'")
    sources_of = _from_behind if behind else _from_nearest
    size = distance.shape[-2:]
    maps, holes = distance.reshape(-1, *size), unknown.reshape(-1, *size)
    sources = map(sources_of, maps.detach().cpu().numpy(), holes.cpu().numpy())
    stacked = map(np.stack, zip(*sources, strict=True))
    index, away, free = (torch.from_numpy(x).to(distance.device) for x in stacked)
    nearest = maps.flatten(1).gather(1, index.flatten(1)).view_as(maps)
    filled = torch.where(holes, _spanned(nearest, away, free), maps)
    return filled.view(distance.shape)


def _from_nearest(distance: Any, unknown: Any) -> tuple[Any, Any, Any]:
    """Flat index of the nearest known pixel, its distance in the picture (px), and a mask of pixels
    that the membrane may span, each (HxW).
    """
    from scipy.ndimage import distance_transform_edt

    away, (rows, columns) = distance_transform_edt(unknown, return_indices=True)
    return rows.astype(np.int64) * unknown.shape[-1] + columns, away, unknown


def _from_behind(distance: Any, unknown: Any) -> tuple[Any, Any, Any]:
    """As `_from_nearest`, with sources behind the hole, also of near sides of rims. The membrane
    spans neither rims nor the middle of wide holes.
    """
    from scipy import ndimage
    from scipy.spatial import cKDTree

    def widened(values: Any, pixels: int) -> Any:
        return ndimage.maximum_filter(values, 2 * pixels + 1, mode="constant")

    height, width = unknown.shape
    holes, count = ndimage.label(unknown, np.ones((3, 3)))
    beside, _, _ = _from_nearest(distance, ~unknown)  # the nearest pixel in a hole
    owner = holes.flat[beside]
    rim = widened(unknown, _RIM_PX) & ~unknown
    values = np.where(rim, distance, 0)
    farthest, highest = _far_ends(values, np.where(rim, owner, 0), count)
    # beyond the picture's border there is no hole: frames are as wide as they look
    deep = ndimage.distance_transform_cdt(np.pad(unknown, 1), "chessboard")[1:-1, 1:-1]
    wide = max(_WIDE_LEAST_PX, _WIDE_SHARE * min(height, width))
    middle = (deep >= wide) & (farthest[holes] >= 0)
    index = np.where(middle, farthest[holes], np.arange(unknown.size).reshape(height, width))
    values[middle] = distance.flat[index[middle]]
    across = np.where(unknown, widened(values, 2 * _REACH_WIDTHS), 0)
    half = 1
    while half < 2 * wide and (core := deep > half).any():
        # the parts of holes that are at least so wide, up to their rims
        opened = widened(core, half) & unknown
        across = np.where(opened, widened(values, _REACH_WIDTHS * (half + 1)), across)
        half *= 2
    # what lies across another hole does not count
    across = np.minimum(across, highest[holes])
    far_side = (rim & (values * _NEARER_TIMES >= across.flat[beside])) | middle

    def points(pixels: Any) -> Any:
        # points of one hole are nearer to each other than to those of any other
        layer = owner.flat[pixels] * float(height + width)
        return np.stack([pixels // width, pixels % width, layer], -1)

    sources, targets = np.flatnonzero(far_side), np.flatnonzero((rim | unknown) & ~far_side)
    steps, nearest = cKDTree(points(sources)).query(points(targets))
    away = np.zeros(unknown.shape)
    away.flat[targets] = steps
    index.flat[targets] = index.flat[sources[nearest]]
    return index, away, ~(rim | middle)


def _far_ends(values: Any, rims: Any, count: int) -> tuple[Any, Any]:
    """Flat index of the farthest pixel of each rim but for wild ones, and its largest distance; -1
    and infinity for a rim without pixels. `rims` (HxW): 1…count, and 0 beside them.
    """
    # rim by rim, the nearest first
    pixels = np.flatnonzero(rims)
    pixels = pixels[np.lexsort((values.flat[pixels], rims.flat[pixels]))]
    ends = np.cumsum(np.bincount(rims.flat[pixels], minlength=count + 1))
    starts = np.concatenate([[0], ends[:-1]])
    filled = ends > starts
    places = (starts + _FARTHEST_QUANTILE * (ends - starts - 1)).astype(int)
    farthest, highest = np.full(count + 1, -1), np.full(count + 1, np.inf)
    farthest[filled] = pixels[places[filled]]
    highest[filled] = values.flat[pixels[ends[filled] - 1]]
    return farthest, highest


def _spanned(nearest: Tensor, away: Tensor, free: Tensor) -> Tensor:
    """Put a membrane into maps (NxHxW, m) whose holes hold the nearest value, where that is far
    away (px) and the membrane is free.
    """
    weight = (away / _THIN_PX - 1).clamp(0, 1).to(nearest.dtype)
    if not bool((weight > 0).any()):
        return nearest
    # values that `where` leaves out must be harmless, too, or they spoil the gradient
    inverse = torch.where(free, 0, 1 / torch.where(free, 1, nearest).clamp(min=_OPEN_PER_M))
    smooth = _membrane(inverse[:, None], ~free[:, None])[:, 0]
    mixed = torch.lerp(1 / nearest.clamp(min=_OPEN_PER_M), smooth, weight)
    spanned = torch.where(mixed > _OPEN_PER_M, 1 / mixed.clamp(min=_OPEN_PER_M), torch.inf)
    return torch.where(weight > 0, spanned, nearest)


def _membrane(values: Tensor, fixed: Tensor) -> Tensor:
    """Solve Laplace's equation where values (Nx1xHxW) are not fixed but 0: from coarse grids to
    fine ones. The picture's border is free.
    """
    levels = []
    while not bool(fixed.all()):
        levels.append((values, fixed))
        # half as many rows and columns: means of fixed values
        rim = (0, values.shape[-1] % 2, 0, values.shape[-2] % 2)
        share = F.avg_pool2d(F.pad(fixed.to(values.dtype), rim), 2)
        total = F.avg_pool2d(F.pad(values, rim), 2)
        values, fixed = total / share.clamp(min=0.25), share > 0
    guess = values
    for values, fixed in reversed(levels):
        height, width = values.shape[-2:]
        guess = F.interpolate(guess, scale_factor=2, mode="bilinear", align_corners=False)
        guess = torch.where(fixed, values, guess[..., :height, :width])
        for _ in range(_SWEEPS):
            guess = torch.where(fixed, values, _mean_of_neighbours(guess))
    return guess


def _mean_of_neighbours(values: Tensor) -> Tensor:
    padded = F.pad(values, (1, 1, 1, 1), mode="replicate")
    above, below = padded[..., :-2, 1:-1], padded[..., 2:, 1:-1]
    left, right = padded[..., 1:-1, :-2], padded[..., 1:-1, 2:]
    return (above + below + left + right) / 4
