"""How good are maps made up from pictures? `python -m benchmarks.depth.measures --pairs FOLDER …`.

Against measured maps (`pairs.py`) of sources that the network has not seen: rank correlation, pairs
of pixels in order, steps where the truth is calm, open water where something is near; and time.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.stats import spearmanr
from torch import Tensor

from benchmarks.depth import pairs
from uwaug import RandomUnderwater
from uwaug._support.ranges import as_range
from uwaug.distance import cue
from uwaug.distance.made_up import MadeUp

Array = np.ndarray[Any, Any]
Way = Callable[[Tensor, int], Array]
"""A picture (3xHxW bytes) and a seed to distances (HxW; inf is open water)."""

_STEP = 0.06
"""Of a map's span, from pixel to pixel: a step."""

_CALM = 0.08
"""Of the true map's span, over 7 px, below which it is calm."""


def made_up(source: MadeUp) -> Way:
    """Distances of `MadeUp`, drawn as `RandomUnderwater` draws them."""

    def way(picture: Tensor, seed: int) -> Array:
        rng = np.random.default_rng(seed)
        ends = {name: as_range(name, value) for name, value in source.ranges().items()}
        numbers = {name: float(rng.uniform(*pair)) for name, pair in ends.items()}
        return source.metres(None, picture, numbers)[0].double().numpy()

    return way


def ramp(picture: Tensor, seed: int) -> Array:
    """Far above, near below."""
    height, width = picture.shape[1:]
    return np.exp(np.linspace(1.8, 0, height))[:, None].repeat(width, 1)


def by_weights(weights: dict[str, tuple[Tensor, Tensor]]) -> Way:
    """What a network says, without anything random: open water only where it is sure."""

    def way(picture: Tensor, seed: int) -> Array:
        log, is_open = cue.relative(cue.small_copy(picture) / 255, weights)
        size = picture.shape[1:]
        log, is_open = (
            torch.nn.functional.interpolate(x[None, None], size, mode="bilinear")[0, 0].numpy()
            for x in (log, is_open)
        )
        return np.where(is_open > 0.5, np.inf, np.exp(log))

    return way


def _steps(values: Array) -> Array:
    """To the next row or column, the larger."""
    down = np.abs(np.diff(values, axis=0, append=values[-1:]))
    across = np.abs(np.diff(values, axis=1, append=values[:, -1:]))
    return np.maximum(down, across)


def compared(pair: pairs.Pair, z: Array, rng: np.random.Generator) -> dict[str, float]:
    """A map (HxW) beside the measured one, by name."""
    is_measured, water = np.isfinite(pair.log), np.isinf(z)
    behind = 1.5 * z[~water].max() if (~water).any() else 1.0
    log = np.log(np.where(water, behind, z))
    guess, truth = log[is_measured], pair.log[is_measured]
    rank = float(spearmanr(guess, truth).statistic) if np.ptp(guess) > 1e-9 else 0.0
    first, second = rng.integers(0, truth.size, (2, 3000))
    apart, guessed = truth[first] - truth[second], guess[first] - guess[second]
    ordered = np.where(np.abs(guessed) < 1e-9, 0.5, np.sign(guessed) == np.sign(apart))

    span = np.ptp(np.percentile(log, (2, 98)))
    steps = _steps(log / span) > _STEP if span > 1e-3 else np.zeros_like(is_measured)
    largest = maximum_filter(np.where(is_measured, pair.log, -np.inf), 7)
    smallest = minimum_filter(np.where(is_measured, pair.log, np.inf), 7)
    calm = is_measured & (largest - smallest < _CALM * np.ptp(np.percentile(truth, (2, 98))))
    false = steps & calm & (minimum_filter(is_measured, 7) > 0)
    near = np.where(is_measured, pair.log, np.inf) < np.quantile(truth, 0.75)
    return {
        "rank": rank,
        "pairs": float(ordered[np.abs(apart) > np.log(1.05)].mean()),
        "false steps, %": 100 * float(false.mean() / max(calm.mean(), 0.05)),
        "wrong open water, %": 100 * float((water & near).sum() / is_measured.sum()),
    }


def judged(way: Way, some: list[pairs.Pair], seeds: int = 1) -> dict[str, Any]:
    """Means over sources, of means over their pictures; and the rank by source."""
    sources: dict[str, list[dict[str, float]]] = {}
    for number, pair in enumerate(some):
        picture = torch.from_numpy(pair.picture.copy()).permute(2, 0, 1)
        for seed in range(seeds):
            z = way(picture, 1000 * number + seed)
            row = compared(pair, z, np.random.default_rng(number))
            sources.setdefault(pair.source, []).append(row)
    means = {
        source: {key: float(np.nanmean([row[key] for row in rows])) for key in rows[0]}
        for source, rows in sources.items()
    }
    keys = next(iter(means.values()))
    averages = {key: round(float(np.mean([row[key] for row in means.values()])), 3) for key in keys}
    return {
        **averages,
        "by source": {source: round(row["rank"], 2) for source, row in means.items()},
    }


def milliseconds(side: int, rounds: int = 30) -> tuple[float, float]:
    """Of `MadeUp` for a picture of so many pixels in the square, and of a draw with its map, turn
    by turn; medians.
    """
    from skimage.data import astronaut

    picture = torch.from_numpy(astronaut().copy()).permute(2, 0, 1)[None].float()
    picture = torch.nn.functional.interpolate(picture, (side, side), mode="bilinear")[0].byte()
    way, augment, spent = MadeUp(), RandomUnderwater(), []
    for number in range(-3, rounds):  # the first ones load the loops
        numbers = {"near": 1.0, "far": 8.0, "scene": number % rounds / rounds}
        began = time.perf_counter()
        z = way.metres(None, picture, numbers)
        made = time.perf_counter()
        augment(picture, z)
        spent.append((1000 * (made - began), 1000 * (time.perf_counter() - made)))
    distances, pictures = np.median(spent[3:], axis=0)
    return float(distances), float(pictures)


def ways() -> dict[str, tuple[Way, int]]:
    """Ways to make up maps, and the number of draws of each picture, by name."""
    return {
        "vertical ramp": (ramp, 1),
        "network alone": (by_weights(cue.learnt()), 1),
        "MadeUp()": (made_up(MadeUp(1.0, 8.0)), 4),
        'MadeUp(cue="ramp")': (made_up(MadeUp(1.0, 8.0, cue="ramp")), 4),
    }


def main(
    quick: bool,
    folders: tuple[Path, ...] = (),
    only: tuple[str, ...] = (),
) -> None:
    """Print the table."""
    torch.set_num_threads(1)
    some = [pair for folder in folders for pair in pairs.read(folder)]
    some = [pair for pair in some if not only or pair.source in only]
    for name, (way, seeds) in ways().items() if some else ():
        print(name, judged(way, some[::20] if quick else some, seeds), flush=True)
    for side in (512, 1024):
        distances, pictures = milliseconds(side, 5 if quick else 30)
        print(f"{side}²: {distances:.1f} ms, and {pictures:.1f} ms for a draw with the map")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="little of everything")
    parser.add_argument("--pairs", type=Path, nargs="*", default=(), help="folders of pairs")
    parser.add_argument("--sources", nargs="*", default=(), help="some of them, by name")
    given = parser.parse_args()
    main(given.quick, tuple(given.pairs), tuple(given.sources))
