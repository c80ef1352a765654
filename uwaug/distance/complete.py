"""Distances for pixels that have none."""

import warnings

import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support.tiles import Rows, row_bands

# Artificial holes in five RGB-D pairs and the bundled scene (occlusions, rims, edges, specks,
# blobs of 5 to 30 %, all beyond a range): error of log z in blobs of 5, 15, 30 %; of e^(−z/2) at
# edges; ms at 500×741. This: .041, .069, .112; .0116; 35. Losers:
# * nearest .054, .092, .175; .0116; 18, and its seams are as sharp as knives;
# * a membrane everywhere .040, .068, .109; .0203; 250 to 1000 (sparse solve): softens thin holes;
# * one in log z .042, .072, .111, without an answer for open water; one in z .040, .079, .121;
# * biharmonic, as skimage has it: better in blobs of the smooth rooms (.105 for .133), 10 times the
#   time, and it overshoots beyond what is known;
# * OpenCV's Telea and Navier–Stokes .051, .087, .169, up to 300, no dependency of ours;
# * nearest, then blurred by the depth of the hole .041, .071, .117; .0139; 300 to 3700;
# * the farthest value around, for thin holes: .137 for .276 in occlusions, but twice the error at
#   all other edges and four times that in specks.

_THIN = 4.0
"""Pixels from what is known, up to which the nearest value is taken; from twice as many on the
membrane counts alone. 2 to 16 differ little.
"""

_SWEEPS = 4
"""Of relaxation on each level; the error is .114 with 2, .110 with 8, .109 once all has settled."""

_BEYOND = 16
"""Rows beyond a band that its holes look at, even: nearest values count for 8, sweeps for 5."""

_OPEN_WATER = 1e-9
"""1/m; anything farther is open water."""

_MANY = 0.2
"""Share of unknown pixels above which filling is guessing."""

_warned: list[int] = []
"""Percentages that were warned of, one at most."""


def filled(distance: Tensor, unknown: Tensor) -> Tensor:
    """Maps without holes: thin ones take the nearest value, wide ones are spanned by a membrane.

    The membrane is stretched over 1/z, in which a plane of the scene is a plane, whatever its
    slope, and open water is 0.

    Args:
        distance (NxHxW tensor): m.
        unknown (NxHxW tensor): boolean; each map has a pixel that is known.
    """
    nearby = [_nearest_known(holes) for holes in unknown.cpu()]
    away, index = (torch.stack(parts).to(distance.device) for parts in zip(*nearby, strict=True))
    nearest = distance.flatten(1).gather(1, index.flatten(1)).view_as(distance)
    return spanned(nearest, away, unknown)


def spanned(nearest: Tensor, away: Tensor, unknown: Tensor) -> Tensor:
    """Maps whose holes hold the nearest value, with a membrane where that is far away.

    Args:
        nearest (NxHxW tensor): m.
        away (NxHxW tensor): how far the pixel is that has the value, px.
        unknown (NxHxW tensor): the holes; boolean.
    """
    weight = _weight(away, nearest)
    if not bool((weight > 0).any()):
        return nearest
    smooth = _membrane(_inverse(nearest, unknown)[:, None], ~unknown[:, None])[:, 0]
    return _mixed(nearest, smooth, weight)


def filled_rows(distance: Rows, size: tuple[int, int]) -> Rows:
    """One map (1xHxW) without holes that is read a few rows at a time, as `filled` fills it.

    Values of the holes are held, and a quarter of the pixels of what is known.
    """
    coarse = [_halved_rows(distance(start, stop)) for start, stop in row_bands(*size, multiple=2)]
    means, known = (torch.cat(parts, 2) for parts in zip(*coarse, strict=True))
    del coarse
    guess = _membrane(means, known)
    del means, known
    counts, values = [], []
    for start, stop in row_bands(*size):
        unknown = ~(distance(start, stop) > 0)
        counts.append(unknown.sum((0, 2)))
        if bool(unknown.any()):
            band = _filled_band(distance, guess, size, start, stop)
            values.append(band[unknown])
    holes = torch.cat(values)
    before = F.pad(torch.cat(counts).cumsum(0), (1, 0)).tolist()

    def rows(start: int, stop: int) -> Tensor:
        part = distance(start, stop)
        return part.masked_scatter(~(part > 0), holes[before[start] : before[stop]])

    return rows


def _halved_rows(distance: Tensor) -> tuple[Tensor, Tensor]:
    unknown = ~(distance > 0)
    return _halved(_inverse(distance, unknown)[:, None], ~unknown[:, None])


