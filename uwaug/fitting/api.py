"""The doors: `fit`, `fit_series` and `fit_water`."""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from typing import Any, Literal, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import Array, ColorSpace
from uwaug.fitting.data import Geometry, Observations, Pictures, Pixels
from uwaug.fitting.diagnosis import of_fit, of_series, of_water
from uwaug.fitting.errors import ClusterCovariance, cluster_covariance, parameters
from uwaug.fitting.least_squares import (
    M,
    Objective,
    Solution,
    loss,
    multistart,
    one_thread,
    solve,
    starting_points,
)
from uwaug.fitting.models import (
    COLOURS,
    EXPONENTS,
    MODELS,
    CameraGain,
    CoefficientModel,
    Correction,
    Gain,
    Model,
    SpectralModel,
    TurbidityModel,
)
from uwaug.fitting.noise import Noise, initial_weights, reweight
from uwaug.fitting.results import Candidate, Fit, JerlovType, Line, SeriesFit, WaterFit
from uwaug.fitting.selection import FittedModel, best_of, one_standard_error_rule
from uwaug.fitting.suspects import spread, suspects
from uwaug.light.geometry import focal_of
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.jerlov import JERLOV_TYPES
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.scattering import Scattering
from uwaug.optics.surfaces import Surfaces, require_surfaces
from uwaug.optics.water import Water

Progress = Callable[[str], None]
_PIXELS = (500, 100_000)  # that may be fitted
_MAX_KNOWN = 1e6  # of numbers that a caller knows
_SCOUTS = 4000  # pixels of the fits that noise is first learnt from
_SCOUTS_OF_LEVEL = 3000  # pixels of each turbidity, which say where a series begins
_SCOUTS_OF_TYPE = 1000  # pixels of the fits that those of Jerlov types begin from
_MUCH = 0.01  # of the held-out loss, that a camera must save
_SERIES = ("veil", "gaussian", "exponential")
_VISIBILITIES = np.geomspace(0.4, 25.0, 8)  # to begin at, in multiples of the median distance
_DEPTHS = (0.5, 3.0, 10.0)  # vertical depths to begin at, m
_MIN_VALUES = 500  # values between noise and white, of all that are fitted, that `fit_water` needs
_UNSEEN = 0.001  # RMS of linear light, by which a camera must explain more to be spoken of
_SURELY = 2.0  # standard errors, by which a mixture is neither of its ends
_TOLERANCE = 0.002  # of media and blurs, by default
# RMS of linear light by which blurs of that tolerance look like other widths: a part of .0007.
_BLURS_OFF = 0.0002
_MIN_SHARE = 0.05  # of a type in a mixture: media of the default tolerance make up for .02
# The types, and mixtures of neighbours. Without these, a picture of half 1C and half 3C would be
# type 3C, 7 % off in visibility, and one of half III and half 1C would be none. (Those of the best
# type alone miss three of eight.)
_TYPES = (*((name,) for name in JERLOV_TYPES), *pairwise(JERLOV_TYPES))


