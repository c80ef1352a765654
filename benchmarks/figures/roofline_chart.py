"""The roofline as a figure; run as a module, it draws it from its results."""

import json
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.figures.charts import DEFAULT, OURS, RIVAL, STYLE, plain_numbers, save_small
from benchmarks.harness import RESULTS

_LOOKS = {
    "compiled loops": (OURS, "o"),
    "eager": (DEFAULT, "*"),
    "direct + veil": (RIVAL, "^"),
    "published recipe": (RIVAL, "s"),
}
_SPAN = (1.0, 1500.0)  # flops for each byte


def draw_roofline(results: dict[str, Any]) -> Path:
    return save_small(roofline_figure(results), "roofline")


def roofline_figure(results: dict[str, Any]) -> Figure:
    """Rate against arithmetic for each byte; beside it, what the arithmetic is for."""
    with matplotlib.rc_context(STYLE):
        figure = Figure((9, 3.8), layout="constrained")
        roof, parts = figure.subplots(1, 2, width_ratios=(1.9, 1))
        _roof(roof, results["rates"])
        for name, at in results["paths"].items():
            _path(roof, name, at)
        slowest = min(at["gflops"] for at in results["paths"].values())
        highest = max(results["rates"]["matrix product"], results["rates"]["polynomial"])
        roof.set(xscale="log", yscale="log", xlim=_SPAN, ylim=(slowest / 2, highest * 2))
        roof.set(xlabel="additions + multiplications a byte moved at least", ylabel="GFLOP/s")
        plain_numbers(roof.xaxis)
        plain_numbers(roof.yaxis)
        roof.grid(alpha=0.2)
        roof.set_title("Where the time of each path stands", loc="left")
        _parts(parts, results["paths"]["compiled loops"]["parts"])
        figure.suptitle(results["setting"], fontsize=9)
    return figure


def _roof(axes: Axes, rates: dict[str, float]) -> None:
    x = np.geomspace(*_SPAN, 200)
    product, loop = rates["matrix product"], rates["polynomial"]
    memory = np.minimum(x * rates["copy in memory"], max(product, loop))
    axes.plot(x, memory, color="k", linewidth=1.5)
    cache = x * rates["copy in cache"]
    axes.plot(x[cache < product], cache[cache < product], color=RIVAL, linewidth=0.8, dashes=(4, 2))
    axes.axhline(min(product, loop), color=RIVAL, linewidth=0.8, dashes=(4, 2))
    right = {"ha": "right", "fontsize": 7}
    most = f"plain loop {loop:.0f}, matrix product {product:.0f} GFLOP/s"
    axes.text(_SPAN[1], max(product, loop) * 1.08, most, va="bottom", **right)
    said = f"copies: {rates['copy in memory']:.0f} GB/s in memory (line),\n"
    said += f"{rates['copy in cache']:.0f} in cache (dashed)"
    axes.text(0.99, 0.6, said, transform=axes.transAxes, va="top", **right)


def _path(axes: Axes, name: str, at: dict[str, Any]) -> None:
    colour, marker = _LOOKS[name]
    size = 13 if marker == "*" else 7
    place = (at["flops_per_byte"], at["gflops"])
    axes.plot(*place, color=colour, marker=marker, markersize=size, linestyle="")
    said = f"{name}, {at['median_ms']:.1f} ms\n({at['times_least']:.1f} × the least)"
    axes.annotate(said, place, (-4, -8), textcoords="offset points", va="top", fontsize=7.5)


def _parts(axes: Axes, parts: dict[str, float]) -> None:
    names = list(parts)[::-1]
    bars = axes.barh(names, [parts[name] for name in names], color=OURS, height=0.6)
    axes.bar_label(bars, fmt="%.0f", padding=2)
    axes.margins(x=0.15)
    axes.set_title(f"Our {sum(parts.values()):.0f} operations a pixel", loc="left")


if __name__ == "__main__":
    print(draw_roofline(json.loads((RESULTS / "roofline.json").read_text())))
