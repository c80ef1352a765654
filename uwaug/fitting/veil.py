"""`fit_veil`: the veil of a picture without its clean twin, from what is darkest at a distance."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from uwaug._support import checks
from uwaug._support.types import Array, ColorSpace
from uwaug.fitting.data import Observations, Pair, Pictures, cluster_of, mean_3x3
from uwaug.fitting.diagnosis import full_grown, of_veil, straight
from uwaug.fitting.errors import parameter
from uwaug.fitting.least_squares import one_thread
from uwaug.fitting.models import COLOURS, MAX_OPTICAL_DEPTH, Quantity
from uwaug.fitting.results import VeilFit
from uwaug.formation.colour import LUMINANCE
from uwaug.optics.curves import FARTHEST

_NEAR, _FAR = 0.005, 0.995  # quantiles of the finite distances, between which the bins lie
_BINS = 10  # equal steps of distance
_SHARE = 0.01  # of the pixels of each, that are taken for black
_MIN_PIXELS = 50  # pixels of a bin that is looked at
_MIN_DARK = 10  # dark pixels that are taken from a bin
_MIN_BINS = 3  # bins that a fit needs
_MAX_DARK = 3000  # dark pixels that are fitted
_CLUSTERS = 10  # blocks along the picture's short side, that errors go by
# What residuals above the curve count: surfaces may be brighter than black, none is darker. With 1
# the veil is too high by half as much again where nothing is black, with .1 the noise draws it
# down.
_ABOVE = 0.3
# Others that might be taken as well: by how much they differ is part of the error.
_OTHER_ABOVE = (0.1, 1.0)
# What dark surfaces may reflect, if nobody knows better; no real scene's are blacker than .03. By
# how much veil, G and source would then be others is one standard error.
_DARKEST = 0.05
_ROBUST = 0.02  # of the brightest dark pixels, from where on a residual counts less than its square
_STARTS = (0.1, 0.5, 2.0)  # optical depths G·z at the median distance, to begin at
_THINNEST = 1e-4  # least of these
_REPEATS = 60  # draws of clusters that errors are taken from
_ONE_COLOUR = 1e-3  # of the brightest light: any less variation is none
_RESOLUTION = 1e-6  # light may be of any unit here, so that any change may show


class Dark(NamedTuple):
    """N pixels that are nearly black without the veil.

    Attributes:
        z (N array): effective distance, m.
        light (Nx3 array): linear light.
        cluster (N array): the part of the picture that a pixel is from.
    """

    z: Array
    light: Array
    cluster: NDArray[np.int64]


def fit_veil(
    observed: Pictures,
    distance: Pictures,
    *,
    field: Pictures | None = None,
    mask: Pictures | None = None,
    color_space: ColorSpace = "srgb",
    darkest: float = _DARKEST,
    seed: int = 0,
) -> VeilFit:
    """Estimate a veil V·(1 − e^(−G z)) for each channel without a clean picture, from the darkest
    pixels at each distance: what light they show is the veil's, if their surfaces are black.

    In each of ten equal steps of distance those of least luminance are taken, by the mean of
    their 3×3 neighbours (single pixels would be chosen for their noise: V 7 to 60 % off instead of
    4 to 20 %), and of open water any. Residuals below the curve count more than those above.
    Sea-thru's second term, J'·e^(−β' z) for what dark surfaces reflect, is left out: pictures
    hardly tell it from the veil, and on five scenes V was twice as far off with it.

    Args:
        observed, distance, field, mask, color_space: as of `uwaug.fit`; several pictures are of one
            water.
        darkest: what the darkest surfaces at each distance may reflect, 1 = white. It counts as
            veil, and how far that may be wrong is part of the errors. 0 if some of them are known
            to be black, such as deep shadows or a target.
        seed: of draws.

    Returns:
        The veil, with errors over clusters of pixels and of what dark surfaces reflect: an
        estimate.

    Raises:
        TypeError, ValueError: if an input does not suit; if fewer than 500 pixels can be used,
            fewer than three steps hold enough of them, the distances are all alike, or the picture
            is of one colour.

    Measured on five scenes, degraded in four waters with 1 % noise: the veil at a distance is .002
    to .004 off (RMS, linear light) where something is black at each of them, else up to .03 too
    high. V and G are up to 7 and 11 % off where the far end is veiled (G·z > 1.2) and something is
    black. Where nothing is (reflectances of the bundled scene raised by .05 to .2), G alone would
    be 30 to 300 % too large: it is not identified, nor is V unless open water is in view. No real
    picture with a known veil was at hand.

    Source: Akkaynak and Treibitz, *Sea-thru*, CVPR 2019, section 4.3.

    Examples:
        >>> import torch, uwaug
        >>> clean, z = torch.rand(3, 60, 80) ** 4, torch.linspace(1, 9, 4800).reshape(1, 60, 80)
        >>> water = uwaug.Medium.from_coefficients((0.4,) * 3, (0.4,) * 3, (0.1, 0.3, 0.4))
        >>> fit = uwaug.fitting.fit_veil(uwaug.Underwater(water)(clean, z), z, darkest=0)
        >>> fit.veil.round(decimals=1).tolist()
        [0.1, 0.3, 0.4]
    """
    checks.within("seed", seed, 0)
    checks.within("darkest", darkest, 0.0, 1.0)
    observations = Observations.of(None, observed, distance, field, mask, color_space)
    rng = np.random.default_rng(seed)
    dark = _darkest(observations.pairs, rng)
    reference, everything = observations.reference, np.ones(len(dark.z))
    with one_thread():
        theta = _fit(dark, reference, everything)
        draws = [_fit(dark, reference, w, near=theta) for w in _bootstrap(dark, rng)]
        others = [_fit(dark, reference, everything, above, theta) for above in _OTHER_ABOVE]
        grey = _fit(dark, reference, everything, near=theta, floor=darkest)
    # the distances that the veil is seen from and to
    nearest = float(np.quantile(dark.z, 0.05))
    sea = (dark.z >= FARTHEST).mean() > 0.01
    farthest = np.inf if sea else float(np.quantile(dark.z, 0.95))
    return _reported(
        dark, theta, np.array(draws), np.array(others), grey, (nearest, farthest), darkest
    )


def _reported(
    dark: Dark,
    theta: Array,
    draws: Array,
    others: Array,
    grey: Array,
    seen: tuple[float, float],
    darkest: float,
) -> VeilFit:
    """What is reported of source and G of each channel (3x2), of those of draws of clusters, of
    those of other ways to count what lies above the curve, and of those if nothing is black; `seen`
    from and to, m.
    """
    nearest, farthest = seen
    values, spread, ways = _quantities(theta), _quantities(draws), _quantities(others)
    if_grey = _quantities(grey)
    parameters = {}
    for kind, value in values.items():
        error = np.hypot(spread[kind].std(0), 0.5 * np.ptp(ways[kind], 0))
        error = np.hypot(error, if_grey[kind] - value)
        for c, colour in enumerate(COLOURS):
            unit = "1" if kind == "veil" else "1/m"
            quantity = Quantity(f"{kind}_{colour}", unit, _RESOLUTION, ())
            if full_grown(theta[c, 1], nearest):  # its end alone shows, if it is that of the water
                shows = kind == "veil" and np.isinf(farthest)
            else:  # of a straight line its growth alone
                shows = kind == "source" or not straight(theta[c, 1], farthest)
            parameters[quantity.name] = parameter(quantity, value[c], error[c], shows=shows)
    apart = 0.5 * np.ptp(others.reshape(len(others), 6), 0)
    moved = (grey - theta).flatten()
    residual = np.stack([_veil(source, G, dark.z) for source, G in theta], 1) - dark.light
    return VeilFit(
        parameters=parameters,
        candidates=(),
        message="\n".join(of_veil(parameters, theta[:, 1].tolist(), nearest, farthest, darkest)),
        noise=None,
        rms=float(np.sqrt((residual**2).mean())),
        theta=theta.flatten(),
        covariance=np.cov(draws.reshape(len(draws), 6).T, ddof=0)
        + np.diag(apart**2)
        + np.outer(moved, moved),
        farthest=farthest,
    )


def _quantities(numbers: Array) -> dict[str, Array]:
    """What is reported, by kind, from source and G in the last place."""
    source, G = numbers[..., 0], numbers[..., 1]
    return {"veil": source / G, "G": G, "source": source}


def _darkest(pairs: Sequence[Pair], rng: np.random.Generator) -> Dark:
    """The darkest pixels of each step of distance, and any of open water."""
    weights = torch.tensor(LUMINANCE, dtype=torch.float64)
    grey = [mean_3x3(torch.einsum("c,chw->hw", weights, pair.observed)[None]) for pair in pairs]
    luminance = torch.cat([x[pair.usable] for x, pair in zip(grey, pairs, strict=True)]).numpy()
    z = torch.cat([pair.z[0][pair.usable[0]] for pair in pairs]).numpy()
    light = torch.cat([pair.observed[:, pair.usable[0]].T for pair in pairs]).numpy()
    clusters = np.concatenate(
        [
            cluster_of(np.flatnonzero(pair.usable.numpy()), i, pair.size, _CLUSTERS)
            for i, pair in enumerate(pairs)
        ]
    )
    if float(np.ptp(light, 0).max()) <= _ONE_COLOUR * float(light.max()):
        raise ValueError("observed is of one colour everywhere, which tells nothing of the water")
    finite = z < FARTHEST
    low, high = np.quantile(z[finite], (_NEAR, _FAR))
    step = np.floor((z - low) / max(high - low, 1e-9) * _BINS)
    darkest = []
    for k in range(_BINS):
        inside = np.flatnonzero(finite & (step == k))
        if len(inside) >= _MIN_PIXELS:
            count = max(round(_SHARE * len(inside)), _MIN_DARK)
            darkest.append(inside[np.argpartition(luminance[inside], count)[:count]])
    if len(darkest) < _MIN_BINS:
        few = f"only {len(darkest)} of {_BINS} steps of distance hold {_MIN_PIXELS} pixels"
        raise ValueError(f"distance: {few}, expected {_MIN_BINS}: give larger pictures")
    sea = rng.permutation(np.flatnonzero(~finite))
    darkest.append(sea[: max(len(places) for places in darkest)])
    places = rng.permutation(np.concatenate(darkest))[:_MAX_DARK]
    return Dark(z[places], light[places], clusters[places])


def _bootstrap(dark: Dark, rng: np.random.Generator) -> list[Array]:
    """How often each pixel counts in each draw of clusters."""
    _, cluster = np.unique(dark.cluster, return_inverse=True)
    count = int(cluster.max()) + 1
    draws = [rng.integers(count, size=count) for _ in range(_REPEATS)]
    return [np.bincount(draw, minlength=count)[cluster].astype(np.float64) for draw in draws]


def _fit(
    dark: Dark,
    reference: float,
    weights: Array,
    above: float = _ABOVE,
    near: Array | None = None,
    floor: float = 0.0,
) -> Array:
    """Growth at the lens, 1/m, and G of each channel (3x2): the best from several starts, or from
    `near`. What is dark reflects `floor`, which fades as the veil grows.
    """
    from scipy.optimize import least_squares

    low = np.array([0.0, _THINNEST / reference])
    high = np.array([np.inf, MAX_OPTICAL_DEPTH / reference])
    rows = []
    for c, light in enumerate(dark.light.T):
        scale = max(_ROBUST * float(np.quantile(light, 0.95)), 1e-9)

        def residual(numbers: Array, light: Array = light, scale: float = scale) -> Array:
            seen = _veil(numbers[0], numbers[1], dark.z) + floor * np.exp(-numbers[1] * dark.z)
            error = (light - seen) / scale
            return np.asarray(np.sqrt(weights * np.where(error > 0, above, 1.0)) * error)

        starts = [] if near is None else [near[c]]
        for depth in _STARTS if near is None else ():
            growth = _veil(1.0, depth / reference, dark.z)
            starts.append(np.array([growth @ light / (growth @ growth), depth / reference]))
        ends = []
        for start in starts:
            begin = np.clip(start, low * 1.001 + 1e-12, high * 0.999)
            size = np.maximum(begin, 1e-6)
            ends.append(
                least_squares(residual, begin, bounds=(low, high), x_scale=size, loss="soft_l1")
            )
        rows.append(min(ends, key=lambda end: end.cost).x)
    return np.array(rows)


def _veil(source: float, G: float, z: Array) -> Array:
    return np.asarray(source * -np.expm1(-G * z) / G)
