"""Fits of one structure after the other to the same pixels."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from uwaug._support.types import Array, ColorSpace
from uwaug.fitting.choice import Tried, tried_of
from uwaug.fitting.noise import Noise, counted, estimated
from uwaug.fitting.one_water import OneWater
from uwaug.fitting.pixels import Pixels, thinned
from uwaug.fitting.solve import Problem, Solution, solve
from uwaug.fitting.start import best_of_starts, guess
from uwaug.fitting.structure import Structure

__all__ = ["Search"]

_ROUGH = Noise(0.01)
"""For a first fit, where the noise is not known."""

_SCOUTS = 4000
"""Pixels of the fits that noise is first learnt from."""

_MUCH = 0.01
"""Of the cost, that a gain must save before it is spoken of."""

_GAIN = 0.02
"""By which it must differ from 1."""

_OUTLYING = 6.0
"""Standard deviations of noise, from where on a residual does not count at all."""

_ROUNDS = 2
"""Of learning the noise: a third changes no number by a tenth of its error."""


class Search(NamedTuple):
    """What all fits have in common.

    Attributes:
        color_space: of the files.
        robust: as of `Problem`.
        seed: of random starts and folds.
        start: where to begin, by name.
        say: is told what is being tried.
        bits: of the observed files; None if they are not rounded.
    """

    color_space: ColorSpace
    robust: bool
    seed: int
    start: Mapping[str, float]
    say: Callable[[str], None]
    bits: int | None

    def weighed(
        self, structures: Sequence[OneWater], drawn: Pixels, noise: Noise | None
    ) -> tuple[Pixels, Noise]:
        """The pixels with weights by the noise: that which is known, or what the residuals of the
        richest structure look like. All candidates are compared with these weights.
        """
        self.say("learning the noise")
        structure, theta = self._richest(structures, self.rough(drawn, noise))
        return self.learnt(structure, theta, drawn, noise)

    def rough(self, drawn: Pixels, noise: Noise | None) -> Pixels:
        """The pixels with weights for a first fit."""
        found = noise or _ROUGH
        return drawn.weighed(drawn.weights / found.deviation(drawn.observed, self.color_space))

    def learnt(
        self,
        structure: Structure,
        theta: Array,
        drawn: Pixels,
        noise: Noise | None,
    ) -> tuple[Pixels, Noise]:
        """The pixels with weights by what a structure, begun at θ, says of them."""
        pixels, found = self.rough(drawn, noise), noise or _ROUGH
        for _ in range(_ROUNDS):
            problem = Problem(structure, pixels, self.robust)
            theta = solve(problem, theta).theta
            light = problem.model(theta)
            if noise is None:
                used = pixels.weights > 0
                error = light - drawn.observed
                found = estimated(error, light, used, self.bits, self.color_space)
            deviation = found.deviation(light, self.color_space)
            inside = counted(light, deviation, self.color_space)
            if self.robust:
                # one-sided ones, such as particles, would pull the veil up for ever
                inside = inside & ((light - drawn.observed).abs() < _OUTLYING * deviation)
            pixels = drawn.weighed(drawn.weights * inside / deviation)
        return pixels, found

    def _richest(self, structures: Sequence[OneWater], pixels: Pixels) -> tuple[OneWater, Array]:
        """The structure of the most numbers, that of two which fits better, and its numbers."""
        few = thinned(pixels, _SCOUTS, np.random.default_rng(self.seed))
        most = max(len(one.bounds) for one in structures)
        rich = [one for one in structures if len(one.bounds) == most]
        ends = [self.begun(Problem(one, few, self.robust)) for one in rich]
        best = int(np.argmin([end.cost for end in ends]))
        return rich[best], ends[best].theta

    def begun(
        self, problem: Problem[OneWater], near: Sequence[Mapping[str, float]] = ()
    ) -> Solution:
        """The best from the guess, from random places around it, and from `near`."""
        structure = problem.structure
        first = guess(structure, problem.pixels)
        numbers = [first, *({**first, **other} for other in near)]
        starts = [structure.begun(one, {}) for one in numbers]
        if self.start:
            starts.insert(0, structure.begun(first, self.start))
        return best_of_starts(problem, starts, self.seed)

    def each(self, structures: Sequence[OneWater], pixels: Pixels) -> list[Tried[OneWater]]:
        """Every structure, fitted, and how well it foretells pixels that were left out."""
        tried: list[Tried[OneWater]] = []
        near: list[dict[str, float]] = []
        for i, structure in enumerate(structures):
            self.say(f"fitting {structure.name!r}, {i + 1} of {len(structures)}")
            problem = Problem(structure, pixels, self.robust)
            solution = self.begun(problem, near[-1:])
            near.append(dict(zip(structure.bounds, solution.theta.tolist(), strict=True)))
            tried.append(tried_of(problem, solution, self.seed))
        return tried

    def gain_of(self, chosen: Tried[OneWater]) -> float | None:
        """The mean gain that would explain the pictures much better, where none was asked for."""
        structure = chosen.structure
        if structure.gain != "fixed":
            return None
        freed = replace(structure, gain="free")
        numbers = dict(zip(structure.bounds, chosen.solution.theta.tolist(), strict=True))
        begin = freed.begun({name: numbers.get(name, 1.0) for name in freed.bounds}, {})
        found = solve(replace(chosen.problem, structure=freed), begin, most=20)
        gains = found.theta[[name.startswith("gain") for name in freed.bounds]]
        better = chosen.solution.cost - found.cost > _MUCH * chosen.solution.cost
        apart = float(np.abs(gains - 1).max()) > _GAIN
        return float(gains.mean()) if better and apart else None
