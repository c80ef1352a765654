"""Error against time for every way to compute each part of the model, and where our default stands.

`python -m benchmarks.speed.frontier` writes results/frontier.json and figures/frontier.png. Each
panel swaps one part and keeps the others exact (`benchmarks.speed.panels`); errors are those of the
final image (linear light, 0…1) against float64, 61 bands and each pixel's own Gaussian. Scene:
scikit-image's motorcycle at 1…5 m in Jerlov 7C.
"""

import contextlib
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

from benchmarks.harness import command, race, save, use_threads
from benchmarks.speed import blurs
from benchmarks.speed.panels import (
    Contest,
    blur_contest,
    number_contest,
    runtime_contest,
    spectra_contest,
)

NEAR_TIE = 1.01  # a rival 1 % (.09 dB) less accurate still counts as equally accurate, against us
WITHIN = 0.1
BACKWARD = "forward + backward"
SCENE = "motorcycle, 1…5 m, Jerlov 7C (spectra also I), d = 1 m, g = .2, μ = .3, linear light"

Entry = dict[str, Any]


def errors(result: Tensor, exact: Tensor) -> dict[str, float | None]:
    """Largest error, RMSE, PSNR (None if there is no error) and SSIM of an image on a scale of
    0…1.
    """
    from skimage.metrics import structural_similarity

    difference = result.double() - exact
    rmse = float((difference**2).mean().sqrt())
    planar = [x[0].double().numpy() for x in (result, exact)]
    return {
        "max": float(difference.abs().max()),
        "rmse": rmse,
        "psnr_db": -20 * math.log10(rmse) if rmse > 0 else None,
        "ssim": float(structural_similarity(*planar, channel_axis=0, data_range=1.0)),
    }


def pareto(points: list[tuple[float, float]]) -> list[int]:
    """Indices of the (time, error) pairs that no other pair beats, in order of time."""
    front: list[int] = []
    for i in sorted(range(len(points)), key=points.__getitem__):
        if not front or points[i][1] < points[front[-1]][1] or points[i] == points[front[-1]]:
            front.append(i)
    return front


def excess(points: list[tuple[float, float]], ours: int) -> tuple[float, int]:
    """How much slower `ours` is than the fastest of equal or better error (0 = on the front), and
    which that is.
    """
    time, error = points[ours]
    rivals = [i for i, point in enumerate(points) if point[1] <= NEAR_TIE * error]
    best = min(rivals, key=lambda i: points[i][0])
    return (time / points[best][0] - 1, best) if points[best][0] < time else (0.0, ours)


def judged(entries: list[Entry]) -> dict[str, Any]:
    """A panel's entries with its front marked, and the verdict on our default."""
    points = [(entry["median_ms"], entry["rmse"]) for entry in entries]
    on = pareto(points)
    for i, entry in enumerate(entries):
        entry["front"] = i in on
    ours = next(i for i, entry in enumerate(entries) if entry["default"])
    slower, best = excess(points, ours)
    verdict = {
        "default": entries[ours]["name"],
        "psnr_db": entries[ours]["psnr_db"],
        "on_front": slower == 0,
        "slower_than_front": slower,
        "within_10_percent": slower <= WITHIN,
        "beaten_by": None if slower == 0 else entries[best]["name"],
    }
    return {"entries": entries, "verdict": verdict}


def raced(contest: Contest, rounds: int, seconds: float) -> list[Entry]:
    """Time and error of every method."""
    times = race(contest.methods, rounds, seconds, contest.ours)
    entries = []
    for name, run in contest.methods.items():
        entry = {"name": name, "default": name == contest.ours, **times[name]}
        entries.append({**entry, **_measured(contest, run())})
    if contest.blurs:
        case = contest.case
        _, took = blurs.exact(case.image, case.sigma, most=4)
        entry = {"name": "exact, per pixel", "default": False, "median_ms": took, "estimated": True}
        entries.append({**entry, **_measured(contest, case.scattered)})
    return entries


def _measured(contest: Contest, result: Any) -> Entry:
    """Errors of the final image, and of the blur itself where that is what was made."""
    case = contest.case
    if not contest.blurs:
        return errors(result, case.exact)
    blurred = blurs.planar(result).double()
    final = case.exact + case.share * (blurred - case.scattered)
    return {**errors(final, case.exact), "blur_alone": errors(blurred, case.scattered)}


def contests(size: int, threads: int, quick: bool) -> dict[str, Callable[[], Contest]]:
    """What makes the contest of each part."""
    made: dict[str, Callable[[], Contest]] = {
        "blur 0.9…4.5 px": partial(blur_contest, size, 4.5),
        "spectra 7C": partial(spectra_contest, size, "7C"),
        "spectra I": partial(spectra_contest, size, "I"),
        "number format": partial(number_contest, size),
        "forward": partial(runtime_contest, size, False, threads, quick),
        BACKWARD: partial(runtime_contest, size, True, threads, quick),
    }
    if 64 < size <= 512:
        made["blur 6…30 px"] = partial(blur_contest, size, 30.0)
    return made


def main(quick: bool = False) -> dict[str, Any]:
    """Run all panels; return what is saved (nothing is, if quick)."""
    rounds, seconds = (1, 1.0) if quick else (25, 6.0)
    settings = [(64, 1)] if quick else [(256, 1), (512, 1), (1024, 1), (512, 2)]
    panels: dict[str, dict[str, Any]] = {}
    skipped: set[str] = set()
    for size, threads in settings:
        use_threads(threads)
        for part, make in contests(size, threads, quick).items():
            with contextlib.nullcontext() if part == BACKWARD else torch.no_grad():
                contest = make()
                entries = raced(contest, rounds, seconds)
            panel = {"part": part, "size": size, "threads": threads, **judged(entries)}
            name = f"{part}, {size}², {threads} thread{'s' * (threads > 1)}"
            panels[name] = panel
            skipped |= set(contest.skipped)
            print(name, panel["verdict"], flush=True)
    results = {"scene": SCENE, "skipped": sorted(skipped), "panels": panels}
    if not quick:
        from benchmarks.figures.charts import draw_frontier

        print(save("frontier", results), draw_frontier(results))
    return results


if __name__ == "__main__":
    command(main, __doc__)
