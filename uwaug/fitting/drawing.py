"""The picture of a fit: what was observed, what the water makes of it, what is left, the curves,
and in words what was found.
"""

import math
import textwrap
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from uwaug._support.sheet import GAP, GREY, HEADER, INK, MARGIN, RGB, Canvas, plot, show, show_map
from uwaug.fitting.pixels import Pair
from uwaug.fitting.report import Parameter
from uwaug.fitting.structure import COLOURS
from uwaug.formation.colour import linear_to_srgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from uwaug.fitting.result import Fit

__all__ = ["draw"]

_PAIRS = 3
"""Pairs that are shown at most."""

_ROWS = 14
"""Of the table of parameters, at most."""

_SAMPLES = 200
"""Waters that the bands are of."""

_LEAST = 0.002
"""Of linear light: residuals are not enlarged beyond half of a step of 8 bits."""

_CELL = (Canvas.width - 2 * MARGIN - 2 * GAP) / 3  # px
_LABEL, _CURVES, _PITCH, _LETTERS = 30, 320, 22, 82
_BAR = 220  # px, narrower than which a picture has no room for a colour bar
_MIDDLE = 700
"""px from the left, where the verdict begins."""

_NAMES = {"beta": "β"}


def draw(fit: "Fit") -> "Figure":
    """A sheet of the first three pairs, as far as the fit has its pictures; curves of distance with
    95 % bands; parameters, verdict and candidates.

    Args:
        fit: as `uwaug.fit` returns it. One that was read from a file has no pictures.
    """
    pairs = fit.pairs[:_PAIRS]
    formed = fit._formed(_PAIRS) if pairs else []
    scale = _scale([difference for _, difference in formed])
    table, words, tried = _table(fit), _words(fit.message), _candidates(fit)
    lines = max(len(table) + 1, len(words) + len(tried))
    height = HEADER + sum(2 * _pitch(pair) for pair in pairs)
    height += _LABEL + _CURVES + GAP + lines * _PITCH + MARGIN
    heading = f"A water from pictures: model “{fit.model}”"
    canvas = Canvas(round(height), heading, _caption(fit, scale))
    y = float(HEADER)
    if pairs:
        y = _draw_pairs(canvas, y, fit, formed, scale)
    _draw_curves(canvas, y + _LABEL, fit)
    y += _LABEL + _CURVES + GAP + _PITCH / 2
    _write_table(canvas, y, table)
    for i, line in enumerate(words):
        canvas.write(_MIDDLE, y + i * _PITCH, line, 10.5)
    _write_candidates(canvas, y + len(words) * _PITCH, tried, fit.structure.name)
    return canvas.figure


def _caption(fit: "Fit", scale: float) -> str:
    """What the sheet shows."""
    parts = []
    if len(fit.pairs) > _PAIRS:
        parts.append(f"{_PAIRS} of {len(fit.pairs)} pairs.")
    if fit.pairs:
        parts.append(f"Residuals: linear light (0…1), all on one scale of ±{scale:g}.")
        parts.append("Grey: not counted.")
    parts.append("Bands hold 95 %; shaded: farther than 95 % of the pixels.")
    return " ".join(parts)


def _tall(pair: Pair) -> float:
    """Height of a picture's cell: at most a square."""
    return min(_CELL * pair.size[0] / pair.size[1], _CELL)


