"""The pictures of README, of the guides and of the gallery, by `python -m benchmarks gallery`. One
sheet shows one job. Seeds are fixed; those of `hero` were chosen by eye, all others were not.
"""

import math
from dataclasses import replace
from typing import Any

import torch
from PIL import Image
from skimage import data
from torch import Tensor
from torch.nn.functional import interpolate

from benchmarks.figures.charts import FIGURES
from benchmarks.figures.knobs import knobs
from benchmarks.figures.reef import reef
from benchmarks.harness import command
from uwaug import (
    Development,
    KeepVisible,
    MarineSnow,
    Medium,
    PointSpread,
    RandomDevelopment,
    RandomUnderwater,
    RandomWater,
    Underwater,
    View,
    load_preset,
    published,
)
from uwaug.distance import MadeUp, Metres, from_relative
from uwaug.figures.sheet import Cell, coloured, save, sheet
from uwaug.presets.scene import Scene, motorcycle
from uwaug.transforms.draws import of_frame

WATERS = {"II": 1.0, "7C": 0.2}
"""What the scene's distances are multiplied by: at 2 to 5 m nothing is seen in 7C."""

OWN = "hou-2020"
"""The system that knows no waters and no distances."""

DEPTHS = (0.0, 5.0, 10.0, 20.0, 30.0)
"""m below the surface, of the red tank in type II; a diver is some .7 to 2 m away from it."""

HERO = {"reef": 100, "coffee": 109, "chelsea": 106}
"""Seeds, chosen by eye."""

GREEN, RED = torch.eye(3)[:, 1:2], torch.eye(3)[:, :1]

QUALITY = 70

Pair = tuple[Tensor, Tensor | None]
"""A picture (3xHxW) and its distances, or None where they are guessed."""


