"""`uwaug.fit`: coefficients from pictures of one scene without water and in it."""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.threads import one_thread
from uwaug._support.types import ColorSpace
from uwaug.fitting import choose
from uwaug.fitting.choose import FittedModel
from uwaug.fitting.data import Pictures
from uwaug.fitting.errors import straight_line
from uwaug.fitting.model import MODELS, NARROW_PX, CoefficientModel, Coefficients
from uwaug.fitting.result import Fit
from uwaug.fitting.solve import Objective, multistart, reweighed
from uwaug.formation.setting import Setting

_PIXEL_COUNTS = (500, 100_000)  # least and most pixels of a fit
_NOISE_PIXELS = 4000  # pixels from which the noise is first estimated
_QUIET_SECONDS = 1.0  # s, before progress is printed
_MAX_BETA = 30.0  # 1/m; no natural water attenuates more


def fit(
    clean: Tensor,
    observed: Tensor,
    distance: Tensor,
    *,
    model: str = "auto",
    gain: Literal["fixed", "free"] = "free",
    color_space: ColorSpace = "srgb",
    jpeg: int | None = None,
    pixels: int = 20_000,
    seed: int = 0,
    progress: bool = True,
) -> Fit:
    """Recover a water from pictures of one scene without it and in it.

    Args:
        clean (3xHxW or Bx3xHxW tensor): the scene without water; uint8 or 0…1; one serves all.
        observed (as clean): the scene in one water and exposure, aligned with `clean` to the pixel.
        distance (1xHxW or Bx1xHxW tensor): metres along the ray; pixels that are NaN, 0 or
            negative do not count; +inf is open water.
        model: "haze" (direct light and veil, one coefficient), "veil" (a coefficient for each), or
            "gaussian" and "exponential" (forward scatter with a width law, too). "auto": the one
            with the fewest numbers that predicts left-out blocks of the picture as well as any; of
            "haze" and "veil" alone where the short side has four pixels or less.
        gain: "free": each colour gets a factor for exposure, white balance and daylight lost above
            the scene, if left-out pixels are predicted better with it. "fixed": there is none.
        color_space: "srgb": values are decoded to linear light. "linear": they are taken as is.
        jpeg: quality, 1…100, of the JPEG file that `observed` was; its loss then counts as error.
        pixels: number of pixels to fit, spread evenly over the distances, 500…100 000.
        seed: of the choice of pixels.
        progress: True prints on stderr what a fit of more than a second is doing.

    Raises:
        TypeError, ValueError: if an input does not suit; if fewer than 50 pixels can be used, the
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
    say = checked_options(pixels, seed, progress=progress)
    pictures = Pictures.of(clean, observed, distance, color_space, jpeg)
    specs = [spec for name, spec in MODELS.items() if model in ("auto", name)]
    if model == "auto" and pictures.geometry.widest <= NARROW_PX:
        specs = [spec for spec in specs if spec.shape is None]
    models = [CoefficientModel(spec, pictures.geometry, gain == "free") for spec in specs]
    # a medium that is made in inference mode could not be trained
    with one_thread(), torch.inference_mode(False), torch.no_grad():
        say("blurring the clean picture")
        shapes = sorted({x.spec.shape for x in models if x.spec.shape is not None})
        sample = pictures.sample(shapes, int(pixels), seed)
        say("learning the noise")
        subset = sample.subsample(_NOISE_PIXELS, seed)
        size = max(len(x.bounds) for x in models)
        scouts = [Objective(x, subset) for x in models if len(x.bounds) == size]
        ends = [(x.model, multistart(x, seed=seed)) for x in scouts]
        richest, end = min(ends, key=lambda pair: pair[1].cost)
        weighed, theta = reweighed(Objective(richest, sample), end.theta, pictures.clips)
        candidates: list[FittedModel[CoefficientModel]] = []

        def fitted(model: CoefficientModel) -> FittedModel[CoefficientModel]:
            say(f"fitting {model.name!r}")
            objective = Objective(model, weighed)
            # a richer model is to explain no less than a simpler one
            hints = [dict(zip(richest.bounds, theta.tolist(), strict=True))]
            hints += [x.numbers for x in candidates[-1:]]
            solution = multistart(objective, hints, seed)
            candidates.append(choose.cross_validated(objective, solution, seed))
            return candidates[-1]

        winner = choose.one_standard_error_rule([fitted(model) for model in models])
        if winner.model.gain:
            without = fitted(replace(winner.model, gain=False))
            winner = choose.one_standard_error_rule([winner, without])
        coefficients = winner.model.coefficients(winner.solution.theta)
        setting = Setting(winner.model.medium(coefficients), color_space=color_space)
        result = choose.result_of(winner, candidates, setting, pictures)
    notes = (*_notes(winner.model, coefficients, result), *result.notes)
    return replace(result, model=winner.model.spec.name, notes=notes)


def checked_options(pixels: int, seed: int, *, progress: bool) -> Callable[[str], None]:
    """Check options; the function that tells the progress."""
    checks.within("pixels", pixels, *_PIXEL_COUNTS)
    checks.within("seed", seed, 0)
    began = time.monotonic()

    def say(line: str) -> None:
        if progress and time.monotonic() - began > _QUIET_SECONDS:
            print(f"uwaug: {line}", file=sys.stderr, flush=True)

    return say


def _notes(model: CoefficientModel, c: Coefficients, fit: Fit) -> list[str]:
    """Sentences on the model, and on what it takes for one."""
    best, reason = min(fit.candidates, key=lambda candidate: candidate.behind), ""
    if not best.chosen:
        reason = f" The fewest numbers within one standard error of the best, {best.name!r}."
    elif len(fit.candidates) > 1:
        reason = " It foretells left-out pixels best."
    sentences = [
        f"Model {model.name!r}: {model.spec.words}.{reason}",
        f"The residual is {fit.rms:.2g} RMS of linear light.",
    ]
    if model.spec.shape is None:
        sentences.append(
            "Without a blur, direct light and light that is scattered forward are one: beta is the "
            "attenuation of both; that of the direct light alone, β of the water, may be larger."
        )
    elif c.width < NARROW_PX:
        sentences.append(
            f"A blur below {NARROW_PX} px is hardly told from none, and with it what is scattered "
            "forward from what is not; G and veil do not depend on it."
        )
    else:
        sentences.append(f"Width law: {model.medium(c).width_law}, at b̄ of the medium.")
    if c.beta.max() > _MAX_BETA:
        sentences.append(f"β reaches {c.beta.max():.3g}/m: are the distances in metres?")
    return sentences + straight_line(fit.parameters, c.G, model.geometry.farthest)
