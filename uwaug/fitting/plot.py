"""Curves of a medium, and figures of fits: pictures, residuals by distance, the curves."""

import textwrap
from typing import TYPE_CHECKING

import numpy as np
import torch

from uwaug._support.types import Array
from uwaug.fitting.model import COLOURS, NORMAL, VISIBLE_LIGHT
from uwaug.formation.colour import linear_to_srgb
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from uwaug.fitting.result import Fit

_INK, _GREY = "#1a1a1a", "#5a5a5a"
_LEFT_OUT = 1.0  # value of pixels that the fit has left out: white
_RGB = ("#c0392b", "#2e8b57", "#2a5caa")
_WIDTH_IN, _ROW_IN = 14.0, 4.2  # inches: width of the figure, height of a row
_LINE_LETTERS, _LINE_IN = 150, 0.18  # letters in a line of text, and its height in inches
_CURVES = {
    "transmission": ("-", "$T_β$  direct"),
    "signal": ("--", "$T_G$  direct + forward"),
    "backscatter": (":", "$V$  veil"),
}


def plot(fit: "Fit") -> "Figure":
    """Draw the first picture of a fit where it has one, its residuals, and its curves."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    notes = [textwrap.fill(note, _LINE_LETTERS) for note in fit.notes]
    words = "\n".join([f"A water from pictures: {fit.model}", *notes])
    has_pair = fit.pictures is not None and bool(fit.pictures.clean.any())
    cells = 1 + bool(fit.remainder) + 2 * has_pair
    rows = 1 + (cells > 2)
    size = _WIDTH_IN, _ROW_IN * rows + _LINE_IN * (words.count("\n") + 2)
    figure = Figure(size, dpi=100, layout=ConstrainedLayoutEngine(w_pad=0.15, h_pad=0.15))
    figure.suptitle(words, x=0.2 / _WIDTH_IN, ha="left", fontsize=10, color=_INK, parse_math=False)
    axes = [figure.add_subplot(rows, -(-cells // rows), i + 1) for i in range(cells)]
    axes[-1].set_title("Curves of red, green and blue", loc="left", fontsize=12, color=_INK)
    curves, medium, far = axes.pop(), fit.medium, fit.geometry.farthest
    if fit.patches is not None:
        medium = medium.brightened(1 / medium.ambient())  # the gain is that of the charts
        _draw_patches(axes.pop(), *fit.patches)
    elif fit.remainder:
        _draw_residuals(axes.pop(), fit)
    draw_curves(curves, medium, 1.25 * far, far)
    if fit.pictures is not None and has_pair:
        usable = fit.pictures.usable[0]
        fitted = fit.rendered()[0].where(usable, _LEFT_OUT)
        titles = "Observed", "Fitted" if usable.all() else "Fitted; left-out pixels are white"
        lights = fit.pictures.observed[0], fitted
        for axis, title, light in zip(axes, titles, lights, strict=True):
            axis.imshow(linear_to_srgb(light.clamp(0, 1)).permute(1, 2, 0).numpy())
            axis.set(xticks=[], yticks=[])
            axis.set_title(title, loc="left", fontsize=12)
    return figure


def draw_curves(axis: "Axes", medium: Medium, reach: float, seen: float | None = None) -> None:
    """Draw the three curves of a medium up to a distance (m); what lies beyond `seen` is shaded."""
    z = torch.linspace(0, reach, 161, dtype=torch.float64)
    for name, (style, label) in _CURVES.items():
        curve = getattr(medium, name)(z)[0].numpy()
        curve = curve.sum(1) if curve.ndim == 3 else curve  # of matrices, that of a white surface
        for line, colour in zip(curve, _RGB, strict=True):
            axis.plot(z.numpy(), line, style, color=colour, linewidth=1.6)
        axis.plot([], [], style, color=_INK, label=label)
    if seen is not None:
        axis.axvspan(seen, reach, color="black", alpha=0.07)
    # a colour matrix may raise a channel above 1
    axis.set(xlim=(0, reach), ylim=(0, max(1, axis.dataLim.ymax)))
    axis.legend(frameon=False, fontsize=10, labelspacing=0.2)
    _style(axis)


def _draw_residuals(axis: "Axes", fit: "Fit") -> None:
    """Observed − fitted by distance, with 95 % intervals of independent noise; the grey band does
    not show in pictures.
    """
    rows = [row for row in fit.remainder if row.distance < FARTHEST]
    z = np.array([row.distance for row in rows])
    offset = 0.004 * np.ptp(z)
    axis.axhspan(-VISIBLE_LIGHT, VISIBLE_LIGHT, color="black", alpha=0.07)
    for c, colour in enumerate(COLOURS):
        axis.errorbar(
            z + (c - 1) * offset,  # colours side by side
            [row.mean[c] for row in rows],
            NORMAL * np.array([row.error[c] for row in rows]),
            color=_RGB[c],
            marker="o",
            markersize=4,
            label=colour,
        )
    axis.legend(frameon=False, fontsize=10)
    axis.set_title("Observed − fitted, linear light", loc="left", fontsize=12, color=_INK)
    _style(axis)


def _draw_patches(axis: "Axes", z: Array, measured: Array, fitted: Array) -> None:
    """Fitted against measured light of patches (3xN each), by distance (N)."""
    for seen, light, mark, edge, label in zip(measured, fitted, "os^", _RGB, COLOURS, strict=True):
        points = axis.scatter(seen, light, s=24, c=z, marker=mark, edgecolors=edge, label=label)
    axis.axline((1, 1), slope=1, color=_GREY, linewidth=0.8, zorder=0)
    axis.set(xscale="log", yscale="log")
    axis.legend(frameon=False, fontsize=10)
    axis.set_title("Fitted light of patches", loc="left", fontsize=12, color=_INK)
    axis.figure.colorbar(points, ax=axis).set_label("distance [m]", fontsize=10, color=_GREY)
    _style(axis, "measured")


def _style(axis: "Axes", across: str = "distance [m]") -> None:
    axis.set_xlabel(across, fontsize=10, color=_GREY)
    axis.tick_params(labelsize=10, colors=_GREY, length=3)
    axis.spines[["top", "right"]].set_visible(False)
