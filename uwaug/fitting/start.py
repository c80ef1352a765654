"""Where a fit begins: from the best of a coarse grid, and from places near it."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import Array
from uwaug.fitting.model import Natural, rendered
from uwaug.fitting.one_water import OneWater
from uwaug.fitting.pixels import Pixels, thinned
from uwaug.fitting.solve import Problem, Solution, scouted, solve
from uwaug.fitting.structure import COLOURS

__all__ = ["best_of_starts", "guess"]

_DEPTHS = np.geomspace(0.05, 12.0, 24)
"""Optical depths β·z at the reference distance."""

_SHARES = (0.1, 0.3, 0.6, 1.0)
"""Of G in β."""

_FEW = 2000
"""Pixels that decide between starts."""

_APART = 0.5
"""Of random starts: each number is multiplied by up to e^±_APART."""


def best_of_starts(
    problem: Problem[OneWater], starts: list[Array], seed: int, more: int = 1
) -> Solution:
    """The least cost from any of `starts` and from `more` places around the first of them.

    Few pixels decide which, all of them where it ends. From there each colour is guessed once more,
    with the width law that was found: a colour that was taken for opaque, a veil and no scene, has
    nothing to call it back (1 start in 9 ended so).
    """
    rng = np.random.default_rng(seed)
    low, high = problem.limits
    for _ in range(more):
        factor = np.exp(rng.uniform(-_APART, _APART, len(low)))
        starts = [*starts, np.clip(starts[0] * factor, low, high)]
    few = replace(problem, pixels=thinned(problem.pixels, _FEW, rng))
    ends = [solve(few, scouted(few, start), most=20) for start in starts]
    nearest = min(ends, key=lambda end: end.cost)
    structure = problem.structure
    numbers = dict(zip(structure.bounds, nearest.theta.tolist(), strict=True))
    again = structure.begun(guess(structure, few.pixels, numbers), {})
    nearest = min(nearest, solve(few, again, most=20), key=lambda end: end.cost)
    found = solve(problem, nearest.theta)
    return replace(found, history=[*nearest.history, *found.history])


def guess(
    structure: OneWater, pixels: Pixels, known: Mapping[str, float] | None = None
) -> dict[str, float]:
    """For each colour, the best of a grid of β and G/β, whose veil follows by linear least squares;
    everything else as it is known, or at its beginning.
    """
    numbers = {name: one.begin for name, one in structure.bounds.items()}
    numbers |= known or {}
    few = thinned(pixels, _FEW // 2, np.random.default_rng(0))
    beta = torch.from_numpy(_DEPTHS / structure.geometry.reference)
    shares = _SHARES if structure.model.veil == "own" else (1.0,)
    costs, sources = [], []
    for share in shares:
        one, two = _columns(structure, few, beta, share, numbers)
        cost, source = _fitted(one, two, few, veil_wanted=structure.model.veil != "none")
        costs.append(cost)
        sources.append(source)
    cost, source = torch.stack(costs), torch.stack(sources)  # (shares, rates, 3)
    for c, colour in enumerate(COLOURS):
        place = int(cost[..., c].argmin())
        i, k = place // len(beta), place % len(beta)
        numbers[f"beta_{colour}"] = float(beta[k])
        numbers[f"share_{colour}"] = shares[i]
        numbers[f"source_{colour}"] = float(source[i, k, c])
    return numbers


def _columns(
    structure: OneWater,
    pixels: Pixels,
    beta: Tensor,
    share: float,
    numbers: Mapping[str, float],
) -> tuple[Tensor, Tensor]:
    """What the picture is a sum of, for each β: the scene as it is seen, and a veil that grows by
    1 per metre (ratesxPx3x1xN).
    """
    pairs = len(pixels)
    like = torch.tensor([numbers[name] for name in structure.bounds], dtype=torch.float64)
    around = structure.natural(like)
    scenes, veils = [], []
    for rate in beta:
        b = rate.expand(pairs, 3)
        natural = Natural(
            beta=b,
            G=share * b,
            source=torch.zeros_like(b),
            width=around.width,
            exponent=around.exponent,
            gain=around.gain,
        )
        scene = rendered(natural, pixels, structure.shape)
        both = rendered(natural._replace(source=torch.ones_like(b)), pixels, structure.shape)
        scenes.append(scene)
        veils.append(both - scene)
    return torch.stack(scenes), torch.stack(veils)


def _fitted(
    scene: Tensor, veil: Tensor, pixels: Pixels, *, veil_wanted: bool
) -> tuple[Tensor, Tensor]:
    """The least cost of each β and colour, and the source that gives it (both ratesx3)."""
    w = pixels.weights**2
    left = pixels.observed - scene

    def total(value: Tensor) -> Tensor:
        return (w * value).sum((1, 3, 4))

    source = torch.zeros_like(total(left))
    if veil_wanted:
        source = (total(veil * left) / total(veil * veil).clamp(min=1e-300)).clamp(min=0.0)
    error = left - source[:, None, :, None, None] * veil
    return total(error * error), source