def fit(
    clean: Pictures,
    observed: Pictures,
    distance: Pictures,
    *,
    field: Pictures | None = None,
    model: str = "auto",
    fixed: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
    mask: Pictures | None = None,
    color_space: ColorSpace = "srgb",
    gain: Gain | Literal["auto"] = "auto",
    shading: Correction = "auto",
    tone: Correction = "auto",
    noise: Noise | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    focal_px: float | None = None,
    g: float | None = None,
    pixels: int = 20_000,
    relative: bool = False,
) -> Fit:
    """Recover a water from pictures of one scene without it and in it.

    Args:
        clean (3xHxW or Bx3xHxW tensor, or a sequence): the scene without water; uint8 (0…255) or
            floating point (0…1). One serves all observed pictures.
        observed (as clean): the scene in the water, aligned with `clean` to the pixel.
        distance (1xHxW or Bx1xHxW tensor, or a sequence): metres along the ray; pixels that are
            NaN, 0 or negative are left out; +inf is open water.
        field (as distance): medium field, multiplies the distance.
        model: "auto" tries all and takes the one of the fewest numbers that foretells pixels which
            it was not fitted to as well as any (one-standard-error rule, on blocks of the picture).
            Or one of them: "attenuation" (direct light alone), "haze" (direct light and veil, one
            coefficient), "veil" (a coefficient for each), and with forward scatter "paper",
            "calibrated" (their width laws), "gaussian", "exponential" (a width law of their own).
        fixed: numbers that are known, by the names in `Fit.parameters`, such as {"G_red": .3}:
            beta, G, veil of a colour, width, exponent.
        start: where to begin, by the same names; everything else is guessed.
        mask (as distance): true or > 0 where pixels count.
        color_space: "srgb", or "linear" for linear light. All numbers refer to linear light.
        gain: "fixed": both pictures have one exposure. "free": a factor for each observed picture.
            "channels": one for each of its colours, as where the scene lies deep, or with another
            white balance. "auto": that which the pictures tell of, of these.
        shading: whether the observed pictures are darker in the corners (vignette) or to one side
            (down, right): "fixed", they are not; "free", that is fitted too; "auto", if the
            pictures tell of it.
        tone: whether the observed pictures have a tone curve of their own, which leaves black and
            white: (1 + s)·x^c/(1 + s·x^c) with c, tone, and s, shoulder; as shading.
        noise: of the observed pictures; None learns it from the residuals.
        seed: of the pixels that are drawn, and of random starts.
        progress: is called with a line on what is being tried.
        focal_px: focal length, px; "calibrated" needs it, and is not tried without.
        g: share of the scattered light that leaves the line of sight: with it a and b follow from β
            and G. None: .2 with the paper's law, else .05.
        pixels: how many are fitted, spread evenly over the distances; at most 100 000.
        relative: the distances are of unknown scale: rates are in 1/unit, not 1/m.

    Returns:
        The fit: numbers, errors, what the pictures cannot tell.

    Raises:
        TypeError, ValueError: if an input does not suit; if fewer than 500 pixels can be used, the
            distances are all alike, or clean and observed are one picture.

    Source: sandwich covariance: White 1982, over clusters, Liang and Zeger 1986; one-standard-error
    rule: Breiman et al. 1984.

    Examples:
        >>> import torch, uwaug
        >>> clean, z = torch.rand(3, 60, 80), torch.linspace(1, 6, 4800).reshape(1, 60, 80)
        >>> beta, veil = (0.5, 0.2, 0.3), (0.1, 0.3, 0.4)
        >>> water = uwaug.Medium.from_coefficients(beta, beta, veil)
        >>> observed = uwaug.Underwater(water)(clean, z)
        >>> fit = uwaug.fit(clean, observed, z, model="haze")
        >>> round(fit.parameters["beta_red"].value, 2)
        0.5
    """
    say = _require_options(noise, pixels, seed, progress)
    checks.one_of("model", model, ("auto", *MODELS))
    checks.one_of("gain", gain, ("auto", *get_args(Gain)))
    checks.one_of("shading", shading, get_args(Correction))
    checks.one_of("tone", tone, get_args(Correction))
    if focal_px is not None:
        checks.positive("focal_px", focal_px, "px")
    elif model == "calibrated":
        raise ValueError("focal_px: the calibrated width law needs the focal length in px")
    if g is not None:
        checks.within("g", g, 0.0, 0.99)
    observations = Observations.of(clean, observed, distance, field, mask, color_space, relative)
    models = _models(model, observations.geometry(focal_px), g, fixed or {})
    asked = {"gain": gain, "shading": shading, "tone": tone}
    models = [replace(x, **_asked_camera(asked)) for x in models]
    start = _checked("start", start or {}, models)
    with one_thread():
        say("blurring the clean picture")
        shapes = sorted({model.shape for model in models if model.shape is not None})
        drawn = observations.sample_pixels(shapes, int(pixels), seed)
        say("learning the noise")
        rough = initial_weights(drawn, noise, color_space).subsample(_SCOUTS, seed)
        richest, solution = _richest(models, rough, seed, start)
        given, theta = noise, solution.theta
        weighed, noise, theta = reweight(richest, theta, drawn, given, observations)
        if "auto" in asked.values():
            say("looking at what the camera has done")
            few = Objective(richest, weighed.subsample(_SCOUTS, seed))
            changed, theta = _with_camera(few, theta, asked, seed)
            if changed is not richest:
                camera = {name: getattr(changed, name) for name in asked}
                models = [replace(x, **camera) for x in models]
                richest = next(x for x in models if x == changed)
                weighed, noise, theta = reweight(richest, theta, drawn, given, observations)
        tried: list[FittedModel[CoefficientModel]] = []
        for i, candidate in enumerate(models):
            say(f"fitting {candidate.name!r}, {i + 1} of {len(models)}")
            objective = Objective(candidate, weighed)
            end = solve(objective, theta) if candidate is richest else None
            # one that explains less than fewer numbers do has gone astray
            if end is None or any(x.solution.cost < end.cost for x in tried):
                starts = starting_points(objective, [x.numbers for x in tried[-1:]], start)
                end = multistart(objective, starts, seed)
            tried.append(FittedModel.of(objective, end, seed))
        chosen = one_standard_error_rule(tried)
        if gain not in ("auto", "fixed") and model == "auto":
            say("fitting without a gain")
            objective = Objective(replace(chosen.model, gain="fixed"), weighed)
            solution = multistart(objective, starting_points(objective, (), start), seed)
            tried.append(FittedModel.of(objective, solution, seed))
            chosen = one_standard_error_rule([chosen, tried[-1]])
        say("looking at what may be wrong")
        faults = suspects(chosen.objective, chosen.solution)
        more = spread(faults, len(chosen.theta))
        common, covariance = _reported(chosen, noise, more)
    return Fit(
        **common,
        message="\n".join(of_fit(chosen, tried, common["parameters"], covariance, faults)),
        candidates=_candidates(tried),
        fitted=chosen.model,
        history=chosen.solution.history,
        pairs=observations.pairs,
    )


