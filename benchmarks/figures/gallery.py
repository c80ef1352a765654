"""The pictures of README, of the guides and of the gallery, by `python -m benchmarks gallery`. One
sheet shows one job. Seeds are fixed; those of `hero` were chosen by eye, all others were not.
"""

from typing import Any

import torch
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from skimage import data
from torch import Tensor
from torch.nn.functional import interpolate

from benchmarks.figures.grid import GAP, Grid, save
from benchmarks.figures.knobs import knobs
from benchmarks.figures.reef import reef
from benchmarks.harness import command
from uwaug import (
    Development,
    KeepVisible,
    MarineSnow,
    Medium,
    RandomDevelopment,
    RandomLight,
    RandomUnderwater,
    RandomWater,
    Underwater,
    published,
)
from uwaug.distance import MadeUp, Metres
from uwaug.optics.scattering import Scattering
from uwaug.presets.scene import Scene, motorcycle

WATERS = {"II": 1.0, "7C": 0.2}
"""What the scene's distances are multiplied by: at 2 to 5 m nothing is seen in 7C."""

OWN = "hou-2020"
"""The system that knows no waters and no distances."""

DEPTHS = (0.0, 5.0, 10.0, 20.0, 30.0)
"""m below the surface, of the red tank in type II; a diver is some .7 to 2 m away from it."""

HERO = {"reef": 13, "coffee": 22, "chelsea": 5}
"""Seeds, chosen by eye."""

HERO_PX, FRAME_PX = 300, 310

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


def shown_distance(metres: Tensor, nearest: float = 0.5, farthest: float = 12.0) -> Tensor:
    """Distances (1xHxW) in colours (3xHxW); black is open water."""
    ends = torch.tensor([nearest, farthest]).log()
    shade = (metres[0].log() - ends[0]) / (ends[1] - ends[0])
    colours = torch.from_numpy(colormaps["viridis_r"](shade.clamp(0, 1).numpy())[..., :3])
    colours[metres[0].isinf()] = 0
    return colours.permute(2, 0, 1)


def hero() -> Figure:
    """Three scenes in air, and below in water."""
    grid = Grid(2, len(HERO), (2, 3), HERO_PX, label=GAP)
    for column, (name, seed) in enumerate(HERO.items()):
        pair = scene_of(name, 2 * HERO_PX)
        grid.show(column, pair[0])
        grid.show(len(HERO) + column, in_water(pair, seed))
    return grid.figure


def default_draws() -> Figure:
    """Four scenes by six seeds."""
    names, draws = ("reef", "motorcycle", "coffee", "chelsea"), 6
    grid = Grid(len(names), draws, (2, 3), 150, label=GAP)
    for row, name in enumerate(names):
        pair = scene_of(name, 300)
        for draw in range(draws):
            grid.show(row * draws + draw, in_water(pair, 10 * row + draw))
    return grid.figure


def detection() -> Figure:
    """The fish of the reef as water thickens: boxes that stay, and dashed those that go."""
    contrasts = (0.7, 0.4, 0.2, 0.1, 0.05)
    image, distance, boxes = reef()
    camera = RandomDevelopment(exposure=-0.5, white_balance=0.3, saturation=1, gamut=1, tone=1)
    grid = Grid(2, 3, (2, 3), FRAME_PX)

    def show(place: int, picture: Tensor, kept: Tensor, label: str) -> None:
        axis = grid.show(place, picture, label)
        for number, (left, top, right, bottom) in enumerate(boxes.tolist()):
            stays = number in kept
            style = ("lime", "-") if stays else ("red", ":")
            corner, size = (left - 4, top - 4), (right - left + 8, bottom - top + 8)
            frame = Rectangle(corner, *size, fill=False, edgecolor=style[0], linestyle=style[1])
            axis.add_patch(frame)

    numbers = torch.arange(len(boxes))
    show(0, image, numbers, f"in air: {len(boxes)} fish")
    for place, contrast in enumerate(contrasts, 1):
        water = RandomWater("3C", contrast=contrast, contrast_by="contents", vertical_depth=3)
        augment = RandomUnderwater(water, light=None, development=camera)
        target = {"boxes": boxes, "labels": numbers}
        torch.manual_seed(0)
        wet, _, target = KeepVisible(augment, min_contrast=0.05)(image, distance, target)
        label = f"contrast {contrast:g} at the median distance: {len(target['labels'])} fish"
        show(place, wet, target["labels"], label)
    return grid.figure


def restoration() -> Figure:
    """Input, target and distances, of three scenes."""
    names = ("reef", "motorcycle", "coffee")
    grid = Grid(len(names), 4, (2, 3), 230)
    for row, name in enumerate(names):
        image, distance = scene_of(name, 460)
        source = Metres() if distance is not None else MadeUp()
        augment = RandomUnderwater(RandomWater(contrast=(0.2, 0.5)), distance=source, light=None)
        record = augment.make_params(image, torch.Generator().manual_seed(40 + row))
        metres = source.metres(distance, image, record["samples"][0]["distance"])
        left = augment.contrast_left(image, distance, record)
        shown = (augment.transform(image, distance, record), image)
        cells = (*shown, shown_distance(metres), left.expand(3, -1, -1))
        titles = ("input", "target", "distance", "contrast that is left")
        guessed = ", guessed" if distance is None else ""
        for column, (cell, title) in enumerate(zip(cells, titles, strict=True)):
            grid.show(4 * row + column, cell, title + guessed * (title == "distance"))
    return grid.figure


