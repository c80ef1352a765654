"""`fit_veil`: the veil of a picture without its clean twin, from what is darkest at a distance."""

from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support import checks
from uwaug._support.threads import one_thread
from uwaug._support.types import Array, ColorSpace
from uwaug.fitting.data import Pictures, Places, blocks_of
from uwaug.fitting.errors import parameter, sandwich
from uwaug.fitting.model import COLOURS, MAX_OPTICAL_DEPTH, Quantity
from uwaug.fitting.result import THIN, Fit, straight_line, unknown
from uwaug.fitting.solve import ROBUST, influence
from uwaug.formation.colour import LUMINANCE
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium

_NEAR, _FAR = 0.005, 0.995  # quantiles of the finite distances, between which the bins lie
_BINS = 10  # equal steps of distance
_DARK_SHARE = 0.01  # of the pixels of each, that are taken for black
_MIN_PIXELS = 50  # pixels of a bin that is looked at
_MIN_DARK = 10  # dark pixels that are taken from a bin
_MIN_BINS = 3  # bins that a fit needs
_MAX_DARK = 3000  # dark pixels that are fitted
# What residuals above the curve count: surfaces may be brighter than black, none is darker. With 1
# the veil is too high by half as much again where nothing is black, with .1 the noise draws it
# down.
_ABOVE = 0.3
# What dark surfaces may reflect, if nobody knows better; no real scene's are blacker than .03. By
# how much veil, G and source would then be others is one standard error.
_DARKEST = 0.05
_ROBUST = 0.02  # of the brightest dark pixels, from where on a residual counts less than its square
_STARTS = (0.1, 0.5, 2.0)  # optical depths G·z at the median distance, to begin at
_THINNEST = 1e-4  # least of these
_ONE_COLOUR = 1e-3  # of the brightest light: any less variation is none
_KINDS = {"veil": "1", "G": "1/m", "source": "1/m"}  # what is reported, with its unit
_RESOLUTION = 1e-6  # light may be of any unit here, so that any change may show
# Optical depth G·z at the near end, above which less than a third of the growth is left to be seen.
# With surfaces that reflect .05 to .5 everywhere the bundled scene comes to 1.2 to 22.
_FULL_GROWN = 1.2


class Dark(NamedTuple):
    """N pixels that are nearly black without the veil.

    Attributes:
        z (N array): m.
        light (Nx3 array): linear light.
        blocks (N array): the block of the picture that a pixel is from.
    """

    z: Array
    light: Array
    blocks: Places


