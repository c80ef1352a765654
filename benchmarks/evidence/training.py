"""Does training with uwaug help on real underwater pictures? Two tasks with a truth.

    python -m benchmarks.evidence --data FOLDER     all arms, three nets each: hours on one core
    python -m benchmarks.evidence --quick           a little of both, on made-up pictures

*Colour*: which of three colours has a buoy; trained on painted balls in photographs of land.
*Fish*: is there one in the crop; trained on aquaria, tested on wild water. Films and places of each
test set choose or judge: pick variants by "choose", tell "judge". `benchmarks.evidence.sets` says
what a folder holds: clones of the public repositories, or a kit of crops.

Some arms are shown eight pictures of the test set, without labels, and so have nets for each.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from benchmarks.evidence import sets, stand_ins, tasks
from benchmarks.evidence.arms import ARMS, DEFAULTS, SHOWN, Arm, degraded
from benchmarks.evidence.net import answers, keeper, score, table, trained
from benchmarks.evidence.sets import Sets
from benchmarks.evidence.tasks import Array, Pool
from benchmarks.harness import save


class Size(NamedTuple):
    """How much of everything."""

    nets: int  # of each arm
    balls: int
    draws: int  # of each picture
    steps: int  # of 64 pictures
    trials: int  # of `uwaug.like`, for each picture that it is shown


FULL = Size(nets=3, balls=2000, draws=3, steps=800, trials=300)
"""With one draw and 400 steps, what is easy to learn wins, and not what helps."""

QUICK = Size(nets=1, balls=24, draws=1, steps=4, trials=15)

TASKS = {"colour": ("buoys",), "fish": ("deepfish", "fjord")}
"""Test sets of each task."""

PARTS = ("choose", "judge")


def main(
    quick: bool = False,
    data: Path | None = None,
    size: Size = FULL,
    arms: Sequence[str] = (*ARMS, *SHOWN),
    answered: Path | None = None,
) -> dict[str, Any]:
    """Train, score, print; saved only where real sets are there."""
    torch.set_num_threads(1)
    if data is None and not quick:
        print("skipped: real sets are needed, python -m benchmarks.evidence --data FOLDER")
        return {}
    with keeper(answered) as folder:
        if data is None:
            print("MADE-UP PICTURES: these numbers mean nothing but that everything runs")
            return measured(stand_ins.made(folder), QUICK, arms, folder)
        results = measured(sets.load(data), size, arms, folder)
    save("evidence", {**size._asdict(), **results})
    return results


def measured(real: Sets, size: Size, arms: Sequence[str], answered: Path) -> dict[str, Any]:
    """Tables of all test sets, as pictures are and after grey-world, and the numbers of crops.

    What a net answers is kept in the folder `answered`, and asked once.
    """
    counts = {name: len(crops.labels) for name, crops in real.crops.items()}
    for name, count in counts.items():
        print(f"{name}: {count} of {sets.COUNTS[name]} crops", flush=True)
    tables: dict[str, Any] = {}
    rng = np.random.default_rng(0)
    for task, names in TASKS.items():
        pool = pool_of(task, real, size.balls, rng)
        given: dict[str, dict[str, list[Array]]] = {}
        for arm in arms:
            for tests, make in makers(arm, names, real, pool, size.trials):
                for seed in range(size.nets):
                    path = answered / f"{arm}, {' '.join(tests)}, {seed}.npz"
                    if not path.exists():
                        np.savez(path, **asked(make, pool, tests, real, size, seed))
                    for title, of_net in np.load(path).items():
                        given.setdefault(title, {}).setdefault(arm, []).append(of_net)
        for title, of_arms in given.items():
            crops = real.crops[title.split(",")[0]]
            tables[title] = table(of_arms, crops, DEFAULTS if DEFAULTS in of_arms else arms[0])
            printed(title, tables[title])
    return {"crops": counts, "tables": tables}


def pool_of(task: str, real: Sets, balls: int, rng: np.random.Generator) -> Pool:
    """What nets of a task see before water."""
    if task == "colour":
        return tasks.painted_balls(real.land, balls, rng)
    aquaria = real.crops["aquaria"]
    return tasks.fish_pool(aquaria.images, aquaria.labels, rng)


def makers(
    arm: str, names: tuple[str, ...], real: Sets, pool: Pool, trials: int
) -> Iterator[tuple[tuple[str, ...], Callable[[], Arm]]]:
    """What makes an arm, with the test sets that its nets are for: all of a task, or each alone."""
    if arm in ARMS:
        yield names, ARMS[arm]
        return
    for name in names:
        yield (name,), lambda shown=real.references[name]: SHOWN[arm](shown, pool, trials)


def asked(
    make: Callable[[], Arm], pool: Pool, tests: tuple[str, ...], real: Sets, size: Size, seed: int
) -> dict[str, Array]:
    """Answers of a net that has seen the pictures of an arm, of each test set and by grey-world."""
    torch.manual_seed(seed)
    pictures, labels = degraded(make(), pool, size.draws, seed)
    net = trained(pictures, labels, len(pool.labels.unique()), size.steps, seed)
    given = {}
    for name in tests:
        crops = real.crops[name]
        given[name] = answers(net, crops, balanced=False)
        given[f"{name}, grey-world"] = answers(net, crops, balanced=True)
        print(f"  {name}: {score(given[name], crops.labels):.3f}", flush=True)
    return given


def printed(title: str, rows: dict[str, Any], reference: str = "the defaults") -> None:
    """The table of a test set."""
    less = f"less that of {reference}, by blocks, by films"
    print(f"\n{title}: score, its nets; {less}; choose, judge")
    for arm, row in rows.items():
        nets = " ".join(f"{net:.3f}" for net in row["nets"])
        between = " ".join("({:+.3f} … {:+.3f})".format(*row[kind]) for kind in ("blocks", "films"))
        parts = " ".join("–" if row[part] is None else f"{row[part]:.3f}" for part in PARTS)
        recalls = " / ".join(f"{recall:.2f}" for recall in row.get("recalls", []))
        means = f"{row['score']:.3f} ({nets})  {row['difference']:+.3f}"
        print(f"{arm:32}{means} {between}  {parts}  {recalls}", flush=True)


def command() -> None:
    """From the command line."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--quick", action="store_true", help="a smoke test, nothing written")
    parser.add_argument("--data", type=Path, help="a kit, or the folder of the public sets")
    parser.add_argument("--nets", type=int, default=FULL.nets, help="of each arm")
    names = (*ARMS, *SHOWN)
    meaning = f"some of: {'; '.join(names)}"
    parser.add_argument(
        "--arms", nargs="+", choices=names, default=names, metavar="ARM", help=meaning
    )
    meaning = "a folder that keeps what nets answered: a run that was stopped goes on"
    parser.add_argument("--answered", type=Path, help=meaning)
    given = parser.parse_args()
    if given.quick or given.data:
        size = FULL._replace(nets=given.nets)
        main(given.quick, given.data, size, given.arms, given.answered)
    else:
        parser.error("say --data FOLDER (where the sets are), or --quick")
