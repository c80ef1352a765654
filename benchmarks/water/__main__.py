"""Is the model right of real water?

python -m benchmarks.water --kit FOLDER
python -m benchmarks.water --kit FOLDER --nets NETS          nets restore the charts, too

The folder holds charts in three pictures of a reef at known distances, and pairs of a tank. Nets
are kept by `python -m benchmarks.evidence.restore --kit KITS --answered NETS`.
"""

import argparse
from functools import partial
from pathlib import Path

from benchmarks.harness import save
from benchmarks.water import charts, edges, restore, waters

PARTS = {
    "charts": charts.main,
    "edges": edges.main,
    "waters": waters.main,
    "restore": restore.main,
}


def main() -> None:
    """Run the parts and write results/water.json, if all are run."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--kit", type=Path, required=True, help="folder of charts and tanks")
    parser.add_argument("--nets", type=Path, help="folder of trained nets")
    parser.add_argument("--out", default="water", help="name of the results")
    parser.add_argument("parts", nargs="*", help=f"some of {', '.join(PARTS)}")
    arguments = parser.parse_args()
    parts = PARTS | {"restore": partial(restore.main, nets=arguments.nets)}
    results = {name: parts[name](arguments.kit) for name in arguments.parts or parts}
    if not arguments.parts:
        save(arguments.out, results)


if __name__ == "__main__":
    main()
