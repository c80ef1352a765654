"""Draw the frontier and the scaling from their results: `python -m benchmarks.charts`."""

import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import Bbox
from PIL import Image

from benchmarks.harness import RESULTS

FIGURES = Path(__file__).parent / "figures"
DEFAULT, OURS, RIVAL, FRONT = "#c1272d", "#0b6e99", "#7a7a7a", "#e8a33d"
STYLES = {
    "uwaug": (OURS, "o"),
    "fused C++": ("#8a5a9e", "s"),
    "copy bound": (RIVAL, "^"),
    "memory": ("#2a7f4f", "D"),
}
SHOWN = (512, 1)  # size and threads of the panels drawn; all others are in the JSON
_NUMBER = re.compile(r"\b\d[\de.-]*(?: \+ \d+)?\b")
_STYLE = {
    "font.size": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9,
}


def save(figure: Figure, name: str) -> Path:
    """Write figures/NAME.png, in 96 colours: a third of the bytes."""
    FIGURES.mkdir(exist_ok=True)
    path = FIGURES / f"{name}.png"
    canvas = FigureCanvasAgg(figure)
    with matplotlib.rc_context(_STYLE):
        canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture.quantize(96, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def draw_frontier(results: dict[str, Any]) -> Path:
    return save(frontier_figure(results), "frontier")


def draw_scaling(results: dict[str, Any]) -> Path:
    return save(scaling_figure(results), "scaling")


def frontier_figure(results: dict[str, Any], shown: tuple[int, int] = SHOWN) -> Figure:
    """Time against PSNR of every method, a panel for each part of the model."""
    panels = [p for p in results["panels"].values() if (p["size"], p["threads"]) == shown]
    with matplotlib.rc_context(_STYLE):
        wide = [p for p in panels if p["part"].startswith("blur")]
        narrow = [p for p in panels if not p["part"].startswith("blur")]
        figure = Figure((13, 12.5), layout="constrained")
        grid = figure.add_gridspec(3, 6, height_ratios=(1.25, 1, 1))
        places = [
            grid[0, 0:3],
            grid[0, 3:6],
            grid[1, 0:3],
            grid[1, 3:6],
            grid[2, 0:2],
            grid[2, 2:4],
            grid[2, 4:6],
        ]
        drawn = [
            (figure.add_subplot(place), panel)
            for place, panel in zip(places, [*wide, *narrow], strict=False)
        ]
        size, threads = shown
        figure.suptitle(
            f"Error of the final image against time, {size}² px, {threads} thread{'s' * (threads > 1)}; "
            "up and to the left is better",
            fontsize=11,
        )
        handles = [
            Line2D(
                [], [], color=DEFAULT, marker="*", markersize=12, linestyle="", label="our default"
            ),
            Line2D([], [], color=OURS, marker="o", linestyle="", label="ours"),
            Line2D([], [], color=RIVAL, marker="s", linestyle="", label="others"),
            Line2D([], [], color=FRONT, linewidth=4, alpha=0.5, label="Pareto front"),
        ]
        figure.legend(
            handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9
        )
        marked = [(axes, _panel(axes, panel)) for axes, panel in drawn]
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # labels must not move what they were placed against
        for axes, points in marked:
            _label(figure, axes, points)
    return figure


def _is_ours(name: str) -> bool:
    return name.startswith(
        ("ours", "eager", "torch.compile", "ONNX", "float", "bfloat")
    ) or name.endswith("rates")


def _panel(axes: Axes, panel: dict[str, Any]) -> list[tuple[float, float, str, str]]:
    """Draw one panel; return (x, y, label, colour) of what is to be labelled, and unlabelled points with ""."""
    entries = sorted(panel["entries"], key=lambda e: e["median_ms"])
    top = max(e["psnr_db"] for e in entries if e["psnr_db"] is not None)
    top += 0.12 * (top - min(e["psnr_db"] for e in entries if e["psnr_db"] is not None))
    place = {
        e["name"]: (e["median_ms"], top if e["psnr_db"] is None else e["psnr_db"]) for e in entries
    }
    front = [place[e["name"]] for e in entries if e["front"]]
    axes.step(
        *zip(*front, strict=True),
        where="post",
        color=FRONT,
        linewidth=4,
        alpha=0.5,
        solid_capstyle="round",
        zorder=1,
    )
    series: dict[str, list[str]] = {}
    for e in panel["entries"]:
        series.setdefault(
            e["name"] if e["default"] else _NUMBER.sub("#", e["name"], count=1), []
        ).append(e["name"])
    points = []
    for names in series.values():
        default = any(e["default"] for e in entries if e["name"] == names[0])
        colour = DEFAULT if default else OURS if _is_ours(names[0]) else RIVAL
        xy = [place[name] for name in names]
        size, marker = (15, "*") if default else (5, "o" if _is_ours(names[0]) else "s")
        axes.plot(
            *zip(*xy, strict=True),
            color=colour,
            marker=marker,
            markersize=size,
            linewidth=0.8,
            zorder=4 if default else 3,
        )
        label = names[0]
        if len(names) > 1:
            first, last = (
                found.group()
                for found in (_NUMBER.search(names[0]), _NUMBER.search(names[-1]))
                if found
            )
            label = _NUMBER.sub(f"{first} … {last}", names[0], count=1)
        if any(e["psnr_db"] is None for e in entries if e["name"] in names):
            label += " (no error)"
        points += [(*p, "", colour) for p in xy[:-1]] + [(*xy[-1], label, colour)]
    axes.set_xscale("log")
    axes.margins(0.16, 0.16)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set(xlabel="time, ms (log)", ylabel="PSNR, dB")
    v = panel["verdict"]
    stands = (
        "on the front"
        if v["on_front"]
        else f"{100 * v['slower_than_front']:.0f} % slower than “{v['beaten_by']}”"
    )
    axes.set_title(f"{panel['part']}\ndefault: {v['psnr_db']:.1f} dB, {stands}", loc="left")
    axes.grid(alpha=0.2)
    return points


def _label(figure: Figure, axes: Axes, points: list[tuple[float, float, str, str]]) -> None:
    """Write each label beside its point, where it covers the least of points, labels and axes already there."""
    scale = figure.dpi / 72
    at = [axes.transData.transform((x, y)) for x, y, *_ in points]
    taken = [
        Bbox.from_bounds(px - r, py - r, 2 * r, 2 * r)
        for (px, py), (*_, colour) in zip(at, points, strict=True)
        for r in [scale * (8 if colour == DEFAULT else 4)]
    ]
    for line in axes.lines:
        path = axes.transData.transform(line.get_path().vertices)
        for start, end in pairwise(path):
            for share in np.linspace(0, 1, 2 + int(np.hypot(*(end - start)) / (6 * scale))):
                px, py = start + share * (end - start)
                taken.append(Bbox.from_bounds(px - scale, py - scale, 2 * scale, 2 * scale))
    frame = axes.get_window_extent()
    compass = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
    steps = [(r * dx, r * dy) for r in (8, 12, 17, 24, 32, 42, 56, 72) for dx, dy in compass]
    for (x, y, label, colour), (px, py) in sorted(
        zip(points, at, strict=True), key=lambda p: (p[0][3] != DEFAULT, p[0][0])
    ):
        if not label:
            continue
        text = axes.annotate(
            label,
            (x, y),
            (0, 0),
            textcoords="offset points",
            va="center",
            fontsize=7.5,
            color=colour,
        )
        extent = text.get_window_extent()
        width, height = (
            1.05 * extent.width + 4,
            extent.height + 2,
        )  # outlines are wider than hinted text

        def box(dx: float, dy: float) -> Bbox:
            left = px + dx * scale - (0 if dx > 0 else width if dx < 0 else width / 2)
            return Bbox.from_bounds(left, py + dy * scale - height / 2, width, height)

        def cost(step: tuple[float, float]) -> float:
            place = box(*step)
            outside = width * height - _overlap(place, frame)
            covered = sum(_overlap(place, other) for other in taken)
            leader = [(px + t * scale * step[0], py + t * scale * step[1]) for t in (0.5, 0.7, 0.9)]
            crossed = sum(
                other.contains(*p) for other in taken if not other.contains(px, py) for p in leader
            )
            return covered + 3 * outside + scale * (abs(step[0]) + abs(step[1])) + 10 * crossed

        dx, dy = min(steps, key=cost)
        taken.append(box(dx, dy))
        text.remove()
        across = "left" if dx > 0 else "right" if dx < 0 else "center"
        place = (dx - (0.04 * width / scale if dx < 0 else 0), dy)
        axes.annotate(
            label, (x, y), place, textcoords="offset points", ha=across, va="center", fontsize=7.5, color=colour,
            path_effects=[withStroke(linewidth=2, foreground="white")], zorder=5,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.4} if abs(dx) + abs(dy) > 14 else None,
        )  # fmt: skip


