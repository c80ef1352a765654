"""ONNX Runtime against eager and compiled eager: one and two threads, 256², 512² and 1024², one
image and (but for 1024²) eight.

`python -m benchmarks.speed.runtime` writes results/runtime.json and prints the table. All have the
plan of the same module, for short sides of 32 to 1024 px: it may hold a blur more than eager needs
for one size.
"""

import tempfile
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

import uwaug
from benchmarks.harness import command, race, save, scene, use_threads
from uwaug.onnx import OnnxUnderwater, check_onnx, export_onnx, read_metadata

OURS, WHOLE = "ONNX Runtime", "ONNX Runtime, batch at once"


def speed(
    degrade: uwaug.Underwater, path: Path, threads: int, size: int, batch: int, quick: bool
) -> dict[str, Any]:
    """Whole model in milliseconds per call, float32, without field."""
    use_threads(threads)
    image, distance = scene(size, batch)
    run = OnnxUnderwater(path, threads)
    runners: dict[str, Callable[[], object]] = {OURS: lambda: run(image, distance)}
    if batch > 1:
        inputs = {"image": image, "distance": distance}
        runners[WHOLE] = lambda: run.session(inputs)
    runners["eager"] = lambda: degrade(image, distance)
    if not quick:
        torch.compiler.reset()
        fast = torch.compile(degrade, fullgraph=True, dynamic=False)
        runners["compiled"] = lambda: fast(image, distance)
    with torch.no_grad():
        times = race(runners, 3 if quick else 15)
    ratio = times[OURS]["median_ms"] / times["eager"]["median_ms"]
    said = ", ".join(f"{name} {taken['median_ms']:.2f} ms" for name, taken in times.items())
    print(f"{threads} thread(s) {size}² × {batch}: {ratio:.2f} of eager; {said}", flush=True)
    return {"threads": threads, "size": size, "batch": batch, "ms": times, "of_eager": ratio}


def main(quick: bool = False) -> None:
    """Export the survey preset, check the file, race it; save the figures."""
    degrade = uwaug.load_preset("survey", water="7C").module(sides=(32, 1024))
    sizes = {256: (1,)} if quick else {256: (1, 8), 512: (1, 8), 1024: (1,)}
    with tempfile.TemporaryDirectory() as folder:
        path = export_onnx(degrade, Path(folder) / "7C.onnx")
        size = path.stat().st_size
        report = check_onnx(path, degrade)
        found = f"{report.cases} cases, largest difference {report.worst:.2g}"
        print(f"{size} bytes, {found}", flush=True)
        plan = read_metadata(path)["uwaug_plan"]
        rows = []
        for threads in (1, 2):
            for side, batches in sizes.items():
                for batch in batches:
                    rows.append(speed(degrade, path, threads, side, batch, quick))
    results = {
        "onnxruntime": version("onnxruntime"),
        "plan": {"file": plan, "eager, 512 px": str(degrade.plan((512, 512)))},
        "bytes": size,
        "difference": {"cases": report.cases, "worst": report.worst, "where": report.where},
        "speed": rows,
    }
    if not quick:
        print(save("runtime", results))


if __name__ == "__main__":
    command(main, __doc__)
