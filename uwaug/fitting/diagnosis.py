"""What a fit has found, in words: which model, how well it explains the pictures, what they cannot
tell and why. Each result has one list of conditions and sentences.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import torch

from uwaug.fitting.coefficients import Coefficients
from uwaug.fitting.data import Geometry, widest_blur
from uwaug.fitting.errors import ClusterCovariance
from uwaug.fitting.least_squares import M
from uwaug.fitting.models import (
    COLOURS,
    SHADING,
    TONE,
    CoefficientModel,
    SpectralModel,
    TurbidityModel,
)
from uwaug.fitting.results import JerlovType, Line, Parameter
from uwaug.fitting.selection import FittedModel, best_of
from uwaug.fitting.suspects import Suspect

Parameters = Mapping[str, Parameter]
_THIN = 0.3  # optical depth G·z at the far end, below which a veil is still a straight line
# Optical depth G·z at the far end, below which surfaces that are not quite black bend a veil as
# much as its end does.
_HALF_GROWN = 1.0
# Optical depth G·z at the near end, above which less than a third of the growth is left to be seen.
# With surfaces that reflect .05 to .5 everywhere the bundled scene comes to 1.2 to 22.
_FULL_GROWN = 1.2
# Ratio of standard errors over clusters to those of independent residuals, above which the model
# misses something.
_DEPENDENT = 1.5
_HARMLESS = 0.05  # of a number, half the interval that one need not look at twice
_GRAVE = 0.25  # of a number, half an interval that is more than an estimate's
# What is likely missing, by the names of `suspects.changes`; behind the colon, how and what cures.
_FAULTS = {
    "gain": 'another exposure or white balance: give gain="channels"',
    "tone": 'a tone curve: give tone="free"',
    "shading": 'corners or a side that are darker: give shading="free"',
    "scene": "uneven light on the scene: on one side it is not that of the clean picture",
    "veil": "an uneven veil: brighter on one side, as with a lamp or uneven water",
    "alignment": "a shift: clean and observed are not aligned to the pixel",
    "sharpness": "other detail: observed seems {smoothed}, and β is taken from detail",
    "offset": "an offset of the distances: all surfaces seem {size:.2g} m {nearer}",
    "noise": "noise of the clean picture, {size:.2g} of white: mean over several of it",
    "planar": "distances that are off towards the corners: planar depth is not metres along the "
    "ray, see uwaug.distance.along_ray",
}
_POOR = 0.8  # share of the observed variance, below which a model does not explain a picture
_NEAREST = 0.05  # m, median distance; nearer scenes are rare
_FASTEST = 30.0  # 1/m; no natural water attenuates more
_ALMOST = 0.95  # of the widest blur
# px, σ at the median distance, below which a blur is hardly told from none: in pictures of the
# default tolerance β is 40 % too small at .2 px, 10 % at .45, right at .7.
_NARROW = 0.6
_ALIKE = 0.03  # smallest singular value of the scaled Jacobian where two numbers do nearly the same
# Probability, below which scattering does not follow turbidity; there are three colours.
_UNLIKELY = 0.05 / 3
# Ratio of held-out errors to those of coefficients that are free in every channel: above, no Jerlov
# water explains a picture. Jerlov waters reach 1.002, a wrong g or μ 1.2, grey water, wrong cameras
# and wrong exposures 1.5 to 5.
_UNLIKE = 1.25
# Correlation of depth and gain, above which errors do not count what media are off by: in 9C as
# deep as an exposure allows .9999, in other waters .9 to .996.
_ONE_BAND = 0.999
_NOT_QUITE = 1.02  # ratio above which none is quite right
_UNSEEN = 0.001  # RMS of linear light: the default tolerance of a medium puts pictures .0007 off
_NOTHING_SHOWS = f"What is left is less than shows in a picture, {_UNSEEN} of linear light."
_DEPEND = "Residuals of neighbouring pixels depend on each other: with that, errors are"
_CLAMPED = 0.01  # share of the pixels at which blurs are wider than any that was made


def full_grown(G: float, nearest: float) -> bool:
    """Whether a veil has grown to its end before the nearest surface, so that its growth is not
    seen.
    """
    return G * nearest > _FULL_GROWN


def straight(G: float, farthest: float) -> bool:
    """Whether a veil still grows as a straight line at the far end, so that its end is not seen."""
    return G * farthest < _THIN


def of_fit(
    chosen: FittedModel[CoefficientModel],
    tried: Sequence[FittedModel[CoefficientModel]],
    parameters: Parameters,
    covariance: ClusterCovariance,
    faults: Sequence[Suspect],
) -> Iterator[str]:
    """The sentences on a `Fit`. faults: that the residuals tell of."""
    model, best = chosen.model, best_of(tried)
    geometry = model.geometry
    choice = ""
    if len(tried) > 1:
        choice = " It foretells left-out pixels best."
        if best is not chosen:
            choice = f" The fewest numbers within one standard error of the best, {best.name!r}."
    yield f"Model {chosen.name!r}: {model.spec.words}.{choice}"
    yield _residual(chosen)
    c = model.coefficients(torch.from_numpy(chosen.theta))
    yield from _blur(model, c)
    if len(tried) > 1 and c.width is not None and geometry.focal_px is None:
        yield "The calibrated width law was not tried: for it, give focal_px=…, of the camera."
    yield from _camera(parameters)
    wrong = list(_trust(chosen, parameters, covariance, faults))
    if chosen.explained < _POOR and wrong:
        yield "That is little: are the pictures aligned, of one scene, and in metres?"
    yield from wrong
    fastest = max(parameters[f"beta_{colour}"].value or 0.0 for colour in COLOURS)
    if geometry.unit == "m" and (geometry.reference < _NEAREST or fastest > _FASTEST):
        yield (
            f"The median distance is {geometry.reference:.3g} m and the largest β {fastest:.3g}/m: "
            "are the distances in metres?"
        )
    if c.width is not None and c.exponent is not None:
        far = (geometry.farthest / geometry.reference) ** float(c.exponent[0])
        if float(c.width[0]) * far >= _ALMOST * geometry.widest:
            yield (
                f"The blur reaches the widest that a fit holds, {geometry.widest:.3g} px: width "
                "law, β and G may be off by more than their errors."
            )
    yield from _not_identified(parameters)
    alike = covariance.singular.size and covariance.singular[-1] < _ALIKE
    if covariance.null_space.size or covariance.idle.any() or alike:
        yield "Some numbers do nearly the same to these pictures: see the correlation."
    yield from _straight_veil(parameters, geometry)
    yield from _at_bounds(parameters)
    negative = [c for c in COLOURS if (_value(parameters, f"a_{c}") or 0.0) < 0]
    if negative:
        yield (
            f"Absorption is negative in {', '.join(negative)}: g = {model.g:g} is more than these "
            "pictures allow, or the model does not suit them."
        )
    if geometry.unit != "m":
        yield (
            "The scale of the distances is unknown, and so is that of the rates: β times the scale "
            "is what a picture shows."
        )
    yield from _unsettled(chosen)


def of_series(
    chosen: FittedModel[TurbidityModel],
    parameters: Parameters,
    covariance: ClusterCovariance,
    lines: Mapping[str, Line],
) -> Iterator[str]:
    """The sentences on a `SeriesFit`."""
    yield f"Model {chosen.name!r}. {_residual(chosen)}"
    odds = {c: line.probability for c, line in lines.items() if line.probability is not None}
    untested = [colour for colour in lines if colour not in odds]
    if untested:
        yield (
            f"In {', '.join(untested)} two turbidities or fewer have a known b, which lie on any "
            "line: a third would test it."
        )
    off = [colour for colour, probability in odds.items() if probability < _UNLIKELY]
    if off:
        yield f"Scattering does not follow turbidity on a line in {', '.join(off)}."
    elif odds:
        yield "Scattering follows turbidity on a line, within its errors."
    yield from _dependent(chosen, covariance)
    yield from _not_identified(parameters)
    yield from _at_bounds(parameters)
    yield from _unsettled(chosen)


def of_water(
    chosen: FittedModel[SpectralModel],
    tried: Sequence[FittedModel[SpectralModel]],
    parameters: Parameters,
    covariance: ClusterCovariance,
    types: Sequence[JerlovType],
    free: FittedModel[Any],
) -> Iterator[str]:
    """The sentences on a `WaterFit`. free: the model that explains the pictures best."""
    model = chosen.model
    kind = "A mixture of Jerlov types" if len(model.waters) == 2 else "Jerlov type"
    distance = parameters["visibility"]
    error = "" if distance.error is None else f" ± {distance.error:.2g}"
    visibility = "" if distance.value is None else f", visibility {distance.value:.4g}{error} m"
    yield f"{kind} {model.name}{visibility}."
    alike = [x.name for x in types if not x.told_apart and x.name != model.name]
    if alike:
        yield f"Within one standard error, these foretell as well: {', '.join(alike)}."
    else:
        yield "All others foretell left-out pixels worse by more than one standard error."
    yield _residual(chosen)
    yield from _no_jerlov_water(best_of(tried), free)
    yield from _depth_or_exposure(model, covariance)
    yield from _dependent(chosen, covariance)
    yield from _not_identified(parameters)
    yield from _at_bounds(parameters)
    pixels = chosen.objective.pixels
    widest = max(widest_blur(size) for size in model.sizes)
    used = (pixels.weights > 0).any(1, keepdim=True)
    sigma = model.sigma(model.medium(chosen.theta), pixels.z)
    share = float((sigma[used] > widest).double().mean())
    if share >= _CLAMPED:
        yield (
            f"At {100 * share:.0f} % of the pixels the width law asks for more than the widest "
            f"blur, {widest:.3g} px, which may bias type and numbers: leave the far ones out with "
            "a mask."
        )
    yield from _unsettled(chosen)


def of_veil(
    parameters: Parameters, G: Sequence[float], nearest: float, farthest: float, darkest: float
) -> Iterator[str]:
    """The sentences on a `VeilFit`, of its G in each colour, 1/m, seen from `nearest` to
    `farthest`, m, where dark surfaces may reflect `darkest`.
    """
    yield (
        "An estimate: the darkest pixels at each distance are taken for black. What their surfaces "
        f"reflect counts as veil; errors are for up to {darkest:.2g} of white (darkest)."
    )
    yield from _not_identified(parameters)
    even = [c for c, rate in zip(COLOURS, G, strict=True) if full_grown(rate, nearest)]
    if even:
        yield (
            f"In {', '.join(even)} what is darkest is as light at {nearest:.3g} m as farther away: "
            "the water is very turbid, or nothing in view is black and V(0) is too high."
        )
    depths = {colour: rate * farthest for colour, rate in zip(COLOURS, G, strict=True)}
    lines = [colour for colour, depth in depths.items() if depth < _THIN]
    if lines:
        yield _straight_line(lines, farthest, "m")
    early = [c for c, z in depths.items() if z < _HALF_GROWN and _value(parameters, f"veil_{c}")]
    if early:
        yield (
            f"In {', '.join(early)} the veil is far from its end at {farthest:.3g} m: V(0) may be "
            "off by half, and G more; up to there the veil itself (backscatter) is better known."
        )


def _value(parameters: Parameters, name: str) -> float | None:
    return parameters[name].value if name in parameters else None


def _residual(chosen: FittedModel[M]) -> str:
    share = f"{100 * np.floor(1e4 * chosen.explained) / 1e4:.4g} %"
    residual = f"The residual is {chosen.rms:.2g} RMS of linear light"
    return f"{residual}; {share} of the variance of the observed pixels is explained."


def _dependent(chosen: FittedModel[M], covariance: ClusterCovariance) -> Iterator[str]:
    if covariance.design_effect <= _DEPENDENT:
        return
    if chosen.rms < _UNSEEN:
        yield _NOTHING_SHOWS
        return
    yield (
        f"{_DEPEND} {covariance.design_effect:.1f} times those of independent noise. The model "
        "misses something, such as wrong distances, another exposure, uneven water or light, or "
        "more than one rate for a colour."
    )


def _camera(parameters: Parameters) -> Iterator[str]:
    """What was fitted of the camera."""
    names = [*(name for name in parameters if name.startswith("gain")), *SHADING, *TONE]
    shown = []
    for name in names:
        if name in parameters:
            value = parameters[name].value
            shown.append(f"{name} not identified" if value is None else f"{name} {value:.3g}")
    if shown:
        yield f"Of the camera, this is fitted too: {', '.join(shown)}."


def _blur(model: CoefficientModel, c: Coefficients) -> Iterator[str]:
    """The width law in the measure of `PointSpread`, beside that of the table; what no blur means
    for β.
    """
    if c.width is None:
        yield (
            "Without a blur, direct light and light that is scattered forward are one: beta is the "
            "attenuation of both together, and G at least. That of the direct light alone, β of "
            "the water, may be larger: it is not identified."
        )
        return
    medium, reference = model.media(c.at(0)), model.geometry.reference
    law = medium.point_spread
    yield (
        f"Width {float(c.width[0]):.3g} px, σ at the median distance of {reference:.3g} "
        f"{model.geometry.unit}, is that of PointSpread({float(law.scale):.3g}, "
        f"{float(law.exponent):.3g}) at b̄ = {float(medium.b_mean[0]):.3g}/{model.geometry.unit}: "
        "scale·(b̄ z)^exponent."
    )
    if float(c.width[0]) < _NARROW:
        yield (
            f"A blur below {_NARROW} px is hardly told from none, and pictures that were made with "
            "the default tolerance do not have it exactly: beta, a and b may be off by more than "
            "their errors. G and veil do not depend on it."
        )


def _trust(
    chosen: FittedModel[CoefficientModel],
    parameters: Parameters,
    covariance: ClusterCovariance,
    faults: Sequence[Suspect],
) -> Iterator[str]:
    """How far numbers can be trusted where the model misses something, and what that may be."""
    if covariance.design_effect <= _DEPENDENT and not faults:
        return
    if chosen.rms < _UNSEEN:
        yield _NOTHING_SHOWS
        return
    yield f"{_DEPEND} {covariance.design_effect:.1f} times those of independent noise."
    yield f"The model misses something: {_cause(faults)}."
    kinds = ("beta", "G", "veil")
    shares, lost = [0.0], False
    for name, x in parameters.items():
        if name.rpartition("_")[0] in kinds:
            lost |= x.state == "not identified"
            if x.value and x.low is not None and x.high is not None:
                shares.append((x.high - x.low) / (2 * abs(x.value)))
    reach = f"95 % intervals of β, G and veil reach up to {100 * max(shares):.2g} % to either side"
    cure = "mend the pictures and fit again"
    if lost:
        yield f"Verdict: do not rely on it. Some of β, G and veil are hidden by that; {cure}."
    elif max(shares) > _GRAVE:
        yield f"Verdict: do not rely on it. With that, {reach}; {cure}."
    elif max(shares) > _HARMLESS:
        yield f"Verdict: estimates. With that, {reach}."
    else:
        yield f"Verdict: harmless. Even with that, {reach}."


def _cause(faults: Sequence[Suspect]) -> str:
    """The likeliest of what is missing, in words, and what explains as much."""
    if not faults:
        return (
            "neither a camera's doing nor a shift, but such as wrong distances at edges, uneven "
            "water or JPEG"
        )
    first, *rest = faults
    others = [_in_words(x).partition(":")[0] for x in rest if x.explained > first.explained / 2]
    return f"likely {_in_words(first)}" + "".join(f"; or {other}" for other in others)


def _in_words(fault: Suspect) -> str:
    size = float(fault.size[0])
    return _FAULTS[fault.name].format(
        size=abs(size),
        nearer="farther" if size > 0 else "nearer",
        smoothed="sharpened" if size > 0 else "smoothed (noise reduction, JPEG, focus)",
    )


def _not_identified(parameters: Parameters) -> Iterator[str]:
    names = [name for name, number in parameters.items() if number.state == "not identified"]
    if names:
        yield f"Not identified: {', '.join(names)}."


def _at_bounds(parameters: Parameters) -> Iterator[str]:
    names = [name for name, number in parameters.items() if number.state == "at bound"]
    if names:
        cure = "the interval has one open side"
        yield f"At the end of what they may be: {', '.join(names)}; {cure}."


def _straight_veil(parameters: Parameters, geometry: Geometry) -> Iterator[str]:
    colours = []
    for colour in COLOURS:
        G = _value(parameters, f"G_{colour}" if "G_red" in parameters else f"beta_{colour}")
        lost = f"veil_{colour}" in parameters and _value(parameters, f"veil_{colour}") is None
        grows = _value(parameters, f"source_{colour}") is not None
        if lost and grows and straight(G or 0.0, geometry.farthest):
            colours.append(colour)
    if colours:
        yield _straight_line(colours, geometry.farthest, geometry.unit)


def _straight_line(colours: Sequence[str], farthest: float, unit: str) -> str:
    return (
        f"In {', '.join(colours)} the veil still grows as a straight line at {farthest:.3g} "
        f"{unit}: its growth (source) is seen, where it ends is not."
    )


def _no_jerlov_water(best: FittedModel[SpectralModel], free: FittedModel[Any]) -> Iterator[str]:
    ratio = best.error / max(free.error, 1e-9)
    behind, error = best.delta_loss(free)
    missed = max(best.rms**2 - free.rms**2, 0.0) ** 0.5
    if ratio < _NOT_QUITE or behind < 2 * error or missed < _UNSEEN:
        return
    off = f"left-out pixels are {ratio:.3g} times as far off as"
    causes = "camera, g, μ, exposure (gain), surfaces, and distances in metres"
    if isinstance(free.model, SpectralModel):
        off += f" with a colour matrix and a black of the camera's own, in {free.name}"
        cure = 'if it was developed (white balance, saturation, black point), give gain="matrix"'
    else:
        off += " with coefficients free in every channel"
        cure = "see uwaug.fit"
    if ratio < _UNLIKE:
        yield f"No type is quite right: {off}. Errors do not count that; check {causes}; {cure}."
    else:
        yield (
            f"No Jerlov water explains this picture: {off}. Do not rely on type and numbers; check "
            f"{causes}; {cure}."
        )


def _depth_or_exposure(model: SpectralModel, covariance: ClusterCovariance) -> Iterator[str]:
    """Where so little light is left that a greater depth looks like a shorter exposure."""
    names, variance = list(model.bounds), np.diag(covariance.matrix)
    gains = [i for i, name in enumerate(names) if name.startswith("gain") and variance[i] > 0]
    if "vertical_depth" not in names or not gains or not variance[names.index("vertical_depth")]:
        return
    depth = names.index("vertical_depth")
    alike = max(
        covariance.matrix[depth, i] / math.sqrt(variance[depth] * variance[i]) for i in gains
    )
    if alike > _ONE_BAND:
        yield (
            f"Depth and exposure do nearly the same to this picture (correlation {alike:.4f}), as "
            "hardly more than one band of light is left: depth and gain may be off by ten of their "
            "errors, visibility by four. Give vertical_depth=… if it is known."
        )


def _unsettled(chosen: FittedModel[M]) -> Iterator[str]:
    if not chosen.solution.converged:
        yield "The fit stopped before it settled: give a start, or fewer free numbers."
