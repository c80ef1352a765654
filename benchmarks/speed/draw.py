"""A default draw by the loops: calls of functions of the package, files in which they lie, and its
processor time beside the published recipe's, at three sizes, in one process on one thread.

`python -m benchmarks.speed.draw` writes results/draw.json and prints the figures.
"""

import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

import uwaug
from benchmarks.harness import command, loops, save, scene, use_threads
from benchmarks.speed.throughput import Recipe, warm

PACKAGE = str(Path(uwaug.__file__).parent)
DRAWS = {256: 8, 512: 4, 1024: 2}
"""Draws of a turn, beside one picture by the recipe."""


def calls(count: int = 60) -> dict[str, float]:
    """Medians of some warm draws: calls of functions of the package, files in which they lie."""
    image, distance = (values[0] for values in scene(256))
    picture, augment = (image * 255).byte(), uwaug.RandomUnderwater()
    warm(augment, picture, distance)
    called: list[list[str]] = []

    def counted(frame: Any, event: str, argument: object) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(PACKAGE):
            called[-1].append(frame.f_code.co_filename)

    for index in range(count):
        called.append([])
        sys.setprofile(counted)
        try:
            augment.at(0, 0, index)(picture, distance)
        finally:
            sys.setprofile(None)
    numbers = {"calls": map(len, called), "files": map(len, map(set, called))}
    return {name: float(np.median([*values])) for name, values in numbers.items()}


def beside_recipe(size: int, turns: int) -> dict[str, Any]:
    """Quartiles of processor time, ms, of draws (of bytes) and of the recipe (of float32) in turn;
    and the ratio of the medians.
    """
    image, distance = (values[0] for values in scene(size))
    picture, augment, recipe = (image * 255).byte(), uwaug.RandomUnderwater(), Recipe()
    warm(augment, picture, distance)
    taken: dict[str, list[float]] = {"recipe": [], "draw": []}
    for turn in range(turns):
        draws = [augment.at(0, turn, n) for n in range(DRAWS[size])]
        runs = [("recipe", partial(recipe, image)), *(("draw", partial(d, picture)) for d in draws)]
        for name, run in runs:
            began = time.process_time()
            run(distance)
            taken[name].append(1e3 * (time.process_time() - began))
    ms = {name: np.percentile(times, (25, 50, 75)).tolist() for name, times in taken.items()}
    ratio = ms["recipe"][1] / ms["draw"][1]
    medians = f"draw {ms['draw'][1]:.1f} ms, recipe {ms['recipe'][1]:.1f} ms"
    print(f"{size}²: {medians}: {ratio:.1f} times as fast", flush=True)
    return {"ms": ms, "recipe / draw": ratio}


def main(quick: bool = False) -> None:
    """Run all parts and save the figures."""
    use_threads(1)
    torch.manual_seed(0)  # the same draws each time
    with torch.no_grad(), loops(True):
        counts = calls(3 if quick else 60)
        print(f"a draw: {counts['calls']:g} calls in {counts['files']:g} files", flush=True)
        sizes = {size: beside_recipe(size, 1 if quick else 30) for size in DRAWS}
    if not quick:
        print(save("draw", {**counts, "sizes": sizes}))


if __name__ == "__main__":
    command(main, __doc__)
