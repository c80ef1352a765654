"""`fit_series`: one scene at several turbidities, the protocol of a tank."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import Array, ColorSpace
from uwaug.fitting.choice import choose, tried_of
from uwaug.fitting.inputs import bits_of, distances_apart, geometry_of, pairs_of, require_pixels
from uwaug.fitting.noise import Noise
from uwaug.fitting.one_water import OneWater
from uwaug.fitting.pixels import Pixels, gather, thinned
from uwaug.fitting.search import Search
from uwaug.fitting.series_model import SeriesWater
from uwaug.fitting.series_result import SeriesFit, finished_series
from uwaug.fitting.solve import Problem, solve
from uwaug.fitting.structure import MODELS
from uwaug.fitting.threads import one_thread

__all__ = ["fit_series"]

_FEW = 3000
"""Pixels of each level, which say where a series begins."""

_MODELS = ("veil", "gaussian", "exponential")


def fit_series(
    pairs: Sequence[tuple[Tensor, Tensor, Tensor]],
    turbidity: Sequence[float],
    *,
    model: str = "auto",
    mask: Tensor | Sequence[Tensor] | None = None,
    color_space: ColorSpace = "srgb",
    noise: Noise | None = None,
    robust: bool = True,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
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
        mask, color_space, noise, robust, seed, progress, pixels: as for `uwaug.fit`; `pixels` are
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
    checks.one_of("model", model, ("auto", *_MODELS))
    levels, level = _levels(pairs, turbidity)
    clean, observed, distance = (list(column) for column in zip(*pairs, strict=True))
    checked = pairs_of(clean, observed, distance, None, mask, color_space)
    require_pixels(checked)
    distances_apart(checked)
    geometry = geometry_of(checked, None, relative=False)
    structures = []
    for name in _MODELS:
        if model in ("auto", name):
            shape = MODELS[name].shape
            structures.append(SeriesWater(name, shape, geometry, level, len(levels)))
    say = progress or (lambda _: None)
    search = Search(color_space, robust, seed, {}, say, bits_of(observed))
    with one_thread():
        search.say("blurring the clean pictures")
        shapes = sorted({one.shape for one in structures if one.shape is not None})
        drawn = gather(checked, shapes, int(pixels), np.random.default_rng(seed))
        starts = [_start(search, one, search.rough(drawn, noise)) for one in structures]
        search.say("learning the noise")
        weighed, found = search.learnt(structures[-1], starts[-1], drawn, noise)
        tried = []
        for structure, start in zip(structures, starts, strict=True):
            search.say(f"fitting {structure.name!r} to all")
            problem = Problem(structure, weighed, robust)
            tried.append(tried_of(problem, solve(problem, start), seed))
        return finished_series(choose(tried), tried, levels, found, unit)


def _levels(
    pairs: Sequence[Any], turbidity: Sequence[float]
) -> tuple[tuple[float, ...], tuple[int, ...]]:
    """The turbidities in ascending order, and which of them each picture has."""
    if len(pairs) != len(turbidity):
        got = f"{len(turbidity)} for {len(pairs)} pairs"
        raise ValueError(f"turbidity must hold a number for each pair, got {got}")
    for i, value in enumerate(turbidity):
        checks.within(f"turbidity[{i}]", value, 0.0)
    levels = sorted(set(map(float, turbidity)))
    if len(levels) < 2:
        cure = "one water alone is fitted by uwaug.fit"
        raise ValueError(f"turbidity must have at least two values, got {levels}: {cure}")
    for i, pair in enumerate(pairs):
        if not isinstance(pair, (tuple, list)) or len(pair) != 3:
            got = type(pair).__name__
            raise TypeError(f"pairs[{i}] must be (clean, observed, distance), got {got}")
    return tuple(levels), tuple(levels.index(float(value)) for value in turbidity)


def _start(search: Search, structure: SeriesWater, pixels: Pixels) -> Array:
    """Where a series begins: from each level alone."""
    found = []
    for level in range(structure.levels):
        search.say(f"fitting {structure.name!r}, turbidity {level + 1} of {structure.levels} alone")
        rows = [i for i, one in enumerate(structure.level) if one == level]
        geometry = structure.geometry._replace(pairs=len(rows))
        alone = OneWater(MODELS[structure.name], geometry, "fixed", 0.0, {})
        few = thinned(pixels.at(rows), _FEW, np.random.default_rng(search.seed))
        solution = search.begun(Problem(alone, few, search.robust))
        found.append(alone.natural(torch.from_numpy(solution.theta)))
    return structure.begun(found)
