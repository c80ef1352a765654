"""What a water that is fitted to charts says of charts that were left out, beside rivals.

Two errors of each left-out chart, as shares of its values: *alone*, from its distance and picture
alone, as if its light were that of all charts; and *with its light*, which the green of its
brightest grey tells, and which then does not count. Charts lean and lie in shade, and no model of
water knows that.
"""

import csv
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.optimize import least_squares
from torch.nn.functional import huber_loss

import uwaug
from benchmarks.harness import use_threads
from uwaug.fitting import Patch, fit_patches
from uwaug.formation.learnable import LearnableMedium
from uwaug.optics.jerlov import JERLOV_TYPES

Array = Any
GREYS = ("gray1", "gray2", "gray3", "gray4", "black")
COLOURS = ("red", "yellow", "green", "blue", "purple", "magenta", "maroon")
"""Patches whose colour in air the kit trusts."""

GREEN = 1
UNEVEN = 0.3  # standard deviation of the logarithm of the light on charts
STEPS = 800  # of Adam


class Seen(NamedTuple):
    """A chart in a picture: its patches by name."""

    picture: str
    chart: str
    distance: float  # m
    air: dict[str, Array]  # linear light
    water: dict[str, Array]

    @property
    def patches(self) -> list[Patch]:
        """The patches, as `fit_patches` takes them."""
        return [
            Patch(self.picture, self.chart, self.distance, tuple(self.air[x]), tuple(self.water[x]))
            for x in self.air
        ]


def read_charts(kit: Path, names: Sequence[str] = GREYS, space: str = "cam") -> list[Seen]:
    """Charts of the kit with patches of some names that can be used, in a space of its table."""
    charts: dict[tuple[str, str], Seen] = {}
    with (kit / "charts" / "patches.csv").open() as file:
        for row in csv.DictReader(file):
            if row["patch"] not in names or row["usable"] != "1" or row["occluded"] != "0":
                continue
            key = row["scene"], row["chart"]
            chart = charts.setdefault(key, Seen(*key, float(row["distance_m"]), {}, {}))
            air, water = (np.array([float(row[f"{x}_{c}"]) for c in "RGB"]) for x in ("ref", space))
            chart.air[row["patch"]], chart.water[row["patch"]] = air, water
    return list(charts.values())


class Model(NamedTuple):
    """A fitted model: light and veil of a white surface at a distance (3 each), exposures."""

    light: Callable[[float], Array]
    veil: Callable[[float], Array]

    def seen(self, air: Array, chart: Seen, exposure: float, light: float = 1.0) -> Array:
        """Values of patches (Nx3) on a chart."""
        direct = light * air * self.light(chart.distance)
        return exposure * (direct + self.veil(chart.distance))

    def exposure(self, charts: Sequence[Seen], uneven: float) -> float:
        """Exposure of the picture in which charts are."""

        def residual(logs: Array) -> Array:
            rows = [logs[1:] / uneven]
            for chart, log in zip(charts, logs[1:], strict=True):
                air, water = values(chart)
                expected = self.seen(air, chart, np.exp(logs[0]), np.exp(log))
                rows.append(np.log(expected / water.clip(1e-4)).ravel() / 0.05)
            return np.concatenate(rows)

        return float(
            np.exp(least_squares(residual, np.zeros(1 + len(charts)), loss="soft_l1").x[0])
        )


def values(chart: Seen) -> tuple[Array, Array]:
    """Patches of a chart in air and in water (Nx3 each)."""
    return np.array([*chart.air.values()]), np.array([*chart.water.values()])


def of_medium(medium: uwaug.Medium) -> Model:
    """A model of a medium with one rate for each colour."""

    def curve(name: str, z: float) -> Array:
        curve = getattr(medium, name)(torch.tensor([z], dtype=torch.float64))[0].detach().numpy()
        return curve.reshape(3, -1).sum(1) if curve.ndim == 3 else curve[:, 0]

    return Model(partial(curve, "signal"), partial(curve, "backscatter"))


