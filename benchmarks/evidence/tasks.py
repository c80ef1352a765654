"""What nets are trained on: painted balls in photographs of land, and crops of fish; and distances.

Paint, light and sizes of the balls were chosen by eye after looking at the buoys, alike for all
arms. A ball has a distance of its own, `MadeUp` gives the rest; half of the balls hang before open
water, a quarter before a horizon, a quarter before things.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug.distance import MadeUp

SIDE = 48
"""Pixels of the side of a crop."""

COLOURS = ("red", "yellow", "green")
HUES = {"red": (-0.03, 0.03), "yellow": (0.12, 0.17), "green": (0.27, 0.42)}
"""Of the paint, of 0…1."""

SATURATION, VALUE = (0.6, 1.0), (0.45, 1.0)
"""Of each paint, of 0…1."""

BALL_DISTANCES = (0.8, 8.0)
"""m."""

FARTHEST = 50.0
"""m: what is farther than one sees in any water is open water."""

Array = np.ndarray[Any, Any]


class Pool(NamedTuple):
    """Crops that a net is trained on, in air or as they are."""

    images: Tensor  # Nx3x48x48, 0…1
    distances: Tensor  # Nx1x48x48, m, +inf for open water
    labels: Tensor  # N


def painted_balls(
    photographs: Sequence[Array],
    count: int,
    rng: np.random.Generator,
) -> Pool:
    """Scenes of one ball each."""
    images, distances = [], []
    labels = np.arange(count) % len(COLOURS)
    for label in labels:
        behind = square_of(photographs[rng.integers(len(photographs))], rng)
        far = np.exp(rng.uniform(*np.log(BALL_DISTANCES)))
        y, x = np.mgrid[:SIDE, :SIDE] + 0.5
        radius, (middle_y, middle_x) = rng.uniform(9, 14), SIDE / 2 + rng.uniform(-4, 4, 2)
        right, down = (x - middle_x) / radius, (y - middle_y) / radius
        from_middle = np.hypot(right, down)
        ball = _shaded(_paint(COLOURS[label], rng), right, down, rng)
        cover = np.clip((1 - from_middle) * radius + 0.5, 0, 1)
        images.append(cover[..., None] * ball + (1 - cover[..., None]) * behind)
        around = _distances_behind(behind, far, y, rng)
        distances.append(np.where(from_middle < 1, far, around))
    pictures = torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2).float()
    metres = torch.from_numpy(np.stack(distances)).float()[:, None]
    return Pool(pictures.contiguous(), metres, torch.from_numpy(labels))


def square_of(photograph: Array, rng: np.random.Generator) -> Array:
    """A square somewhere in a photograph (HxWx3, 0…1) at 48x48 px: every so many pixels' mean."""
    step = int(rng.integers(1, min(photograph.shape[:2]) // SIDE + 1))
    side = step * SIDE
    top, left = (int(rng.integers(0, n - side + 1)) for n in photograph.shape[:2])
    square = photograph[top : top + side, left : left + side]
    return square.reshape(SIDE, step, SIDE, step, 3).mean((1, 3))


def _paint(colour: str, rng: np.random.Generator) -> Array:
    """Linear light that a paint sends back, of the light that falls on it."""
    from skimage.color import hsv2rgb

    hue = rng.uniform(*HUES[colour]) % 1
    srgb = hsv2rgb([hue, rng.uniform(*SATURATION), rng.uniform(*VALUE)])
    return np.asarray(srgb) ** 2.2


def _shaded(paint: Array, right: Array, down: Array, rng: np.random.Generator) -> Array:
    """A ball in sRGB (48x48x3), lit from above, more or less from the front, and by all around."""
    ahead = np.sqrt(np.clip(1 - right**2 - down**2, 0, 1))
    light = np.array([rng.normal(0, 0.4), -1.0, rng.uniform(0, 1.5)])
    light /= np.linalg.norm(light)
    lit = np.clip(light[0] * right + light[1] * down + light[2] * ahead, 0, 1)
    ambient = rng.uniform(0.25, 0.6)
    return np.clip((ambient + (1 - ambient) * lit)[..., None] * paint, 0, 1) ** (1 / 2.2)


def _distances_behind(behind: Array, far: float, y: Array, rng: np.random.Generator) -> Array:
    """Distances of what is behind a ball (48x48, m), never nearer than the ball."""
    kind = rng.uniform()
    if kind < 0.5:
        return np.full(behind.shape[:2], np.inf)
    if kind < 0.75:  # a ground up to a horizon, open water above
        horizon = rng.uniform(0.2, 0.8) * SIDE
        below = np.maximum(y - horizon, 1e-9)
        ground = far * rng.uniform(0.8, 2.0) * (SIDE - horizon) / below
        return np.where((y > horizon) & (ground < FARTHEST), np.maximum(ground, far), np.inf)
    return np.maximum(made_up(torch.from_numpy(behind).permute(2, 0, 1).float(), rng), far)


def made_up(image: Tensor, rng: np.random.Generator) -> Array:
    """`MadeUp` distances of a picture (HxW, m), from a generator of numpy."""
    source = MadeUp(near=(0.7, 1.8), far=(2.5, 8.0))
    numbers = {name: rng.uniform(*ends) for name, ends in source.ranges().items()}
    return source.metres(None, image, numbers)[0].numpy()


def fish_pool(images: Array, labels: Array, rng: np.random.Generator) -> Pool:
    """Crops (Nx48x48x3, uint8), with distances that step at an ellipse in their middle, whether a
    fish is there or not: a step in crops with fish alone would be a label that the water shows.
    """
    pictures = torch.from_numpy(images).permute(0, 3, 1, 2).float().div(255).contiguous()
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5 - SIDE / 2
    distances = []
    for picture in pictures:
        z = made_up(picture, rng)
        height, width = rng.uniform(0.2, 0.35, 2) * SIDE
        inside = np.hypot(y / height, x / width) < 1
        solid = z[np.isfinite(z)]
        nearest = np.percentile(solid, 20) if solid.size else 3.0
        distances.append(np.where(inside, nearest * rng.uniform(0.6, 1.0), z))
    metres = torch.from_numpy(np.stack(distances)).float()[:, None]
    return Pool(pictures, metres, torch.from_numpy(labels))
