"""Persons in other waters: a detector tuned on labelled swimmers and bathers, tested on divers; and
the other way; and at home.

    python -m benchmarks.evidence.wet_persons --kit FOLDER

As `benchmarks.evidence.detector`, but the pictures that are tuned on are wet: each is seen as it is
and twice with an arm on top. Air tells what is forgotten. At home is the half of the swimmers and
pools that shares no film with the half that is tuned on.
"""

from collections.abc import Sequence
from functools import partial
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.evidence.arms import none
from benchmarks.evidence.detector import (
    RATE,
    STEPS,
    TESTS,
    UNTUNED,
    Bench,
    degraded,
    parser,
    scenes_of,
    tuned,
)
from benchmarks.evidence.net import keeper
from benchmarks.evidence.tasks import Array, made_up
from benchmarks.evidence.waters import AS_THEY_ARE, HOME, ON_TOP, PRESET, halves
from benchmarks.harness import save

DIVERS, SWIMMERS, POOLS, AIR = TESTS
DRAWS = 2  # of an arm on top of each picture
AND_AIR = f"{PRESET}, and air under water"
ARMS = [*ON_TOP, AND_AIR]


def tested(bench: Bench, *names: str) -> Bench:
    """A bench of some of its sets."""
    return bench._replace(tests={name: bench.tests[name] for name in names})


def halved(bench: Bench, which: int) -> Bench:
    """Swimmers and pools of one of two halves, which share no film."""
    tests, blocks = dict[str, Any](), dict[str, Any]()
    for name in (SWIMMERS, POOLS):
        places = np.flatnonzero(halves(bench.blocks[name]) == which)
        tests[name], blocks[name] = (
            [of[name][place] for place in places] for of in (bench.tests, bench.blocks)
        )
    return bench._replace(tests=tests, blocks=blocks)


def directions(bench: Bench) -> dict[str, tuple[Bench, Bench]]:
    """The sets that are tuned on, and those that are tested."""
    return {
        "swimmers, pools": (tested(bench, SWIMMERS, POOLS), tested(bench, DIVERS, AIR)),
        "divers": (tested(bench, DIVERS), tested(bench, SWIMMERS, POOLS)),
        HOME: (halved(bench, 0), halved(bench, 1)),
    }


def asked(
    whole: Bench, learnt: Bench, bench: Bench, arm: str, seed: int, steps: int
) -> dict[str, Array]:
    """What a net finds that has been tuned on pictures as they are and with an arm on top."""
    torch.manual_seed(seed)
    scenes = scenes_of([*chain(*learnt.tests.values())])
    if arm == AND_AIR:
        scenes += whole.scenes[: len(scenes)]
    rng = np.random.default_rng(0)
    maps = [torch.from_numpy(made_up(x.image, rng)).float()[None] for x in scenes * DRAWS]
    on_top = ON_TOP[PRESET if arm == AND_AIR else arm](whole.shown)
    drawn = degraded(none, scenes, maps[: len(scenes)]) + degraded(on_top, scenes, maps)
    net = whole.yolox.load().to(memory_format=torch.channels_last)
    tuned(net, drawn, len(scenes), RATE, seed, steps)
    return bench.found(net)


def main(kit: Path, arms: Sequence[str], nets: int, answered: Path | None, steps: int) -> None:
    """Tune, score, save and print."""
    torch.set_num_threads(1)
    whole, tables = Bench.of(kit), dict[str, Any]()
    with keeper(answered) as folder:
        for title, (learnt, bench) in directions(whole).items():
            answers = {UNTUNED: [bench.found(whole.yolox.load())]}
            for arm, seed in product(arms, range(nets)):
                path = folder / f"{title}, {arm}, {steps} steps, {seed}.npz"
                of_net = bench.kept(path, partial(asked, whole, learnt, bench, arm, seed, steps))
                answers.setdefault(arm, []).append(of_net)
            for name in bench.tests:
                rows = bench.table(name, answers, AS_THEY_ARE)
                tables[f"{title} → {name}"] = rows
                for arm, row in rows.items():
                    low, high = row["blocks"]
                    print(f"{title} → {name} {arm:32}{row['score']:.3f} ({low:+.3f} … {high:+.3f})")
    save("wet_persons", {"steps": steps, "nets": nets, "tables": tables})


if __name__ == "__main__":
    flags = parser(__doc__, ARMS)
    flags.add_argument("--steps", type=int, default=STEPS, help="of tuning")
    given = flags.parse_args()
    main(given.kit, given.arms, given.nets, given.answered, given.steps)