def severity() -> Figure:
    """Five grades of two scenes."""
    names = ("reef", "chelsea")
    grid = Grid(len(names), 6, (2, 3), 155)
    for row, name in enumerate(names):
        pair = scene_of(name, 310)
        grid.show(6 * row, pair[0], "in air")
        for level in range(1, 6):
            water = RandomUnderwater.severity(level).water
            picture = in_water(pair, 2, water=water, light=None)
            grid.show(6 * row + level, picture, f"severity {level}" if row == 0 else "")
    return grid.figure


def night() -> Figure:
    """Lamps on each rig, on two scenes; the other in marine snow."""
    rigs, names = ("vehicle", "diver", "strobe"), {"reef": None, "motorcycle": MarineSnow(2000)}
    grid = Grid(len(names), len(rigs), (2, 3), FRAME_PX)
    for row, (name, snow) in enumerate(names.items()):
        pair, water = scene_of(name, 2 * FRAME_PX), RandomWater(snow=snow)
        for column, rig in enumerate(rigs):
            light = RandomLight(share=1.0, rigs=rig)
            label = f"{rig}, marine snow" if snow else rig
            grid.show(3 * row + column, in_water(pair, 5 + column, water=water, light=light), label)
    return grid.figure


def film() -> Figure:
    """A pan along the reef: six frames in one water, whose field drifts."""
    frames, step = 6, 56  # px of the reef's 720
    image, distance, _ = reef()
    wide = image.shape[-1] - (frames - 1) * step
    views = [(..., slice(k * step, k * step + wide)) for k in range(frames)]
    augment = RandomUnderwater(RandomWater(field=(0.6, 1.4)), light=None)
    record = augment.make_params(image, torch.Generator().manual_seed(4))
    middle = views[frames // 2]
    (sample,) = augment.for_clip(record, image[middle], distance[middle])["samples"]
    grid = Grid(1, frames, (image.shape[-2], wide), 155)
    for number, view in enumerate(views):
        moved = {"samples": [{**sample, "moved": 0.1 * number}]}
        wet = augment.transform(image[view], distance[view], moved)
        grid.show(number, wet, f"{0.1 * number:.1f} m of drift")
    return grid.figure


def systems(scene: Scene) -> Figure:
    """The scene, and each published system in II and in 7C, two systems a row."""
    names = [name for name in published.systems() if name != OWN]
    rows = -(-(len(names) + 1) // 2)
    grid = Grid(rows, 4, (scene.image.shape[-2], scene.image.shape[-1]))
    grid.show(0, scene.image, "no water")
    own = published.picture(OWN, scene.image, scene.distance)
    grid.show(1, own, f"{OWN}, its own water")
    place = 2
    for name in names:
        for water, factor in WATERS.items():
            z = factor * scene.distance
            picture = published.picture(name, scene.image, z, water)
            grid.show(place, picture, f"{name}, {water}")
            place += 1
    return grid.figure


def reds(scene: Scene) -> Figure:
    """A red tank at five depths: above, each channel fades by one number; below, surfaces have
    spectra. The camera's exposure is automatic.
    """
    height, width = scene.image.shape[-2:]
    tank = (..., slice(height // 4, 3 * height // 4), slice(3 * width // 8, 7 * width // 8))
    image, distance = scene.image[tank], scene.distance[tank] / 3
    grid = Grid(2, len(DEPTHS), (image.shape[-2], image.shape[-1]))
    for column, depth in enumerate(DEPTHS):
        for row, surfaces in enumerate(("grey", "spectral")):
            medium = Medium.from_water(
                "II",
                vertical_depth=depth,
                g=Scattering.CALIBRATED.g,
                surfaces=surfaces,
            )
            camera = Development(exposure="auto", gamut=float(surfaces == "spectral"))
            degrade = Underwater(medium, development=camera)
            label = f"{depth:g} m, {'spectra' if row else 'one number a channel'}"
            grid.show(row * len(DEPTHS) + column, degrade(image, distance), label)
    return grid.figure


def made_up() -> Figure:
    """Four pictures of scikit-image, with two made-up maps and what default draws make of each."""
    names, draws = ("coffee", "astronaut", "rocket", "chelsea"), 2
    source = MadeUp()
    augment = RandomUnderwater(distance=source)
    grid = Grid(len(names), 1 + 2 * draws, (2, 3))
    for row, name in enumerate(names):
        image, _ = scene_of(name, 2 * grid.wide)
        grid.show(row * grid.columns, image, name)
        for draw in range(draws):
            generator = torch.Generator().manual_seed(draws * row + draw)
            record = augment.make_params(image, generator)
            numbers = record["samples"][0]["distance"]
            z = source.metres(None, image, numbers)
            place = row * grid.columns + 1 + 2 * draw
            grid.show(place, shown_distance(z), f"{numbers['near']:.1f} to {numbers['far']:.0f} m")
            grid.show(place + 1, augment.transform(image, None, record))
    return grid.figure


def main(quick: bool = False) -> dict[str, Figure]:
    """Draw and save."""
    scene = motorcycle()
    if quick:
        scene = Scene(scene.image[:, ::8, ::8], scene.distance[:, ::8, ::8], 125.0)
    figures = {"systems": systems(scene), "reds": reds(scene), "made-up": made_up()}
    if not quick:
        jobs = (hero, default_draws, detection, restoration, severity, night, film)
        figures |= {job.__name__.replace("_", "-"): job() for job in jobs}
        figures["knobs"] = knobs(*scene_of("reef", 370))
        for name, figure in figures.items():
            print(save(figure, name))
    return figures


if __name__ == "__main__":
    command(main, __doc__)
