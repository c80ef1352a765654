"""From the model that was chosen to what is reported."""

from collections.abc import Sequence
from typing import Any

import torch

from uwaug.fitting.choice import Tried, best_of
from uwaug.fitting.noise import Noise
from uwaug.fitting.one_water import OneWater
from uwaug.fitting.pixels import Pair
from uwaug.fitting.report import Candidate, correlation, parameters_of
from uwaug.fitting.result import Fit
from uwaug.fitting.uncertainty import spread
from uwaug.fitting.verdict import verdict

__all__ = ["candidates_of", "explained", "finished"]


def finished(
    chosen: Tried[OneWater],
    tried: list[Tried[OneWater]],
    noise: Noise,
    pairs: Sequence[Pair],
    gain: float | None,
) -> Fit:
    """The fit of `chosen`, one of `tried`; gain: that would explain the pictures better."""
    problem, solution = chosen.problem, chosen.solution
    structure = chosen.structure
    found = spread(problem, solution)
    parameters = parameters_of(problem, solution, found)
    share, rms = explained(chosen)
    return Fit(
        model=structure.model.name,
        parameters=parameters,
        correlation=correlation(structure, solution, found),
        candidates=candidates_of(tried),
        message=verdict(chosen, tried, parameters, found, share, rms, gain),
        noise=noise,
        rms=rms,
        history=solution.history,
        structure=structure,
        theta=solution.theta,
        covariance=found.covariance,
        pairs=tuple(pairs),
    )


def candidates_of(tried: Sequence[Tried[Any]]) -> tuple[Candidate, ...]:
    """What is reported of each."""
    best = best_of(tried)
    found = []
    for one in tried:
        behind = one.behind(best)
        found.append(Candidate(one.name, len(one.solution.theta), one.error, *behind))
    return tuple(found)


def explained(chosen: Tried[Any]) -> tuple[float, float]:
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