def _models(
    name: str, geometry: Geometry, g: float | None, fixed: Mapping[str, float]
) -> list[CoefficientModel]:
    """The candidates in which all that is fixed has a place."""
    models = []
    for spec in MODELS.values():
        if name in ("auto", spec.name) and (spec.law != "calibrated" or geometry.focal_px):
            share = spec.g if g is None else float(g)
            models.append(CoefficientModel(spec, geometry, "fixed", share, {}))
    numbers = _checked("fixed", fixed, models)
    fixable = [replace(x, fixed=numbers) for x in models if set(numbers) <= set(x.fixable)]
    models = [model for model in fixable if model.bounds]
    if not models:
        raise ValueError(f"fixed: nothing is left to be fitted, got {', '.join(numbers)}")
    return models


def _checked(
    name: str, numbers: Mapping[str, float], models: Sequence[CoefficientModel]
) -> dict[str, float]:
    """Numbers that a caller knows, by the names of `CoefficientModel.fixable`."""
    if not isinstance(numbers, Mapping):
        raise TypeError(f"{name} must be a dict of numbers, got {type(numbers).__name__}")
    richest = models[-1]
    if not any(set(numbers) <= set(model.fixable) for model in models):
        some = ", ".join(richest.fixable)
        raise ValueError(f"{name}: expected some of {some}, got {', '.join(map(str, numbers))}")
    for key, value in numbers.items():
        least = EXPONENTS[0] if key == "exponent" else 0.0
        most = richest.geometry.widest if key == "width" else _MAX_KNOWN
        checks.within(f"{name}[{key!r}]", value, least, most)
    for colour in COLOURS:
        beta, G = numbers.get(f"beta_{colour}"), numbers.get(f"G_{colour}")
        if beta is not None and G is not None and beta < G and richest.spec.law:
            raise ValueError(f"{name}: expected G_{colour} ≤ beta_{colour}, got {G} and {beta}")
    return {key: float(value) for key, value in numbers.items()}


def _richest(
    models: Sequence[CoefficientModel],
    pixels: Pixels,
    seed: int,
    start: Mapping[str, float],
) -> tuple[CoefficientModel, Solution]:
    """The model of the most numbers, that of two which fits better, and where it ended."""
    most = max(len(model.bounds) for model in models)
    ends = []
    for model in models:
        if len(model.bounds) == most:
            objective = Objective(model, pixels)
            starts = starting_points(objective, (), start)
            ends.append((model, multistart(objective, starts, seed)))
    return min(ends, key=lambda end: end[1].cost)


