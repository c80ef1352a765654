"""Persons in other waters: a detector tuned on labelled swimmers and bathers, tested on divers.

    python -m benchmarks.evidence.wet_persons --kit FOLDER

As `benchmarks.evidence.detector`, but the pictures that are tuned on are wet: two pools, of which
each picture is seen as it is and twice with an arm on top. Divers are of many seas, and air tells
what is forgotten.
"""

from collections.abc import Sequence
from functools import partial
from itertools import product
from pathlib import Path

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

    def asked(arm: str, seed: int) -> dict[str, Array]:
        """What a net finds that has been tuned on the pictures, and with an arm on top."""
        torch.manual_seed(seed)
        drawn = degraded(none, scenes, maps[: len(scenes)]) + degraded(ON_TOP[arm](), scenes, maps)
        net = bench.yolox.load().to(memory_format=torch.channels_last)
        tuned(net, drawn, len(scenes), RATE, seed, STEPS)
        return told.found(net)

    answers = {UNTUNED: [told.found(bench.yolox.load())]}
    with keeper(answered) as folder:
        for arm, seed in product(arms, range(nets)):
            of_net = told.kept(folder / f"wet, {arm}, {seed}.npz", partial(asked, arm, seed))
            answers.setdefault(arm, []).append(of_net)
    tables = {name: told.table(name, answers, AS_THEY_ARE) for name in TOLD}
    save("wet_persons", {"steps": STEPS, "nets": nets, "tables": tables})
    for name, rows in tables.items():
        for arm, row in rows.items():
            low, high = row["blocks"]
            print(f"{name} {arm:32}{row['score']:.3f} ({low:+.3f} … {high:+.3f})")


if __name__ == "__main__":
    given = parser(__doc__, list(ON_TOP)).parse_args()
    main(given.kit, given.arms, given.nets, given.answered)
