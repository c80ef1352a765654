"""Figures of fits: pictures observed and fitted, residuals by distance, the three curves."""

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from uwaug.fitting.errors import NORMAL
from uwaug.fitting.model import COLOURS
from uwaug.fitting.result import VISIBLE_LIGHT, Fit
from uwaug.formation.colour import linear_to_srgb
from uwaug.optics.curves import FARTHEST

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INK, _GREY = "#1a1a1a", "#5a5a5a"
_LEFT_OUT = 1.0  # value of pixels that the fit has left out: white
_RGB = ("#c0392b", "#2e8b57", "#2a5caa")
_WIDTH_IN, _ROW_IN = 14.0, 4.0  # inches: width of the figure, height of a row
_LINE_LETTERS, _LINE_IN = 150, 0.22  # letters in a line of text, and its height in inches
_CURVES = {
    "transmission": "$T_β$   what is left of direct light",
    "signal": "$T_G$   with light scattered forward",
    "backscatter": "$V$   veil",
}


def plot(fit: Fit) -> "Figure":
    """Draw the first picture of a fit where it has one, its residuals, and its curves."""
    from matplotlib.figure import Figure

    notes = "\n".join(textwrap.fill(note, _LINE_LETTERS) for note in fit.notes)
    top = _LINE_IN * (notes.count("\n") + 4)
    has_pair = fit.pictures is not None and bool(fit.pictures.clean.any())
    rows = [[*_CURVES]]
    if fit.remainder:
        rows.insert(0, ["observed", "fitted", "residual"] if has_pair else ["residual"] * 3)
    height = _ROW_IN * len(rows) + top
    figure = Figure(figsize=(_WIDTH_IN, height), dpi=100, layout="constrained")
    layout = figure.get_layout_engine()
    assert layout is not None
    layout.set(rect=(0, 0, 1, 1 - top / height), w_pad=0.1, h_pad=0.1)  # type: ignore[call-arg]
    style: dict[str, Any] = {"x": 0.2 / _WIDTH_IN, "ha": "left", "va": "top", "color": _INK}
    figure.text(y=1 - 0.15 / height, s=f"A water from pictures: {fit.model}", fontsize=16, **style)
    figure.text(y=1 - 0.55 / height, s=notes, fontsize=10, parse_math=False, **style)
    cells = figure.subplot_mosaic(rows)  # type: ignore[arg-type]
    if "residual" in cells:
        _draw_residuals(cells["residual"], fit)
    if fit.pictures is not None and has_pair:
        usable = fit.pictures.usable[0]
        fitted = fit.rendered()[0].where(usable, _LEFT_OUT)
        titles = "Observed", "Fitted" if usable.all() else "Fitted; left-out pixels are white"
        for title, light in zip(titles, (fit.pictures.observed[0], fitted), strict=True):
            axis = cells[title.partition(";")[0].lower()]
            axis.imshow(linear_to_srgb(light.clamp(0, 1)).permute(1, 2, 0).numpy())
            axis.set(xticks=[], yticks=[])
            axis.set_title(title, loc="left", fontsize=12)
    z = torch.linspace(0, 1.25 * fit.geometry.farthest, 161, dtype=torch.float64)
    for name, label in _CURVES.items():
        curve = getattr(fit.medium, name)(z)[0].numpy()
        curve = curve.sum(1) if curve.ndim == 3 else curve  # of matrices, that of a white surface
        for line, colour in zip(curve, _RGB, strict=True):
            cells[name].plot(z.numpy(), line, color=colour, linewidth=1.6)
        cells[name].axvspan(fit.geometry.farthest, float(z[-1]), color="black", alpha=0.07)
        cells[name].set(xlim=(0, float(z[-1])), ylim=(0, 1.1 * max(float(curve.max()), 0.01)))
        _style(cells[name], label)
    return figure


def _draw_residuals(axis: "Axes", fit: Fit) -> None:
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
    _style(axis, "Observed − fitted, linear light")


def _style(axis: "Axes", title: str) -> None:
    axis.set_title(title, loc="left", fontsize=12, color=_INK)
    axis.set_xlabel("distance [m]", fontsize=10, color=_GREY)
    axis.tick_params(labelsize=10, colors=_GREY, length=3)
    axis.spines[["top", "right"]].set_visible(False)