def _asked_camera(asked: Mapping[str, str]) -> dict[str, Any]:
    """What is fitted of a camera before anything is seen: what is asked for."""
    gain = "fixed" if asked["gain"] == "auto" else asked["gain"]
    return {"gain": gain, "shading": asked["shading"] == "free", "tone": asked["tone"] == "free"}


def _with_camera(
    objective: Objective[CoefficientModel], theta: Array, asked: Mapping[str, str], seed: int
) -> tuple[CoefficientModel, Array]:
    """The model with as much of a camera as its pictures tell of, and its θ: of all that may be
    added, what explains most is, for as long as it surely foretells left-out pixels better, and by
    more than does not show.
    """
    best = FittedModel.of(objective, solve(objective, theta), seed)
    while True:
        model = best.model
        richer: list[dict[str, Any]] = []
        if asked["gain"] == "auto" and model.gain != "channels":
            richer += [{"gain": x} for x in ("free", "channels") if x != model.gain]
        for name in ("shading", "tone"):
            if asked[name] == "auto" and not getattr(model, name):
                richer.append({name: True})
        better = []
        for camera in richer:
            freed = replace(objective, model=replace(model, **camera))
            begin = _begun(freed.model, best.numbers)
            candidate = FittedModel.of(freed, solve(freed, begin), seed)
            if _is_better(candidate, best):
                better.append(candidate)
        if not better:
            return model, best.theta
        best = one_standard_error_rule(better)


def _begun(model: CoefficientModel, numbers: Mapping[str, float]) -> Array:
    """θ from that of a simpler camera: one gain is that of each colour."""
    begun = []
    for name, bound in model.bounds.items():
        simpler = numbers.get(name.rpartition("_")[0], bound.begin)
        begun.append(numbers.get(name, simpler))
    return np.array(begun)


def _is_better(more: FittedModel[M], less: FittedModel[M]) -> bool:
    """Whether a model of more numbers surely foretells left-out pixels better, and as one sees."""
    behind, error = less.delta_loss(more)
    seen = math.sqrt(max(less.rms**2 - more.rms**2, 0.0))
    return behind > max(_SURELY * error, _MUCH * less.loss) and seen > _UNSEEN


def _reported(
    chosen: FittedModel[M], noise: Noise, more: Array | None = None
) -> tuple[dict[str, Any], ClusterCovariance]:
    """What all results hold. more: covariance of what is no noise."""
    covariance = cluster_covariance(chosen.objective, chosen.solution)
    numbers = parameters(chosen.objective, chosen.solution, covariance, more)
    if more is not None:
        covariance = replace(covariance, matrix=covariance.matrix + more)
    return {
        "parameters": numbers,
        "noise": noise,
        "rms": chosen.rms,
        "theta": chosen.theta,
        "covariance": covariance.matrix,
    }, covariance


def _candidates(tried: Sequence[FittedModel[M]]) -> tuple[Candidate, ...]:
    best = best_of(tried)
    return tuple(Candidate(x.name, len(x.theta), x.error, *x.delta_loss(best)) for x in tried)


