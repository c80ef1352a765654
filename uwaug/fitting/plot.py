"""Results as pictures: what was observed, what the water makes of it, what is left, the curves, and
in words what was found. A series is a chart of coefficients against turbidity.
"""

import math
import textwrap
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from uwaug._support.drawing import GREY, INK, RGB
from uwaug.fitting.errors import NORMAL
from uwaug.fitting.models import COLOURS
from uwaug.fitting.results import Fit, Parameter, Result, SeriesFit, VeilFit, WaterFit
from uwaug.formation.colour import linear_to_srgb
from uwaug.optics.medium import Medium

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

_PAIRS = 3  # pairs that are shown at most
_ROWS = 14  # of the tables of parameters and candidates, at most
_SAMPLES = 200  # waters that the bands are of; of those by spectra, which take longer, a fifth
_LEAST = 0.002  # of linear light: residuals are not enlarged beyond half of a step of 8 bits
_GROUND = "#9a9a9a"  # behind pictures, where NaN lets it through
_WIDTH, _CELL, _ABOUT = 14.0, 4.3, 0.5  # inches: of a sheet, of a picture, of what is written on it
_LINE, _MARGIN = 0.22, 0.2  # inches
_ABOVE, _BELOW = 0.65, 0.5  # inches: of heading and caption, with their margins
_LETTERS = 82  # of a line of the message
_CURVES = {
    "transmission": "$T_β$   what is left of direct light",
    "signal": "$T_G$   with light scattered forward",
    "backscatter": "$V$   veil",
}


def plot(result: Result) -> "Figure":
    """Draw any of the results of `uwaug.fitting`."""
    generator = torch.Generator().manual_seed(0)
    if isinstance(result, SeriesFit):
        return _series(result)
    curves, count, unit = list(_CURVES), _SAMPLES, "m"
    if isinstance(result, VeilFit):
        heading, curves = "A veil from pictures without their clean twins", ["backscatter"]
        # open water shows the end of a veil, a few lengths of its growth away
        farthest = min(result.farthest, 4 / float(result.theta[1::2].min()))
    else:
        assert isinstance(result, (Fit, WaterFit))
        heading = f"A water from pictures: model “{result.chosen}”"
        if isinstance(result, WaterFit):
            heading, count = f"A water from pictures: Jerlov type {result.type}", _SAMPLES // 5
        farthest, unit = result.fitted.geometry.farthest, result.fitted.geometry.unit
    figure, cells = _sheet(result, heading, curves)
    media = result.medium, result.sample(count, generator)
    _draw_curves({name: cells[name] for name in curves}, *media, farthest, unit)
    return figure


def _sheet(result: Result, heading: str, curves: list[str]) -> "tuple[Figure, dict[str, Axes]]":
    """A sheet of the first three pairs, as far as the result has its pictures; room for curves of
    distance; parameters, message and candidates.
    """
    words = [line for row in result.message.splitlines() for line in textwrap.wrap(row, _LETTERS)]
    table, tried = _table(result), _candidates(result)
    pictured = result if isinstance(result, (Fit, WaterFit)) and result.pairs else None
    pairs = pictured.pairs[:_PAIRS] if pictured else ()
    rows, heights = [], []
    for i, pair in enumerate(pairs):
        rows += [[f"{i} {kind}{c}" for c in range(3) for _ in "12"] for kind in ("", "residual ")]
        heights += 2 * [min(_CELL * pair.size[0] / pair.size[1], _CELL)]
    rows += [
        [name for name in [*curves, ".", "."][:3] for _ in "12"],
        3 * ["table"] + 3 * ["words"],
    ]
    heights += [3.0, _LINE * max(len(table) + 1, len(words) + len(tried))]
    caption = "Bands hold 95 %; shaded: farther than 95 % of the pixels."
    formed = pictured.formed(_PAIRS) if pictured else []
    scale = _scale([difference for _, difference in formed])
    if pictured:
        residuals = f"Residuals: linear light (0…1), all on one scale of ±{scale:g}."
        caption = f"{residuals} Grey: not counted. {caption}"
        if len(pictured.pairs) > _PAIRS:
            caption = f"{_PAIRS} of {len(pictured.pairs)} pairs. {caption}"
    figure, cells = _figure(heading, caption, rows, heights)
    if pictured:
        _draw_pairs(cells, pictured, formed, scale)
    head = [("", *COLOURS)] if any(len(row) == 4 for row in table) else [("",)]
    _write(cells["table"], [*head, *table], (0, 0.24, 0.5, 0.765), _style_of_table)
    lines = [*((line,) for line in words), *tried]

    def style(i: int, _: int) -> dict[str, Any]:
        bold = i > len(words) + 1 and lines[i][0] == result.chosen
        return {"fontweight": "bold"} if bold else {"color": GREY if i == len(words) + 1 else INK}

    _write(cells["words"], lines, (0, 0.36, 0.5, 0.72), style)
    return figure, cells


