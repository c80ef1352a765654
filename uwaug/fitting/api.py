"""`uwaug.fit`: coefficients from pictures of one scene without water and in it."""

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.threads import one_thread
from uwaug._support.types import ColorSpace
from uwaug.fitting.choose import (
    FittedModel,
    best_of,
    cross_validated,
    one_standard_error_rule,
    result_of,
)
from uwaug.fitting.data import Geometry, Pictures
from uwaug.fitting.encoded import haze_of_values
from uwaug.fitting.model import (
    COLOURS,
    EXPONENTS,
    MODELS,
    NARROW_PX,
    CoefficientModel,
)
from uwaug.fitting.result import Fit, Parameter, straight_line
from uwaug.fitting.solve import Objective, multistart, reweighed, roughly_weighed, solve

Progress = Callable[[str], None]
PIXELS = (500, 100_000)  # that may be fitted
_MAX_KNOWN = 1e6  # of numbers that a caller knows
_NOISE_PIXELS = 4000  # pixels of the fits that noise is first learnt from
_QUIET_SECONDS = 1.0  # s, after which a fit says what it does
_POOR = 0.8  # share of the observed variance, below which a model does not explain a picture
_MAX_BETA = 30.0  # 1/m; no natural water attenuates more


def fit(
    clean: Tensor,
    observed: Tensor,
    distance: Tensor,
    *,
    model: str = "auto",
    fixed: Mapping[str, float] | None = None,
    gain: Literal["fixed", "free"] = "free",
    color_space: ColorSpace = "srgb",
    pixels: int = 20_000,
    seed: int = 0,
    progress: bool | Progress = True,
) -> Fit:
    """Recover a water from pictures of one scene without it and in it.

    Args:
        clean (3xHxW or Bx3xHxW tensor): the scene without water; uint8 (0…255) or floating point
            (0…1). One serves all observed pictures.
        observed (as clean): the scene in the water, aligned with `clean` to the pixel; several
            pictures are of one water and one exposure.
        distance (1xHxW or Bx1xHxW tensor): metres along the ray; pixels that are NaN, 0 or
            negative do not count; +inf is open water.
        model: "haze" (direct light and veil, one coefficient), "veil" (a coefficient for each), and
            with forward scatter and a width law "gaussian" and "exponential". "auto" tries all and
            takes the one of the fewest numbers that foretells pixels which it was not fitted to as
            well as any (one-standard-error rule, on blocks of the picture).
        fixed: numbers that are known, by their names in `Fit.parameters`, such as {"G_red": .3}:
            beta, G, veil of a colour, width, exponent.
        gain: "free": a factor for each colour, of exposure, white balance and daylight that is
            lost above the scene, if left-out pixels are foretold better with it. "fixed": the light
            on the scene, exposure and white balance are those of the clean picture. The factor is
            part of the light and the veil of `Fit.medium`.
        color_space: "srgb": numbers refer to the light that values stand for. "linear": values as
            they are, of linear light, or of a haze that was composed in encoded values, as most
            published synthesisers do; where such a haze fits better, a fit of "srgb" says so.
        pixels: how many are fitted, spread evenly over the distances, 500…100 000.
        seed: of the pixels that are drawn, and of random starts.
        progress: True: lines on stderr of what a fit does that takes longer than a second; False:
            none; or a function that is called with each of them.

    Returns:
        The fit: the medium, numbers, errors, what the pictures cannot tell.

    Raises:
        TypeError, ValueError: if an input does not suit; if fewer than 500 pixels can be used, the
            distances are all alike, or clean and observed are one picture.

    Examples:
        >>> import torch, uwaug
        >>> clean, z = torch.rand(3, 60, 80), torch.linspace(1, 6, 4800).reshape(1, 60, 80)
        >>> beta, veil = (0.5, 0.2, 0.3), (0.1, 0.3, 0.4)
        >>> water = uwaug.Medium.from_coefficients(beta, beta, veil)
        >>> observed = uwaug.Underwater(water)(clean, z)
        >>> fit = uwaug.fit(clean, observed, z, model="haze", progress=False)
        >>> round(fit.parameters["beta_red"].value, 2)
        0.5
    """
    checks.one_of("model", model, ("auto", *MODELS))
    checks.one_of("gain", gain, ("fixed", "free"))
    say = checked_options(pixels, seed, progress)
    pictures = Pictures.of(clean, observed, distance, color_space)
    models = _models(model, pictures.geometry, fixed or {}, gain=gain == "free")
    # a medium that is made in inference mode could not be trained
    with one_thread(), torch.inference_mode(False), torch.no_grad():
        say("blurring the clean picture")
        shapes = sorted({x.spec.shape for x in models if x.spec.shape is not None})
        drawn = pictures.sample(shapes, int(pixels), seed)
        say("learning the noise")
        few = roughly_weighed(drawn).subsample(_NOISE_PIXELS, seed)
        most = max(len(x.bounds) for x in models)
        scouts = [Objective(x, few) for x in models if len(x.bounds) == most]
        ends = [(x.model, multistart(x, seed=seed)) for x in scouts]
        richest, end = min(ends, key=lambda pair: pair[1].cost)
        roughly = Objective(richest, roughly_weighed(drawn))
        weighed, theta = reweighed(roughly, end.theta, pictures.clips)
        tried: list[FittedModel[CoefficientModel]] = []
        for i, candidate in enumerate(models):
            say(f"fitting {candidate.name!r}, {i + 1} of {len(models)}")
            objective = Objective(candidate, weighed)
            solution = solve(objective, theta) if candidate is richest else None
            # one that explains less than fewer numbers do has gone astray
            if solution is None or any(x.solution.cost < solution.cost for x in tried):
                near = [x.numbers for x in tried[-1:]]
                solution = multistart(objective, near, seed)
            tried.append(cross_validated(objective, solution, seed))
        chosen = one_standard_error_rule(tried)
        if chosen.model.gain:
            say("fitting without a gain")
            objective = Objective(replace(chosen.model, gain=False), weighed)
            solution = multistart(objective, [chosen.numbers], seed)
            tried.append(cross_validated(objective, solution, seed))
            chosen = one_standard_error_rule([chosen, tried[-1]])
        composed = []
        if color_space == "srgb":
            say("trying encoded values")
            composed = haze_of_values(chosen, gain == "free", seed)
        medium = chosen.model.medium(chosen.solution.theta)
        result = result_of(chosen, tried, chosen.model.spec.name, medium, pictures)
    doubts = _doubts(chosen, result.parameters)
    return replace(result, notes=(*_chosen(chosen, tried), *composed, *result.notes, *doubts))


