"""Made-up pictures in the layout of the public sets, so that all can be tried without them."""

from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.evidence.sets import AQUARIA, BUOYS, LAND, WILD
from benchmarks.evidence.tasks import COLOURS, Array, painted_balls

PICTURES = 12
"""Of each set."""


def write(data: Path) -> None:
    """Land of coloured patches, balls in a cyan haze, and pale ellipses in noise for fish."""
    rng = np.random.default_rng(0)
    land = [patches(rng) for _ in range(PICTURES)]
    for index, picture in enumerate(land):
        save(picture, data / LAND / f"BSDS500/data/images/train/{index}.jpg")
    pool, _ = painted_balls(land, 3 * PICTURES, rng)
    cyan = np.array([0.1, 0.6, 0.65])
    for number, (ball, label) in enumerate(zip(pool.images, pool.labels, strict=True)):
        pixels = 0.6 * ball.permute(1, 2, 0).numpy() + 0.4 * cyan
        save(np.kron(pixels, np.ones((2, 2, 1))), data / BUOYS / f"Images/{100 * number}.jpg")
        corners = "<xmin>20</xmin><ymin>20</ymin><xmax>76</xmax><ymax>76</ymax>"
        name = f"<name>buoy_{COLOURS[int(label)]}</name>"
        thing = f"<object>{name}<bndbox>{corners}</bndbox></object>"
        note = data / BUOYS / f"Annotations/{100 * number}.xml"
        note.parent.mkdir(parents=True, exist_ok=True)
        note.write_text(f"<annotation>{thing}</annotation>")
    for folder in (
        AQUARIA + "/aquarium_pretrain/train/{}/{}",
        WILD + "/datasets/{}/test/{}",
        WILD + "/datasets/fish4knowledge/test/{}/{}",
    ):
        for number in range(PICTURES):
            name = f"{7000 + number // 4}_F1_f{number:06d}_jpg"
            save(fish(rng), data / folder.format("images", f"{name}.jpg"))
            label = data / folder.format("labels", f"{name}.txt")
            label.parent.mkdir(parents=True, exist_ok=True)
            label.write_text("0 0.25 0.3 0.2 0.15\n")


def patches(rng: np.random.Generator) -> Array:
    """Blocks of colour (144x192x3)."""
    return np.kron(rng.uniform(0, 1, (9, 12, 3)), np.ones((16, 16, 1)))


def fish(rng: np.random.Generator) -> Array:
    """An ellipse at a quarter of the width, in blue noise (160x240x3)."""
    y, x = np.mgrid[:160, :240]
    body = np.hypot((x - 60) / 24, (y - 48) / 12) < 1
    water = np.array([0.1, 0.4, 0.5]) + rng.normal(0, 0.05, (160, 240, 3))
    return np.where(body[..., None], [0.7, 0.7, 0.6], water)


def save(pixels: Array, path: Path) -> None:
    """A picture of 0…1."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.uint8(255 * np.clip(pixels, 0, 1))).save(path, quality=92)
