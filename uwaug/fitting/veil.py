"""`fit_veil`: the veil of a picture without a clean one, from its darkest pixels."""

from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support import checks
from uwaug._support.threads import one_thread
from uwaug._support.types import Array, ColorSpace
from uwaug.fitting.data import Pictures, Pixels, blocks_of
from uwaug.fitting.errors import (
    THIN_OPTICAL_DEPTH,
    covariance_of,
    parameter,
    straight_line,
    unknown,
)
from uwaug.fitting.model import COLOURS, MODELS, CoefficientModel, Quantity, report_slopes
from uwaug.fitting.result import Fit
from uwaug.fitting.solve import ROBUST, Objective, guess, solve
from uwaug.formation.colour import LUMINANCE
from uwaug.formation.setting import Setting
from uwaug.optics.curves import FARTHEST

_NEAR_QUANTILE, _FAR_QUANTILE = 0.005, 0.995  # of the finite distances: the ends of the bins
_BINS = 10  # equal steps of distance
_DARK_SHARE = 0.01  # of the pixels of a bin, taken for black
_MIN_PIXELS = 50  # pixels that a bin needs
_MIN_DARK = 10  # least number of dark pixels of a bin
_MIN_BINS = 3  # bins that a fit needs
_MAX_DARK = 3000  # dark pixels of a fit
# Factor of residuals above the curve. With 1 the veil is too high by half as much again where
# nothing is black. With .1^½ noise draws it down.
_ABOVE_WEIGHT = 0.3**0.5
# Default of what dark surfaces may reflect; no real scene's are blacker than .03. The change of a
# number by it is one standard error.
_DARKEST = 0.05
_ROBUST_SHARE = 0.02  # of the brightest dark pixels; larger residuals count less than their square
_LEAST_SHARE = 1e-3  # of the brightest colour, that stands for the light of a darker one
_ONE_COLOUR = 1e-3  # variation, as a share of the brightest light, below which there is none
_UNITS = {"G": "1/m", "veil": "1", "source": "1/m"}  # of the reported numbers, by kind
_RESOLUTION = 1e-6  # light may have any scale here, so any change may show
# Optical depth G·z at the near end, above which less than a third of the growth shows. With
# surfaces that reflect .05 to .5 everywhere the bundled scene comes to 1.2 to 22.
_FULL_GROWN = 1.2