def _draw_pairs(
    canvas: Canvas, y: float, fit: "Fit", formed: list[tuple[Tensor, Tensor]], scale: float
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
        _show_distance(first[2], pair, f"{which}Distance", fit.structure.geometry.unit)
        for c, colour in enumerate(COLOURS):
            label = f"{which}Rendered − observed, {colour}"
            bar = i == 0 and c == 0 and _wide(pair) >= _BAR
            show_map(second[c], difference[c : c + 1], label, "RdBu_r", ticks, bar=bar)
        y += 2 * _pitch(pair)
    return y


def _wide(pair: Pair) -> float:
    return _tall(pair) * pair.size[1] / pair.size[0]


def _pitch(pair: Pair) -> float:
    return _LABEL + _tall(pair) + GAP


def _row(canvas: Canvas, y: float, pair: Pair) -> list["Axes"]:
    """Three cells of the shape of a pair's pictures, on grey, which NaN lets through."""
    wide, tall = _wide(pair), _tall(pair)
    cells = []
    for i in range(3):
        cell = canvas.axes(MARGIN + i * (_CELL + GAP), y + _LABEL, wide, tall)
        cell.set(xticks=[], yticks=[], facecolor="#9a9a9a")
        cell.spines[:].set_visible(False)
        cells.append(cell)
    return cells


def _scale(residual: list[Tensor]) -> float:
    """One end for all: what 99 % of the values are within, rounded up to 1, 2 or 5 of a decade."""
    wanted = _LEAST
    for part in residual:
        known = part[part.isfinite()].abs()
        if known.numel():
            wanted = max(wanted, float(np.quantile(known.numpy(), 0.99)))
    decade = 10.0 ** math.floor(math.log10(wanted))
    for step in (1, 2, 5):
        if wanted <= step * decade * (1 + 1e-6):
            return step * decade
    return 10 * decade


def _show_distance(axis: "Axes", pair: Pair, label: str, unit: str) -> None:
    """Of the pixels that count."""
    known = pair.known
    if not bool(known.any()):
        axis.set_title(f"{label}: open water", loc="left", fontsize=12.5)
        return
    low, high = np.quantile(pair.z[known].numpy(), (0.01, 0.99))
    ticks = (f"{low:.3g} {unit}", f"{(low + high) / 2:.3g} {unit}", f"{high:.3g} {unit}")
    label = f"{label}, {low:.3g}–{high:.3g} {unit}"
    z = torch.where(known, pair.z, torch.nan)
    show_map(axis, z, label, "viridis_r", ticks, bar=_wide(pair) >= _BAR)


def _draw_curves(canvas: Canvas, y: float, fit: "Fit") -> None:
    """Curves of distance, with the bands of waters that the pictures allow."""
    geometry = fit.structure.geometry
    z = torch.linspace(0, 1.25 * geometry.farthest, 161, dtype=torch.float64)
    best = fit.medium
    others = fit.sample(_SAMPLES, generator=torch.Generator().manual_seed(0))
    curves = (
        ("$T_β$   what is left of direct light", best.transmission(z), others.transmission(z)),
        ("$T_G$   with light scattered forward", best.signal(z), others.signal(z)),
        ("$V$   veil", best.backscatter(z), others.backscatter(z)),
    )
    for i, (label, curve, samples) in enumerate(curves):
        cell = canvas.axes(MARGIN + i * (_CELL + GAP), y, _CELL, _CURVES)
        cell.set_axis_off()
        axis = plot(cell, label, f"distance [{geometry.unit}]", "")
        low, high = samples.quantile(torch.tensor([0.025, 0.975], dtype=torch.float64), dim=0)
        for c, colour in enumerate(RGB):
            axis.fill_between(z, low[c], high[c], color=colour, alpha=0.25, linewidth=0)
            axis.plot(z.numpy(), curve[0, c].numpy(), color=colour, linewidth=1.6)
        axis.axvspan(geometry.farthest, float(z[-1]), color="black", alpha=0.07, linewidth=0)
        axis.set(xlim=(0, float(z[-1])), ylim=(0, 1))
        if i == 2 and float(curve.max()) > 0:
            # a veil that is not identified has bands without end
            axis.set_ylim(0, max(1.15 * float(curve.max()), min(float(high.max()), 1.0)))


def _table(fit: "Fit") -> list[tuple[str, list[str]]]:
    """Rows of a name and of one number, or of three, of red, green and blue."""
    rows: dict[str, list[str]] = {}
    for name, one in fit.parameters.items():
        kind, _, colour = name.rpartition("_")
        kind = kind if colour in COLOURS else name
        unit = "" if one.unit == "1" else f"  [{one.unit}]"
        rows.setdefault(f"{_NAMES.get(kind, kind.replace('_', ' '))}{unit}", []).append(_told(one))
    found = list(rows.items())
    if len(found) > _ROWS:
        found = [*found[: _ROWS - 1], (f"and {len(found) - _ROWS + 1} more, see the summary", [])]
    return found


def _told(one: Parameter) -> str:
    """A number and its error, to the digits that the error leaves."""
    if one.value is None:
        return "not identified"
    if one.error is None:
        return f"{round(one.value, 6):.3g} ({one.state})"
    # what rounds to 0 is rounded up
    error = max(one.error, 1e-5)
    digits = min(max(1 - math.floor(math.log10(error)), 0), 5)
    return f"{one.value:.{digits}f} ± {error:.{digits}f}"


def _words(message: str) -> list[str]:
    """The verdict, in lines that fit."""
    lines = []
    for sentence in message.splitlines():
        lines += textwrap.wrap(sentence, _LETTERS)
    return lines


def _write_table(canvas: Canvas, y: float, table: list[tuple[str, list[str]]]) -> None:
    across = [MARGIN + 130 + 170 * i for i in range(3)]
    for x, colour, name in zip(across, RGB, COLOURS, strict=True):
        canvas.write(x, y, name, 10.5, colour, fontweight="bold")
    for i, (name, cells) in enumerate(table):
        canvas.write(MARGIN, y + (i + 1) * _PITCH, name, 10.5, GREY)
        for x, cell in zip(across, cells, strict=False):
            canvas.write(x, y + (i + 1) * _PITCH, cell, 10.5)


def _candidates(fit: "Fit") -> list[tuple[str, ...]]:
    """Rows of the models that were tried, if there were several, below an empty one."""
    if len(fit.candidates) < 2:
        return []
    rows = [(), ("models tried", "numbers", "held-out error", "behind the best")]
    for one in fit.candidates:
        behind = f"{one.behind:.3g} ± {one.behind_error:.2g}" if one.behind else "best"
        rows.append((one.name, str(one.numbers), f"{one.error:.4f}", behind))
    return rows


def _write_candidates(canvas: Canvas, y: float, rows: list[tuple[str, ...]], chosen: str) -> None:
    across = [_MIDDLE, _MIDDLE + 150, _MIDDLE + 260, _MIDDLE + 420]
    for i, row in enumerate(rows):
        for x, text in zip(across, row, strict=False):
            weight = "bold" if row[0] == chosen else "normal"
            colour = GREY if i == 1 else INK
            canvas.write(x, y + i * _PITCH, text, 10.5, colour, fontweight=weight)
