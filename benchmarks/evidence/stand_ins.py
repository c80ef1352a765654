"""Made-up pictures in the layout of the public sets, so that all can be tried without them."""

from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.evidence import sets
from benchmarks.evidence.sets import AQUARIA, BUOYS, LAND, WILD
from benchmarks.evidence.tasks import COLOURS, Array, painted_balls

PICTURES = 12
"""Of land, of each colour of buoys, of aquaria, of DeepFish."""

FJORD_PICTURES = 72
"""A film of 66, and the beginning of the next."""

BAR = 24
"""px: rows of black above and below what is wild."""


def made(data: Path) -> sets.Sets:
    """Sets of made-up pictures, which are written to a folder; two are shown, for `like`'s sake."""
    write(data)
    cut = sets.cut(data)
    return cut._replace(references={name: shown[:2] for name, shown in cut.references.items()})


def write(data: Path) -> None:
    """Land of coloured patches, balls in a cyan haze, and pale ellipses in noise for fish."""
    rng = np.random.default_rng(0)
    land = [patches(rng) for _ in range(PICTURES)]
    for index, picture in enumerate(land):
        save(picture, data / LAND / f"BSDS500/data/images/train/{index}.jpg")
    pool = painted_balls(land, len(COLOURS) * PICTURES, rng)
    cyan = np.array([0.1, 0.6, 0.65])
    for index, (ball, label) in enumerate(zip(pool.images, pool.labels, strict=True)):
        number = 510 + 30 * index  # three of them are called rendered
        pixels = 0.6 * ball.permute(1, 2, 0).numpy() + 0.4 * cyan
        save(np.kron(pixels, np.ones((2, 2, 1))), data / BUOYS / f"Images/{number}.jpg")
        corners = "<xmin>20</xmin><ymin>20</ymin><xmax>76</xmax><ymax>76</ymax>"
        name = f"<name>buoy_{COLOURS[int(label)]}</name>"
        thing = f"<object>{name}<bndbox>{corners}</bndbox></object>"
        written(data / BUOYS / f"Annotations/{number}.xml", f"<annotation>{thing}</annotation>")
    for number in range(PICTURES):
        tank = data / AQUARIA / "aquarium_pretrain/train"
        labelled(fish(rng), tank, "{}", f"IMG_{number}", "0346"[number % 4])
        place = (7117, 7268, 7426, 7393)[number // 3]
        name = f"{place}_F1_f{number:06d}_jpg"
        labelled(letterboxed(fish(rng)), data / WILD / "datasets", "{}/val", name, "0")
    for number in range(FJORD_PICTURES):
        part = data / WILD / "datasets/fish4knowledge" / ("test", "train", "valid")[number % 3]
        labelled(letterboxed(fish(rng)), part, "{}", f"{number}_jpg", "0")


def labelled(pixels: Array, folder: Path, parts: str, name: str, kind: str) -> None:
    """A picture with the box of its fish, in YOLO's layout."""
    save(pixels, folder / parts.format("images") / f"{name}.jpg")
    bar = (len(pixels) - 160) // 2  # px
    y, height = (bar + 0.3 * 160) / len(pixels), 0.15 * 160 / len(pixels)
    written(folder / parts.format("labels") / f"{name}.txt", f"{kind} 0.25 {y} 0.2 {height}\n")


def patches(rng: np.random.Generator) -> Array:
    """Blocks of colour (144x192x3)."""
    return np.kron(rng.uniform(0, 1, (9, 12, 3)), np.ones((16, 16, 1)))


def fish(rng: np.random.Generator) -> Array:
    """An ellipse at a quarter of the width, in blue noise (160x240x3)."""
    y, x = np.mgrid[:160, :240]
    body = np.hypot((x - 60) / 24, (y - 48) / 12) < 1
    water = np.array([0.1, 0.4, 0.5]) + rng.normal(0, 0.05, (160, 240, 3))
    return np.where(body[..., None], [0.7, 0.7, 0.6], water)


def letterboxed(pixels: Array) -> Array:
    """With black rows above and below."""
    return np.pad(pixels, ((BAR, BAR), (0, 0), (0, 0)))


def save(pixels: Array, path: Path) -> None:
    """A picture of 0…1."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.uint8(255 * np.clip(pixels, 0, 1))).save(path, quality=92)


def written(path: Path, text: str) -> None:
    """A file of labels."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
