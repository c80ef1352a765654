"""Is the model right of real water?

python -m benchmarks.water --kit FOLDER

The folder holds charts in three pictures of a reef at known distances, and pairs of a tank.
"""

import argparse
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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kit", type=Path, required=True, help="folder of charts and tanks")
    parser.add_argument("--out", default="water", help="name of the results")
    parser.add_argument("parts", nargs="*", help=f"some of {', '.join(PARTS)}")
    arguments = parser.parse_args()
    results = {name: PARTS[name](arguments.kit) for name in arguments.parts or PARTS}
    if not arguments.parts:
        save(arguments.out, results)


if __name__ == "__main__":
    main()
