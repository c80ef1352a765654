"""What is left to see: the five grades of severity and the ten waters on the bundled scene, by
visibility, contrast at 2 and 5 m, and phase-congruency difference; and a chart of that difference
against visibility. Prints the tables of the README.
"""

from typing import Any, NamedTuple

import torch
from matplotlib.figure import Figure
from torch import Tensor

import uwaug
from benchmarks.figures.summary import table
from benchmarks.harness import RESULTS, command, machine, save
from uwaug._support.drawing import GREY, INK
from uwaug._support.drawing import save as save_figure
from uwaug.figures.comparison import METRES, phase_congruency_difference
from uwaug.formation.contrast import contrast
from uwaug.optics.medium import Medium
from uwaug.optics.scattering import Scattering
from uwaug.optics.water import JERLOV_TYPES, Water
from uwaug.presets.scene import Scene, motorcycle

DRAWS = 20
SEED = 11
G, MU = Scattering.CALIBRATED.g, Scattering.CALIBRATED.mu
VISIBILITIES = (1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0)  # m, that waters are scaled to for the chart
SCALED = ("II", "1C", "7C")
FIGURE = RESULTS.parent / "figures" / "information.png"


class Seen(NamedTuple):
    """What is left in one picture: visibility in m, contrast at 2 and 5 m, phase-congruency
    difference.
    """

    visibility: float
    contrast_2m: float
    contrast_5m: float
    phase_congruency: float


def seen(scene: Scene, picture: Tensor, medium: Medium, visibility: float) -> Seen:
    z = torch.tensor(METRES, dtype=torch.float64).reshape(1, 1, -1)
    near, far = contrast(medium, z).flatten().tolist()
    return Seen(visibility, near, far, phase_congruency_difference(scene.image, picture))


def pictured(scene: Scene, water: Water) -> tuple[Tensor, Medium]:
    """A water with the calibrated law, 1 m deep, with an automatic exposure."""
    assert scene.focal_px is not None
    law = uwaug.PointSpread.calibrated(scene.focal_px)
    medium = Medium.from_water(water, g=G, mu=MU, point_spread=law)
    with torch.no_grad():
        return uwaug.Underwater(medium, exposure="auto")(scene.image, scene.distance), medium


def in_type(scene: Scene, water: Water) -> Seen:
    picture, medium = pictured(scene, water)
    return seen(scene, picture, medium, water.visibility())


def at_severity(scene: Scene, level: int, draws: int) -> list[Seen]:
    """Draws of a grade, each in a water of its own."""
    aug, found = uwaug.RandomUnderwater.severity(level), []
    for index in range(draws):
        generator = torch.Generator().manual_seed(SEED * 1000 + index)
        record = aug.make_params(scene.image, generator)
        picture = aug.transform(scene.image, scene.distance, record)
        (wet,) = aug.in_water(scene.image, scene.distance, record, lambda wet: wet).values()
        found.append(seen(scene, picture, wet.scene.setup.medium, wet.water.visibility()))
    return found


def grades(found: dict[int, list[Seen]]) -> str:
    """Medians, and the 5th and 95th percentile of visibility and difference."""
    rows = []
    for level, draws in found.items():
        columns = torch.tensor(draws).double()
        low, middle, high = columns.quantile(torch.tensor([0.05, 0.5, 0.95]).double(), 0).tolist()
        rows.append(
            [
                str(level),
                f"{middle[0]:.1f} ({low[0]:.1f}–{high[0]:.1f})",
                f"{middle[1]:.2f}",
                f"{middle[2]:.2f}",
                f"{middle[3]:.2f} ({low[3]:.2f}–{high[3]:.2f})",
            ]
        )
    return table(["severity", "visibility (m)", "contrast at 2 m", "5 m", "PC difference"], rows)


def types(found: dict[str, Seen]) -> str:
    rows = []
    for name, one in found.items():
        shares = [f"{one.contrast_2m:.3f}", f"{one.contrast_5m:.3f}"]
        rows.append([name, f"{one.visibility:.1f}", *shares, f"{one.phase_congruency:.2f}"])
    return table(["water", "visibility (m)", "contrast at 2 m", "5 m", "PC difference"], rows)


def chart(
    drawn: dict[int, list[Seen]], natural: dict[str, Seen], scaled: dict[str, list[Seen]]
) -> Figure:
    """Phase-congruency difference against visibility."""
    figure = Figure(figsize=(8, 4.4), dpi=100, layout="constrained")
    axis = figure.add_subplot()
    shades = ("#9ecae1", "#6baed6", "#4292c6", "#2171b5", "#084594")
    for (level, draws), shade in zip(drawn.items(), shades, strict=True):
        x, y = [one.visibility for one in draws], [one.phase_congruency for one in draws]
        axis.scatter(x, y, s=16, color=shade, label=f"severity {level}", linewidths=0)
    for (name, steps), style in zip(scaled.items(), ("-", "--", ":"), strict=True):
        x, y = [one.visibility for one in steps], [one.phase_congruency for one in steps]
        axis.plot(x, y, style, color=GREY, linewidth=1.4, label=f"{name}, scaled")
    for name, one in natural.items():
        at = (one.visibility, one.phase_congruency)
        axis.plot(*at, "o", color="none", markeredgecolor=INK, markersize=6)
        offset = (-16, -12) if name == "1C" else (5, 4)  # II is beside it
        axis.annotate(name, at, xytext=offset, textcoords="offset points", fontsize=9)
    ticks = (1, 2, 5, 10, 20, 50)
    axis.set(xscale="log", ylim=(0, None), xlabel="visibility [m]")
    axis.set_xticks(ticks, [str(tick) for tick in ticks])
    axis.minorticks_off()
    axis.set_ylabel("phase-congruency difference")
    axis.set_title("What is left of the scene's structure (2 to 5 m away)", loc="left", fontsize=12)
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False, fontsize=9, ncols=2)
    return figure


def main(quick: bool = False) -> dict[str, Any]:
    """Measure, print, draw and save."""
    scene = motorcycle()
    if quick:
        scene = Scene(scene.image[:, ::4, ::4], scene.distance[:, ::4, ::4], 250.0)
    drawn = {level: at_severity(scene, level, 2 if quick else DRAWS) for level in range(1, 6)}
    print(grades(drawn), end="\n\n")
    natural = {name: in_type(scene, Water.jerlov(name)) for name in JERLOV_TYPES}
    print(types(natural))
    scaled: dict[str, list[Seen]] = {}
    for name in SCALED:
        water = Water.jerlov(name)
        metres = VISIBILITIES[::3] if quick else VISIBILITIES
        scaled[name] = [in_type(scene, water.with_visibility(one)) for one in metres]
    figure = chart(drawn, natural, scaled)
    results = {"columns": Seen._fields, "severity": drawn, "waters": natural, "scaled": scaled}
    if not quick:
        save_figure(figure, FIGURE)
        print(save("information", {"machine": machine(), **results}))
    return {**results, "figure": figure}


if __name__ == "__main__":
    command(main, __doc__)
