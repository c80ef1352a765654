"""All benchmarks: `python -m benchmarks [--quick]`. Each part also runs alone, as
`python -m benchmarks.speed.model`.
"""

import argparse
import importlib
import time

from benchmarks.harness import measure_eager

PARTS = {
    "model": "accuracy",
    "frontier": "speed",
    "planner": "accuracy",
    "stability": "accuracy",
    "physics": "accuracy",
    "surfaces": "accuracy",
    "direction": "accuracy",
    "fitting_recovery": "accuracy",
    "conditions": "accuracy",
    "like": "accuracy",
    "runtimes": "accuracy",
    "training": "evidence",
    "throughput": "speed",
    "draw": "speed",
    "page": "speed",
    "gallery": "figures",
    "summary": "figures",
}
"""Each part and its folder, in the order in which they run."""


def main() -> None:
    """Run the parts in turn; a part whose optional library is missing is skipped by name."""
    parser = argparse.ArgumentParser(description=__doc__)
    quick = "a smoke test of every part, nothing written"
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("parts", nargs="*", help=f"some of {', '.join(PARTS)}; all by default")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.parts) - set(PARTS))
    if unknown:
        parser.error(f"unknown part {', '.join(unknown)}; there are {', '.join(PARTS)}")
    measure_eager()
    for name in arguments.parts or PARTS:
        print(f"== {name}", flush=True)
        began = time.perf_counter()
        try:
            part = importlib.import_module(f"benchmarks.{PARTS[name]}.{name}")
        except ModuleNotFoundError as error:
            print(f"skipped: {error.name} is not installed")
            continue
        part.main(arguments.quick)
        print(f"== {name}: {time.perf_counter() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
