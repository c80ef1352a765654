"""What a water that is fitted to charts says of charts that were left out, beside rivals.

Two errors of each left-out chart, as shares of its values: *alone*, from its distance and picture
alone, as if its light were that of all charts; and *with its light*, which the green of its
brightest grey tells, and which then does not count. Charts lean and lie in shade, and no model of
water knows that.
"""

import csv
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import matplotlib
import numpy as np
import torch
from matplotlib.figure import Figure
from scipy.optimize import least_squares
from torch.nn.functional import huber_loss

import uwaug
from benchmarks.figures.charts import STYLE, save_small
from benchmarks.harness import use_threads
from benchmarks.water.patches import GREYS, LIGHT_SD
from uwaug.fitting import Patch, fit_patches, fit_veil
from uwaug.formation.learnable import LearnableMedium
from uwaug.optics.jerlov import JERLOV_TYPES

Array = Any
COLOURS = ("red", "yellow", "green", "blue", "purple", "magenta", "maroon")
"""Patches whose colour in air the kit trusts."""

GREEN = 1
RESAMPLES = 1000
STEPS = 4000  # of Adam


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


class Fold(NamedTuple):
    """Numbers of charts."""

    known: list[int]
    left_out: list[int]


class Model(NamedTuple):
    """A fitted model: light of a white surface, and veil, at a distance (3 each)."""

    light: Callable[[float], Array]
    veil: Callable[[float], Array]

    def seen(self, air: Array, chart: Seen, exposure: float, light: float = 1.0) -> Array:
        """Values of patches (Nx3) on a chart."""
        direct = light * air * self.light(chart.distance)
        return exposure * (direct + self.veil(chart.distance))

    def exposure(self, charts: Sequence[Seen]) -> float:
        """Exposure of the picture in which charts are."""

        def residual(logs: Array) -> Array:
            rows = [logs[1:] / LIGHT_SD]
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


def by_adam(charts: Sequence[Seen]) -> uwaug.Medium:
    """A medium that PyTorch's Adam learns, with gains of colours, pictures and charts."""
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
        (loss + (lights / LIGHT_SD).square().sum() / 2).backward()
        adam.step()
    medium: uwaug.Medium = learnable()
    return medium


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


OURS = "uwaug: one rate a colour, a light for each chart"
ARMS: Mapping[str, Callable[[Sequence[Seen]], Model]] = {
    OURS: fitted,
    "the same, two rates": partial(fitted, model="veil"),
    "Jaffe-McGlamery: one rate, charts lit alike": partial(fitted, uneven=0.0),
    "Akkaynak: two rates, charts lit alike": partial(fitted, model="veil", uneven=0.0),
    "the nearest of ten Jerlov types, as published": of_type,
}
NEAREST = "the nearest chart's colours"


class Prediction(NamedTuple):
    """Values of a chart that was left out, and what a model says of them (Nx3 each)."""

    distance: float  # m
    seen: Array
    alone: Array
    lit: Array  # with the light that the green of its brightest patch tells; NaN there

    def errors(self, kind: str) -> Array:
        """Errors as shares of what is seen."""
        return np.abs(getattr(self, kind) / self.seen.clip(1e-4) - 1)


def predicted(model: Model, chart: Seen, exposure: float) -> Prediction:
    """What a model says of a chart."""
    air, water = values(chart)
    dark, alone = (model.seen(x, chart, exposure) for x in (0 * air, air))
    # of colours the kit knows less
    is_grey = np.isin([*chart.air], GREYS)
    i = int((air[:, GREEN] * is_grey).argmax())
    light = (water[i] - dark[i])[GREEN] / (alone - dark)[i, GREEN]
    lit = dark + light * (alone - dark)
    lit[i, GREEN] = np.nan
    return Prediction(chart.distance, water, alone, lit)