def checked_options(pixels: int, seed: int, progress: bool | Progress) -> Progress:
    """Refuse what no fit can do; where to say what is being done."""
    checks.within("pixels", pixels, *PIXELS)
    checks.within("seed", seed, 0)
    if callable(progress):
        return progress
    began = time.monotonic()

    def say(line: str) -> None:
        if progress and time.monotonic() - began > _QUIET_SECONDS:
            print(f"uwaug: {line}", file=sys.stderr, flush=True)

    return say


def _models(
    name: str, geometry: Geometry, fixed: Mapping[str, float], *, gain: bool
) -> list[CoefficientModel]:
    """The candidates in which all that is fixed has a place."""
    if not isinstance(fixed, Mapping):
        raise TypeError(f"fixed must be a dict of numbers, got {type(fixed).__name__}")
    all_of_them = [
        CoefficientModel(spec, geometry, gain, {})
        for spec in MODELS.values()
        if name in ("auto", spec.name)
    ]
    models = [x for x in all_of_them if set(fixed) <= set(x.fixable)]
    if not models:
        some = ", ".join(all_of_them[-1].fixable)
        raise ValueError(f"fixed: expected some of {some}, got {', '.join(map(str, fixed))}")
    for key, value in fixed.items():
        least = EXPONENTS[0] if key == "exponent" else 0.0
        most = {"width": geometry.widest, "exponent": EXPONENTS[1]}.get(key, _MAX_KNOWN)
        checks.within(f"fixed[{key!r}]", value, least, most)
    for colour in COLOURS:
        beta, G = fixed.get(f"beta_{colour}"), fixed.get(f"G_{colour}")
        if beta is not None and G is not None and beta < G:
            models = [x for x in models if x.spec.shape is None]
    numbers = {key: float(value) for key, value in fixed.items()}
    models = [replace(x, fixed=numbers) for x in models]
    models = [x for x in models if x.bounds]
    if not models:
        raise ValueError(f"fixed: leaves nothing that may be fitted, got {dict(fixed)}")
    return models


def _chosen(
    chosen: FittedModel[CoefficientModel], tried: Sequence[FittedModel[CoefficientModel]]
) -> list[str]:
    """Which model it is, and how well it explains the pictures."""
    best, choice = best_of(tried), ""
    if len(tried) > 1:
        choice = " It foretells left-out pixels best."
        if best is not chosen:
            name = best.model.name
            choice = f" The fewest numbers within one standard error of the best, {name!r}."
    poor = ""
    if chosen.explained < _POOR:
        poor = " That is little: are the pictures aligned, of one scene, and in metres?"
    return [
        f"Model {chosen.model.name!r}: {chosen.model.spec.words}.{choice}",
        f"The residual is {chosen.rms:.2g} RMS of linear light; {100 * chosen.explained:.4g} % of "
        f"the variance of the observed pixels is explained.{poor}",
    ]


def _doubts(chosen: FittedModel[CoefficientModel], numbers: Mapping[str, Parameter]) -> list[str]:
    """What the numbers do not say by themselves."""
    model, theta = chosen.model, chosen.solution.theta
    c, geometry, sentences = model.coefficients(theta), model.geometry, []
    if model.spec.shape is None:
        sentences.append(
            "Without a blur, direct light and light that is scattered forward are one: beta is the "
            "attenuation of both together, and G at least; that of the direct light alone, β of "
            "the water, may be larger."
        )
    elif c.width < NARROW_PX:
        sentences.append(
            f"A blur below {NARROW_PX} px is hardly told from none, and with it what is scattered "
            "forward from what is not; G and veil do not depend on it."
        )
    else:
        sentences.append(f"Width law: {model.medium(theta).point_spread}, at b̄ of the medium.")
    rates = {
        colour: float(G)
        for colour, G in zip(COLOURS, c.G, strict=True)
        if numbers[f"veil_{colour}"].value is None
    }
    sentences += straight_line(rates, geometry.farthest)
    if c.beta.max() > _MAX_BETA:
        sentences.append(f"β reaches {c.beta.max():.3g}/m: are the distances in metres?")
    if not chosen.solution.converged:
        sentences.append("The fit stopped before it settled: fix what is known.")
    return sentences