def fit_series(
    pairs: Sequence[tuple[Tensor, Tensor, Tensor]],
    turbidity: Sequence[float],
    *,
    model: str = "auto",
    mask: Tensor | Sequence[Tensor] | None = None,
    color_space: ColorSpace = "srgb",
    noise: Noise | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    pixels: int = 40_000,
    unit: str = "NTU",
) -> SeriesFit:
    """Recover a water whose turbidity was raised step by step, and see whether its scattering
    follows the turbidity.

    Args:
        pairs: (clean, observed, distance) of each picture, as for `uwaug.fit`.
        turbidity: of each picture, in any unit, ≥ 0; pictures of one turbidity share their b.
        model: "veil" (no forward scatter), "gaussian", "exponential"; "auto" takes the one of the
            fewest numbers that foretells pixels it was not fitted to as well as any.
        mask, color_space, noise, seed, progress, pixels: as for `uwaug.fit`; `pixels` are
            those of all pictures together.
        unit: of the turbidity, for what is written.

    Returns:
        a, geometry and width law of all pictures, b of each level, the line b₀ + k·turbidity, and a
        test of whether b lies on it.

    Raises:
        TypeError, ValueError: as `uwaug.fit`; if there are fewer than two levels, or not one
            turbidity for each pair.

    Source: protocol: "Sea-ing Through Scattered Rays" (2025), tank experiments.
    """
    say = _require_options(noise, pixels, seed, progress)
    checks.one_of("model", model, ("auto", *_SERIES))
    levels, level = _levels(pairs, turbidity)
    clean, observed, distance = (list(column) for column in zip(*pairs, strict=True))
    observations = Observations.of(clean, observed, distance, mask=mask, color_space=color_space)
    models = [
        TurbidityModel(MODELS[name], observations.geometry(), level, len(levels))
        for name in _SERIES
        if model in ("auto", name)
    ]
    with one_thread():
        say("blurring the clean pictures")
        shapes = sorted({model.shape for model in models if model.shape is not None})
        drawn = observations.sample_pixels(shapes, int(pixels), seed)
        rough = initial_weights(drawn, noise, color_space)
        starts = [_start_of_series(model, rough, seed, say) for model in models]
        say("learning the noise")
        weighed, noise, _ = reweight(models[-1], starts[-1], drawn, noise, observations)
        tried = []
        for candidate, start in zip(models, starts, strict=True):
            say(f"fitting {candidate.name!r} to all")
            objective = Objective(candidate, weighed)
            tried.append(FittedModel.of(objective, solve(objective, start), seed))
        chosen = one_standard_error_rule(tried)
        common, covariance = _reported(chosen, noise)
    lines = {}
    for c, colour in enumerate(COLOURS):
        places = 3 + 3 * np.arange(len(levels)) + c
        block = covariance.matrix[np.ix_(places, places)]
        lines[colour] = _line(np.array(levels), chosen.theta[places], block)
    return SeriesFit(
        **common,
        message="\n".join(of_series(chosen, common["parameters"], covariance, lines)),
        candidates=_candidates(tried),
        fitted=chosen.model,
        levels=levels,
        unit=unit,
        lines=lines,
    )


def _levels(
    pairs: Sequence[Any], turbidity: Sequence[float]
) -> tuple[tuple[float, ...], tuple[int, ...]]:
    """The turbidities in ascending order, and which of them each picture has."""
    if len(pairs) != len(turbidity):
        counts = f"{len(turbidity)} for {len(pairs)} pairs"
        raise ValueError(f"turbidity must hold a number for each pair, got {counts}")
    for i, value in enumerate(turbidity):
        checks.within(f"turbidity[{i}]", value, 0.0)
    levels = sorted(set(map(float, turbidity)))
    if len(levels) < 2:
        cure = "one water alone is fitted by uwaug.fit"
        raise ValueError(f"turbidity must have at least two values, got {levels}: {cure}")
    for i, pair in enumerate(pairs):
        if not isinstance(pair, (tuple, list)) or len(pair) != 3:
            kind = type(pair).__name__
            raise TypeError(f"pairs[{i}] must be (clean, observed, distance), got {kind}")
    return tuple(levels), tuple(levels.index(float(value)) for value in turbidity)


def _start_of_series(model: TurbidityModel, pixels: Pixels, seed: int, say: Progress) -> Array:
    """θ where a series begins: from each level alone."""
    alone = []
    for level in range(model.levels):
        say(f"fitting {model.name!r}, turbidity {level + 1} of {model.levels} alone")
        rows = [i for i, its_level in enumerate(model.level) if its_level == level]
        geometry = replace(model.geometry, pairs=len(rows))
        single = CoefficientModel(model.spec, geometry, "fixed", 0.0, {})
        few = pixels.at(rows).subsample(_SCOUTS_OF_LEVEL, seed)
        objective = Objective(single, few)
        theta = multistart(objective, starting_points(objective), seed).theta
        alone.append(single.coefficients(torch.from_numpy(theta)))
    return model.start(alone)


