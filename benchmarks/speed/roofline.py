"""Roofline: how far each path is from what this machine can do.

`python -m benchmarks.speed.roofline` writes results/roofline.json and a figure. Survey preset,
Jerlov 7C, 512², with field, linear light, float32, one thread. The arithmetic is counted by formula
from the plan and the rates: additions and multiplications, a multiply-add is two; no comparisons
and no conversions. Bytes are those that any program has to move: image, distance and field are read
once, the result is written once. Peak and copy rates are measured in the same race as the paths.

Eager PyTorch has the same plan, so the same arithmetic is needed. What it does beyond (zeros in
blocks of its matrices, intermediates in memory) counts as time lost.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numba
import numpy as np
import torch
from referees import published

import uwaug
from benchmarks.harness import command, race, save, scene, use_threads
from benchmarks.speed.loops import WATER, by, direct_and_veil, module
from uwaug.blur.plan import BlurPlan
from uwaug.formation.loops.tables import CoarseTable, Floats, medium_tables, plan_table
from uwaug.optics.medium import Medium

Work = dict[str, float]
"""Additions and multiplications for each pixel, of each part."""

CHANNELS = 3
EXP, LOG = 16, 21
"""Of one exponential and one logarithm, as in `uwaug.formation.loops.approx`."""

BYTES = 4 * (CHANNELS + 1 + 1 + CHANNELS)
"""For each pixel: image, distance, field; result."""

SIDE = 512  # of the matrices, and by default of the picture
STEPS = 32  # of the polynomial


def narrow(pairs: int) -> int:
    """One blur on the image's own grid, along both axes: a middle tap, and pairs of equal ones."""
    return CHANNELS * 2 * (1 + 3 * pairs)


def wide(grid: CoarseTable) -> float:
    """One blur on a coarse grid: shrunk along both axes, enlarged along both."""
    height, width = len(grid.rows) - 2 * grid.row_margin, len(grid.back_first)
    (lines, down), (cells, across) = grid.down.shape, grid.across.shape
    back = grid.back.shape[1]
    shrunk = 2 * down * lines * width + 2 * across * lines * cells
    enlarged = 2 * back * lines * width + 2 * back * height * width
    return CHANNELS * (shrunk + enlarged) / (height * width)


def arithmetic(plan: BlurPlan, medium: Medium, size: tuple[int, int]) -> Work:
    """Our model with field, whichever path computes it."""
    stack, coarse = plan_table(plan, size)
    (table,) = medium_tables(medium, plan, size)
    blurs, terms = len(plan.coefficients), len(plan.coefficients[0])
    rates, direct = len(table.rates), table.direct.shape[1]
    falling = rates - direct
    place = (LOG + 3) + 6 if blurs > 1 else 0  # three more: log2(1 + x) keeps what rounding loses
    if blurs > 1 and table.law[2] != 1:
        place += LOG + EXP + 1
    shares = place + 3 * max(terms - 2, 0) + 2 * blurs * terms
    # a rate is multiplied with z; that of the veil also gives e^−x − 1
    curves = (EXP + 1) * rates + 2 * falling + CHANNELS * 2 * (direct + rates + falling)
    return {
        "narrow blurs": float(sum(narrow(int(pairs)) for pairs in stack.pairs)),
        "coarse blurs": sum(wide(grid) for grid in coarse),
        "shares of the blurs": float(shares),
        "curves": float(curves),
        "sum": float(CHANNELS * (2 * blurs - 1 + 4) + 1),  # and distance times field
    }


def arithmetic_of_recipe(size: int) -> Work:
    """`published.published`, whose 30 blurs have kernels of 15×15."""
    bands = len(published.WAVELENGTHS)
    # twice: bands to channels by z, rates of channels by their logarithm, and by m·z
    transmission = bands * (EXP + 1) + 2 * bands * CHANNELS + CHANNELS * (LOG + EXP + 3)
    veil = bands * (EXP + 2) + 2 * bands * CHANNELS
    return {
        "30 blurs": float(published.BINS * narrow(7)),
        "blur of distance": narrow(10) / CHANNELS,
        "curves": float(2 * transmission + veil),
        "sum": float(CHANNELS * 6 + 2),
    }


def arithmetic_without_scatter() -> Work:
    """`direct_and_veil`."""
    return {"curves": float(CHANNELS * 2 * (EXP + 1)), "sum": float(CHANNELS * 5 + 1)}


@numba.njit(fastmath={"contract"}, error_model="numpy")  # type: ignore[untyped-decorator]
def _polynomial(values: Floats, factor: np.float32, repeats: int) -> None:
    """STEPS multiply-adds for each value, which stays in the first-level cache."""
    for _ in range(repeats):
        for i in range(values.size):
            x = values[i]
            total = x
            for _ in range(STEPS):
                total = total * x + factor
            values[i] = total


