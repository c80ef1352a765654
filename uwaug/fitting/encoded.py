"""Was a haze composed in encoded values, as most published synthesisers do? Fits of light try."""

from dataclasses import replace

from torch import Tensor

from uwaug.fitting.choose import FittedModel
from uwaug.fitting.model import MODELS, CoefficientModel
from uwaug.fitting.solve import Objective, guess, roughly_weighed, solve
from uwaug.formation.colour import linear_to_srgb

_PIXELS = 2000  # that the haze of values is fitted to
_BETTER = 1.05  # times, that is worth a word: pictures of light reached 1.01, hazes of values 1.08


def haze_of_values(chosen: FittedModel[CoefficientModel], gain: bool, seed: int) -> list[str]:
    """The sentence on sRGB values that a haze explains better, taken for light, than the chosen
    model explains the light that they stand for; none if it does not.

    Args:
        chosen: the model that was fitted to linear light.
        gain, seed: of the fit.
    """
    haze = replace(chosen.model, spec=MODELS["haze"], gain=gain)
    if not set(haze.fixed) <= set(haze.fixable) or not haze.bounds:
        return []  # what the caller knows has no place in it
    pixels = chosen.objective.pixels
    is_used = pixels.weights > 0
    clean, observed = linear_to_srgb(pixels.clean), linear_to_srgb(pixels.observed)
    values = replace(pixels, clean=clean, observed=observed, weights=is_used.double(), stacks={})
    few = Objective(haze, roughly_weighed(values).subsample(_PIXELS, seed))
    theta = solve(few, haze.start(guess(few))).theta

    def rms(picture: Tensor) -> float:
        return float((picture - observed)[is_used].square().mean().sqrt())

    of_light = rms(linear_to_srgb(chosen.model.render(chosen.solution.theta, pixels)))
    of_values = rms(haze.render(theta, values))
    if of_light < _BETTER * of_values:
        return []
    return [
        f"A haze that was composed in encoded values fits {of_light / of_values:.2g} times better: "
        f"it is {of_values:.2g} RMS of sRGB values off, this fit {of_light:.2g}. Give "
        'color_space="linear" (--color-space linear), which takes values as they are: numbers '
        "then refer to them. Those here are wrong, and so may be a blur."
    ]
