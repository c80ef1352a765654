"""Are the numbers right, and their errors? Fits to pictures in random waters."""

import json
import multiprocessing
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.accuracy.fitting_scenes import (
    SHARE,
    Truth,
    first_guess,
    formed,
    percent,
    photographed,
    problem_of,
    random_truth,
    view,
)
from uwaug.fitting import Fit, fit
from uwaug.fitting.least_squares import multistart, solve

RUNS = 200
PROCESSES = 2
KINDS = ("exponential", "gaussian", "exponential", "narrow")
STARTS = 3
APART = 1.0  # random starts: each number times up to e^±1
SAME = 1e-4  # of cost
MAIN = ("beta", "G", "veil")

Row = dict[str, Any]


def recovered(seed: int, pixels: int = 20_000) -> Row:
    """A run: its water, what was fitted, and where random starts end."""
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    scene = view()
    truth = random_truth(KINDS[seed % len(KINDS)], rng, scene)
    observed = photographed(formed(truth, scene), rng)
    began = time.perf_counter()
    found = fit(scene.srgb, observed, scene.distance, pixels=pixels)
    seconds = time.perf_counter() - began
    return {
        "seed": seed,
        "kind": truth.kind,
        "model": found.model,
        "seconds": round(seconds, 1),
        "read": found.noise.read,
        "numbers": compared(truth, found),
        "costs": _costs(found, pixels, rng),
    }


def compared(truth: Truth, found: Fit) -> dict[str, list[Any]]:
    """Of each number that is reported: truth, value, standard error, interval, state."""
    rows = {}
    for name, right in truth.numbers(found.fitted.geometry.reference).items():
        one = found.parameters.get(name)
        if one is not None:
            row = [right, one.value, one.error, one.low, one.high, one.state]
            rows[name] = [float(f"{v:.6g}") if isinstance(v, float) else v for v in row]
    return rows


def _costs(found: Fit, pixels: int, rng: np.random.Generator) -> list[float]:
    """Where the fit ended, and where it would have ended from one random start."""
    problem = problem_of(found, count=pixels)
    low, high = problem.bounds
    first = first_guess(problem)
    costs = [solve(problem, found.theta).cost]
    for _ in range(STARTS):
        start = np.clip(first * np.exp(rng.uniform(-APART, APART, len(first))), low, high)
        costs.append(multistart(problem, [start], 0, more=0).cost)
    return costs


def summarised(rows: list[Row]) -> dict[str, Any]:
    """The shares that matter."""
    within, covered, errors, scores = [], [], {name: [] for name in MAIN}, []
    states: dict[str, int] = {}
    for row in rows:
        for name, (right, value, error, low, high, state) in row["numbers"].items():
            states[state] = states.get(state, 0) + 1
            if low is not None:
                covered.append(low <= right <= high)
            if state != "free":
                continue
            within.append(abs(value - right) <= 2 * error)
            scores.append((value - right) / max(error, 1e-12))
            kind = name.split("_")[0]
            if kind in errors:
                errors[kind].append(abs(value - right) / right)
    alike = []
    for row in rows:
        costs = np.array(row["costs"][1:])
        alike.append(bool(costs.max() <= (1 + SAME) * costs.min()))
    return {
        "runs": len(rows),
        "within_2_errors_percent": percent(within),
        "covered_percent": percent(covered),
        "numbers": len(within),
        "median_relative_error": {name: float(np.median(one)) for name, one in errors.items()},
        "deviation_of_scores": float(np.std(scores)),
        "same_minimum_percent": percent(alike),
        "fit_at_least_minimum_percent": percent(
            [row["costs"][0] <= (1 + SAME) * min(row["costs"]) for row in rows]
        ),
        "states": states,
        "chosen": _chosen(rows),
        "seconds": float(np.median([row["seconds"] for row in rows])),
    }


def _chosen(rows: list[Row]) -> dict[str, dict[str, int]]:
    """How often each model was chosen for each kind of water."""
    counts: dict[str, dict[str, int]] = {}
    for row in rows:
        one = counts.setdefault(row["kind"], {})
        one[row["model"]] = one.get(row["model"], 0) + 1
    return counts


def resumed(progress: Path | None) -> list[Row]:
    """The runs that a file holds."""
    if progress is None or not progress.exists():
        return []
    return [json.loads(line) for line in progress.read_text().splitlines()]


def run(task: Any, seeds: list[Any], progress: Path | None) -> list[Row]:
    """`task` of each of `seeds`, in several processes; `progress` keeps what is done."""
    rows = resumed(progress)
    done = {row["seed"] for row in rows}
    left = [seed for seed in seeds if seed not in done]
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # they would wait for each other
    with multiprocessing.get_context("spawn").Pool(PROCESSES) as pool:
        for row in pool.imap_unordered(task, left):
            rows.append(row)
            print(".", end="", flush=True)
            if progress is not None:
                with progress.open("a") as file:
                    file.write(json.dumps(row) + "\n")
    print()
    return sorted(rows, key=lambda row: row["seed"])


def recovery(quick: bool, progress: Path | None = None) -> dict[str, Any]:
    """Run, print, return."""
    rows = [recovered(0, pixels=1000)] if quick else run(recovered, list(range(RUNS)), progress)
    results: dict[str, Any] = {"scene": list(view().distance.shape[-2:]), "g": SHARE}
    results["all"] = summarised(rows)
    show("all", results["all"])
    for kind in dict.fromkeys(KINDS):
        some = [row for row in rows if row["kind"] == kind]
        if some:
            results[kind] = summarised(some)
            show(kind, results[kind])
    return results


def show(name: str, found: dict[str, Any]) -> None:
    errors = ", ".join(f"{k} {100 * v:.2g} %" for k, v in found["median_relative_error"].items())
    print(
        f"{name:12} {found['runs']:4} runs: within 2 errors "
        f"{found['within_2_errors_percent']:.1f} % of {found['numbers']}, intervals cover "
        f"{found['covered_percent']:.1f} %, scores ±{found['deviation_of_scores']:.2f}, "
        f"median error {errors}, random starts agree in {found['same_minimum_percent']:.1f} %, the "
        f"fit ends at the least in {found['fit_at_least_minimum_percent']:.1f} %, "
        f"{found['seconds']:.1f} s; {found['states']}; {found['chosen']}"
    )