def copied(near: Seen, chart: Seen) -> Prediction:
    """The colours of another chart, alone and by the ratio of their brightest green."""
    names = [name for name in chart.air if name in near.air]
    water, other = (np.array([x.water[name] for name in names]) for x in (chart, near))
    lit = other * water[0, GREEN] / other[0, GREEN]
    lit[0, GREEN] = np.nan
    return Prediction(chart.distance, water, other, lit)


def left_out(charts: Sequence[Seen], folds: Sequence[Fold]) -> dict[str, list[Prediction]]:
    """What each arm says of the charts that are left out of a fit."""
    rows: dict[str, list[Prediction]] = {name: [] for name in (*ARMS, NEAREST)}
    for fold in folds:
        trained = [charts[i] for i in fold.known]
        for name, arm in ARMS.items():
            model = arm(trained)
            for chart in (charts[i] for i in fold.left_out):
                same = [x for x in trained if x.picture == chart.picture]
                rows[name].append(predicted(model, chart, model.exposure(same or [chart])))
        for chart in (charts[i] for i in fold.left_out):
            same = [x for x in trained if x.picture == chart.picture] or trained
            near = min(same, key=lambda x: abs(x.distance - chart.distance))
            rows[NEAREST].append(copied(near, chart))
    return rows


def folds_of(charts: Sequence[Seen]) -> dict[str, list[Fold]]:
    """What is left out, by name. Exposures are told by other charts of the picture, or else by the
    chart itself.
    """
    count = range(len(charts))
    pictures = sorted({chart.picture for chart in charts})
    members = {p: [i for i in count if charts[i].picture == p] for p in pictures}
    middle = {p: np.median([charts[i].distance for i in members[p]]) for p in pictures}
    near = [i for i in count if charts[i].distance <= middle[charts[i].picture]]
    far = [i for i in count if i not in near]
    with_others = [i for rows in members.values() if len(rows) > 1 for i in rows]
    return {
        "each chart": [Fold([j for j in count if j != i], [i]) for i in with_others],
        "far charts": [Fold(near, far)],
        "near charts": [Fold(far, near)],
        "each picture": [Fold([i for i in count if i not in x], x) for x in members.values()],
    }


def medians(rows: Sequence[Prediction], ours: Sequence[Prediction], kind: str) -> Array:
    """Median error of an arm, and by how much it is more than ours, each with its ends of 95 % over
    charts (2x3).
    """

    def of(predictions: Sequence[Prediction], chosen: Array) -> float:
        parts = [predictions[i].errors(kind).ravel() for i in chosen]
        return float(np.nanmedian(np.concatenate(parts)))

    rng, count = np.random.default_rng(0), len(rows)
    draws = [np.arange(count), *rng.integers(0, count, (RESAMPLES, count))]
    errors = np.array([(of(rows, draw), of(rows, draw) - of(ours, draw)) for draw in draws])
    return np.stack([errors[0], *np.quantile(errors[1:], (0.025, 0.975), axis=0)], 1)


def doors(kit: Path, charts: Sequence[Seen]) -> dict[str, Any]:
    """Rates and veils of all charts, by each door of the package."""
    rows: dict[str, Any] = {}
    patches = [patch for chart in charts for patch in chart.patches]
    for model in ("haze", "veil"):
        fit = fit_patches(patches, model=model, color_space="linear")
        rows[f"fit_patches, {model}"] = {
            name: [number.value, number.low, number.high]
            for name, number in fit.parameters.items()
            if name.startswith(("beta", "G_", "veil", "source"))
        }
    medium = by_adam(charts)
    rows["Adam"] = {"beta": medium.G.tolist(), "veil": medium.veil_weights.sum(-1).tolist()}
    for path in sorted((kit / "charts" / "pictures").glob("*_distance.npz")):
        picture = path.name.partition("_distance")[0]
        image = cv2.imread(str(path.with_name(f"{picture}_lin16.png")), cv2.IMREAD_UNCHANGED)
        z = np.load(path)
        z = torch.from_numpy(z[z.files[0]].astype(np.float32))[None]
        light = torch.from_numpy(image[..., ::-1].astype(np.float32) / 65535).permute(2, 0, 1)
        z = torch.nn.functional.interpolate(z[None], light.shape[1:], mode="nearest")[0]
        fit = fit_veil(light, z.where(z > 0, torch.nan), color_space="linear")
        rows[f"fit_veil, {picture}"] = {
            name: [number.value, number.low, number.high] for name, number in fit.parameters.items()
        }
    for name, numbers in rows.items():
        print(name, numbers)
    return rows


