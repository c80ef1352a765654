"""How far are painted balls in draws of `RandomUnderwater` from real buoys?

`python -m benchmarks.evidence --colours` draws the balls of `tasks` by the defaults and with ranges
changed, and prints the mean sRGB values of a ball less those of the ring of water round it, beside
those of the real buoys, which the first run measured.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from skimage import data
from torch import Tensor

import uwaug
from benchmarks.evidence.tasks import BY_EYE, COLOURS, Array, painted_balls
from uwaug import RandomDevelopment, RandomWater

REAL = {"red": (0.40, 0.00, -0.07), "green": (0.02, 0.10, -0.02), "ring": (0.12, 0.63, 0.68)}
"""Ball less ring, and ring, of the real buoys in coloured water."""

VARIANTS: dict[str, dict[str, Any]] = {
    "defaults": {},
    "vertical_depth 0–5": {"water": RandomWater(vertical_depth=(0.0, 5.0))},
    "contrast .3–.9": {"water": RandomWater(contrast=(0.3, 0.9))},
    "exposure −1.8–.6": {"development": RandomDevelopment(exposure=(-1.8, 0.6))},
    "saturation 1": {"development": RandomDevelopment(saturation=1.0)},
    "tone 1": {"development": RandomDevelopment(tone=1.0)},
    "mu None": {"water": RandomWater(mu=None)},
    "light None": {"light": None},
}
"""What is put in place of ranges of the defaults, by name."""


OTHER_PAINTS = {
    "red": ((0.6, 0.8), (0.8, 1.0)),
    "yellow": ((0.6, 0.8), (0.6, 1.0)),
    "green": ((0.6, 0.8), (0.3, 0.6)),
}
"""As `tasks.BY_EYE`: brighter reds, darker greens, picked after seeing the real numbers."""


def ball_less_ring(images: Tensor, radii: Tensor, labels: Tensor) -> dict[str, Array]:
    """Means of balls less their rings by colour, and of all rings (sRGB, each 3); and "dark": of
    the red ones, the share whose brightest channel is below .8 of their ring's.
    """

    def mean(inside: Tensor) -> Tensor:
        weights = inside[:, None].float()
        return (images * weights).sum((2, 3)) / weights.sum((2, 3))

    ball, ring = mean(radii < 0.8), mean((radii > 1.25) & (radii < 1.8))
    found = {name: (ball - ring)[labels == index].mean(0) for index, name in enumerate(COLOURS)}
    reds = labels == COLOURS.index("red")
    found["dark"] = (ball.amax(1) < 0.8 * ring.amax(1))[reds].float().mean()
    return {name: value.numpy() for name, value in {**found, "ring": ring.mean(0)}.items()}


def distance_to_real(found: dict[str, Array]) -> float:
    """RMS difference of the nine numbers from those of real buoys."""
    return float(np.sqrt(np.mean([(found[name] - REAL[name]) ** 2 for name in REAL])))


def measured(
    options: dict[str, Any],
    photographs: Sequence[Array],
    count: int,
    paints: Mapping[str, tuple[Any, Any]] = BY_EYE,
) -> dict[str, Array]:
    """Ball less ring of draws with these options."""
    pool, radii = painted_balls(photographs, count, np.random.default_rng(0), paints)
    augment = uwaug.RandomUnderwater(**options)
    torch.manual_seed(0)
    pairs = zip(pool.images.split(64), pool.distances.split(64), strict=True)
    drawn = torch.cat([augment(*pair)[0] for pair in pairs])
    return ball_less_ring(drawn, radii, pool.labels)


def main(count: int = 1200, names: Sequence[str] = tuple(VARIANTS)) -> dict[str, Any]:
    """Print the table, with scikit-image's photographs behind the balls."""
    scenes = (data.astronaut, data.coffee, data.chelsea, data.rocket)
    behind = [scene() / 255 for scene in scenes]
    rows = {"real buoys": {part: np.array(value) for part, value in REAL.items()}}
    rows |= {name: measured(VARIANTS[name], behind, count) for name in names}
    for name in (name for name in names if name == "defaults" or name.startswith("mu")):
        rows[f"{name}, other paints"] = measured(VARIANTS[name], behind, count, OTHER_PAINTS)
    print(f"\n{'ball − ring, r g b':30}{'red':19}{'green':19}{'ring':19}dark reds, from real")
    for name, row in rows.items():
        cells = (" ".join(f"{value:+.2f}" for value in row[part]) for part in REAL)
        dark = f"{row['dark']:.2f}" if "dark" in row else "–"
        apart = f"{distance_to_real(row):.3f}"
        print(f"{name:30}{''.join(f'{cell:19}' for cell in cells)}{dark}  {apart}")
    return {name: {part: row[part].tolist() for part in row} for name, row in rows.items()}
