"""From the model that was chosen to what is reported."""

from collections.abc import Sequence

import torch

from uwaug.fitting.choice import Tried
from uwaug.fitting.noise import Noise
from uwaug.fitting.pixels import Pair
from uwaug.fitting.report import correlation, parameters_of
from uwaug.fitting.result import Candidate, Correlation, Fit
from uwaug.fitting.structure import OneWater
from uwaug.fitting.uncertainty import spread
from uwaug.fitting.verdict import verdict

__all__ = ["finished"]


def finished(chosen: Tried, tried: list[Tried], noise: Noise, pairs: Sequence[Pair]) -> Fit:
    """The fit of `chosen`, one of `tried`."""
    problem, solution = chosen.problem, chosen.solution
    structure = problem.structure
    assert isinstance(structure, OneWater)
    found = spread(problem, solution)
    parameters = parameters_of(problem, solution, found)
    explained, rms = _explained(chosen)
    best = min(tried, key=lambda one: float(one.losses.sum()))
    candidates = []
    for one in tried:
        behind = one.behind(best)
        candidates.append(Candidate(one.name, len(one.solution.theta), one.error, *behind))
    return Fit(
        model=chosen.name,
        parameters=parameters,
        correlation=Correlation(*correlation(structure, solution, found)),
        candidates=tuple(candidates),
        message=verdict(chosen, tried, parameters, found, explained, rms),
        noise=noise,
        rms=rms,
        history=solution.history,
        structure=structure,
        theta=solution.theta,
        covariance=found.covariance,
        pairs=tuple(pairs),
    )


def _explained(chosen: Tried) -> tuple[float, float]:
    """The share of the observed variance that the model explains, and the RMS of the residual."""
    pixels = chosen.problem.pixels
    used = pixels.weights > 0
    residual = (chosen.problem.model(chosen.solution.theta) - pixels.observed)[used]
    variance = 0.0
    for channel in range(3):
        values = pixels.observed[:, channel][used[:, channel]]
        variance += float(((values - values.mean()) ** 2).sum()) if values.numel() else 0.0
    squares = float((residual**2).sum())
    share = 1 - squares / variance if variance > 0 else 0.0
    return share, float(torch.sqrt((residual**2).mean()))