class Kernel(NamedTuple):
    """What measures a rate of the machine.

    Attributes:
        run: the kernel.
        amount: what one run computes (additions and multiplications) or moves (bytes).
    """

    run: Callable[[], object]
    amount: float


def kernels(size: int, quick: bool) -> dict[str, Kernel]:
    """Peak of multiply-adds, by matrix product and by a plain loop; copies in memory and in cache.

    A copy reads and writes, so it moves twice its size.
    """
    factor = torch.full((SIDE, SIDE), 0.5)
    made = torch.empty_like(factor)
    values, repeats = np.full(4096, 0.5, np.float32), 2 if quick else 200
    found = {
        "matrix product": Kernel(partial(torch.mm, factor, factor, out=made), 2.0 * SIDE**3),
        "polynomial": Kernel(
            partial(_polynomial, values, np.float32(0.25), repeats),
            2.0 * STEPS * repeats * values.size,
        ),
    }
    pictures = {"copy in memory": (1 if quick else 64) * 2**20, "copy in cache": 12 * size * size}
    for name, length in pictures.items():
        source = np.ones(length // 4, np.float32)
        found[name] = Kernel(partial(np.copyto, np.zeros_like(source), source), 2.0 * length)
    return found


def paths(size: int) -> tuple[dict[str, Callable[[], object]], dict[str, Work]]:
    """What runs, and the arithmetic that it needs."""
    image, distance = scene(size)
    field = uwaug.gaussian_random_field(distance.shape)
    degrade, bands = module("linear"), published.bands(WATER)
    planes = (image[0].permute(1, 2, 0), distance[0, 0], field[0, 0])
    arrays = [np.ascontiguousarray(plane.numpy()) for plane in planes]
    ours = arithmetic(degrade.plan((size, size)), degrade.medium, (size, size))
    given = (image, distance, field)
    runners: dict[str, Callable[[], object]] = {
        "compiled loops": by(True, degrade, *given),
        "eager": by(False, degrade, *given),
        "direct + veil": partial(direct_and_veil, *given),
        "published recipe": partial(published.published, *arrays, bands),
    }
    work = {
        "compiled loops": ours,
        "eager": ours,
        "direct + veil": arithmetic_without_scatter(),
        "published recipe": arithmetic_of_recipe(size),
    }
    return runners, work


def stands(work: Work, pixels: int, median_ms: float, rates: dict[str, float]) -> dict[str, Any]:
    """Where a path stands: its rate, and the time that the machine itself would need.

    rates: in 1e9 operations or bytes for each second.
    """
    flops = sum(work.values())
    peak = max(rates["matrix product"], rates["polynomial"])
    least = max(flops / peak, BYTES / rates["copy in memory"]) * pixels / 1e6
    return {
        "flops_per_pixel": flops,
        "bytes_per_pixel": BYTES,
        "flops_per_byte": flops / BYTES,
        "parts": work,
        "median_ms": median_ms,
        "gflops": flops * pixels / median_ms / 1e6,
        "least_ms": least,
        "times_least": median_ms / least,
    }


def report(found: dict[str, Any]) -> None:
    """Print what was counted and measured."""
    for name, rate in found["rates"].items():
        unit = "GB/s" if name.startswith("copy") else "GFLOP/s"
        print(f"{name:<18} {rate:7.1f} {unit}")
    for name, at in found["paths"].items():
        counted = f"{at['flops_per_pixel']:6.0f} flops/px, {at['flops_per_byte']:6.1f} a byte"
        took = f"{at['median_ms']:7.2f} ms, {at['gflops']:5.1f} GFLOP/s"
        print(f"{name:<18} {counted}, {took}, {at['times_least']:6.1f} times the least")


def main(quick: bool = False) -> dict[str, Any]:
    """Count, race and draw; return what is saved (nothing is, if quick)."""
    size = 64 if quick else SIDE
    use_threads(1)
    runners, work = paths(size)
    machine = kernels(size, quick)
    all_runners = {**runners, **{name: kernel.run for name, kernel in machine.items()}}
    with torch.no_grad():
        times = race(all_runners, 3 if quick else 31, 2.0 if quick else 60.0)
    rates = {}
    for name, kernel in machine.items():
        rates[name] = kernel.amount / times[name]["median_ms"] / 1e6
    found = {}
    for name, counted in work.items():
        found[name] = stands(counted, size * size, times[name]["median_ms"], rates)
    setting = f"{WATER}, survey, {size}² with field, linear light, float32, one thread"
    noise = "a machine shared with others: medians of interleaved runs; read the ratios"
    results = {"setting": setting, "noise": noise, "rates": rates, "paths": found, "ms": times}
    report(results)
    if not quick:
        from benchmarks.figures.roofline_chart import draw_roofline

        print(save("roofline", results), draw_roofline(results))
    return results


if __name__ == "__main__":
    command(main, __doc__)
