"""`fit_veil`: the veil of a picture without its clean twin, from what is darkest at a distance."""

from collections.abc import Sequence
from typing import Any, NamedTuple, get_args

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import Array, ColorSpace
from uwaug.fitting.inputs import Pictures, distances_apart, pairs_of, require_pixels
from uwaug.fitting.pixels import Pair, reference_distance, tiles
from uwaug.fitting.threads import one_thread
from uwaug.fitting.veil_result import VeilFit, veil_found
from uwaug.formation.colour import LUMINANCE
from uwaug.optics.curves import FARTHEST

__all__ = ["fit_veil"]

_STAND_IN = 0.9
"""For the clean picture, which is not looked at."""

_NEAR, _FAR = 0.005, 0.995
"""Quantiles of the finite distances, between which the bins lie."""

_FEWEST = 50
"""Pixels of a bin that is looked at."""

_LEAST = 10
"""Dark pixels that are taken from a bin."""

_BINS = 3
"""Bins that a fit needs."""

_MOST = 3000
"""Dark pixels that are fitted."""

_TILES = 10
"""Blocks along the picture's short side, that errors go by."""

_ABOVE = 0.3
"""What residuals above the curve count: surfaces may be brighter than black, none is darker. With 1
the veil is too high by half as much again where nothing is black, with .1 the noise draws it down.
"""

_WAYS = (0.1, 1.0)
"""Others that might be taken as well: by how much they differ is part of the error."""

_ROBUST = 0.02
"""Of the brightest dark pixels, from where on a residual counts less than its square."""

_STARTS = (0.1, 0.5, 2.0)
"""Optical depths G·z at the median distance, to begin at."""

_THINNEST, _THICKEST = 1e-4, 40.0
"""Bounds of these."""

_REPEATS = 60
"""Draws of blocks that errors are taken from."""


class Dark(NamedTuple):
    """N pixels that are nearly black without the veil.

    Attributes:
        z (N array): effective distance, m.
        light (Nx3 array): linear light.
        block (N array): the part of the picture that a pixel is from.
    """

    z: Array
    light: Array
    block: NDArray[np.int64]


def fit_veil(
    observed: Pictures,
    distance: Pictures,
    *,
    field: Pictures | None = None,
    mask: Pictures | None = None,
    color_space: ColorSpace = "srgb",
    bins: int = 10,
    share: float = 0.01,
    seed: int = 0,
) -> VeilFit:
    """Estimate a veil V·(1 − e^(−G z)) for each channel without a clean picture, from the darkest
    pixels at each distance: what light they show is the veil's, if their surfaces are black.

    In each of `bins` equal steps of distance those of least luminance are taken, by the mean of
    their 3×3 neighbours (single pixels would be chosen for their noise: V 7 to 60 % off instead of
    4 to 20 %), and of open water any. Residuals below the curve count more than those above.
    Sea-thru's second term, J'·e^(−β' z) for what dark surfaces reflect, is left out: pictures
    hardly tell it from the veil, and on five scenes V was twice as far off with it.

    Args:
        observed (3xHxW or Bx3xHxW tensor, or a sequence): the scene in the water; uint8 (0…255) or
            floating point (0…1). Several pictures are of one water.
        distance (1xHxW or Bx1xHxW tensor, or a sequence): metres along the ray; pixels that are
            NaN, 0 or negative are left out; +inf is open water.
        field (as distance): medium field, multiplies the distance.
        mask (as distance): true or > 0 where pixels count.
        color_space: "srgb", or "linear" for linear light. All numbers refer to linear light.
        bins: steps of distance, 3…100.
        share: of the pixels of each, that are taken for black, 0…0.5.
        seed: of draws.

    Returns:
        The veil, with errors over blocks of the picture: an estimate.

    Raises:
        TypeError, ValueError: if an input does not suit; if fewer than 500 pixels can be used,
            fewer than three steps hold enough of them, or the distances are all alike.

    Measured on five scenes, degraded in four waters with 1 % noise: the veil at a distance is .002
    to .004 off (RMS, linear light) where something is black at each of them, else up to .03 too
    high. V and G are up to 7 and 11 % off where the far end is veiled (G·z > 1.2) and something is
    black, up to 25 and 30 % if not quite. In clearer waters, where the veil's growth has hardly
    slowed, V may be 50 % off and G by a factor of 3. No real picture with a known veil was at hand.

    Source: Akkaynak and Treibitz, *Sea-thru*, CVPR 2019, section 4.3.

    Examples:
        >>> import torch, uwaug
        >>> clean, z = torch.rand(3, 60, 80) ** 4, torch.linspace(1, 9, 4800).reshape(1, 60, 80)
        >>> water = uwaug.Medium.from_coefficients((0.4,) * 3, (0.4,) * 3, (0.1, 0.3, 0.4))
        >>> found = uwaug.fitting.fit_veil(uwaug.Underwater(water)(clean, z), z)
        >>> found.veil.round(decimals=1).tolist()
        [0.1, 0.3, 0.4]
    """
    checks.one_of("color_space", color_space, get_args(ColorSpace))
    checks.within("bins", bins, _BINS, 100)
    checks.within("share", share, 1e-6, 0.5)
    pairs = pairs_of(_stand_in(observed), observed, distance, field, mask, color_space)
    require_pixels(pairs)
    distances_apart(pairs)
    rng = np.random.default_rng(seed)
    dark = _darkest(pairs, int(bins), share, rng)
    reference = reference_distance(pairs)
    everything = np.ones(len(dark.z))
    with one_thread():
        numbers = _channels(dark, reference, everything)
        repeats = [_channels(dark, reference, one, near=numbers) for one in _draws(dark, rng)]
        ways = [_channels(dark, reference, everything, above, numbers) for above in _WAYS]
    return veil_found(numbers, np.array(repeats), np.array(ways), _farthest(dark.z))


