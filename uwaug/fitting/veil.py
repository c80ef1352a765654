"""`fit_veil`: the veil of a picture without a clean one, from its darkest pixels."""

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
from uwaug.fitting.result import THIN_OPTICAL_DEPTH, Fit, straight_line, unknown
from uwaug.fitting.solve import ROBUST, influence
from uwaug.formation.colour import LUMINANCE
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium

_NEAR_QUANTILE, _FAR_QUANTILE = 0.005, 0.995  # of the finite distances: the ends of the bins
_BINS = 10  # equal steps of distance
_DARK_SHARE = 0.01  # of the pixels of a bin, taken for black
_MIN_PIXELS = 50  # pixels that a bin needs
_MIN_DARK = 10  # least number of dark pixels of a bin
_MIN_BINS = 3  # bins that a fit needs
_MAX_DARK = 3000  # dark pixels of a fit
# Weight of residuals above the curve, as surfaces may be brighter than black and none is darker.
# With 1 the veil is too high by half as much again where nothing is black. With .1 noise draws it
# down.
_ABOVE_WEIGHT = 0.3
# Default of what dark surfaces may reflect; no real scene's are blacker than .03. The change of a
# number by it is one standard error.
_DARKEST = 0.05
_ROBUST_SHARE = 0.02  # of the brightest dark pixels; larger residuals count less than their square
_START_OPTICAL_DEPTHS = (0.1, 0.5, 2.0)  # G·z at the median distance
_MIN_OPTICAL_DEPTH = 1e-4  # G·z at the median distance
_ONE_COLOUR = 1e-3  # variation, as a share of the brightest light, below which there is none
_KINDS = {"veil": "1", "G": "1/m", "source": "1/m"}  # units of the reported numbers
_RESOLUTION = 1e-6  # light may have any scale here, so any change may show
# Optical depth G·z at the near end, above which less than a third of the growth shows. With
# surfaces that reflect .05 to .5 everywhere the bundled scene comes to 1.2 to 22.
_FULL_GROWN = 1.2


