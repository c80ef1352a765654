"""Results as pictures: what was observed, what the water makes of it, what is left, the curves, and
in words what was found. A series is a chart of coefficients against turbidity.
"""

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug._support.sheet import GAP, GREY, HEADER, INK, MARGIN, RGB, Canvas, show, show_map
from uwaug._support.sheet import plot as plot_cell
from uwaug.fitting.data import Pair
from uwaug.fitting.errors import NORMAL
from uwaug.fitting.models import COLOURS
from uwaug.fitting.results import Fit, Parameter, Result, SeriesFit, VeilFit, WaterFit
from uwaug.formation.colour import linear_to_srgb
from uwaug.optics.medium import Medium

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PAIRS = 3  # pairs that are shown at most
_ROWS = 14  # of the tables of parameters and candidates, at most
_SAMPLES = 200  # waters that the bands are of; of those by spectra, which take longer, a fifth
_LEAST = 0.002  # of linear light: residuals are not enlarged beyond half of a step of 8 bits
_GROUND = "#9a9a9a"  # behind pictures, where NaN lets it through

_CELL = (Canvas.width - 2 * MARGIN - 2 * GAP) / 3  # px
_LABEL, _CURVES, _PITCH, _LETTERS = 30, 320, 22, 82
_BAR = 220  # px, narrower than which a picture has no room for a colour bar
_MIDDLE = 700  # px from the left, where the message begins

_CHART = 420  # px, height of the axes of a series


class _Curves(NamedTuple):
    """What the curves of a sheet are of: media, the far end of the pictures, the unit of distance,
    and which of the three are known.
    """

    best: Medium
    samples: Medium
    farthest: float
    unit: str
    names: tuple[str, ...] = ("transmission", "signal", "backscatter")


_TITLES = {
    "transmission": "$T_β$   what is left of direct light",
    "signal": "$T_G$   with light scattered forward",
    "backscatter": "$V$   veil",
}