def _draws(dark: Dark, rng: np.random.Generator) -> list[Array]:
    """How often each pixel counts in each draw of blocks."""
    _, block = np.unique(dark.block, return_inverse=True)
    count = int(block.max()) + 1
    found = []
    for _ in range(_REPEATS):
        times = np.bincount(rng.integers(count, size=count), minlength=count)
        found.append(times[block].astype(np.float64))
    return found


def _channels(
    dark: Dark,
    reference: float,
    weights: Array,
    above: float = _ABOVE,
    near: Array | None = None,
) -> Array:
    """Source and G of each channel (3x2)."""
    rows = []
    for c in range(3):
        start = None if near is None else near[c]
        rows.append(_fitted(dark.z, dark.light[:, c], reference, weights, above, start))
    return np.array(rows)


def _stand_in(observed: Any) -> Pictures:
    """A clean picture where there is none, of the size of the observed ones."""
    first = observed
    if not isinstance(observed, Tensor) and isinstance(observed, Sequence) and observed:
        first = observed[0]
    if not isinstance(first, Tensor):
        checks.floating("observed", first)
    checks.picture("observed", first, 3)
    return torch.full((3, *first.shape[-2:]), _STAND_IN)


def _darkest(pairs: Sequence[Pair], bins: int, share: float, rng: np.random.Generator) -> Dark:
    """The darkest pixels of each step of distance, and any of open water."""
    all_pixels = _flattened(pairs)
    z, luminance = all_pixels.z, _luminance(pairs)
    finite = z < FARTHEST
    low, high = np.quantile(z[finite], (_NEAR, _FAR))
    step = np.floor((z - low) / max(high - low, 1e-9) * bins)
    taken = []
    for k in range(bins):
        inside = np.flatnonzero(finite & (step == k))
        if len(inside) >= _FEWEST:
            wanted = max(round(share * len(inside)), _LEAST)
            taken.append(inside[np.argpartition(luminance[inside], wanted)[:wanted]])
    if len(taken) < _BINS:
        got = f"only {len(taken)} of {bins} steps of distance hold {_FEWEST} pixels"
        raise ValueError(f"distance: {got}, expected {_BINS}: give fewer bins, or more pixels")
    open_water = rng.permutation(np.flatnonzero(~finite))
    taken.append(open_water[: max(len(one) for one in taken)])
    places = rng.permutation(np.concatenate(taken))[:_MOST]
    return Dark(z[places], all_pixels.light[places], all_pixels.block[places])


def _flattened(pairs: Sequence[Pair]) -> Dark:
    """The usable pixels of all pairs."""
    z, light, block = [], [], []
    for i, pair in enumerate(pairs):
        usable = pair.usable[0]
        z.append(pair.z[0][usable])
        light.append(pair.observed[:, usable].T)
        block.append(tiles(np.flatnonzero(usable.numpy()), i, pair.size, _TILES))
    return Dark(torch.cat(z).numpy(), torch.cat(light).numpy(), np.concatenate(block))


def _luminance(pairs: Sequence[Pair]) -> Array:
    """Of the usable pixels, over 3×3 neighbours."""
    found = []
    for pair in pairs:
        weights = torch.tensor(LUMINANCE, dtype=torch.float64)
        picture = torch.einsum("c,chw->hw", weights, pair.observed)[None, None]
        smooth = F.avg_pool2d(F.pad(picture, (1, 1, 1, 1), mode="replicate"), 3, 1)
        found.append(smooth[0, 0][pair.usable[0]])
    return np.asarray(torch.cat(found).numpy())


def _fitted(
    z: Array, light: Array, reference: float, weights: Array, above: float, near: Array | None
) -> Array:
    """Growth at the lens, 1/m, and G of a channel: the best from several starts, or from `near`."""
    from scipy.optimize import least_squares

    scale = max(_ROBUST * float(np.quantile(light, 0.95)), 1e-9)

    def residual(numbers: Array) -> Array:
        error = (light - _veil(numbers[0], numbers[1], z)) / scale
        return np.asarray(np.sqrt(weights * np.where(error > 0, above, 1.0)) * error)

    starts = [] if near is None else [near]
    for depth in _STARTS if near is None else ():
        growth = _veil(1.0, depth / reference, z)
        starts.append(np.array([growth @ light / (growth @ growth), depth / reference]))
    low = np.array([0.0, _THINNEST / reference])
    high = np.array([np.inf, _THICKEST / reference])
    best: Any = None
    for start in starts:
        begin = np.clip(start, low * 1.001 + 1e-12, high * 0.999)
        found = least_squares(
            residual, begin, bounds=(low, high), x_scale=np.maximum(begin, 1e-6), loss="soft_l1"
        )
        if best is None or found.cost < best.cost:
            best = found
    return np.asarray(best.x)


def _veil(source: float, G: float, z: Array) -> Array:
    return np.asarray(source * -np.expm1(-G * z) / G)


def _farthest(z: Array) -> float:
    """The distance that the veil is seen to, m: infinity if there is open water."""
    return float(np.inf) if (z >= FARTHEST).mean() > 0.01 else float(np.quantile(z, 0.95))
