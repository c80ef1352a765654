"""Is the model right? What `auto` picks for pictures of every kind of water."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.accuracy.fitting_recovery import Row, run
from benchmarks.accuracy.fitting_scenes import (
    NOISE,
    first_guess,
    formed,
    percent,
    photographed,
    problem_of,
    random_truth,
    view,
)
from uwaug.fitting import fit
from uwaug.fitting.least_squares import multistart
from uwaug.fitting.models import MODELS

# "narrow" is of the candidate "gaussian"
KINDS = ("attenuation", "haze", "veil", "paper", "calibrated", "gaussian", "exponential", "narrow")
EACH = 12
FEW = 5000  # pixels that tell how far candidates are from a picture
SHOWS = 0.1  # RMS of noise, by which the noise-free picture differs from all rivals' best
HIDDEN = 0.01  # RMS of noise, below which 60 000 values cannot tell
NUMBERS = {"attenuation": 3, "haze": 6, "veil": 9, "paper": 9, "calibrated": 9}  # others: 11


def picked(seed: int, pixels: int = 20_000) -> Row:
    """A run: what was picked, and how far the best of each candidate is from the noise-free
    picture.
    """
    torch.set_num_threads(1)
    rng = np.random.default_rng(10_000 + seed)
    scene = view()
    truth = random_truth(KINDS[seed % len(KINDS)], rng, scene)
    light = formed(truth, scene)
    observed = photographed(light, rng)
    found = fit(scene.srgb, observed, scene.distance, focal_px=scene.focal_px, pixels=pixels)
    apart = {}
    for name in MODELS if pixels > FEW else ("attenuation", "haze"):
        problem = problem_of(found, name, light, min(FEW, pixels))
        best = multistart(problem, [first_guess(problem)], seed)
        used = problem.pixels.weights > 0
        residual = (problem.render(best.theta) - problem.pixels.observed)[used]
        apart[name] = float(f"{float(residual.square().mean().sqrt()) / NOISE:.3g}")
    candidates = {}
    for one in found.candidates:
        candidates[one.name] = [round(one.behind, 1), round(one.behind_error, 1)]
    row = {"seed": seed, "kind": truth.kind, "picked": found.model, "apart": apart}
    return row | {"behind": candidates, "states": _states(found.parameters)}


def _states(parameters: dict[str, Any]) -> dict[str, str]:
    """Those that are not free."""
    return {name: one.state for name, one in parameters.items() if one.state != "free"}


def expected(row: Row) -> tuple[str, list[str]]:
    """Whether the generating model shows, and which picks are right.

    It shows if the noise-free picture differs from the best fit of every candidate that has as many
    numbers or fewer by more than `SHOWS`. Where one differs by less than `HIDDEN`, the one of the
    fewest numbers that does is right. Between the two, either is.
    """
    kind = "gaussian" if row["kind"] == "narrow" else row["kind"]
    rivals = {}
    for name, apart in row["apart"].items():
        if name != kind and NUMBERS.get(name, 11) <= NUMBERS.get(kind, 11):
            rivals[name] = apart
    if all(apart > SHOWS for apart in rivals.values()):
        return "shows", [kind]
    hidden = [name for name, apart in rivals.items() if apart < HIDDEN]
    if hidden:
        fewest = min(NUMBERS.get(name, 11) for name in hidden)
        if fewest < NUMBERS.get(kind, 11):
            return "hidden", [name for name in hidden if NUMBERS.get(name, 11) == fewest]
        return "hidden", [*hidden, kind]
    near = [name for name, apart in rivals.items() if apart <= SHOWS]
    return "between", [*near, kind]


def choice(quick: bool, progress: Path | None = None) -> dict[str, Any]:
    """Run, print, return."""
    rows = (
        [picked(1, pixels=1000)] if quick else run(picked, list(range(EACH * len(KINDS))), progress)
    )
    results: dict[str, Any] = {"definition": expected.__doc__}
    right: dict[str, list[bool]] = {}
    for row in rows:
        state, names = expected(row)
        row["state"] = state
        right.setdefault(state, []).append(row["picked"] in names)
        right.setdefault(f"{state}: {row['kind']}", []).append(row["picked"] in names)
        if row["picked"] not in names:
            print(f"seed {row['seed']}: {row['kind']}, {state}, picked {row['picked']} not {names}")
            print("   apart", row["apart"], "behind", row["behind"])
    results["right_percent"] = {}
    for state, values in sorted(right.items()):
        results["right_percent"][state] = [percent(values), len(values)]
        print(f"{state:24} right in {percent(values):.0f} % of {len(values)}")
    return results
