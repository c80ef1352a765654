"""ONNX Runtime against eager and compiled eager: one and two threads, 256² and 512², one image and eight.

`python -m benchmarks.runtime` writes results/runtime.json and prints the table. All have the plan of the same module;
the file's covers short sides of 32 to 1024 px, so that it may hold a blur more than eager needs for one size.
"""

import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

import uwaug
from benchmarks.harness import command, race, save, scene, use_threads
from uwaug.onnx import OnnxUnderwater, _session, check_onnx, export_onnx, read_metadata

OURS, WHOLE = "ONNX Runtime", "ONNX Runtime, batch at once"


def speed(
    degrade: uwaug.Underwater,
    path: Path,
    threads: int,
    sizes: tuple[int, ...],
    batches: tuple[int, ...],
    rounds: int,
    compiled: bool,
) -> list[dict[str, Any]]:
    """Whole model in milliseconds per call, float32, without field."""
    use_threads(threads)
    run, session = OnnxUnderwater(path, threads), _session(path, threads)
    rows = []
    for size in sizes:
        for batch in batches:
            image, distance = scene(size, batch)
            feed = {"image": image.numpy(), "distance": distance.numpy()}
            runners = {
                OURS: lambda: run(image, distance),
                **({WHOLE: lambda: session.run(None, feed)} if batch > 1 else {}),
                "eager": lambda: degrade(image, distance),
            }
            if compiled:
                torch.compiler.reset()
                fast = torch.compile(degrade, fullgraph=True, dynamic=False)
                runners["compiled"] = lambda: fast(image, distance)
            with torch.no_grad():
                result = race(runners, rounds)
            ratio = result[OURS]["median_ms"] / result["eager"]["median_ms"]
            rows.append(
                {"threads": threads, "size": size, "batch": batch, "ms": result, "of_eager": ratio}
            )
            print(
                f"{threads} thread(s) {size}² × {batch}: {ratio:.2f} of eager; "
                + ", ".join(f"{name} {r['median_ms']:.2f} ms" for name, r in result.items()),
                flush=True,
            )
    return rows


def main(quick: bool = False) -> None:
    """Export the survey preset, check the file, race it; save the figures."""
    degrade = uwaug.load_preset("survey", water="7C").module()
    sizes, batches, rounds = ((256,), (1,), 3) if quick else ((256, 512), (1, 8), 15)
    with tempfile.TemporaryDirectory() as folder:
        path = export_onnx(degrade, Path(folder) / "7C.onnx")
        report = check_onnx(path, degrade)
        print(
            f"{path.stat().st_size} bytes, {report.cases} cases, largest difference {report.worst:.2g}",
            flush=True,
        )
        results = {
            "onnxruntime": version("onnxruntime"),
            "plan": {
                "file": read_metadata(path)["uwaug_plan"],
                "eager, 512 px": str(degrade.plan((512, 512))),
            },
            "bytes": path.stat().st_size,
            "difference": {"cases": report.cases, "worst": report.worst, "where": report.where},
            "speed": [
                row
                for threads in (1, 2)
                for row in speed(degrade, path, threads, sizes, batches, rounds, compiled=not quick)
            ],
        }
    if not quick:
        print(save("runtime", results))


if __name__ == "__main__":
    command(main, __doc__)