def fitted(charts: Sequence[Seen], **options: Any) -> Model:
    """The model of `fit_patches`."""
    patches = [patch for chart in charts for patch in chart.patches]
    return of_medium(fit_patches(patches, color_space="linear", **options).medium)


def by_adam(charts: Sequence[Seen]) -> Model:
    """A learnable medium and gains of colours, pictures and charts, by PyTorch's Adam."""
    start = uwaug.Medium.from_coefficients((0.2,) * 3, (0.2,) * 3, (0.2,) * 3)
    learnable = LearnableMedium(start, ("rates", "veil")).double()
    names = [chart.picture for chart in charts]
    counts = torch.tensor([len(chart.air) for chart in charts])
    chart_of = torch.arange(len(charts)).repeat_interleave(counts)
    picture_of = torch.tensor([sorted({*names}).index(name) for name in names])[chart_of]
    tables = [np.concatenate(x) for x in zip(*map(values, charts), strict=True)]
    air, water = (torch.from_numpy(table).T[None, :, None] for table in tables)
    z = torch.tensor([chart.distance for chart in charts], dtype=torch.float64)[chart_of]
    sizes = (3, 1, 1), (len({*names}),), (len(charts),)
    gains, exposures, lights = (
        torch.zeros(n, dtype=torch.float64, requires_grad=True) for n in sizes
    )
    adam = torch.optim.Adam([*learnable.parameters(), gains, exposures, lights], lr=0.02)
    for _ in range(STEPS):
        lit = air * (gains + lights[chart_of]).exp()
        seen = learnable().image(z.reshape(1, 1, 1, -1), lit, lit)
        log = seen.log() + (exposures - exposures[0])[picture_of] - water.clamp(min=1e-4).log()
        loss = huber_loss(log / 0.05, torch.zeros_like(log), reduction="sum")
        adam.zero_grad()
        (loss + (lights / UNEVEN).square().sum() / 2).backward()
        adam.step()
    model, gain = of_medium(learnable()), gains.exp().detach().numpy().ravel()
    return model._replace(light=lambda z: gain * model.light(z))


def of_type(charts: Sequence[Seen]) -> Model:
    """The curves of the Jerlov type, of a camera and 5 m below the surface, that explain charts
    best, with a gain for each colour: nothing of the water is fitted but its name.
    """
    best: tuple[float, Model] | None = None
    for name in JERLOV_TYPES:
        model = of_medium(uwaug.Medium.from_water(name, vertical_depth=5.0, tolerance=0))

        def gained(logs: Array, model: Model = model) -> Model:
            gain = np.exp(logs)
            return Model(lambda z: gain * model.light(z), lambda z: gain * model.veil(z))

        def residual(logs: Array, gained: Callable[[Array], Model] = gained) -> Array:
            rows = []
            for chart in charts:
                air, water = values(chart)
                rows.append(np.log(gained(logs).seen(air, chart, 1.0) / water.clip(1e-4)).ravel())
            return np.concatenate(rows) / 0.1

        end = least_squares(residual, np.ones(3), loss="soft_l1")
        if best is None or end.cost < best[0]:
            best = float(end.cost), gained(end.x)
    assert best is not None
    return best[1]


ARMS: Mapping[str, Callable[[Sequence[Seen]], Model]] = {
    "uwaug: one rate a colour, a light for each chart": fitted,
    "the same, two rates": partial(fitted, model="veil"),
    "the same by Adam": by_adam,
    "Jaffe-McGlamery: one rate, charts lit alike": partial(fitted, uneven=0.0),
    "Akkaynak: two rates, charts lit alike": partial(fitted, model="veil", uneven=0.0),
    "the nearest of ten Jerlov types, as published": of_type,
}
NEAREST = "the nearest chart's colours"


def errors(water: Array, expected: Array) -> Array:
    return np.abs(expected / water.clip(1e-4) - 1)


