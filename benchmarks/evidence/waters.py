"""From one water to another: nets trained on labelled crops of one water, tested in others.

    python -m benchmarks.evidence.waters --data FOLDER

*Fish*: is there one in the crop? Trained on half of the places of DeepFish (mangroves, reefs) or on
half of the films of a green fjord; tested on the other half, at home, and on the other set.
*Colours* of buoys: trained on some tanks, tested on others. `benchmarks.evidence.sets` says what a
folder holds; its parts that choose and judge are both used, as nothing is chosen.

Nets see every crop four times: as it is, and three draws of an arm on top, in guessed distances.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import uwaug
from benchmarks.evidence import sets, tasks
from benchmarks.evidence.arms import ARMS, DEFAULTS, Arm, degraded, jitter, none, ours
from benchmarks.evidence.net import answers, keeper, table, trained
from benchmarks.evidence.sets import Crops, Sets
from benchmarks.evidence.tasks import Array
from benchmarks.evidence.training import printed
from benchmarks.harness import save

STEPS = 800  # of 64 crops
DRAWS = 3  # of an arm on top of each crop
AS_THEY_ARE = "as they are"
HOME = "at home"

DIRECTIONS = {"deepfish": ("fjord",), "fjord": ("deepfish",), "buoys": ()}
"""Sets that are trained on, by halves, and the other sets on which their nets are tested."""


def jittered_water() -> Arm:
    """Jitter of what the defaults made."""
    water = ours()

    def arm(images: Tensor, distances: Tensor) -> Tensor:
        return jitter(water(images, distances).clamp(0, 1), distances)

    return arm


def planes() -> Arm:
    """The defaults on planes, whatever distances are guessed."""
    augment = uwaug.RandomUnderwater(distance=(0.5, 4.0))
    return lambda images, distances: augment(images)


ON_TOP: dict[str, Callable[[], Arm]] = {
    AS_THEY_ARE: lambda: none,
    "jitter, blur": ARMS["jitter, blur"],
    "by hand": ARMS["by hand"],
    DEFAULTS: ours,
    "a plane, .5 to 4 m": planes,
    "RandomUnderwater(), then jitter": jittered_water,
}


def half(crops: Crops, which: int) -> Crops:
    """Films that make about half of the crops, and share none with the other half."""
    films, counts = np.unique(crops.films, return_counts=True)
    sizes, of_halves = [0, 0], list[list[Any]]([[], []])
    for place in np.argsort(-counts, kind="stable"):
        least = int(np.argmin(sizes))
        sizes[least] += counts[place]
        of_halves[least].append(films[place])
    chosen = np.isin(crops.films, of_halves[which])
    return Crops(*(None if values is None else values[chosen] for values in crops))


def asked(arm: str, crops: Crops, tests: dict[str, Crops], seed: int) -> dict[str, Array]:
    """Answers of a net that was trained on crops as they are and with an arm on top."""
    torch.manual_seed(seed)
    pool = tasks.fish_pool(crops.images, crops.labels, np.random.default_rng(seed))
    dry, labels = degraded(none, pool, 1, seed)
    wet, of_wet = degraded(ON_TOP[arm](), pool, DRAWS, seed + 1)
    pictures, truth = torch.cat([dry, wet]), torch.cat([labels, of_wet])
    net = trained(pictures, truth, int(truth.max()) + 1, STEPS, seed)
    return {name: answers(net, test, balanced=False) for name, test in tests.items()}


def measured(real: Sets, arms: list[str], nets: int, answered: Path) -> dict[str, Any]:
    """A table for each set that was trained on and each test. Answers are kept in a folder."""
    tables = dict[str, Any]()
    for name, others in DIRECTIONS.items():
        learnt = half(real.crops[name], 0)
        tests = {HOME: half(real.crops[name], 1)} | {other: real.crops[other] for other in others}
        of_tests: dict[str, dict[str, list[Array]]] = {test: {} for test in tests}
        for arm in arms:
            for seed in range(nets):
                path = answered / f"{name}, {arm}, {seed}.npz".replace("/", " ")
                if not path.exists():
                    given: dict[str, Any] = asked(arm, learnt, tests, seed)
                    np.savez(path, **given)
                for test, of_net in np.load(path).items():
                    of_tests[test].setdefault(arm, []).append(of_net)
        for test, of_arms in of_tests.items():
            tables[f"{name} → {test}"] = table(of_arms, tests[test], AS_THEY_ARE)
            printed(f"{name} → {test}", tables[f"{name} → {test}"], AS_THEY_ARE)
    return tables


def main() -> None:
    """From the command line."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--nets", type=int, default=3, help="of each arm")
    parser.add_argument("--arms", nargs="+", choices=ON_TOP, default=list(ON_TOP), metavar="ARM")
    parser.add_argument("--answered", type=Path, help="a folder that keeps what nets answered")
    given = parser.parse_args()
    torch.set_num_threads(1)
    with keeper(given.answered) as folder:
        tables = measured(sets.load(given.data), given.arms, given.nets, folder)
    save("waters", {"nets": given.nets, "steps": STEPS, "tables": tables})


if __name__ == "__main__":
    main()