def fit_veil(
    observed: Tensor,
    distance: Tensor,
    *,
    darkest: float = _DARKEST,
    color_space: ColorSpace = "srgb",
    seed: int = 0,
) -> Fit:
    """Estimate a veil V(0)·(1 − e^(−Gz)) for each channel without a clean picture, from the darkest
    pixels at each distance: if their surfaces are black, all their light is the veil's. Sea-thru's
    second term, for the light of dark surfaces, is left out: pictures hardly tell it from the veil.

    Args:
        observed, distance, color_space, seed: as of `uwaug.fit`; pictures are of one water.
        darkest: share of light that the darkest surfaces at each distance may reflect, 0…1; its
            change of a number counts as a standard error. 0 if some surfaces are known to be black.

    Returns:
        The fit, an estimate: G, veil V(0) and source G·V(0) of each channel. Its medium has β = G.
        Where V(0) and G are not identified, `medium.backscatter` still is, up to the farthest.

    Raises:
        TypeError, ValueError: as `uwaug.fit`; if fewer than three steps hold 50 pixels, or the
            picture is of one colour.

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
    dark, unit = _darkest(pictures, np.random.default_rng(seed))
    z = dark.z.flatten().numpy()
    nearest, farthest = np.quantile(z, (0.05, 0.95)).tolist()
    if (z >= FARTHEST).mean() > 0.01:
        farthest = np.inf
    model = CoefficientModel(MODELS["haze"], pictures.geometry, False)
    # a medium that is made in inference mode could not be trained
    with one_thread(), torch.inference_mode(False), torch.no_grad():
        objective = _OneSided(model, dark)
        solution = solve(objective, model.start(guess(objective)))
        theta = solution.theta
        # what is darkest is a haze of black, or of surfaces that reflect `darkest`
        grey = replace(dark, clean=torch.full_like(dark.clean, darkest / unit))
        bias = model.report(solve(_OneSided(model, grey), theta).theta) - model.report(theta)
        slopes = report_slopes(model, theta)
        of_pixels = slopes @ covariance_of(objective, solution).matrix @ slopes.T
        c = model.coefficients(theta)
        medium = model.medium(c._replace(source=unit * c.source))
        rms = unit * float((model.render(theta, dark) - dark.observed).square().mean().sqrt())
    # the errors of pixels, and the change by surfaces that are not black
    covariance = of_pixels + np.outer(bias, bias)
    scale = np.repeat([1.0, unit, unit], 3)
    covariance *= np.outer(scale, scale)
    values, errors = scale * model.report(theta), np.sqrt(np.diag(covariance))
    G = dict(zip(COLOURS, c.G.tolist(), strict=True))
    full_grown = [colour for colour in COLOURS if G[colour] * nearest > _FULL_GROWN]
    numbers, untold = {}, []  # names of numbers that other surfaces would tell
    kinds = [(kind, colour) for kind in _UNITS for colour in COLOURS]
    for (kind, colour), value, error in zip(kinds, values.tolist(), errors.tolist(), strict=True):
        # of a veil that is full-grown its end alone shows, if it is that of the water; of a
        # straight line its growth alone
        shows = kind == "source" or G[colour] * farthest >= THIN_OPTICAL_DEPTH
        if colour in full_grown:
            shows = kind == "veil" and farthest == np.inf
        quantity = Quantity(f"{kind}_{colour}", _UNITS[kind], _RESOLUTION, "")
        number = parameter(quantity, value, error, shows=shows)
        if number.value is None and shows:
            untold.append(quantity.name)
        numbers[quantity.name] = number
    notes = [
        "An estimate: the darkest pixels at each distance are taken for black, within an error of "
        f"{darkest:.2g} of white (darkest)."
    ]
    if full_grown:
        notes.append(
            f"In {', '.join(full_grown)} what is darkest is as light at {nearest:.3g} m as farther "
            "away: the water is very turbid, or nothing in view is black and V(0) is too high."
        )
    if straight := straight_line(numbers, c.G, farthest):
        notes += [f"{straight[0]} Open water in view (distance inf) would tell its end."]
    if untold:
        cure = "Dark surfaces nearer and farther, or black ones and darkest=0 (--darkest 0),"
        notes.append(f"{cure} would tell {', '.join(untold)}.")
    return Fit(
        model="darkest pixels",
        parameters=numbers,
        covariance=covariance,
        setting=Setting(medium, color_space=color_space),
        geometry=pictures.geometry,
        rms=rms,
        notes=(*notes, *unknown(numbers)),
        pictures=pictures,
    )


class _OneSided(Objective[CoefficientModel]):
    """Residuals of pixels that are lighter than the veil count less, as no surface is darker."""

    def residual(self, theta: Array) -> Array:
        residual = super().residual(theta)
        return np.where(residual < 0, _ABOVE_WEIGHT, 1.0) * residual

    def jacobian(self, theta: Array) -> Array:
        is_lighter = super().residual(theta) < 0
        return np.where(is_lighter, _ABOVE_WEIGHT, 1.0)[:, None] * super().jacobian(theta)


def _darkest(pictures: Pictures, rng: np.random.Generator) -> tuple[Pixels, float]:
    """Darkest pixels at each distance and some of open water, as black, and their unit of light."""
    # single pixels would be chosen for their noise: V was 7 to 60 % off instead of 4 to 20 %
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
        members = np.flatnonzero(finite & (bins == k))
        if len(members) >= _MIN_PIXELS:
            count = max(round(_DARK_SHARE * len(members)), _MIN_DARK)
            darkest.append(members[np.argpartition(luminance[members], count)[:count]])
    if len(darkest) < _MIN_BINS:
        got = f"only {len(darkest)} of {_BINS} steps of distance hold {_MIN_PIXELS} pixels"
        raise ValueError(f"distance: {got}, expected {_MIN_BINS}: give larger pictures")
    open_water = rng.permutation(np.flatnonzero(~finite))
    darkest.append(open_water[: max(map(len, darkest))])
    sample = rng.permutation(np.concatenate(darkest))[:_MAX_DARK]
    light = light[sample].T
    bright = np.quantile(light, 0.95, axis=1, keepdims=True)
    unit = max(float(bright.max()), 1e-9)
    weight = ROBUST / _ROBUST_SHARE / (bright / unit).clip(min=_LEAST_SHARE)
    observed = torch.from_numpy(light / unit)[None, :, None]
    pixels = Pixels(
        clean=torch.zeros_like(observed),
        observed=observed,
        z=torch.from_numpy(z[sample])[None, None, None],
        weights=torch.from_numpy(weight)[None, :, None].expand_as(observed),
        places=sample,
        blocks=blocks[sample],
        stacks={},
        size=pictures.geometry.size,
    )
    return pixels, unit