def main(kit: Path) -> dict[str, Any]:
    """Print the tables and return their numbers."""
    use_threads(1)
    results: dict[str, Any] = {}
    results["doors"] = doors(kit, read_charts(kit))
    for space in ("cam", "meas"):
        charts = read_charts(kit, space=space)
        for split, folds in folds_of(charts).items():
            print(
                f"\n{space}, left out: {split}. Median error, % (more than ours, 95 % over charts)"
            )
            rows = left_out(charts, folds)
            for name, kind in product(rows, ("alone", "lit")):
                numbers = medians(rows[name], rows[OURS], kind)
                results.setdefault(f"{space}, {split}", {})[f"{name}, {kind}"] = numbers.tolist()
                (error, low, high), (more, least, most) = 100 * numbers
                cells = f"{error:5.1f} ({low:.1f} to {high:.1f})"
                more_cells = f"{more:+5.1f} ({least:+.1f} to {most:+.1f})"
                print(f"  {name:50s} {kind:6s} {cells:22s} {more_cells}")
            if (space, split) == ("cam", "each chart"):
                draw(rows[OURS])
    print("\nColours, with the light on the chart: median error of red, green and blue, %")
    results["colours"] = colours(kit)
    return results


def colours(kit: Path) -> dict[str, Any]:
    """Errors of colours on charts that were left out of a fit to greys, in linear sRGB."""
    greys = read_charts(kit, space="meas")
    charts = {(x.picture, x.chart): x for x in read_charts(kit, (*GREYS, *COLOURS), "meas")}
    rows: dict[str, list[Array]] = {name: [] for name in COLOURS}
    for known, (i,) in folds_of(greys)["each chart"]:
        model, chart = fitted([greys[k] for k in known]), charts[greys[i][:2]]
        same = [greys[k] for k in known if greys[k].picture == chart.picture]
        errors = predicted(model, chart, model.exposure(same)).errors("lit")
        for name, error in zip(chart.air, errors, strict=True):
            if name in COLOURS:
                rows[name].append(error)
    table = {name: np.nanmedian(errors, 0).tolist() for name, errors in rows.items() if errors}
    for name, numbers in table.items():
        print(f"  {name:10s}", *(f"{100 * x:5.1f}" for x in numbers))
    return table


def draw(rows: Sequence[Prediction]) -> None:
    """Predicted against measured patches of charts that were left out, by distance."""
    with matplotlib.rc_context(STYLE):
        figure = Figure((7, 3.4), dpi=110, layout="constrained")
        axes = figure.subplots(1, 2, sharey=True)
        titles = {"alone": "From its distance alone", "lit": "With the light on the chart"}
        for axis, (kind, title) in zip(axes, titles.items(), strict=True):
            for row, (c, mark) in product(rows, enumerate("os^")):
                z = np.full(len(row.seen), row.distance)
                points = axis.scatter(
                    row.seen[:, c],
                    getattr(row, kind)[:, c],
                    16,
                    z,
                    mark,
                    cmap="viridis",
                    vmin=1,
                    vmax=10,
                )
            ends = 0.04, 1.0
            axis.plot(ends, ends, color="0.6", linewidth=0.8, zorder=0)
            axis.set(xscale="log", yscale="log", xlim=ends, ylim=ends, title=title)
        axes[0].set_ylabel("predicted")
        figure.supxlabel("measured: red (discs), green (squares), blue (triangles)", fontsize=8)
        figure.colorbar(points, label="distance [m]")
        save_small(figure, "water")