def _line(turbidity: Array, b: Array, covariance: Array) -> Line:
    """Generalised least squares, and the χ² test of what is left."""
    from scipy.stats import chi2

    # what is at a bound has no error, and says nothing
    certain = np.diag(covariance) > 0
    turbidity, b, covariance = turbidity[certain], b[certain], covariance[np.ix_(certain, certain)]
    system = np.stack([np.ones_like(turbidity), turbidity], 1)
    precision = np.linalg.pinv(covariance, hermitian=True)
    of_line = np.linalg.pinv(system.T @ precision @ system, hermitian=True)
    values = of_line @ system.T @ precision @ b
    residual = b - system @ values
    (b0, k), (b0_error, k_error) = values, np.sqrt(np.maximum(np.diag(of_line), 0.0))
    correlation = of_line[0, 1] / max(b0_error * k_error, 1e-300)
    free = len(b) - 2
    odds = float(chi2.sf(residual @ precision @ residual, free)) if free > 0 else None
    return Line(float(b0), float(b0_error), float(k), float(k_error), float(correlation), odds)


def fit_water(
    clean: Pictures,
    observed: Pictures,
    distance: Pictures,
    *,
    camera: "str | os.PathLike[str] | Camera" = "Nikon 5100 (NPL)",
    surfaces: Surfaces = "spectral",
    vertical_depth: float | None = None,
    focal_px: float | None = None,
    point_spread: PointSpread | None = None,
    g: float = Scattering.CALIBRATED.g,
    mu: float = Scattering.CALIBRATED.mu,
    field: Pictures | None = None,
    mask: Pictures | None = None,
    color_space: ColorSpace = "srgb",
    gain: CameraGain = "free",
    noise: Noise | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    pixels: int = 5000,
) -> WaterFit:
    """Which Jerlov water a scene lies in: the type, or the mixture of two neighbouring types, and
    how much is in it.

    Each of the ten types, and each mixture of neighbours in the order of `JERLOV_TYPES`, is fitted
    by its contents, by vertical depth and gain if these are free, by its spectra and the camera's,
    through `Medium.from_water`. That which foretells left-out parts of the picture best is taken;
    a type before a mixture, unless the mixture is better by more than one standard error. All that
    is known by default is what `uwaug degrade --water` takes.

    Args:
        clean, observed, distance, field, mask, color_space: as of `uwaug.fit`.
        camera: as of `Medium.from_water`. A wrong one gives a wrong water.
        surfaces: "spectral" or "grey", as of `Medium.from_water`.
        vertical_depth: of the scene below the surface, m; None: it is fitted, 0…30 m.
        focal_px: focal length, px, of the width law `PointSpread.calibrated(focal_px)`; None for a
            view 60° wide, .866·width of the first picture.
        point_spread: the width law in its place, such as `PointSpread.paper()`.
        g, mu: share of the scattered light that leaves the line of sight, and that is sent towards
            the camera; see `uwaug.Scattering`. One picture does not tell them from the water: one
            made with .05 and .075 in 1C passes for IA + IB with the paper's .2 and .3.
        gain: "free": an exposure for each observed picture, as cameras choose it. "fixed": that of
            the clean picture. "matrix": a colour matrix and a black for each picture, which make up
            for white balance, saturation and black point of one that was developed; depth is then
            hardly known. What is not linear, tone and gamut compression, nothing makes up for: the
            message says that no water explains the picture.
        noise: of the observed pictures; None learns it from the model that explains them best.
        seed, progress, pixels: as of `uwaug.fit`.

    Returns:
        Type, water, visibility and depth, with errors; all types; what cannot be told, in words.

    Raises:
        TypeError, ValueError: as `uwaug.fit`; if too few pixels lie above the noise.

    Of 29 pictures (250×370) that `uwaug degrade --water` makes of the ten types, 1 and 8 m deep, at
    their own visibility and at 6 m, all 29 types are found, and visibility and depth lie within two
    standard errors in 28. In 9C with the least light, visibility is 7 % off and depth 60 %: the
    message says that depth looks like an exposure (`python -m benchmarks.accuracy.fitting waters`).

    Source: spectra: Solonenko and Mobley 2015, see `Water.jerlov`; choice: see `uwaug.fit`.

    Examples:
        >>> import torch, uwaug
        >>> clean, z = torch.rand(3, 60, 80), torch.linspace(1, 6, 4800).reshape(1, 60, 80)
        >>> water = uwaug.Medium.from_water("5C", g=0.05, mu=0.075, surfaces="spectral")
        >>> observed = uwaug.Underwater(water)(clean, z)
        >>> law = water.point_spread
        >>> fit = uwaug.fitting.fit_water(clean, observed, z, point_spread=law, pixels=500)
        >>> fit.type
        '5C'
    """
    say = _require_options(noise, pixels, seed, progress)
    if focal_px is not None:
        if point_spread is not None:
            raise ValueError("point_spread and focal_px: expected one of the two, got both")
        checks.positive("focal_px", focal_px, "px")
    for name, share in {"g": g, "mu": mu}.items():
        checks.within(name, share, *checks.DOMAIN[name])
    camera = load_camera(camera)
    require_surfaces(surfaces)
    checks.one_of("gain", gain, get_args(CameraGain))
    if vertical_depth is not None:
        checks.within("vertical_depth", vertical_depth, *checks.DOMAIN["vertical_depth"])
    observations = Observations.of(clean, observed, distance, field, mask, color_space)
    geometry = observations.geometry()
    sizes = tuple(pair.size for pair in observations.pairs)
    if point_spread is None:
        point_spread = PointSpread.calibrated(focal_of(focal_px, sizes[0][1]))
    checks.instance("point_spread", point_spread, PointSpread)
    known = (camera, surfaces, Scattering(g, mu), point_spread, vertical_depth, sizes, geometry)
    types = [SpectralModel(tuple(map(Water.jerlov, names)), *known, gain) for names in _TYPES]
    with one_thread():
        say("blurring the clean picture")
        drawn = observations.sample_pixels([point_spread.shape], int(pixels), seed)
        say("learning the noise")
        rough = initial_weights(drawn, noise, color_space).subsample(_SCOUTS_OF_TYPE, seed)
        free, theta = _freest(types, geometry, g, rough, seed)
        weighed, noise, theta = reweight(free, theta, drawn, noise, observations)
        bright = int((weighed.weights > 0).sum())
        if bright < _MIN_VALUES:
            cure = "raise the exposure, or give the noise if it is known"
            few_values = f"only {bright} of {weighed.weights.numel()} values that are fitted"
            above = f"lie above the noise, expected {_MIN_VALUES}"
            raise ValueError(f"observed: {few_values} {above}: {cure}")
        objective = Objective(free, weighed)
        freest = FittedModel.of(objective, solve(objective, theta), seed)
        tried = _fit_types(types, weighed, seed, say)
        chosen = one_standard_error_rule(tried)
        tolerated = _formed_to_tolerance(chosen)
        common, covariance = _reported(chosen, noise, tolerated)
        # pictures of the types' own are off by so much: nothing is amiss there
        covariance = replace(covariance, independent=covariance.independent + tolerated)
        candidates = _jerlov_types(tried)
        message = "\n".join(
            of_water(chosen, tried, common["parameters"], covariance, candidates, freest)
        )
    return WaterFit(
        **common,
        message=message,
        candidates=candidates,
        fitted=chosen.model,
        pairs=observations.pairs,
    )


