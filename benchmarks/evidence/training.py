"""Does training with uwaug help on real underwater pictures? Two tasks with a truth.

    python -m benchmarks.evidence --data FOLDER     all arms, three seeds, about an hour on one core
    python -m benchmarks.evidence --colours         painted balls in draws, beside real buoys
    python -m benchmarks.evidence --quick           a little of both, on made-up pictures

*Colour*: which of three colours has a buoy; trained on painted balls in photographs of land.
*Fish*: is there one in the crop; trained on aquaria, tested on wild water. Each test set is split
by place or film into a part that chooses and one that judges, by a checksum of its name: pick
variants by "choose", tell "judge". `benchmarks.evidence.sets` says where the sets are.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import nn

from benchmarks.evidence import colours, sets, stand_ins, tasks
from benchmarks.evidence.arms import ARMS, DEFAULTS, degraded
from benchmarks.evidence.net import answers, table, trained
from benchmarks.evidence.sets import Crops
from benchmarks.evidence.tasks import Pool
from benchmarks.harness import save

SEEDS = 3
BALLS = 4000
STEPS = {"colour": 500, "fish": 400}
PARTS = ("choose", "judge")


def main(quick: bool = False, data: Path | None = None) -> dict[str, Any]:
    """Train, score, print; saved only where the public sets are there."""
    torch.set_num_threads(1)
    if data is not None:
        sets.require(data)
        found = measured(data, SEEDS, BALLS, STEPS, list(ARMS))
        save("evidence", {"seeds": SEEDS, **found})
        return found
    if not quick:
        print("skipped: the public sets are needed, python -m benchmarks.evidence --data FOLDER")
        return {}
    print("MADE-UP PICTURES: these numbers mean nothing but that everything runs")
    with TemporaryDirectory() as folder:
        stand_ins.write(Path(folder))
        few = {"colour": 4, "fish": 4}
        found = measured(Path(folder), seeds=1, balls=24, steps=few, arms=list(ARMS))
    return {**found, "colours": colours.main(count=48, names=["defaults", "mu .015–.075"])}


def measured(
    data: Path, seeds: int, balls: int, steps: dict[str, int], arms: list[str]
) -> dict[str, Any]:
    """Tables of both tasks, as pictures are and after grey-world, and the numbers of crops."""
    coloured, grey = sets.buoys(data)
    deepfish, fjord = sets.wild(data)
    aquaria = sets.aquaria(data)
    rng = np.random.default_rng(0)
    ball_pool, _ = tasks.painted_balls(sets.photographs_of_land(data), balls, rng)
    fish_pool = tasks.fish_pool(aquaria.images, aquaria.labels, rng)
    tests = {
        "colour": {"buoys": coloured, "grey pool": grey},
        "fish": {"DeepFish": deepfish, "fjord": fjord},
    }
    counts = {name: len(crops.labels) for task in tests.values() for name, crops in task.items()}
    counts["aquaria"] = len(aquaria.labels)
    for name, count in counts.items():
        print(f"{name}: {count} crops; the first run had {sets.FIRST_RUN[name]}", flush=True)
    found: dict[str, Any] = {"crops": counts}
    for task, pool in (("colour", ball_pool), ("fish", fish_pool)):
        nets = {
            arm: [trained_by(arm, task, pool, steps[task], s) for s in range(seeds)] for arm in arms
        }
        for name, crops in tests[task].items():
            for balanced in (False, True):
                title = f"{name}, grey-world" if balanced else name
                found[title] = tabled(title, nets, crops, balanced)
    return found


def trained_by(arm: str, task: str, pool: Pool, steps: int, seed: int) -> nn.Module:
    """A net that has seen the pictures of an arm."""
    pictures = degraded(ARMS[arm](), pool.images, pool.distances, seed)
    return trained(pictures, pool.labels, 3 if task == "colour" else 2, steps, seed)


def tabled(
    title: str, nets: dict[str, list[nn.Module]], crops: Crops, balanced: bool
) -> dict[str, Any]:
    """The table of one test set, printed."""
    if not len(crops.labels):
        return {}
    given = {arm: [answers(net, crops, balanced) for net in seeds] for arm, seeds in nets.items()}
    rows = table(given, crops, DEFAULTS, np.random.default_rng(0))
    print(f"\n{title}: score; less the defaults' (95 %); part that chooses, that judges; recalls")
    for arm, row in rows.items():
        low, high = row["interval"]
        parts = " ".join("–" if row[part] is None else f"{row[part]:.3f}" for part in PARTS)
        recalls = " / ".join(f"{recall:.2f}" for recall in row.get("recalls", []))
        difference = f"{row['difference']:+.3f} ({low:+.3f} … {high:+.3f})"
        print(f"{arm:22}{row['score']:.3f}  {difference}  {parts}  {recalls}", flush=True)
    return rows


def command() -> None:
    """From the command line."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--quick", action="store_true", help="a smoke test, nothing written")
    parser.add_argument("--colours", action="store_true", help="balls in draws, beside real buoys")
    parser.add_argument("--data", type=Path, help="the folder that holds the public sets")
    arguments = parser.parse_args()
    if arguments.colours:
        torch.set_num_threads(1)
        colours.main()
    elif arguments.quick or arguments.data:
        main(arguments.quick, arguments.data)
    else:
        parser.error("say --data FOLDER (where the public sets are), or --colours, or --quick")
