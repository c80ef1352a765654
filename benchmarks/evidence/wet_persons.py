"""Persons in other waters: a detector tuned on labelled swimmers and bathers, tested on divers.

    python -m benchmarks.evidence.wet_persons --kit FOLDER

As `benchmarks.evidence.detector`, but the pictures that are tuned on are wet: two pools, of which
each picture is seen as it is and twice with an arm on top. Divers are of many seas, and air tells
what is forgotten.
"""

from collections.abc import Sequence
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
from benchmarks.evidence.net import compared, keeper, resampled_units
from benchmarks.evidence.tasks import Array, made_up
from benchmarks.evidence.waters import AS_THEY_ARE, ON_TOP
from benchmarks.harness import save

LEARNT = TESTS[1:3]  # swimmers, pools
TOLD = TESTS[0], TESTS[3]  # divers, air
DRAWS = 2  # of an arm on top of each picture


def main(kit: Path, arms: Sequence[str], nets: int, answered: Path | None) -> None:
    """Tune, score, save and print."""
    torch.set_num_threads(1)
    bench = Bench.of(kit)
    scenes = scenes_of([sample for name in LEARNT for sample in bench.tests[name]])
    rng = np.random.default_rng(0)
    maps = [torch.from_numpy(made_up(x.image, rng)).float()[None] for x in scenes * DRAWS]
    told = bench._replace(tests={name: bench.tests[name] for name in TOLD})
    answers = {UNTUNED: [told.found(bench.yolox.load())]}
    with keeper(answered) as folder:
        for arm in arms:
            for seed in range(nets):
                path = folder / f"wet, {arm}, {seed}.npz"
                if not path.exists():
                    torch.manual_seed(seed)
                    drawn = degraded(none, scenes, maps[: len(scenes)])
                    drawn += degraded(ON_TOP[arm](), scenes, maps)
                    net = bench.yolox.load().to(memory_format=torch.channels_last)
                    tuned(net, drawn, len(scenes), RATE, seed, STEPS)
                    found: dict[str, Any] = told.found(net)
                    np.savez(path, **{name.replace("/", " "): x for name, x in found.items()})
                with np.load(path) as found_by_net:
                    of_net = {name: found_by_net[name.replace("/", " ")] for name in TOLD}
                answers.setdefault(arm, []).append(of_net)
    tables = {name: _table(told, name, answers) for name in TOLD}
    save("wet_persons", {"steps": STEPS, "nets": nets, "tables": tables})
    for name, rows in tables.items():
        for arm, row in rows.items():
            low, high = row["blocks"]
            print(f"{name} {arm:32}{row['score']:.3f} ({low:+.3f} … {high:+.3f})")


def _table(bench: Bench, name: str, answers: dict[str, list[dict[str, Array]]]) -> dict[str, Any]:
    """Of each arm: AP50, and the difference to pictures as they are."""
    often = resampled_units(bench.blocks[name])
    weights = np.concatenate([np.ones_like(often[:1]), often])
    scores = {
        arm: np.stack([bench.scores(name, net[name], weights) for net in nets])
        for arm, nets in answers.items()
    }
    return compared(scores, AS_THEY_ARE)


if __name__ == "__main__":
    given = parser(__doc__, list(ON_TOP)).parse_args()
    main(given.kit, given.arms, given.nets, given.answered)