def _freest(
    types: Sequence[SpectralModel], geometry: Geometry, g: float, pixels: Pixels, seed: int
) -> tuple[Model, Array]:
    """The model that explains the pixels best, which the types are compared with, and its θ: one
    that is free in every channel, or a type as seen by a camera with any colour matrix.
    """
    channels = CoefficientModel(MODELS[types[0].shape], geometry, "channels", g, {})
    of_channels = Objective(channels, pixels)
    solution = multistart(of_channels, starting_points(of_channels), seed)
    free: Model = channels
    theta, least = solution.theta, solution.cost
    for model in types:
        if len(model.waters) == 1:
            developed = Objective(replace(model, gain="matrix"), pixels)
            solution = solve(developed, _start_of_type(developed))
            if solution.cost < least:
                free, theta, least = developed.model, solution.theta, solution.cost
    return free, theta


def _fit_types(
    types: Sequence[SpectralModel], pixels: Pixels, seed: int, say: Progress
) -> list[FittedModel[SpectralModel]]:
    """The types, and the mixtures that are none of them, fitted."""
    few = pixels.subsample(_SCOUTS_OF_TYPE, seed)
    tried, least = [], math.inf
    for model in types:
        say(f"fitting {model.name}")
        roughly = Objective(model, few)
        near = solve(roughly, _start_of_type(roughly))
        mixture = len(model.waters) == 2
        if mixture and near.cost > least:
            continue
        objective = Objective(model, pixels)
        fitted = FittedModel.of(objective, solve(objective, near.theta), seed)
        if not mixture:
            least = min(least, near.cost)
        if not mixture or _is_mixed(fitted):
            tried.append(fitted)
    return tried


