"""Fits of waters that are known: are numbers, errors and choices right, and how fast?

`python -m benchmarks.accuracy.fitting` writes results/fitting.json and prints the tables; with
names of parts it runs these alone and keeps the others' figures. `--progress FOLDER` keeps what is
done of the long parts, and goes on from there.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.accuracy.fitting_bias import errors_on_purpose, without_forward_scatter
from benchmarks.accuracy.fitting_choice import choice
from benchmarks.accuracy.fitting_disturbances import disturbances
from benchmarks.accuracy.fitting_picture import picture
from benchmarks.accuracy.fitting_recovery import recovery
from benchmarks.accuracy.fitting_speed import speed
from benchmarks.accuracy.fitting_transport import transport
from benchmarks.accuracy.fitting_waters import waters
from benchmarks.harness import RESULTS, save, use_threads

PARTS: dict[str, Callable[[bool], dict[str, Any]]] = {
    "transport": transport,
    "bias": without_forward_scatter,
    "errors": errors_on_purpose,
    "speed": speed,
    "picture": picture,
    "waters": waters,
}
LONG: dict[str, Callable[[bool, Path | None], dict[str, Any]]] = {
    "choice": choice,
    "recovery": recovery,
    "disturbances": disturbances,
}


def main(quick: bool = False, parts: list[str] | None = None, progress: Path | None = None) -> None:
    """Run the parts and save the figures of each as soon as it is done."""
    use_threads(1)
    path = RESULTS / "fitting.json"
    results = json.loads(path.read_text()) if parts and path.exists() else {}
    results.pop("machine", None)
    for name in parts or [*PARTS, *LONG]:
        print(f"-- {name}", flush=True)
        if name in LONG:
            results[name] = LONG[name](quick, progress and progress / f"{name}.jsonl")
        else:
            results[name] = PARTS[name](quick)
        if not quick:
            print(save("fitting", results))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--progress", type=Path)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, *LONG, []])
    arguments = parser.parse_args()
    main(arguments.quick, arguments.parts, arguments.progress)