def _figure(
    heading: str, caption: str, rows: list[list[str]], heights: list[float]
) -> "tuple[Figure, dict[str, Axes]]":
    """A figure with a cell for each name in rows of these heights, inches."""
    from matplotlib.figure import Figure

    tall = sum(heights) + _ABOUT * (len(heights) + 2)
    figure = Figure(figsize=(_WIDTH, tall), dpi=100)
    x, y, bottom, top = _MARGIN / _WIDTH, _MARGIN / tall, _BELOW / tall, _ABOVE / tall
    # what is left of axes, such as the labels of their ticks, keeps clear of the cell beside
    figure.set_layout_engine(
        "constrained", rect=(x, bottom, 1 - 2 * x, 1 - bottom - top), w_pad=0.1
    )
    plain: dict[str, Any] = {"ha": "left", "parse_math": False}
    figure.text(x, 1 - y, heading, fontsize=18, fontweight="bold", color=INK, va="top", **plain)
    figure.text(x, y, caption, fontsize=11.5, color=GREY, va="bottom", **plain)
    cells = figure.subplot_mosaic(rows, height_ratios=heights)  # type: ignore[arg-type]
    return figure, cells


def _write(
    axis: "Axes",
    rows: Sequence[tuple[str, ...]],
    across: tuple[float, ...],
    style: Callable[[int, int], dict[str, Any]],
) -> None:
    """Write a table, from the upper left corner of a cell."""
    axis.set_axis_off()
    for i, row in enumerate(rows):
        for j, text in enumerate(row):
            look: dict[str, Any] = {
                "fontsize": 10,
                "parse_math": False,
                "va": "top",
                **style(i, j),
            }
            down, at = (0, -72 * _LINE * i), (across[j], 1)
            look |= {"xycoords": "axes fraction", "textcoords": "offset points"}
            axis.annotate(text, at, down, **look).set_in_layout(False)


def _style_of_table(i: int, j: int) -> dict[str, Any]:
    if i == 0:
        return {"color": RGB[j - 1], "fontweight": "bold"}
    return {"color": INK if j else GREY}


def _draw_pairs(
    cells: "dict[str, Axes]", fit: Fit | WaterFit, formed: list[tuple[Tensor, Tensor]], scale: float
) -> None:
    """Pictures, distances and residuals."""
    for i, (rendered, difference) in enumerate(formed):
        pair, unit = fit.pairs[i], fit.fitted.geometry.unit
        which = f"{i + 1}: " if len(fit.pairs) > 1 else ""
        _show(cells[f"{i} 0"], linear_to_srgb(pair.observed.clamp(0, 1)), f"{which}Observed")
        # as an image of four channels, whose last lets grey through
        masked = torch.cat([linear_to_srgb(rendered.clamp(0, 1)), pair.usable.to(rendered)])
        _show(cells[f"{i} 1"], masked, f"{which}Rendered by the fit")
        low, high = None, None
        label = f"{which}Distance: open water"
        if bool(pair.finite.any()):
            low, high = np.quantile(pair.z[pair.finite].numpy(), (0.01, 0.99))
            label = f"{which}Distance, {low:.3g}–{high:.3g} {unit}"
        z = torch.where(pair.finite, pair.z, torch.nan)
        picture = _show(cells[f"{i} 2"], z, label, cmap="viridis_r", vmin=low, vmax=high)
        if low is not None:
            _bar(picture)
        ends: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -scale, "vmax": scale}
        for c, colour in enumerate(COLOURS):
            label = f"{which}Rendered − observed, {colour}"
            _bar(_show(cells[f"{i} residual {c}"], difference[c : c + 1], label, **ends))


def _show(axis: "Axes", picture: Tensor, label: str, **style: Any) -> "AxesImage":
    """A picture or a map (CxHxW), on grey."""
    axis.set(xticks=[], yticks=[], facecolor=_GROUND, anchor="NW")
    axis.spines[:].set_visible(False)
    axis.set_title(label, loc="left", fontsize=12.5, color=INK)
    return axis.imshow(picture.permute(1, 2, 0).numpy(), **style)