def fit_veil(
    observed: Tensor,
    distance: Tensor,
    *,
    darkest: float = _DARKEST,
    color_space: ColorSpace = "srgb",
    seed: int = 0,
) -> Fit:
    """Estimate a veil V(0)·(1 − e^(−Gz)) for each channel without a clean picture, from the darkest
    pixels at each distance: what light they show is the veil's, if their surfaces are black.

    In each of ten equal steps of distance those of least luminance are taken, by the mean of their
    3×3 neighbours (single pixels would be chosen for their noise: V 7 to 60 % off instead of 4 to
    20 %), and of open water any. Residuals below the curve count more than those above. Sea-thru's
    second term, J'·e^(−β' z) for what dark surfaces reflect, is left out: pictures hardly tell it
    from the veil, and on five scenes V was twice as far off with it.

    Args:
        observed, distance, color_space: as of `uwaug.fit`; several pictures are of one water.
        darkest: what the darkest surfaces at each distance may reflect, 1 = white. It counts as
            veil, and how far that may be wrong is part of the errors. 0 if some of them are known
            to be black, such as deep shadows or a target.
        seed: of the pixels that are drawn.

    Returns:
        The fit: veil, V(0), G and source, G·V(0), of each channel. It is an estimate. Its medium
        has β = G, which pictures without a clean one do not tell; `medium.backscatter` is known
        where V(0) and G are not, as far as the picture reaches.

    Raises:
        TypeError, ValueError: if an input does not suit; if fewer than 500 pixels can be used,
            fewer than three steps hold enough of them, the distances are all alike, or the picture
            is of one colour.

    Measured on five scenes, degraded in four waters with 1 % noise: the veil at a distance is .002
    to .004 off (RMS, linear light) where something is black at each of them, else up to .03 too
    high. No real picture with a known veil was at hand.

    Source: Akkaynak and Treibitz, *Sea-thru*, CVPR 2019, section 4.3.

    Examples:
        >>> import torch, uwaug
        >>> clean, z = torch.rand(3, 60, 80) ** 4, torch.linspace(1, 9, 4800).reshape(1, 60, 80)
        >>> water = uwaug.Medium.from_coefficients((0.4,) * 3, (0.4,) * 3, (0.1, 0.3, 0.4))
        >>> fit = uwaug.fitting.fit_veil(uwaug.Underwater(water)(clean, z), z, darkest=0)
        >>> [round(fit.parameters[f"veil_{colour}"].value, 1) for colour in ("red", "blue")]
        [0.1, 0.4]
    """
    checks.within("seed", seed, 0)
    checks.within("darkest", darkest, 0.0, 1.0)
    pictures = Pictures.of(None, observed, distance, color_space)
    dark = _darkest(pictures, np.random.default_rng(seed))
    reference = pictures.geometry.reference
    # the distances that the veil is seen from and to
    nearest, farthest = np.quantile(dark.z, (0.05, 0.95)).tolist()
    if (dark.z >= FARTHEST).mean() > 0.01:
        farthest = np.inf
    theta, rows, full_grown, covariance = np.zeros((3, 2)), {}, [], np.zeros((9, 9))
    # a medium that is made in inference mode could not be trained
    with one_thread(), torch.inference_mode(False), torch.no_grad():
        for c, colour in enumerate(COLOURS):
            theta[c] = source, G = _fit(dark, c, reference)
            slopes = np.array([[1 / G, -source / G**2], [0.0, 1.0], [1.0, 0.0]])
            values = _quantities(theta[c])
            moved = _quantities(_fit(dark, c, reference, floor=darkest)) - values
            # the errors of pixels, and what surfaces that are not black would change
            spread = slopes @ _covariance(dark, c, theta[c]) @ slopes.T + np.outer(moved, moved)
            places = [c, 3 + c, 6 + c]
            covariance[np.ix_(places, places)] = spread
            if G * nearest > _FULL_GROWN:  # its end alone shows, if it is that of the water
                full_grown.append(colour)
                shows = {"veil": bool(np.isinf(farthest)), "G": False, "source": False}
            else:  # of a straight line its growth alone
                bent = bool(G * farthest >= THIN)
                shows = {"veil": bent, "G": bent, "source": True}
            errors = np.sqrt(np.diag(spread)).tolist()
            for kind, value, error in zip(_KINDS, values.tolist(), errors, strict=True):
                quantity = Quantity(f"{kind}_{colour}", _KINDS[kind], _RESOLUTION, "")
                rows[quantity.name] = parameter(quantity, value, error, shows=shows[kind])
    numbers = {f"{kind}_{c}": rows[f"{kind}_{c}"] for kind in _KINDS for c in COLOURS}
    source, G = theta.T
    residual = dark.light - np.stack([_veil(s, rate, dark.z) for s, rate in theta], 1)
    notes = [
        "An estimate: the darkest pixels at each distance are taken for black. What their surfaces "
        f"reflect counts as veil; errors are for up to {darkest:.2g} of white (darkest)."
    ]
    if full_grown:
        notes.append(
            f"In {', '.join(full_grown)} what is darkest is as light at {nearest:.3g} m as farther "
            "away: the water is very turbid, or nothing in view is black and V(0) is too high."
        )
    notes += straight_line(dict(zip(COLOURS, G.tolist(), strict=True)), farthest)
    return Fit(
        model="darkest pixels",
        parameters=numbers,
        covariance=covariance,
        medium=Medium.from_coefficients(*map(torch.from_numpy, (G, G, source / G))),
        geometry=pictures.geometry,
        rms=float(np.sqrt((residual**2).mean())),
        notes=(*notes, *unknown(numbers)),
        color_space=color_space,
        pictures=pictures,
    )