def told(model: Model, chart: Seen, exposure: float) -> Array:
    """Errors of a chart (N) whose light the green of its brightest patch tells."""
    air, water = values(chart)
    dark = model.seen(0 * air, chart, exposure)
    lit = model.seen(air, chart, exposure) - dark
    i = int(air[:, GREEN].argmax())
    light = (water[i] - dark[i])[GREEN] / lit[i, GREEN]
    error = errors(water, dark + light * lit)
    error[i, GREEN] = np.nan
    return error


def left_out(
    charts: Sequence[Seen], folds: Sequence[tuple[list[int], list[int]]]
) -> dict[str, Any]:
    """Errors (values of a chart, 3) of each chart that is left out, by arm: alone and told."""
    rows: dict[str, dict[str, list[Array]]] = {
        name: {"alone": [], "with its light": []} for name in (*ARMS, NEAREST)
    }
    for known, unknown in folds:
        trained = [charts[i] for i in known]
        for name, arm in ARMS.items():
            model = arm(trained)
            for chart in (charts[i] for i in unknown):
                same = [x for x in trained if x.picture == chart.picture]
                exposure = model.exposure(same or [chart], UNEVEN)
                air, water = values(chart)
                rows[name]["alone"].append(errors(water, model.seen(air, chart, exposure)))
                rows[name]["with its light"].append(told(model, chart, exposure))
        for chart in (charts[i] for i in unknown):
            same = [x for x in trained if x.picture == chart.picture] or trained
            near = min(same, key=lambda x: abs(x.distance - chart.distance))
            names = [x for x in chart.air if x in near.air]
            water, other = (np.array([x.water[name] for name in names]) for x in (chart, near))
            rows[NEAREST]["alone"].append(errors(water, other))
            ratio = water[0, GREEN] / other[0, GREEN]
            error = errors(water, ratio * other)
            error[0, GREEN] = np.nan
            rows[NEAREST]["with its light"].append(error)
    return rows


def median(units: Sequence[Array]) -> tuple[float, float, float]:
    """Median of all values, and its 95 % interval over charts."""
    rng = np.random.default_rng(0)

    def of(chosen: Sequence[Array]) -> float:
        return float(np.nanmedian(np.concatenate([x.ravel() for x in chosen])))

    draws = [of([units[i] for i in rng.integers(0, len(units), len(units))]) for _ in range(1000)]
    return of(units), *map(float, np.quantile(draws, (0.025, 0.975)))


def folds_of(charts: Sequence[Seen]) -> dict[str, list[tuple[list[int], list[int]]]]:
    """What is known and what is left out: each chart, each picture, near charts, far charts."""
    count = range(len(charts))
    pictures = sorted({chart.picture for chart in charts})
    z = {p: np.median([c.distance for c in charts if c.picture == p]) for p in pictures}
    near = [i for i in count if charts[i].distance <= z[charts[i].picture]]
    far = [i for i in count if i not in near]
    alone = [i for i in count if sum(c.picture == charts[i].picture for c in charts) == 1]
    return {
        "each chart": [([j for j in count if j != i], [i]) for i in count if i not in alone],
        "near tell far": [(near, far)],
        "far tell near": [(far, near)],
        "each picture": [
            (
                [i for i in count if charts[i].picture != p],
                [i for i in count if charts[i].picture == p],
            )
            for p in pictures
        ],
    }


def main(kit: Path) -> dict[str, Any]:
    """Print the tables and return their numbers."""
    results: dict[str, Any] = {}
    use_threads(1)
    for space in ("cam", "meas"):
        charts = read_charts(kit, space=space)
        for split, folds in folds_of(charts).items():
            rows = left_out(charts, folds)
            print(f"\n{space}, {split} left out: median error of greys, % (95 % over charts)")
            for name, kinds in rows.items():
                numbers = {kind: median(units) for kind, units in kinds.items()}
                results.setdefault(space, {}).setdefault(split, {})[name] = numbers
                cells = [
                    f"{100 * m:5.1f} ({100 * a:.1f} to {100 * b:.1f})"
                    for m, a, b in numbers.values()
                ]
                print(
                    f"  {name:50s}",
                    *(f"{kind}: {cell}" for kind, cell in zip(numbers, cells, strict=True)),
                )
    return results