def _bar(picture: "AxesImage") -> None:
    """The scale of a map, below it."""
    below = picture.axes.inset_axes((0, -0.06, 1, 0.03))
    picture.axes.figure.colorbar(picture, cax=below, orientation="horizontal")
    below.tick_params(labelsize=9, colors=GREY, length=2)
    below.locator_params(nbins=2)


def _scale(residuals: list[Tensor]) -> float:
    """One end for all: what 99 % of the values are within, rounded up to 1, 2 or 5 of a decade."""
    end = _LEAST
    for part in residuals:
        values = part[part.isfinite()].abs()
        if values.numel():
            end = max(end, float(np.quantile(values.numpy(), 0.99)))
    decade = 10.0 ** math.floor(math.log10(end))
    steps = (step * decade for step in (1, 2, 5, 10))
    return next(step for step in steps if end <= step * (1 + 1e-6))


def _of_white(media: Medium, name: str, z: Tensor) -> Tensor:
    """A curve of each channel (Bx3xN): of matrices, that of a white surface."""
    curve: Tensor = getattr(media, name)(z)
    return curve.sum(2) if curve.ndim == 4 else curve


def _draw_curves(
    cells: "dict[str, Axes]", best: Medium, samples: Medium, farthest: float, unit: str
) -> None:
    """Curves of distance of the best water, as far as `farthest` and a bit farther, with the bands
    of waters that the pictures allow.
    """
    z = torch.linspace(0, 1.25 * farthest, 161, dtype=torch.float64)
    quantiles = torch.tensor([0.025, 0.975], dtype=torch.float64)
    for name, axis in cells.items():
        curve = _of_white(best, name, z)
        low, high = _of_white(samples, name, z).quantile(quantiles, dim=0)
        for c, colour in enumerate(RGB):
            axis.fill_between(z, low[c], high[c], color=colour, alpha=0.25, linewidth=0)
            axis.plot(z.numpy(), curve[0, c].numpy(), color=colour, linewidth=1.6)
        axis.axvspan(farthest, float(z[-1]), color="black", alpha=0.07, linewidth=0)
        axis.set(xlim=(0, float(z[-1])), ylim=(0, 1))
        if name == "backscatter" and float(curve.max()) > 0:
            # a veil that is not identified has bands without end
            axis.set_ylim(0, max(1.15 * float(curve.max()), min(float(high.max()), 1.0)))
        _styled(axis, _CURVES[name], f"distance [{unit}]", "")


def _table(result: Result) -> list[tuple[str, ...]]:
    """Rows of a name and of one number, or of three, of red, green and blue."""
    rows: dict[str, list[str]] = {}
    for name, number in result.parameters.items():
        kind, _, colour = name.rpartition("_")
        kind = kind if colour in COLOURS else name
        kind = "β" if kind == "beta" else kind.replace("_", " ")
        unit = "" if number.unit == "1" else f"  [{number.unit}]"
        rows.setdefault(f"{kind}{unit}", []).append(_told(number))
    table = [(name, *cells) for name, cells in rows.items()]
    more = f"and {len(table) - _ROWS + 1} more, see the summary"
    return table if len(table) <= _ROWS else [*table[: _ROWS - 1], (more,)]


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


def _candidates(result: Result) -> list[tuple[str, ...]]:
    """Rows of the models that were tried, if there were several, below an empty one."""
    if len(result.candidates) < 2:
        return []
    rows = [(), ("models tried", "numbers", "held-out error", "behind the best")]
    for tried in result.candidates[:_ROWS]:
        behind = f"{tried.behind:.3g} ± {tried.behind_error:.2g}" if tried.behind else "best"
        rows.append((tried.name, str(tried.numbers), f"{tried.error:.4f}", behind))
    return rows


def _series(fit: SeriesFit) -> "Figure":
    """Draw b of each level with its 95 % interval, the line and its band; what is left of b beside
    the line; a of each colour.
    """
    verdict = fit.message.splitlines()[1]
    figure, cells = _figure("Scattering against turbidity", verdict, [["b", "left", "a"]], [_CELL])
    _draw_lines(cells["b"], cells["left"], fit)
    _draw_absorption(cells["a"], fit)
    return figure


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
        residual = b - line.b0 - line.k * levels
        at = levels + (c - 1) * 0.012 * levels[-1]  # colours side by side
        odds = "" if line.probability is None else f"p = {line.probability:.2g}"
        beside.errorbar(
            at, residual, half, fmt="o", color=RGB[c], markersize=4, capsize=3, label=odds
        )
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