class Dark(NamedTuple):
    """N pixels that are nearly black without the veil.

    Attributes:
        z (N array): m.
        light (Nx3 array): linear light.
        blocks (N array): number of the block of the picture that a pixel is from.
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
    pixels at each distance: if their surfaces are black, all their light is the veil's.

    In each of ten equal steps of distance the pixels of least luminance are taken, by the mean of
    3×3 neighbours; in open water, any. Single pixels would be chosen for their noise, and V was
    then 7 to 60 % off instead of 4 to 20 %. Residuals below the curve count more than those above.
    Sea-thru's second term, J'·e^(−β' z) for the light of dark surfaces, is left out: pictures
    hardly tell it from the veil, and on five scenes V was twice as far off with it.

    Args:
        observed, distance, color_space: as of `uwaug.fit`; several pictures are of one water.
        darkest: share of light that the darkest surfaces at each distance may reflect, 0…1. It
            counts as veil, and the error this may cause is part of the errors. 0 if some surfaces
            are known to be black, such as deep shadows or a target.
        seed: seed of the choice of pixels.

    Returns:
        The fit, an estimate: veil V(0), G and source G·V(0) of each channel. Its medium has β = G,
        as pictures without a clean one do not tell β. Where V(0) and G are not identified,
        `medium.backscatter` still is, as far as the picture reaches.

    Raises:
        TypeError, ValueError: if an input does not suit; if fewer than 50 pixels can be used,
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
    nearest, farthest = np.quantile(dark.z, (0.05, 0.95)).tolist()
    if (dark.z >= FARTHEST).mean() > 0.01:
        farthest = np.inf
    theta, rows, full_grown, covariance = np.zeros((3, 2)), {}, [], np.zeros((9, 9))
    # names of numbers that black surfaces, or more pixels, would tell
    if_black: list[str] = []
    if_more: list[str] = []
    # a medium that is made in inference mode could not be trained
    with one_thread(), torch.inference_mode(False), torch.no_grad():
        for c, colour in enumerate(COLOURS):
            theta[c] = source, G = _fit(dark, c, reference)
            slopes = np.array([[1 / G, -source / G**2], [0.0, 1.0], [1.0, 0.0]])
            values = _quantities(theta[c])
            bias = _quantities(_fit(dark, c, reference, floor=darkest)) - values
            # the errors of pixels, and the change by surfaces that are not black
            of_pixels = slopes @ _covariance(dark, c, theta[c]) @ slopes.T
            spread = of_pixels + np.outer(bias, bias)
            places = [c, 3 + c, 6 + c]
            covariance[np.ix_(places, places)] = spread
            if G * nearest > _FULL_GROWN:  # its end alone shows, if it is that of the water
                full_grown.append(colour)
                shows = {"veil": bool(np.isinf(farthest)), "G": False, "source": False}
            else:  # of a straight line its growth alone
                is_bent = bool(G * farthest >= THIN_OPTICAL_DEPTH)
                shows = {"veil": is_bent, "G": is_bent, "source": True}
            errors = [np.sqrt(np.diag(matrix)).tolist() for matrix in (spread, of_pixels)]
            for kind, value, error, least in zip(_KINDS, values.tolist(), *errors, strict=True):
                quantity = Quantity(f"{kind}_{colour}", _KINDS[kind], _RESOLUTION, "")
                number = parameter(quantity, value, error, shows=shows[kind])
                if number.value is None and shows[kind]:
                    is_told = parameter(quantity, value, least).value is not None
                    (if_black if is_told else if_more).append(quantity.name)
                rows[quantity.name] = number
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
            "away: the water is very turbid, or nothing in view is black and V(0) is too high. "
            f"Something black nearer than {nearest:.3g} m would tell."
        )
    if straight := straight_line(dict(zip(COLOURS, G.tolist(), strict=True)), farthest):
        notes += [f"{straight[0]} Open water in view (distance inf) would tell its end."]
    if if_black:
        cure = "Something black at each distance, such as deep shadow, and darkest=0 (--darkest 0)"
        notes.append(f"{cure} would tell {', '.join(if_black)}.")
    if if_more:
        cure = "Dark surfaces nearer and farther, or more pictures of this water,"
        notes.append(f"{cure} would tell {', '.join(if_more)}.")
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
    """The darkest pixels of each step of distance, and random pixels of open water."""
    weights = torch.tensor(LUMINANCE, dtype=torch.float64).reshape(3, 1, 1)
    grey = (weights * pictures.observed).sum(1, keepdim=True)
    grey = F.avg_pool2d(F.pad(grey, (1, 1, 1, 1), mode="replicate"), 3, 1)
    usable = pictures.usable[:, 0]
    luminance, z = grey[:, 0][usable].numpy(), pictures.z[:, 0][usable].numpy()
    light = pictures.observed.movedim(1, -1)[usable].numpy()
    places = [np.flatnonzero(mask.numpy()) for mask in usable]
    blocks = blocks_of(places, pictures.geometry.size)
    if float(np.ptp(light, 0).max()) <= _ONE_COLOUR * float(light.max()):
        raise ValueError("observed is of one colour everywhere, which tells nothing of the water")
    finite = z < FARTHEST
    low, high = np.quantile(z[finite], (_NEAR_QUANTILE, _FAR_QUANTILE))
    bins = np.floor((z - low) / max(high - low, 1e-9) * _BINS)
    darkest = []
    for k in range(_BINS):
        pixels = np.flatnonzero(finite & (bins == k))
        if len(pixels) >= _MIN_PIXELS:
            count = max(round(_DARK_SHARE * len(pixels)), _MIN_DARK)
            darkest.append(pixels[np.argpartition(luminance[pixels], count)[:count]])
    if len(darkest) < _MIN_BINS:
        got = f"only {len(darkest)} of {_BINS} steps of distance hold {_MIN_PIXELS} pixels"
        raise ValueError(f"distance: {got}, expected {_MIN_BINS}: give larger pictures")
    open_water = rng.permutation(np.flatnonzero(~finite))
    darkest.append(open_water[: max(map(len, darkest))])
    sample = rng.permutation(np.concatenate(darkest))[:_MAX_DARK]
    return Dark(z[sample], light[sample], blocks[sample])


def _fit(dark: Dark, channel: int, reference: float, floor: float = 0.0) -> Array:
    """Source and G of a channel, 1/m: the best from several starts. Dark surfaces reflect `floor`,
    which fades as the veil grows.
    """
    from scipy.optimize import least_squares

    light = dark.light[:, channel]
    low = np.array([0.0, _MIN_OPTICAL_DEPTH / reference])
    high = np.array([np.inf, MAX_OPTICAL_DEPTH / reference])
    ends = []
    for depth in _START_OPTICAL_DEPTHS:
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
    light, (source, G) = dark.light[:, channel], theta
    scale = max(_ROBUST_SHARE * float(np.quantile(light, 0.95)), 1e-9) / ROBUST
    error = (light - _veil(source, G, dark.z) - floor * np.exp(-G * dark.z)) / scale
    return np.asarray(np.sqrt(np.where(error > 0, _ABOVE_WEIGHT, 1.0)) * error)


def _covariance(dark: Dark, channel: int, theta: Array) -> Array:
    """Covariance of source and G, over blocks of the pictures."""
    columns = []
    for step in np.diag(1e-5 * theta):
        difference = _residual(theta + step, dark, channel) - _residual(theta - step, dark, channel)
        columns.append(difference / (2 * step.sum()))
    scores = influence(_residual(theta, dark, channel))
    return sandwich(np.stack(columns, 1), *scores, dark.blocks).matrix


def _quantities(theta: Array) -> Array:
    """Veil, G and source from θ, source and G."""
    source, G = theta
    return np.array([source / G, G, source])


def _veil(source: float, G: float, z: Array) -> Array:
    """Veil at distances z (m)."""
    return np.asarray(source * -np.expm1(-G * z) / G)