def _filled_band(
    distance: Rows, guess: Tensor, size: tuple[int, int], start: int, stop: int
) -> Tensor:
    """Rows `start` to `stop` without holes, given the membrane on half as many rows and columns."""
    height, _ = size
    # what the nearest value counts for, and how far the relaxation reaches
    low, high = max(0, start // 2 * 2 - _BEYOND), min(height, stop + _BEYOND)
    part = distance(low, high)
    unknown = ~(part > 0)
    inverse = _inverse(part, unknown)[:, None]
    smooth = _finer(guess[..., low // 2 : (high + 1) // 2, :], inverse, ~unknown[:, None])[:, 0]
    if bool(unknown.all()):
        nearest, weight = part, torch.ones_like(part)
    else:
        away, index = _nearest_known(unknown[0])
        nearest, weight = part.flatten()[index][None], _weight(away[None], part)
    return _mixed(nearest, smooth, weight)[:, start - low : stop - low]


def _weight(away: Tensor, like: Tensor) -> Tensor:
    """Of the membrane, so far from what is known."""
    return (away.to(like.device) / _THIN - 1).clamp(0, 1).to(like.dtype)


def _inverse(distance: Tensor, unknown: Tensor) -> Tensor:
    """1/z, 0 where unknown."""
    # what `where` leaves out must be harmless too, or it spoils the gradient
    return torch.where(unknown, 0, 1 / torch.where(unknown, 1, distance).clamp(min=_OPEN_WATER))


def _mixed(nearest: Tensor, smooth: Tensor, weight: Tensor) -> Tensor:
    """Nearest distances, and the membrane (1/z) as its weight says."""
    mixed = torch.lerp(1 / nearest.clamp(min=_OPEN_WATER), smooth, weight)
    spanned = torch.where(mixed > _OPEN_WATER, 1 / mixed.clamp(min=_OPEN_WATER), torch.inf)
    return torch.where(weight > 0, spanned, nearest)


def _nearest_known(unknown: Tensor) -> tuple[Tensor, Tensor]:
    """How far the nearest known pixel of each pixel (HxW) is, and its flat index."""
    from scipy.ndimage import distance_transform_edt

    away, (rows, columns) = distance_transform_edt(unknown.numpy(), return_indices=True)
    index = torch.from_numpy(rows).long() * unknown.shape[-1] + torch.from_numpy(columns)
    return torch.from_numpy(away), index


def _membrane(values: Tensor, known: Tensor) -> Tensor:
    """Solve Laplace's equation where values (Nx1xHxW) are unknown: from coarse grids to fine ones,
    each a few sweeps better. The picture's border is free.
    """
    levels = []
    while not bool(known.all()):
        levels.append((values, known))
        values, known = _halved(values, known)
    guess = values
    for values, known in reversed(levels):
        guess = _finer(guess, values, known)
    return guess


def _finer(guess: Tensor, values: Tensor, known: Tensor) -> Tensor:
    """A guess on twice as many rows and columns, a few sweeps better."""
    height, width = values.shape[-2:]
    guess = F.interpolate(guess, scale_factor=2, mode="bilinear", align_corners=False)
    guess = torch.where(known, values, guess[..., :height, :width])
    for _ in range(_SWEEPS):
        guess = torch.where(known, values, _mean_of_neighbours(guess))
    return guess


def _halved(values: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
    """Half as many rows and columns: means of what is known; unknown values must be 0."""
    height, width = values.shape[-2:]
    rim = (0, width % 2, 0, height % 2)
    share = F.avg_pool2d(F.pad(known.to(values.dtype), rim), 2)
    total = F.avg_pool2d(F.pad(values, rim), 2)
    return total / share.clamp(min=0.25), share > 0


def _mean_of_neighbours(values: Tensor) -> Tensor:
    padded = F.pad(values, (1, 1, 1, 1), mode="replicate")
    above, below = padded[..., :-2, 1:-1], padded[..., 2:, 1:-1]
    left, right = padded[..., 1:-1, :-2], padded[..., 1:-1, 2:]
    return (above + below + left + right) / 4


def warn_of_unknown(share: float) -> None:
    """Warn if so large a share of a map is guessed; once in a process: a loader fills thousands."""
    if share > _MANY and not _warned:
        percent = round(100 * share)
        guess = f"distance is unknown at {percent} % of a map's pixels, and is guessed there"
        cure = "maps of depth cameras want unknown='behind', or 'far' for open water"
        warnings.warn(f"{guess}: {cure}", UserWarning, stacklevel=3)
        _warned.append(percent)
