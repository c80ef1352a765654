"""Lamps: the veil against its definition, the model against Monte Carlo, what a lamp costs, and
where it takes over from daylight.

`python -m benchmarks.accuracy.lamps` writes results/lamps.json and figures/lamps.jpg and prints the
tables.
"""

from typing import Any

import numpy as np
import torch
from PIL import Image, ImageDraw
from referees.lamps import KINDS, random_case, veil_by_definition
from torch import Tensor

import uwaug
from benchmarks.accuracy.lamps_transport import RADIUS, lamp_light
from benchmarks.harness import ROOT, command, race, save, scene, use_threads, water_medium
from uwaug import Light, Medium, Underwater
from uwaug.light.backscatter import grid_of, integrated, interpolated, polynomials_of
from uwaug.light.geometry import ray_of, view_of
from uwaug.optics import Scattering
from uwaug.presets.scene import motorcycle

FIGURE = ROOT / "benchmarks" / "figures" / "lamps.jpg"
LENGTHS, OFFSETS, ABSORPTION = (0.5, 1.0, 2.0, 4.0), (0.1, 0.3, 1.0, 3.0), (0.1, 0.4, 1.0)
G = 0.05  # of the calibrated law
DEPTHS = (0.0, 10.0, 30.0)  # m, of the figure
WATERS = ("II", "3C")
LAMP = Light.lamp((0.4, -0.3, 0.0), (-0.12, 0.1, 1.0), 2.0, cone=45.0)
IN_VIEW = Light.lamp((0.4, -0.3, 3.0), (-0.12, 0.1, -1.0), 2.0, cone=45.0)


def veils(count: int, water: str = "7C") -> dict[str, dict[str, float]]:
    """The largest and the median error of the veil for random lamps; and of the grid of rays."""
    white = Medium.from_water(water).under()
    rng = np.random.default_rng(0)
    found = {}
    for kind in KINDS:
        errors, gridded = [], []
        for _ in range(count):
            case = random_case(kind, rng)
            lamp, view = case.lamp, case.view
            own = white.brightened(lamp.power[:, None] * lamp.rgb)
            z = torch.full((1, 1, 1, 1), case.z, dtype=torch.float64)
            ours = integrated(lamp, own, view, ray_of(lamp, view), z, lamp.wide).flatten()
            truth = veil_by_definition(case, white)
            # a picture shows no more than white
            errors.append(float(((ours - truth).abs() / truth.clamp(min=1)).max()))
            if not lamp.ahead:
                gridded.append(_off_grid(lamp, own, rng))
        worst = {"largest": max(errors), "median": float(np.median(errors))}
        found[kind] = {**worst, "largest of the grid": max(gridded, default=0.0)}
    return found


def _off_grid(lamp: Any, water: Medium, rng: np.random.Generator) -> float:
    """The largest error of the grid of rays at 200 pixels of a picture."""
    size = (10, 20)
    view = view_of(size, 0.866 * 20, None, water.G)
    ray = ray_of(lamp, view)
    z = torch.from_numpy(0.2 * 100 ** rng.uniform(size=(1, 1, *size)))
    # the rays of a picture of this size lie beside those of the grid
    grid = grid_of(lamp, water, view, polynomials_of(lamp, water), lamp.wide)
    found = interpolated(grid, view, ray, z, slice(0, size[1]))
    return float((found - integrated(lamp, water, view, ray, z, lamp.wide)).abs().max())


def referee(photons: int, lengths: tuple[float, ...] = LENGTHS) -> list[dict[str, float]]:
    """The model over Monte Carlo, for each b·z, lamp and a/b."""
    rows = []
    for seed, length in enumerate(lengths):
        truth = lamp_light(length, OFFSETS, ABSORPTION, photons, seed)
        for i, offset in enumerate(OFFSETS):
            for j, absorption in enumerate(ABSORPTION):
                ours = _modelled(length, offset, absorption)
                known = [float(term[i, j]) for term in (truth.direct, truth.forward, truth.veil)]
                row = {"bz": length, "offset": offset, "a/b": absorption}
                for name, mine, theirs in zip(
                    ("direct", "forward", "veil"), ours, known, strict=True
                ):
                    row[name], row[f"{name} true"] = mine, theirs
                row["once"] = float(truth.once[i, j]) / known[2]
                row["standard error"] = float(truth.error[i, j])
                rows.append(row)
    return rows


def _modelled(length: float, offset: float, absorption: float) -> list[float]:
    """The model's direct, forward and veil in the middle of a plane, b = 1/m."""
    medium = Medium.from_coefficients(
        (absorption + 1.0,) * 3, (absorption + G,) * 3, (0.0,) * 3, b_mean=1.0
    )
    light = Light.lamp((offset, 0, 0), (0, 0, 1), 1.0, cone=180.0, radius=RADIUS)
    image = torch.ones(1, 3, 9, 9, dtype=torch.float64)
    view = view_of((9, 9), 1000.0, None, image)
    z = length / view.shortening()
    terms = uwaug.form_image(image, z, medium, light=light, focal_px=1000.0)
    found = (terms.direct, terms.forward, terms.backscatter)
    return [float(term[0, 0, 4, 4]) for term in found]


