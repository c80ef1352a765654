"""Forward and backward: the compiled loops against eager PyTorch and torch.compile, in one process.

`python -m benchmarks.speed.backward` writes results/backward.json and prints the table. Survey
preset, Jerlov 7C, float32, linear light, one thread; gradients to image, distance and all that is
learned. What shares this machine slows all alike: read the ratios.
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

import uwaug
from benchmarks.harness import command, race, save, scene, use_threads
from uwaug import fused


def learned() -> uwaug.Underwater:
    """The survey's module, with its water to be learned."""
    fixed = uwaug.load_preset("survey", water="7C").module()
    settings: dict[str, Any] = {"distance_range": fixed.distance_range, "color_space": "linear"}
    return uwaug.Underwater(fixed.medium, learnable=True, **settings)


def contest(size: int, quick: bool) -> dict[str, Any]:
    """Milliseconds for one picture, and times of torch.compile's."""
    use_threads(1)
    degrade = learned()
    image, distance = (t.requires_grad_() for t in scene(size))
    leaves = [image, distance, *degrade.parameters()]
    upstream = torch.linspace(-1, 1, image.numel()).reshape(image.shape)

    def by(path: bool, model: Callable[..., Tensor]) -> Callable[[], object]:
        def run() -> object:
            with fused.use(path):
                return torch.autograd.grad(model(image, distance), leaves, upstream)

        return run

    runners = {"fused": by(True, degrade), "eager": by(False, degrade)}
    if not quick:
        torch.compiler.reset()
        compiled = torch.compile(degrade, fullgraph=True, dynamic=False)
        runners["torch.compile"] = by(False, compiled)
    times = race(runners, 3 if quick else 40, 20.0)
    ours = times["fused"]["median_ms"]
    faster = {name: taken["median_ms"] / ours for name, taken in times.items()}
    said = ", ".join(
        f"{name} {times[name]['median_ms']:.1f} ms (×{faster[name]:.2f})" for name in times
    )
    print(f"{size}²: {said}", flush=True)
    return {"size": size, "ms": times, "times_faster": faster}


def main(quick: bool = False) -> dict[str, Any]:
    """Run all races; return what is saved (nothing is, if quick)."""
    results = {"contests": [contest(size, quick) for size in ((64,) if quick else (256, 512))]}
    if not quick:
        print(save("backward", results))
    return results


if __name__ == "__main__":
    command(main, __doc__)