def _is_mixed(fitted: FittedModel[SpectralModel]) -> bool:
    """Whether a mixture is surely neither of its ends, which are candidates of their own."""
    place = list(fitted.model.bounds).index("mixing")
    share = fitted.theta[place]
    covariance = cluster_covariance(fitted.objective, fitted.solution).matrix
    margin = max(_SURELY * math.sqrt(covariance[place, place]), _MIN_SHARE)
    return bool(margin < share < 1 - margin)


def _start_of_type(objective: Objective[SpectralModel]) -> Array:
    """The best of a grid of visibilities and depths, at gains by linear least squares."""
    model, pixels = objective.model, objective.pixels
    low, high = objective.bounds
    best, least = low, math.inf
    for metres in _VISIBILITIES * model.geometry.reference:
        contents = max(model.waters[0].contents_for(0.02, metres), 1e-3)
        for depth in _DEPTHS if model.depth is None else (0.0,):
            numbers = {"contents": math.log(contents), "mixing": 0.5, "vertical_depth": depth}
            theta = np.clip([numbers.get(name, 1.0) for name in model.bounds], low, high)
            if model.gain == "free":
                light = objective.render(theta) * pixels.weights
                along = (light * pixels.observed * pixels.weights).sum((1, 2, 3))
                gains = along / (light * light).sum((1, 2, 3)).clamp(min=1e-300)
                theta[-len(gains) :] = gains.clamp(1e-3, 1e3).numpy()
            cost = float(loss(objective.residual(theta)).sum())
            if cost < least:
                best, least = theta, cost
    return best


def _formed_to_tolerance(fitted: FittedModel[SpectralModel]) -> Array:
    """The covariance of θ from what the default tolerance, .002, puts pictures off: more than the
    noise does, where that is of rounding alone. The medium's curves are known; what blurs are off
    by looks like other widths.
    """
    model, pixels = fitted.model, fitted.objective.pixels
    theta, jacobian = fitted.theta, fitted.solution.jacobian
    exact = model.render(theta, pixels)
    curves = model.render(theta, pixels, _TOLERANCE) - exact
    law = model.point_spread.widened(1.1)
    blurs = replace(model, point_spread=law).render(theta, pixels) - exact
    blurs *= _BLURS_OFF / blurs.square().mean().sqrt().clamp(min=_BLURS_OFF)
    inside = fitted.solution.at_bound == 0
    covariance = np.zeros((len(theta), len(theta)))
    for light in (curves, blurs):
        residual = (pixels.weights * light).flatten().numpy()
        away = np.zeros(len(theta))
        away[inside] = np.linalg.lstsq(jacobian[:, inside], residual, rcond=1e-9)[0]
        covariance += np.outer(away, away)
    return covariance


def _jerlov_types(tried: Sequence[FittedModel[SpectralModel]]) -> tuple[JerlovType, ...]:
    """What is reported of each, best first."""
    order = sorted(tried, key=lambda fitted: fitted.loss)
    rows = []
    for x, common in zip(order, _candidates(order), strict=True):
        visibility, depth = x.model.water(x.theta).visibility(), x.model.vertical_depth(x.theta)
        rows.append(JerlovType(**asdict(common), visibility=visibility, vertical_depth=depth))
    return tuple(rows)


def _require_options(
    noise: Noise | None, pixels: int, seed: int, progress: Progress | None
) -> Progress:
    """Refuse what no fit can do; what to tell of progress, if nothing else, is told to nobody."""
    if noise is not None:
        checks.instance("noise", noise, Noise)
    checks.within("pixels", pixels, *_PIXELS)
    checks.within("seed", seed, 0)
    return progress or (lambda _: None)
