"""Test for a haze that was composed in encoded values, as most published synthesisers do."""

from dataclasses import replace

from torch import Tensor

from uwaug.fitting.choose import FittedModel
from uwaug.fitting.model import MODELS, CoefficientModel
from uwaug.fitting.solve import Objective, guess, roughly_weighed, solve
from uwaug.formation.colour import linear_to_srgb

_HAZE_PIXELS = 2000  # pixels of the fit of encoded values
# Ratio of residuals that is worth a note; pictures of light reached 1.01, hazes of values 1.08.
_MIN_RATIO = 1.05


def encoded_haze_notes(winner: FittedModel[CoefficientModel], gain: bool, seed: int) -> list[str]:
    """A note if a haze that is fitted to the sRGB values explains them better than the winner."""
    haze = replace(winner.model, spec=MODELS["haze"], gain=gain)
    if not set(haze.fixed) <= set(haze.fixable) or not haze.bounds:
        return []  # a haze has no place for the fixed numbers
    pixels = winner.objective.pixels
    is_used = pixels.weights > 0
    clean, observed = linear_to_srgb(pixels.clean), linear_to_srgb(pixels.observed)
    values = replace(pixels, clean=clean, observed=observed, weights=is_used.double(), stacks={})
    objective = Objective(haze, roughly_weighed(values).subsample(_HAZE_PIXELS, seed))
    theta = solve(objective, haze.start(guess(objective))).theta

    def rms(picture: Tensor) -> float:
        return float((picture - observed)[is_used].square().mean().sqrt())

    of_light = rms(linear_to_srgb(winner.model.render(winner.solution.theta, pixels)))
    of_values = rms(haze.render(theta, values))
    if of_light < _MIN_RATIO * of_values:
        return []
    return [
        f"A haze that was composed in encoded values fits {of_light / of_values:.2g} times better: "
        f"it is {of_values:.2g} RMS of sRGB values off, this fit {of_light:.2g}. Give "
        'color_space="linear" (--color-space linear), which takes values as they are: numbers '
        "then refer to them. Those here are wrong, and so may be a blur."
    ]