def summary(rows: list[dict[str, float]]) -> dict[str, dict[str, float]]:
    """Medians and extremes of the model over the truth, by b·z."""
    found = {}
    for length in sorted({row["bz"] for row in rows}):
        some = [row for row in rows if row["bz"] == length]
        ratios: dict[str, float] = {}
        for name in ("direct", "veil", "arriving"):
            values = []
            for row in some:
                both = ("direct", "forward") if name == "arriving" else (name,)
                mine = sum(row[one] for one in both)
                values.append(mine / sum(row[f"{one} true"] for one in both))
            ratios[name] = float(np.median(values))
            ratios[f"{name}, least"], ratios[f"{name}, most"] = min(values), max(values)
        ratios["veil scattered once"] = float(np.median([row["once"] for row in some]))
        found[f"{length:g}"] = ratios
    return found


def costs(size: int, rounds: int) -> dict[str, dict[str, float]]:
    """Milliseconds of each light, and how many times those of the default, one thread."""
    image, z = (t.float() for t in scene(size))
    lights = {
        "default": None,
        "Light.ambient()": Light.ambient(),
        "sun": Light.parallel(50, 30),
        "one lamp": LAMP,
        "daylight and one lamp": Light.ambient() + LAMP,
        "two lamps": LAMP + LAMP,
        "one lamp in view": IN_VIEW,
    }
    found = {}
    for water in ("7C", "I"):
        medium = water_medium(water).to(torch.float32)
        runners = {}
        for name, light in lights.items():
            module = Underwater(medium, color_space="linear", light=light, focal_px=0.866 * size)
            runners[name] = lambda module=module: module(image, z)
        with torch.no_grad():
            times = race(runners, rounds, 60.0)
        base = times["default"]["median_ms"]
        for name, taken in times.items():
            found[f"{water}, {name}"] = {**taken, "times the default": taken["median_ms"] / base}
    return found


def figure(width: int = 300) -> Tensor:
    """Each water: by daylight alone, and with a lamp, at three depths, each pair with the exposure
    of the lit picture; and by how much the lamp outshines daylight.
    """
    shown = motorcycle()
    height = round(width * shown.image.shape[-1] ** -1 * shown.image.shape[-2])
    image = torch.nn.functional.interpolate(shown.image[None].float(), (height, width), mode="area")
    z = torch.nn.functional.interpolate(shown.distance[None].float(), (height, width))
    focal = shown.focal_px * width / shown.image.shape[-1]
    strips = []
    for water in WATERS:
        for lit in (False, True):
            row = []
            for depth in DEPTHS:
                row.append(_cell(image, z, focal, water, depth, lit))
            strips.append(torch.cat(row, -1))
    return torch.cat(strips, -2)


def _cell(image: Tensor, z: Tensor, focal: float, water: str, depth: float, lit: bool) -> Tensor:
    medium = Medium.from_water(
        water,
        vertical_depth=depth,
        surfaces="spectral",
        g=Scattering.CALIBRATED.g,
        mu=Scattering.CALIBRATED.mu,
        point_spread=uwaug.PointSpread.calibrated(focal),
    )
    both = Light.ambient() + LAMP
    arrives = {}
    linear = uwaug.formation.colour.to_light(image, "srgb")
    for name, light in (("day", Light.ambient()), ("lamp", LAMP), ("both", both)):
        arrives[name] = uwaug.form_image(linear, z, medium, light=light, focal_px=focal).image
    share = float(arrives["lamp"].mean() / arrives["both"].mean())
    gain = min(64.0, float(linear.mean() / arrives["both"].mean()))
    seen = arrives["both"] if lit else arrives["day"]
    picture = uwaug.formation.colour.from_light(seen * gain, "srgb", image)[0]
    said = f"{water}, {depth:g} m"
    said += f", with a lamp: {100 * share:.0f} % of the light" if lit else ", daylight"
    return _labelled(picture, said)


def _labelled(picture: Tensor, text: str) -> Tensor:
    array = (picture.permute(1, 2, 0) * 255).round().to(torch.uint8).numpy()
    sheet = Image.fromarray(array)
    draw = ImageDraw.Draw(sheet)
    draw.rectangle((0, 0, 8 + draw.textlength(text), 14), fill="black")
    draw.text((4, 1), text, fill="white")
    return torch.from_numpy(np.array(sheet)).permute(2, 0, 1)


def main(quick: bool = False) -> dict[str, Any]:
    """Run all parts; print and, unless quick, write."""
    use_threads(1)
    results: dict[str, Any] = {"veil": veils(3 if quick else 334)}
    for kind, errors in results["veil"].items():
        said = ", ".join(f"{name} {error:.1e}" for name, error in errors.items())
        print(f"veil, lamp {kind}: {said}")
    results["rows"] = referee(40_000, LENGTHS[:1]) if quick else referee(400_000)
    results["referee"] = summary(results["rows"])
    for length, ratios in results["referee"].items():
        said = ", ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items())
        print(f"model over Monte Carlo, b·z = {length}: {said}")
    results["costs"] = costs(64 if quick else 512, 2 if quick else 25)
    for name, taken in results["costs"].items():
        print(f"{name}: {taken['median_ms']:.1f} ms, {taken['times the default']:.2f}×")
    sheet = figure(60 if quick else 300)
    if not quick:
        print(save("lamps", results))
        Image.fromarray(sheet.permute(1, 2, 0).numpy()).save(FIGURE, quality=85)
    return results


if __name__ == "__main__":
    command(main, __doc__)
