"""A series of turbidities as a chart: coefficients against turbidity."""

from typing import TYPE_CHECKING

import numpy as np

from uwaug._support.sheet import GREY, HEADER, INK, MARGIN, RGB, Canvas
from uwaug.fitting.report import NORMAL
from uwaug.fitting.structure import COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from uwaug.fitting.series_result import SeriesFit

__all__ = ["draw_series"]

_TALL = 420  # px, of the axes


def draw_series(fit: "SeriesFit") -> "Figure":
    """Draw b of each level with its 95 % interval, the line and its band; what is left of b beside
    the line; a of each colour.
    """
    verdict = fit.message.splitlines()[1]
    canvas = Canvas(HEADER + _TALL + 110, "Scattering against turbidity", verdict)
    gap, bottom = 90, 70
    wide = (canvas.width - 2 * MARGIN - 2 * gap) / 3
    cells = []
    for i in range(3):
        left = MARGIN + 40 + i * (wide + gap - 20)
        cells.append(canvas.axes(left, HEADER + 30, wide - 40, _TALL - bottom + 60))
    _draw_lines(cells[0], fit)
    _draw_residuals(cells[1], fit)
    _draw_absorption(cells[2], fit)
    return canvas.figure


def _styled(axis: "Axes", title: str, xlabel: str, ylabel: str) -> None:
    axis.set_title(title, loc="left", fontsize=12.5, color=INK)
    axis.set_xlabel(xlabel, fontsize=11, color=GREY)
    axis.set_ylabel(ylabel, fontsize=11, color=GREY)
    axis.tick_params(labelsize=10, colors=GREY, length=3)
    axis.spines[["top", "right"]].set_visible(False)


def _scattering(fit: "SeriesFit", c: int) -> tuple[np.ndarray, np.ndarray]:
    """The b of each level in a colour, and its standard errors."""
    places = 3 + 3 * np.arange(len(fit.levels)) + c
    return fit.theta[places], np.sqrt(np.diag(fit.covariance)[places])


def _draw_lines(axis: "Axes", fit: "SeriesFit") -> None:
    levels = np.array(fit.levels)
    x = np.linspace(0, 1.05 * levels[-1], 60)
    for c, colour in enumerate(COLOURS):
        b, error = _scattering(fit, c)
        line = fit.lines[colour]
        middle = line.b0 + line.k * x
        half = NORMAL * line.error_at(x)
        axis.fill_between(x, middle - half, middle + half, color=RGB[c], alpha=0.2, linewidth=0)
        axis.plot(x, middle, color=RGB[c], linewidth=1.4, label=colour)
        axis.errorbar(levels, b, NORMAL * error, fmt="o", color=RGB[c], markersize=4, capsize=3)
    axis.set(xlim=(0, x[-1]), ylim=(0, None))
    axis.legend(frameon=False, fontsize=10)
    _styled(axis, "b, and b₀ + k·turbidity", f"turbidity [{fit.unit}]", "b [1/m]")


def _draw_residuals(axis: "Axes", fit: "SeriesFit") -> None:
    levels = np.array(fit.levels)
    axis.axhline(0, color=GREY, linewidth=1)
    step = 0.012 * levels[-1]  # colours side by side
    for c, colour in enumerate(COLOURS):
        b, error = _scattering(fit, c)
        line = fit.lines[colour]
        left = b - line.b0 - line.k * levels
        at = levels + (c - 1) * step
        odds = "" if line.probability is None else f"p = {line.probability:.2g}"
        axis.errorbar(
            at, left, NORMAL * error, fmt="o", color=RGB[c], markersize=4, capsize=3, label=odds
        )
    axis.set_xlim(0, 1.05 * levels[-1])
    if fit.lines["red"].probability is not None:
        axis.legend(frameon=False, fontsize=10)
    _styled(axis, "What is left of b beside its line", f"turbidity [{fit.unit}]", "[1/m]")


def _draw_absorption(axis: "Axes", fit: "SeriesFit") -> None:
    for c, colour in enumerate(COLOURS):
        one = fit.parameters[f"a_{colour}"]
        if one.value is None or one.low is None or one.high is None:
            axis.text(c, 0, "not identified", ha="center", fontsize=10, color=GREY)
            continue
        half = [[one.value - one.low], [one.high - one.value]]
        axis.errorbar([c], [one.value], half, fmt="o", color=RGB[c], markersize=5, capsize=4)
    axis.set(xlim=(-0.5, 2.5), xticks=range(3), xticklabels=COLOURS, ylim=(0, None))
    _styled(axis, "a, of all turbidities", "", "a [1/m]")