def scene_of(name: str, width: int) -> Pair:
    """Our reef with its distances, the bundled motorcycle with measured ones, or a photograph of
    scikit-image (CC0 or public domain); 3:2.
    """
    if name == "reef":
        image, distance, _ = reef()
    elif name == "motorcycle":
        own = motorcycle()
        image, distance = own.image, own.distance
    else:
        image = torch.from_numpy(getattr(data, name)()).permute(2, 0, 1) / 255
        distance = None
    height = 2 * image.shape[-1] // 3
    image = image[:, :height]
    small = interpolate(image[None], (2 * width // 3, width), mode="bilinear", antialias=True)[0]
    if distance is not None:
        distance = interpolate(distance[None, :, :height], small.shape[1:], mode="nearest")[0]
    return small, distance


def in_water(pair: Pair, seed: int, **options: Any) -> Tensor:
    """A random picture of it."""
    image, distance = pair
    source = MadeUp() if distance is None else Metres()
    augment = RandomUnderwater(distance=source, **options)
    record = augment.make_params(image, torch.Generator().manual_seed(seed))
    return augment.transform(image, distance, record)


def shown_distance(metres: Tensor) -> Tensor:
    """Distances (1xHxW) of .5 to 12 m in colours (3xHxW); black is open water."""
    colours = coloured(metres.log(), (math.log(0.5), math.log(12.0)))
    return colours.masked_fill(metres.isinf(), 0)


def hero() -> Image.Image:
    """Three scenes in air, and below in water."""
    pairs = {seed: scene_of(name, 600) for name, seed in HERO.items()}
    dry = [(image, "") for image, _ in pairs.values()]
    wet = [(in_water(pair, seed), "") for seed, pair in pairs.items()]
    return sheet([dry, wet], (300, 200))


def default_draws() -> Image.Image:
    """Four scenes by six seeds."""
    rows = []
    for row, name in enumerate(("reef", "motorcycle", "coffee", "chelsea")):
        pair = scene_of(name, 300)
        rows.append([(in_water(pair, 10 * row + draw), "") for draw in range(6)])
    return sheet(rows, (150, 100))


def detection() -> Image.Image:
    """The fish of the reef as water thickens: boxes that stay, green, and dashed those that go."""
    image, distance, boxes = reef()
    camera = RandomDevelopment(exposure=-0.5, white_balance=0.3, saturation=1, gamut=1, tone=1)
    numbers = torch.arange(len(boxes))
    y, x = torch.meshgrid(*map(torch.arange, image.shape[-2:]), indexing="ij")
    dashes = (x + y) % 8 < 5

    def framed(picture: Tensor, kept: Tensor) -> Tensor:
        picture = picture.clone()
        for number, box in enumerate(boxes.round().int().tolist()):
            left, top, right, bottom = box[0] - 4, box[1] - 4, box[2] + 4, box[3] + 4
            frame = torch.zeros(picture.shape[-2:], dtype=torch.bool)
            frame[max(0, top) : bottom, max(0, left) : right] = True
            frame[max(0, top + 2) : bottom - 2, max(0, left + 2) : right - 2] = False
            if number in kept:
                picture[:, frame] = GREEN
            else:
                picture[:, frame & dashes] = RED
        return picture

    cells = [(framed(image, numbers), f"in air: {len(boxes)} fish")]
    for contrast in (0.7, 0.4, 0.2, 0.1, 0.05):
        water = RandomWater("3C", contrast=contrast, vertical_depth=3)
        augment = RandomUnderwater(water, light=None, development=camera)
        target = {"boxes": boxes, "labels": numbers}
        torch.manual_seed(0)
        wet, _, target = KeepVisible(augment, min_contrast=0.05)(image, distance, target)
        label = f"contrast {contrast:g} at the median distance: {len(target['labels'])} fish"
        cells.append((framed(wet, target["labels"]), label))
    return sheet([cells[:3], cells[3:]])


def restoration() -> Image.Image:
    """Input, target and distances, of three scenes."""
    rows = []
    for row, name in enumerate(("reef", "motorcycle", "coffee")):
        image, distance = scene_of(name, 460)
        source = Metres() if distance is not None else MadeUp()
        augment = RandomUnderwater(RandomWater(contrast=(0.2, 0.5)), distance=source, light=None)
        record = augment.make_params(image, torch.Generator().manual_seed(40 + row))
        scenes = augment.scenes(image, distance, record)
        metres, left = scenes.metres[0], scenes.contrast_map()
        rows.append(
            [
                (scenes.formed(), "input"),
                (image, "target"),
                (
                    shown_distance(metres),
                    "distance" if distance is not None else "distance, guessed",
                ),
                (left.expand(3, -1, -1), "contrast that is left"),
            ]
        )
    return sheet(rows, (230, 230))


def severity() -> Image.Image:
    """Five grades of two scenes."""
    rows = []
    for name in ("reef", "chelsea"):
        pair = scene_of(name, 310)
        cells = [(pair[0], "in air")]
        for level in range(1, 6):
            water = RandomUnderwater.severity(level).water
            cells.append((in_water(pair, 2, water=water, light=None), f"severity {level}"))
        rows.append(cells)
    return sheet(rows, (155, 155))


def night() -> Image.Image:
    """Lamps on each rig, on two scenes; the other in marine snow."""
    preset, rows = load_preset("night"), []
    for name, snow in {"reef": None, "motorcycle": MarineSnow(2000)}.items():
        pair, water = scene_of(name, 620), replace(preset.water, snow=snow)
        cells = []
        for column, rig in enumerate(("vehicle", "diver", "strobe")):
            nouns = {"light": replace(preset.light, rigs=rig), "development": preset.development}
            label = f"{rig}, marine snow" if snow else rig
            cells.append((in_water(pair, 5 + column, water=water, **nouns), label))
        rows.append(cells)
    return sheet(rows)


def film() -> Image.Image:
    """A pan along the reef: six frames in one water, whose field drifts."""
    frames, step = 6, 56  # px of the reef's 720
    image, distance, _ = reef()
    wide = image.shape[-1] - (frames - 1) * step
    views = [(..., slice(k * step, k * step + wide)) for k in range(frames)]
    augment = RandomUnderwater(RandomWater(field=(0.6, 1.4)), light=None)
    record = augment.make_params(image, torch.Generator().manual_seed(4))
    middle = views[frames // 2]
    (sample,) = augment.for_clip(record, image[middle], distance[middle])["samples"]
    cells = []
    for number, view in enumerate(views):
        moved = {"samples": [{**of_frame(sample, number), "moved": 0.1 * number}]}
        wet = augment.transform(image[view], distance[view], moved)
        cells.append((wet, f"{0.1 * number:.1f} m of drift"))
    return sheet([cells], (155, 155))


def systems(scene: Scene) -> Image.Image:
    """The scene, and each published system in II and in 7C, two systems a row."""
    own = published.picture(OWN, scene.image, scene.distance)
    cells = [(scene.image, "no water"), (own, f"{OWN}, its own water")]
    for name in published.systems():
        for water, factor in WATERS.items() if name != OWN else ():
            picture = published.picture(name, scene.image, factor * scene.distance, water)
            cells.append((picture, f"{name}, {water}"))
    return sheet([cells[i : i + 4] for i in range(0, len(cells), 4)], (188, 188))


def reds(scene: Scene) -> Image.Image:
    """A red tank at five depths: above, each channel fades by one number; below, surfaces have
    spectra. The camera's exposure is automatic.
    """
    height, width = scene.image.shape[-2:]
    tank = (..., slice(height // 4, 3 * height // 4), slice(3 * width // 8, 7 * width // 8))
    image, distance = scene.image[tank], scene.distance[tank] / 3

    def cell(surfaces: str, depth: float) -> Cell:
        is_spectral = surfaces == "spectral"
        medium = Medium.from_water("II", vertical_depth=depth, surfaces=surfaces)
        camera = Development(metered=True, gamut=float(is_spectral))
        label = f"{depth:g} m, {'spectra' if is_spectral else 'one number a channel'}"
        return Underwater(medium, development=camera)(image, distance), label

    rows = [[cell(surfaces, depth) for depth in DEPTHS] for surfaces in ("grey", "spectral")]
    return sheet(rows, (188, 188))


def made_up() -> Image.Image:
    """Four pictures of scikit-image, with two made-up maps and what default draws make of each."""
    augment, rows = RandomUnderwater(distance=MadeUp()), []
    for row, name in enumerate(("coffee", "astronaut", "rocket", "chelsea")):
        image, _ = scene_of(name, 376)
        cells = [(image, name)]
        for draw in range(2):
            record = augment.make_params(image, torch.Generator().manual_seed(2 * row + draw))
            scenes = augment.scenes(image, None, record)
            z = scenes.metres[0]
            cells.append((shown_distance(z), f"{float(z.min()):.1f} to {float(z.max()):.0f} m"))
            cells.append((scenes.formed(), ""))
        rows.append(cells)
    return sheet(rows, (188, 188))


def depth_scaling(scene: Scene) -> Image.Image:
    """The paper's: distances of 0 to 20 m by three exponents, and pictures in types II and 7C."""
    low, high = scene.distance.aminmax()
    maps = {}
    for gamma in (1.0, 3.0, 6.0):
        z = from_relative((scene.distance - low) / (high - low), 0.0, 20.0, gamma)
        maps[f"exponent {gamma:g}"] = z
    rows = [[(coloured(z, (0.0, 20.0)), f"distance, {label}") for label, z in maps.items()]]
    for name in ("II", "7C"):
        medium = Medium.from_water(name, g=0.2, point_spread=PointSpread.paper())
        degrade = Underwater(medium, None)
        rows.append([(degrade(scene.image, z), f"{name}, {label}") for label, z in maps.items()])
    return sheet(rows)


def main(quick: bool = False) -> dict[str, Image.Image]:
    """Draw and save."""
    scene = motorcycle()
    if quick:
        scene = Scene(scene.image[:, ::8, ::8], scene.distance[:, ::8, ::8], View(focal_px=125.0))
    sheets = {job.__name__: job(scene) for job in (systems, reds, depth_scaling)}
    sheets["made_up"] = made_up()
    if not quick:
        jobs = (hero, default_draws, detection, restoration, severity, night, film)
        sheets |= {job.__name__: job() for job in jobs}
        sheets["knobs"] = knobs(*scene_of("reef", 370))
        for name, drawn in sheets.items():
            path = FIGURES / f"{name.replace('_', '-')}.jpg"
            save(drawn, path, QUALITY)
            print(path)
    return sheets


if __name__ == "__main__":
    command(main, __doc__)
