"""Time and memory of fits, beside what others do: Adam on the same residual, and on the whole
picture with direct light and veil alone.
"""

import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import softplus

from benchmarks.accuracy.fitting_scenes import (
    HALF,
    WHOLE,
    first_guess,
    formed,
    photographed,
    problem_of,
    random_truth,
    view,
)
from benchmarks.harness import printed
from uwaug.fitting import Fit, fit
from uwaug.fitting.coefficients import render
from uwaug.fitting.errors import cluster_covariance
from uwaug.fitting.least_squares import ROBUST, Objective, solve

CAP = 60.0  # s
NEAR = (1e-3, 1e-6)  # of the least loss
RATES = (0.1, 0.03, 0.01)  # of Adam: the best of these
STEPS = 2000  # of the whole picture

Results = dict[str, Any]

MEASURED = """
import json, sys, time
import torch
from benchmarks.accuracy.fitting_speed import pictures
from benchmarks.harness import peak_of, use_threads
from uwaug.fitting import fit

model, threads = sys.argv[1], int(sys.argv[2])
use_threads(threads)
clean, observed, distance = pictures()
fit(clean, observed, distance, model="haze", pixels=500)
taken = []

def run():
    began, used = time.perf_counter(), time.process_time()
    fit(clean, observed, distance, model=model)
    taken.append((time.perf_counter() - began, time.process_time() - used))

peak = peak_of(run)
run()
seconds, processor = min(taken)
print(json.dumps({"seconds": seconds, "processor_seconds": processor, "peak_bytes": peak}))
"""


def pictures(width: int = WHOLE) -> tuple[Tensor, Tensor, Tensor]:
    """The scene, clean and observed, and its distance."""
    rng = np.random.default_rng(0)
    scene = view(width)
    truth = random_truth("exponential", rng, scene)
    return scene.srgb, photographed(formed(truth, scene), rng), scene.distance


def speed(quick: bool) -> Results:
    """Measure, print, return."""
    results: Results = {}
    if not quick:
        for model in ("auto", "exponential"):
            for threads in (1, 2):
                results[f"{model}, {threads}"] = _measured(model, threads)
    clean, observed, distance = pictures(HALF if quick else WHOLE)
    torch.set_num_threads(1)
    began = time.perf_counter()
    found = fit(clean, observed, distance, model="exponential")
    results["here_seconds"] = time.perf_counter() - began
    cap = 0.2 if quick else CAP
    results["adam"] = adam_on_pixels(problem_of(found), cap)
    print(f"fit of 11 numbers, 1 thread: {results['here_seconds']:.1f} s")
    ours = results["adam"]
    print(f"solver: {ours['solver_seconds']:.2f} s, {ours['solver_evaluations']} evaluations")
    results["whole"] = adam_on_picture(found, cap, 3 if quick else STEPS)
    print("Adam, direct light and veil, whole picture:", json.dumps(results["whole"]))
    return results


def _measured(model: str, threads: int) -> Results:
    count = str(threads)
    line = printed(MEASURED, model, count, OPENBLAS_NUM_THREADS=count, OMP_NUM_THREADS=count)
    row: Results = json.loads(line)
    print(
        f"{model}, {threads} threads: {row['seconds']:.1f} s, of processors "
        f"{row['processor_seconds']:.1f} s, "
        f"peak {row['peak_bytes'] / 2**30:.2f} GiB",
        flush=True,
    )
    return row


def adam_on_pixels(problem: Objective, cap: float) -> Results:
    """Time until Adam, and the fit's own solver, from the same guess, are near the least loss."""
    start = first_guess(problem)
    began = time.perf_counter()
    ours = solve(problem, start)
    results: Results = {"solver_seconds": time.perf_counter() - began, "least": ours.cost}
    results["solver_evaluations"] = len(ours.history)
    error = torch.from_numpy(np.sqrt(np.diag(cluster_covariance(problem, ours).matrix)))
    low, high = (torch.from_numpy(limit) for limit in problem.bounds)

    def cost(raw: Tensor) -> Tensor:
        theta = low + (high - low) * torch.sigmoid(raw)
        light = render(problem.model.coefficients(theta), problem.pixels, problem.model.shape)
        residual = problem.pixels.weights * (light - problem.pixels.observed)
        return ROBUST**2 * (torch.sqrt(1 + (residual / ROBUST) ** 2) - 1).sum()

    share = ((torch.from_numpy(start) - low) / (high - low)).clamp(1e-4, 1 - 1e-4)
    for rate in RATES:
        for near in NEAR:
            wanted = (1 + near) * ours.cost
            row, raw = _descended(cost, share.logit(), rate, wanted, cap)
            off = low + (high - low) * torch.sigmoid(raw) - torch.from_numpy(ours.theta)
            row["farthest_in_errors"] = float((off / error.clamp(min=1e-12)).abs().max())
            results[f"rate {rate:g}, within {near:g}"] = row
            print(f"Adam at {rate:g}, within {near:g} of the least loss: {row}", flush=True)
    return results


def _descended(
    cost: Callable[[Tensor], Tensor], start: Tensor, rate: float, wanted: float, cap: float
) -> tuple[Results, Tensor]:
    """Steps of Adam until the cost is `wanted`, or the time is up."""
    raw = start.clone().requires_grad_()
    adam = torch.optim.Adam([raw], lr=rate)
    least, steps, began = float("inf"), 0, time.perf_counter()
    while time.perf_counter() - began < cap and least > wanted:
        adam.zero_grad()
        value = cost(raw)
        value.backward()
        adam.step()
        least, steps = min(least, float(value.detach())), steps + 1
    seconds = time.perf_counter() - began
    return {"seconds": seconds, "steps": steps, "of_wanted": least / wanted}, raw.detach()


def adam_on_picture(found: Fit, cap: float, steps: int) -> Results:
    """Direct light and veil with a coefficient for each, as DeepSeeColor has them: coefficients
    through softplus, the veil through a sigmoid from .5, Adam on all pixels.
    """
    pair = found.pairs[0]
    clean, observed, z = pair.clean.float(), pair.observed.float(), pair.z.float()
    raw = torch.zeros(3, 3, 1, 1, requires_grad=True)  # β, G, veil; 3 colours
    adam = torch.optim.Adam([raw], lr=0.01)
    began, done, error = time.perf_counter(), 0, float("inf")
    while done < steps and time.perf_counter() - began < 2 * cap:
        adam.zero_grad()
        beta, G, veil = softplus(raw[0]), softplus(raw[1]), torch.sigmoid(raw[2])
        light = clean * torch.exp(-beta * z) + veil * (1 - torch.exp(-G * z))
        value = (light - observed).square().mean()
        value.backward()
        adam.step()
        error, done = float(value.detach()) ** 0.5, done + 1
    seconds = time.perf_counter() - began
    numbers = [softplus(raw[0]), softplus(raw[1]), torch.sigmoid(raw[2])]
    rng = np.random.default_rng(0)
    truth = random_truth("exponential", rng, view())
    off = {}
    for name, value in zip(("beta", "G", "veil"), numbers, strict=True):
        right = getattr(truth, name)
        off[name] = (value.detach().flatten().numpy() / right - 1).tolist()
    return {"seconds": seconds, "steps": done, "rms": error, "fit_rms": found.rms, "bias": off}
