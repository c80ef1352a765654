"""Spectra of waters, drawn."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from uwaug.figures.sheet import NEAR_TO_FAR
from uwaug.optics.water import Water

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SIZE_IN = 14.0, 5.5
_QUANTITIES = {"a": "absorption a", "b": "scattering b", "kd": "diffuse attenuation $K_d$"}
_NM = 400, 700


def draw_spectra(own: Sequence[Water], named: Sequence[Water]) -> "Figure":
    """Draw a, b and K_d (1/m, logarithmic) by wavelength: waters of one's own in black, others in
    colours by their order.
    """
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.figure import Figure

    figure = Figure(_SIZE_IN, dpi=100, layout="constrained")
    colours = LinearSegmentedColormap.from_list("order", NEAR_TO_FAR[::-1])
    axes = figure.subplots(1, len(_QUANTITIES))
    for axis, (name, title) in zip(axes, _QUANTITIES.items(), strict=True):
        for i, water in enumerate(named):
            colour = colours(i / max(len(named) - 1, 1))
            axis.plot(water.wavelengths, getattr(water, name), color=colour, label=water.name)
        for water, style in zip(own, ("-", "--", ":", "-.") * len(own), strict=False):
            line = {"color": "black", "linewidth": 2.5, "linestyle": style, "label": water.name}
            axis.plot(water.wavelengths, getattr(water, name), **line)
        axis.set(yscale="log", xlim=_NM, xlabel="wavelength [nm]", ylabel="1/m")
        axis.set_title(title, loc="left")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", frameon=False)
    return figure