def plot(result: Result) -> "Figure":
    """Draw any of the results of `uwaug.fitting`."""
    generator = torch.Generator().manual_seed(0)
    if isinstance(result, SeriesFit):
        return _series(result)
    if isinstance(result, Fit):
        geometry = result.fitted.geometry
        samples = result.sample(_SAMPLES, generator)
        curves = _Curves(result.medium, samples, geometry.farthest, geometry.unit)
        return _sheet(result, f"A water from pictures: model “{result.model}”", curves)
    if isinstance(result, WaterFit):
        geometry = result.fitted.geometry
        samples = result.sample(_SAMPLES // 5, generator)
        curves = _Curves(result.medium, samples, geometry.farthest, geometry.unit)
        return _sheet(result, f"A water from pictures: Jerlov type {result.type}", curves)
    assert isinstance(result, VeilFit)
    # open water shows the end of a veil, a few lengths of its growth away
    G = result.theta.reshape(3, 2)[:, 1]
    farthest = min(result.farthest, 4 / float(G.min()))
    samples = result.sample(_SAMPLES, generator)
    curves = _Curves(result.medium, samples, farthest, "m", ("backscatter",))
    return _sheet(result, "A veil from pictures without their clean twins", curves)


def _sheet(result: Result, heading: str, curves: _Curves) -> "Figure":
    """A sheet of the first three pairs, as far as the result has its pictures; curves of distance
    with 95 % bands; parameters, message and candidates.
    """
    pairs = result.pairs[:_PAIRS] if isinstance(result, Fit) else ()
    formed = result.formed(_PAIRS) if isinstance(result, Fit) and pairs else []
    scale = _scale([difference for _, difference in formed])
    table, words, tried = _table(result), _words(result.message), _candidates(result)
    lines = max(len(table) + 1, len(words) + len(tried))
    height = HEADER + sum(2 * _pitch(pair) for pair in pairs)
    height += _LABEL + _CURVES + GAP + lines * _PITCH + MARGIN
    caption = "Bands hold 95 %; shaded: farther than 95 % of the pixels."
    if isinstance(result, Fit) and pairs:
        residuals = f"Residuals: linear light (0…1), all on one scale of ±{scale:g}."
        caption = f"{residuals} Grey: not counted. {caption}"
        if len(result.pairs) > _PAIRS:
            caption = f"{_PAIRS} of {len(result.pairs)} pairs. {caption}"
    canvas = Canvas(round(height), heading, caption)
    y = float(HEADER)
    if isinstance(result, Fit) and pairs:
        y = _draw_pairs(canvas, y, result, formed, scale)
    _draw_curves(canvas, y + _LABEL, curves)
    y += _LABEL + _CURVES + GAP + _PITCH / 2
    _write_table(canvas, y, table)
    for i, line in enumerate(words):
        canvas.write(_MIDDLE, y + i * _PITCH, line, 10.5)
    _write_candidates(canvas, y + len(words) * _PITCH, tried, result.chosen)
    return canvas.figure


def _tall(pair: Pair) -> float:
    """Height of a picture's cell: at most a square."""
    return min(_CELL * pair.size[0] / pair.size[1], _CELL)


def _wide(pair: Pair) -> float:
    return _tall(pair) * pair.size[1] / pair.size[0]


def _pitch(pair: Pair) -> float:
    return _LABEL + _tall(pair) + GAP


def _draw_pairs(
    canvas: Canvas, y: float, fit: Fit, formed: list[tuple[Tensor, Tensor]], scale: float
) -> float:
    """Pictures, distances and residuals; returns where they end."""
    ticks = (f"-{scale:g}", "0", f"+{scale:g}")
    for i, (rendered, difference) in enumerate(formed):
        pair = fit.pairs[i]
        first, second = _row(canvas, y, pair), _row(canvas, y + _pitch(pair), pair)
        which = f"{i + 1}: " if len(fit.pairs) > 1 else ""
        show(first[0], linear_to_srgb(pair.observed.clamp(0, 1)), f"{which}Observed")
        picture = linear_to_srgb(rendered.clamp(0, 1))
        # as an image of four channels, whose last lets grey through
        seen = torch.cat([picture, pair.usable.to(picture)])
        show(first[1], seen, f"{which}Rendered by the fit")
        _show_distance(first[2], pair, f"{which}Distance", fit.fitted.geometry.unit)
        for c, colour in enumerate(COLOURS):
            label = f"{which}Rendered − observed, {colour}"
            bar = i == 0 and c == 0 and _wide(pair) >= _BAR
            show_map(second[c], difference[c : c + 1], label, "RdBu_r", ticks, bar=bar)
        y += 2 * _pitch(pair)
    return y


def _row(canvas: Canvas, y: float, pair: Pair) -> list["Axes"]:
    """Three cells of the shape of a pair's pictures, on grey."""
    wide, tall = _wide(pair), _tall(pair)
    cells = []
    for i in range(3):
        cell = canvas.axes(MARGIN + i * (_CELL + GAP), y + _LABEL, wide, tall)
        cell.set(xticks=[], yticks=[], facecolor=_GROUND)
        cell.spines[:].set_visible(False)
        cells.append(cell)
    return cells


def _scale(residual: Sequence[Tensor]) -> float:
    """One end for all: what 99 % of the values are within, rounded up to 1, 2 or 5 of a decade."""
    end = _LEAST
    for part in residual:
        values = part[part.isfinite()].abs()
        if values.numel():
            end = max(end, float(np.quantile(values.numpy(), 0.99)))
    decade = 10.0 ** math.floor(math.log10(end))
    steps = (step * decade for step in (1, 2, 5, 10))
    return next(step for step in steps if end <= step * (1 + 1e-6))


def _show_distance(axis: "Axes", pair: Pair, label: str, unit: str) -> None:
    """Of the pixels that count."""
    finite = pair.finite
    if not bool(finite.any()):
        axis.set_title(f"{label}: open water", loc="left", fontsize=12.5)
        return
    low, high = np.quantile(pair.z[finite].numpy(), (0.01, 0.99))
    ticks = (f"{low:.3g} {unit}", f"{(low + high) / 2:.3g} {unit}", f"{high:.3g} {unit}")
    label = f"{label}, {low:.3g}–{high:.3g} {unit}"
    z = torch.where(finite, pair.z, torch.nan)
    show_map(axis, z, label, "viridis_r", ticks, bar=_wide(pair) >= _BAR)


def _draw_curves(canvas: Canvas, y: float, curves: _Curves) -> None:
    """Curves of distance, with the bands of waters that the pictures allow."""
    z = torch.linspace(0, 1.25 * curves.farthest, 161, dtype=torch.float64)
    quantiles = torch.tensor([0.025, 0.975], dtype=torch.float64)
    for i, name in enumerate(curves.names):
        best, samples = getattr(curves.best, name)(z), getattr(curves.samples, name)(z)
        cell = canvas.axes(MARGIN + i * (_CELL + GAP), y, _CELL, _CURVES)
        cell.set_axis_off()
        axis = plot_cell(cell, _TITLES[name], f"distance [{curves.unit}]", "")
        low, high = samples.quantile(quantiles, dim=0)
        for c, colour in enumerate(RGB):
            axis.fill_between(z, low[c], high[c], color=colour, alpha=0.25, linewidth=0)
            axis.plot(z.numpy(), best[0, c].numpy(), color=colour, linewidth=1.6)
        axis.axvspan(curves.farthest, float(z[-1]), color="black", alpha=0.07, linewidth=0)
        axis.set(xlim=(0, float(z[-1])), ylim=(0, 1))
        if name == "backscatter" and float(best.max()) > 0:
            # a veil that is not identified has bands without end
            axis.set_ylim(0, max(1.15 * float(best.max()), min(float(high.max()), 1.0)))


def _table(result: Result) -> list[tuple[str, list[str]]]:
    """Rows of a name and of one number, or of three, of red, green and blue."""
    rows: dict[str, list[str]] = {}
    for name, number in result.parameters.items():
        kind, _, colour = name.rpartition("_")
        kind = kind if colour in COLOURS else name
        kind = "β" if kind == "beta" else kind.replace("_", " ")
        unit = "" if number.unit == "1" else f"  [{number.unit}]"
        rows.setdefault(f"{kind}{unit}", []).append(_told(number))
    table = list(rows.items())
    if len(table) > _ROWS:
        table = [*table[: _ROWS - 1], (f"and {len(table) - _ROWS + 1} more, see the summary", [])]
    return table


def _told(number: Parameter) -> str:
    """A number and its error, to the digits that the error leaves."""
    if number.value is None:
        return "not identified"
    if number.error is None:
        return f"{round(number.value, 6):.3g} ({number.state})"
    # what rounds to 0 is rounded up
    error = max(number.error, 1e-5)
    digits = min(max(1 - math.floor(math.log10(error)), 0), 5)
    return f"{number.value:.{digits}f} ± {error:.{digits}f}"


def _words(message: str) -> list[str]:
    """The message, in lines that fit."""
    return [line for row in message.splitlines() for line in textwrap.wrap(row, _LETTERS)]


def _write_table(canvas: Canvas, y: float, table: list[tuple[str, list[str]]]) -> None:
    across = [MARGIN + 150 + 165 * i for i in range(3)]
    if any(len(cells) == 3 for _, cells in table):
        for x, colour, name in zip(across, RGB, COLOURS, strict=True):
            canvas.write(x, y, name, 10.5, colour, fontweight="bold")
    for i, (name, cells) in enumerate(table):
        canvas.write(MARGIN, y + (i + 1) * _PITCH, name, 10.5, GREY)
        for x, cell in zip(across, cells, strict=False):
            canvas.write(x, y + (i + 1) * _PITCH, cell, 10.5)


def _candidates(result: Result) -> list[tuple[str, ...]]:
    """Rows of the models that were tried, if there were several, below an empty one."""
    if len(result.candidates) < 2:
        return []
    rows = [(), ("models tried", "numbers", "held-out error", "behind the best")]
    for tried in result.candidates[:_ROWS]:
        behind = f"{tried.behind:.3g} ± {tried.behind_error:.2g}" if tried.behind else "best"
        rows.append((tried.name, str(tried.numbers), f"{tried.error:.4f}", behind))
    return rows


def _write_candidates(canvas: Canvas, y: float, rows: list[tuple[str, ...]], chosen: str) -> None:
    across = [_MIDDLE, _MIDDLE + 150, _MIDDLE + 260, _MIDDLE + 420]
    for i, row in enumerate(rows):
        for x, text in zip(across, row, strict=False):
            weight = "bold" if row[0] == chosen else "normal"
            colour = GREY if i == 1 else INK
            canvas.write(x, y + i * _PITCH, text, 10.5, colour, fontweight=weight)


# ---- a series


def _series(fit: SeriesFit) -> "Figure":
    """Draw b of each level with its 95 % interval, the line and its band; what is left of b beside
    the line; a of each colour.
    """
    verdict = fit.message.splitlines()[1]
    canvas = Canvas(HEADER + _CHART + 110, "Scattering against turbidity", verdict)
    gap, bottom = 90, 70
    wide = (canvas.width - 2 * MARGIN - 2 * gap) / 3
    cells = []
    for i in range(3):
        left = MARGIN + 40 + i * (wide + gap - 20)
        cells.append(canvas.axes(left, HEADER + 30, wide - 40, _CHART - bottom + 60))
    _draw_lines(cells[0], cells[1], fit)
    _draw_absorption(cells[2], fit)
    return canvas.figure


def _styled(axis: "Axes", title: str, xlabel: str, ylabel: str) -> None:
    axis.set_title(title, loc="left", fontsize=12.5, color=INK)
    axis.set_xlabel(xlabel, fontsize=11, color=GREY)
    axis.set_ylabel(ylabel, fontsize=11, color=GREY)
    axis.tick_params(labelsize=10, colors=GREY, length=3)
    axis.spines[["top", "right"]].set_visible(False)


def _draw_lines(axis: "Axes", beside: "Axes", fit: SeriesFit) -> None:
    """The b of each level with the line, and what is left beside the line."""
    levels = np.array(fit.levels)
    x = np.linspace(0, 1.05 * levels[-1], 60)
    beside.axhline(0, color=GREY, linewidth=1)
    for c, colour in enumerate(COLOURS):
        places = 3 + 3 * np.arange(len(levels)) + c
        b, half = fit.theta[places], NORMAL * np.sqrt(np.diag(fit.covariance)[places])
        line = fit.lines[colour]
        middle, band = line.b0 + line.k * x, NORMAL * line.error_at(x)
        axis.fill_between(x, middle - band, middle + band, color=RGB[c], alpha=0.2, linewidth=0)
        axis.plot(x, middle, color=RGB[c], linewidth=1.4, label=colour)
        axis.errorbar(levels, b, half, fmt="o", color=RGB[c], markersize=4, capsize=3)
        left = b - line.b0 - line.k * levels
        at = levels + (c - 1) * 0.012 * levels[-1]  # colours side by side
        odds = "" if line.probability is None else f"p = {line.probability:.2g}"
        beside.errorbar(at, left, half, fmt="o", color=RGB[c], markersize=4, capsize=3, label=odds)
    axis.set(xlim=(0, x[-1]), ylim=(0, None))
    axis.legend(frameon=False, fontsize=10)
    _styled(axis, "b, and b₀ + k·turbidity", f"turbidity [{fit.unit}]", "b [1/m]")
    beside.set_xlim(0, x[-1])
    if fit.lines["red"].probability is not None:
        beside.legend(frameon=False, fontsize=10)
    _styled(beside, "What is left of b beside its line", f"turbidity [{fit.unit}]", "[1/m]")


def _draw_absorption(axis: "Axes", fit: SeriesFit) -> None:
    for c, colour in enumerate(COLOURS):
        a = fit.parameters[f"a_{colour}"]
        if a.value is None or a.low is None or a.high is None:
            axis.text(c, 0, "not identified", ha="center", fontsize=10, color=GREY)
            continue
        half = [[a.value - a.low], [a.high - a.value]]
        axis.errorbar([c], [a.value], half, fmt="o", color=RGB[c], markersize=5, capsize=4)
    axis.set(xlim=(-0.5, 2.5), xticks=range(3), xticklabels=COLOURS, ylim=(0, None))
    _styled(axis, "a, of all turbidities", "", "a [1/m]")