def _darkest(pictures: Pictures, rng: np.random.Generator) -> Dark:
    """The darkest pixels of each step of distance, and any of open water."""
    weights = torch.tensor(LUMINANCE, dtype=torch.float64).reshape(3, 1, 1)
    grey = (weights * pictures.observed).sum(1, keepdim=True)
    grey = F.avg_pool2d(F.pad(grey, (1, 1, 1, 1), mode="replicate"), 3, 1)
    used = pictures.usable[:, 0]
    luminance, z = grey[:, 0][used].numpy(), pictures.z[:, 0][used].numpy()
    light = pictures.observed.movedim(1, -1)[used].numpy()
    places = [np.flatnonzero(mask.numpy()) for mask in used]
    blocks = blocks_of(places, pictures.geometry.size)
    if float(np.ptp(light, 0).max()) <= _ONE_COLOUR * float(light.max()):
        raise ValueError("observed is of one colour everywhere, which tells nothing of the water")
    finite = z < FARTHEST
    low, high = np.quantile(z[finite], (_NEAR, _FAR))
    step = np.floor((z - low) / max(high - low, 1e-9) * _BINS)
    darkest = []
    for k in range(_BINS):
        inside = np.flatnonzero(finite & (step == k))
        if len(inside) >= _MIN_PIXELS:
            count = max(round(_DARK_SHARE * len(inside)), _MIN_DARK)
            darkest.append(inside[np.argpartition(luminance[inside], count)[:count]])
    if len(darkest) < _MIN_BINS:
        few = f"only {len(darkest)} of {_BINS} steps of distance hold {_MIN_PIXELS} pixels"
        raise ValueError(f"distance: {few}, expected {_MIN_BINS}: give larger pictures")
    sea = rng.permutation(np.flatnonzero(~finite))
    darkest.append(sea[: max(len(chosen) for chosen in darkest)])
    drawn = rng.permutation(np.concatenate(darkest))[:_MAX_DARK]
    return Dark(z[drawn], light[drawn], blocks[drawn])


def _fit(dark: Dark, channel: int, reference: float, floor: float = 0.0) -> Array:
    """Growth at the lens, 1/m, and G of a channel: the best from several starts. What is dark
    reflects `floor`, which fades as the veil grows.
    """
    from scipy.optimize import least_squares

    light = dark.light[:, channel]
    low = np.array([0.0, _THINNEST / reference])
    high = np.array([np.inf, MAX_OPTICAL_DEPTH / reference])
    ends = []
    for depth in _STARTS:
        growth = _veil(1.0, depth / reference, dark.z)
        start = np.array([growth @ light / (growth @ growth), depth / reference])
        start = np.clip(start, low * 1.001 + 1e-12, high * 0.999)
        end = least_squares(
            lambda theta: _residual(theta, dark, channel, floor),
            start,
            bounds=(low, high),
            x_scale=np.maximum(start, 1e-6),
            loss="soft_l1",
            f_scale=ROBUST,
        )
        ends.append(end)
    return np.asarray(min(ends, key=lambda end: end.cost).x)


def _residual(theta: Array, dark: Dark, channel: int, floor: float = 0.0) -> Array:
    """Observed − veil, in units of which `ROBUST` begin to count less; above the curve, less."""
    light = dark.light[:, channel]
    scale = max(_ROBUST * float(np.quantile(light, 0.95)), 1e-9) / ROBUST
    error = (light - _veil(theta[0], theta[1], dark.z) - floor * np.exp(-theta[1] * dark.z)) / scale
    return np.asarray(np.sqrt(np.where(error > 0, _ABOVE, 1.0)) * error)


def _covariance(dark: Dark, channel: int, theta: Array) -> Array:
    """Of source and G, over blocks of the pictures."""
    step = 1e-5 * theta
    up, down = (theta + sign * np.diag(step) for sign in (1, -1))
    jacobian = np.stack(
        [
            (_residual(a, dark, channel) - _residual(b, dark, channel)) / (2 * h)
            for a, b, h in zip(up, down, step, strict=True)
        ],
        1,
    )
    return sandwich(jacobian, *influence(_residual(theta, dark, channel)), dark.blocks).matrix


def _quantities(theta: Array) -> Array:
    """Veil, G and source, of source and G."""
    source, G = theta
    return np.array([source / G, G, source])


def _veil(source: float, G: float, z: Array) -> Array:
    return np.asarray(source * -np.expm1(-G * z) / G)
