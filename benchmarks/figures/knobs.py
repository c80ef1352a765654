"""One sheet of every knob: each range of `RandomUnderwater` at five values, on one scene:
`python -m benchmarks.figures.knobs`. All else stays as it is in the middle of its range.
"""

from typing import Any

import torch
from matplotlib.figure import Figure
from torch import Tensor

from benchmarks.figures.gallery import FIGURES, QUALITY, Grid
from benchmarks.harness import command
from uwaug import PointSpread, RandomDevelopment, RandomUnderwater, Sensor
from uwaug._support.atomic import written_whole
from uwaug.presets.scene import Scene, motorcycle

STEPS = 5
WATER = "3C"

OWN: dict[str, tuple[Any, ...]] = {
    "waters": ("IB", "II", "1C", "9C", "chlorophyll=10,cdom=1"),
    "mixing": (0.0, 0.25, 0.5, 0.75, 1.0),
    "g": (0.0, 0.05, 0.1, 0.2, 0.4),
    "mu": (0.0, 0.04, 0.075, 0.15, 0.3),
    "point_spread": (0.0, 0.5, 1.0, 2.0, 4.0),
    "field": (0.0, 0.15, 0.3, 0.5, 0.8),
    "noise": (None, 50_000, 5_000, 1_000, 300),
}
"""Values of what has no range by default: the width of the blur, times that of the calibrated law;
the spread of the field about 1; the full well of the sensor.
"""


def knobs() -> dict[str, tuple[Any, ...]]:
    """Five values of each, from the least to the largest that a default draw has."""
    augment = RandomUnderwater()
    ranges = {"contrast": augment.contrast, "vertical_depth": augment.vertical_depth}
    values = {}
    for name, ends in {**ranges, **augment.development.ranges()}.items():
        assert isinstance(ends, tuple)
        values[name] = tuple(torch.linspace(*ends, STEPS).tolist())
    return {**OWN, **values}


def transform(name: str, value: Any, width: int) -> RandomUnderwater:
    """Fixed in all but one."""
    augment = RandomUnderwater()
    middles = {}
    for own, ends in augment.development.ranges().items():
        assert isinstance(ends, tuple)
        middles[own] = sum(ends) / 2
    options: dict[str, Any] = {"contrast": 0.4, "vertical_depth": 4.0, "field": None}
    waters: list[Any] = [WATER]
    if name == "waters":
        waters = [value]
    elif name == "mixing":
        waters = [f"{1 - value}*{WATER}+{value}*9C"]
    elif name == "point_spread":
        law = PointSpread.calibrated(0.866 * width)
        options[name] = PointSpread(law.scale * value, law.exponent, law.shape)
    elif name == "field":
        options[name] = (1 - value, 1 + value)
    elif name == "noise":
        middles[name] = None if value is None else Sensor(value)
    elif name in middles:
        middles[name] = value
    else:
        options[name] = value
    return RandomUnderwater(waters, **options, development=RandomDevelopment(**middles))


def sheet(scene: Scene) -> Figure:
    """A row for each knob."""
    rows = knobs()
    image, distance = scene.image[..., ::2, ::2], scene.distance[..., ::2, ::2]
    grid = Grid(len(rows), STEPS, (image.shape[-2], image.shape[-1]))
    for row, (name, values) in enumerate(rows.items()):
        for column, value in enumerate(values):
            picture: Tensor = transform(name, value, image.shape[-1]).at(0, 0, 0)(image, distance)[
                0
            ]
            shown = f"{value:.3g}" if isinstance(value, float) else str(value)
            shown = {"field": "1 ± ", "point_spread": "calibrated × "}.get(name, "") + shown
            label = f"{name} = {shown}" if column == 0 else shown
            grid.show(row * STEPS + column, picture, label)
    return grid.figure


def main(quick: bool = False) -> None:
    """Draw it into benchmarks/figures."""
    figure = sheet(motorcycle())
    if not quick:
        with written_whole(FIGURES / "knobs.jpg") as part:
            figure.savefig(part, format="jpeg", pil_kwargs={"quality": QUALITY})


if __name__ == "__main__":
    command(main, __doc__)