def _overlap(a: Bbox, b: Bbox) -> float:
    width, height = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
    return float(max(width, 0) * max(height, 0))


def scaling_figure(results: dict[str, Any]) -> Figure:
    """Time and peak memory on log–log axes, with the fitted exponents in the labels."""
    sweeps = results["sweeps"]
    titles = {
        "pixels": "pixels",
        "batch": "batch, images",
        "widest": "widest σ, px",
        "rates": "rates, direct + scatter",
    }
    with matplotlib.rc_context(_STYLE):
        figure = Figure((13, 6.4), layout="constrained")
        axes = figure.subplots(2, 4, sharex="col", sharey="row", height_ratios=(1.5, 1))
        for column, (name, title) in enumerate(titles.items()):
            sweep, (time, memory) = sweeps[name], axes[:, column]
            x = [p["x"] for p in sweep["points"]]
            for method, fit in sweep["fits"].items():
                ours_memory = method not in sweep["points"][0]["ms"]
                y = [
                    p["peak_mib"] if ours_memory else p["ms"][method]["median_ms"]
                    for p in sweep["points"]
                ]
                colour, marker = STYLES["memory" if ours_memory else method]
                said = "" if ours_memory else f"{method} "
                label = f"{said}∝ $x^{{{fit['exponent']:.2f}}}$ (×/÷ {fit['residual_factor']:.2f})"
                panel = memory if ours_memory else time
                panel.plot(
                    x, y, color=colour, marker=marker, markersize=4, linewidth=1, label=label
                )
            memory.set_xlabel(title)
            time.set_title(f"against {title.split(',')[0]}", loc="left")
            for panel in (time, memory):
                panel.set(xscale="log", yscale="log")
                panel.grid(alpha=0.2)
                panel.legend(frameon=False, fontsize=7.5, loc="upper left", handlelength=1.2)
        for panel in axes.flat:
            panel.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        for panel in axes[1, 1:]:
            panel.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            panel.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
            panel.xaxis.set_minor_formatter(NullFormatter())
        for row in axes:
            low, high = row[0].get_ylim()
            row[0].set_ylim(low, high * (high / low) ** 0.25)  # room for the legends
        axes[0, 0].set_ylabel("time, ms")
        axes[1, 0].set_ylabel("peak memory of uwaug, MiB")
        figure.suptitle(f"Scaling; {results['setting']}", fontsize=10)
    return figure


if __name__ == "__main__":
    for name, draw in (("frontier", draw_frontier), ("scaling", draw_scaling)):
        print(draw(json.loads((RESULTS / f"{name}.json").read_text())))
