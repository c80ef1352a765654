"""A fit as a picture: observed and fitted, what is left by distance, the three curves."""

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from uwaug.fitting.model import COLOURS
from uwaug.fitting.result import SHOWS, Fit
from uwaug.formation.colour import linear_to_srgb
from uwaug.optics.curves import FARTHEST

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INK, _GREY = "#1a1a1a", "#5a5a5a"
_RGB = ("#c0392b", "#2e8b57", "#2a5caa")
_SIZE = (14.0, 4.0)  # inches, of a sheet's width and of a row
_LETTERS = 150  # of a line of words
_LINE = 0.22  # inches
_CURVES = {
    "transmission": "$T_β$   what is left of direct light",
    "signal": "$T_G$   with light scattered forward",
    "backscatter": "$V$   veil",
}


def plot(fit: Fit) -> "Figure":
    """Draw the first picture of a fit, as far as it has one, what is left, and its curves."""
    from matplotlib.figure import Figure

    words = "\n".join(textwrap.fill(note, _LETTERS) for note in fit.notes)
    above = _LINE * (words.count("\n") + 4)
    paired = fit.pictures is not None and bool(fit.pictures.clean.any())
    rows = [[*_CURVES]]
    if fit.remainder:
        rows.insert(0, ["observed", "fitted", "left"] if paired else ["left"] * 3)
    width, tall = _SIZE[0], _SIZE[1] * len(rows) + above
    figure = Figure(figsize=(width, tall), dpi=100, layout="constrained")
    layout = figure.get_layout_engine()
    assert layout is not None
    layout.set(rect=(0, 0, 1, 1 - above / tall), w_pad=0.1, h_pad=0.1)  # type: ignore[call-arg]
    at: dict[str, Any] = {"x": 0.2 / width, "ha": "left", "va": "top", "color": _INK}
    figure.text(y=1 - 0.15 / tall, s=f"A water from pictures: {fit.model}", fontsize=16, **at)
    figure.text(y=1 - 0.55 / tall, s=words, fontsize=10, parse_math=False, **at)
    cells = figure.subplot_mosaic(rows)  # type: ignore[arg-type]
    if "left" in cells:
        _draw_remainder(cells["left"], fit)
    if fit.pictures is not None and paired:
        first = fit.pictures.observed[0], fit.rendered()[0]
        for name, light in zip(("observed", "fitted"), first, strict=True):
            picture = linear_to_srgb(light.clamp(0, 1)).permute(1, 2, 0).numpy()
            cells[name].imshow(picture)
            cells[name].set(xticks=[], yticks=[])
            cells[name].set_title(name.capitalize(), loc="left", fontsize=12)
    z = torch.linspace(0, 1.25 * fit.geometry.farthest, 161, dtype=torch.float64)
    for name, label in _CURVES.items():
        curve = getattr(fit.medium, name)(z)[0].numpy()
        curve = curve.sum(1) if curve.ndim == 3 else curve  # of matrices, that of a white surface
        for line, colour in zip(curve, _RGB, strict=True):
            cells[name].plot(z.numpy(), line, color=colour, linewidth=1.6)
        cells[name].axvspan(fit.geometry.farthest, float(z[-1]), color="black", alpha=0.07)
        cells[name].set(xlim=(0, float(z[-1])), ylim=(0, 1.1 * max(float(curve.max()), 0.01)))
        _styled(cells[name], label)
    return figure


def _draw_remainder(axis: "Axes", fit: Fit) -> None:
    """Observed − fitted by distance, with 95 % intervals of independent noise; grey is what does
    not show.
    """
    seen = [row for row in fit.remainder if row.distance < FARTHEST]
    z = np.array([row.distance for row in seen])
    beside = 0.004 * np.ptp(z)
    axis.axhspan(-SHOWS, SHOWS, color="black", alpha=0.07)
    for c, colour in enumerate(COLOURS):
        mean, error = ([getattr(row, name)[c] for row in seen] for name in ("mean", "error"))
        axis.errorbar(
            z + (c - 1) * beside,  # colours side by side
            mean,
            1.96 * np.array(error),
            color=_RGB[c],
            marker="o",
            markersize=4,
            label=colour,
        )
    axis.legend(frameon=False, fontsize=10)
    _styled(axis, "Observed − fitted, linear light")


def _styled(axis: "Axes", title: str) -> None:
    axis.set_title(title, loc="left", fontsize=12, color=_INK)
    axis.set_xlabel("distance [m]", fontsize=10, color=_GREY)
    axis.tick_params(labelsize=10, colors=_GREY, length=3)
    axis.spines[["top", "right"]].set_visible(False)
