"""A reef as if the sea had left it, with its distances: rocks, corals and fish over sand, of our
own. Relief and colours are noise; grain is scikit-image's gravel (CC0).
"""

from functools import cache

import numpy as np
import torch
from scipy.ndimage import gaussian_filter, map_coordinates
from skimage import data
from torch import Tensor

from benchmarks.depth.scenes import Array, Rng, Thing, turned
from uwaug.formation.colour import linear_to_srgb

SIDE = 14.0  # m of ground, ahead and across
CELLS = 1100
VIEW = 62.0  # degrees
EYE = np.array([0.0, 1.25, 0.2])  # m: right, up, ahead
PITCH = -15.0  # degrees
SUN = np.array([-0.55, 0.7, -0.3]) / np.linalg.norm([-0.55, 0.7, -0.3])

ROCK = (0.24, 0.21, 0.17)
ALGAE = (0.22, 0.25, 0.08)
CRUSTS = ((0.45, 0.2, 0.24), (0.55, 0.24, 0.08), (0.27, 0.18, 0.3), (0.5, 0.46, 0.3))
SAND = (0.6, 0.52, 0.4)
YELLOW = (0.85, 0.55, 0.06)
FISH = 12


def _fractal(rng: Rng, slope: float, lowest: int) -> Array:
    """Noise over the ground, standardised; the power falls with the frequency to `slope`."""
    rows, columns = np.fft.fftfreq(CELLS)[:, None], np.fft.rfftfreq(CELLS)[None]
    frequency = np.maximum(CELLS * np.hypot(rows, columns), 1)
    spectrum = np.fft.rfft2(rng.normal(size=(CELLS, CELLS))) * frequency ** (-slope / 2)
    values = np.fft.irfft2(spectrum * (frequency > lowest), s=(CELLS, CELLS))
    return np.asarray(values / values.std())


def _ground(rng: Rng) -> tuple[Array, Array, Array, Array, Array]:
    """Heights, m, and whether rock lies there (CELLSxCELLS); linear colours of rock and of sand,
    and the light on them (CELLSxCELLSx3).
    """
    z, x = np.mgrid[0 : SIDE : CELLS * 1j, -SIDE / 2 : SIDE / 2 : CELLS * 1j]
    wide = _fractal(rng, 4, 1)
    sand = 0.06 * wide + 0.02 * np.sin(2 * np.pi * (3.5 * z + 0.8 * x + 0.5 * _fractal(rng, 4, 2)))
    bumps = _fractal(rng, 3.2, 8)
    rock = np.full_like(sand, -1.0)
    for _ in range(46):
        across, ahead = rng.uniform(-6, 6), rng.uniform(2, 13)
        if abs(across) < 0.6 and ahead < 3.5:
            continue
        radius = np.exp(rng.normal(-0.35, 0.5))
        turn = rng.uniform(0, np.pi)
        u = (x - across) * np.cos(turn) + (z - ahead) * np.sin(turn)
        v = (z - ahead) * np.cos(turn) - (x - across) * np.sin(turn)
        away = np.hypot(u / radius, v / (0.65 * radius)) + 0.12 * wide + 0.1 * bumps
        rise = radius * rng.uniform(0.5, 1.0)
        rock = np.maximum(rock, rise * np.maximum(1 - away**2, 0) ** 0.7 - 0.05)
    relief = _fractal(rng, 3.4, 6)
    rock = np.where(rock > -0.04, rock + 0.05 * relief + 0.005 * _fractal(rng, 2.2, 60), -1)
    stone = rock > sand
    grain = data.gravel() / 255.0

    def grained(metres: float) -> Array:
        scale = len(grain) / metres
        return np.asarray(
            map_coordinates(grain, [z * scale, x * scale], order=1, mode="grid-wrap")
        )[..., None]

    colours = np.asarray(ROCK) * (0.3 + 1.4 * grained(0.9)) * np.exp(0.25 * relief[..., None])
    algae = np.clip(1.2 * (_fractal(rng, 3, 6) + 0.4), 0, 0.9)[..., None]
    colours += algae * (np.asarray(ALGAE) * (0.2 + 1.6 * grained(0.5)) - colours)
    for crust in CRUSTS:
        share = np.clip(3 * (_fractal(rng, 2.6, 20) - 1.5), 0, 0.95)[..., None]
        colours += share * (np.asarray(crust) * (0.4 + 1.2 * grained(0.6)) - colours)
    bed = np.asarray(SAND) * (0.7 + 0.5 * grained(1.2))
    height = np.where(stone, rock, sand)
    return height, stone, colours, bed * np.ones_like(colours), _light(height)


def _light(height: Array) -> Array:
    """The sun with soft shadows, and the sky where it is not hidden."""
    cell = SIDE / CELLS
    rise = np.gradient(gaussian_filter(height, 1.5), cell)
    normal = np.stack([-rise[1], np.ones_like(height), -rise[0]], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    rows, columns = np.mgrid[:CELLS, :CELLS].astype(float)
    sun = np.clip(normal @ SUN, 0, 1)
    for step in np.geomspace(0.02, 2.5, 24):
        places = [rows + SUN[2] * step / cell, columns + SUN[0] * step / cell]
        above = map_coordinates(height, places, order=1, mode="nearest") - height - SUN[1] * step
        sun = np.minimum(sun, np.clip(0.5 - above / (0.08 * step + 0.01), 0, 1))
    hidden = sum(np.maximum(gaussian_filter(height, width) - height, 0) for width in (6, 15, 40))
    sky = np.clip(1 - 2.2 * np.asarray(hidden), 0.2, 1) * (0.6 + 0.4 * normal[..., 1])
    return np.asarray(
        sun[..., None] * np.array([1.15, 1.05, 0.9]) + 0.35 * sky[..., None] * [0.85, 0.95, 1.15]
    )


def _school(rng: Rng) -> list[Thing]:
    """Fish, each a body and a tail, from 1.7 to 6 m away."""
    things = []
    for number in range(FISH):
        ahead = 1.7 + 4.3 * number / (FISH - 1)
        place = np.array([0.22 * ahead * rng.normal(0.3, 0.8), rng.uniform(0.75, 1.35), ahead])
        size, rotation = rng.uniform(0.05, 0.075), turned(rng.normal(1.7, 0.3), rng.normal(0, 0.1))

        def coat(points: Array, size: float = size) -> Array:
            along, up = points[:, 2:] / size, points[:, 1:2] / size
            stripe = np.abs(along - 0.62) < 0.07
            return np.asarray(np.where(stripe, 0.03, np.array(YELLOW) * (0.8 - 0.7 * up)))

        things.append(Thing("ball", place, size * np.array([0.13, 0.5, 1.0]), coat, rotation))
        tail = place + rotation @ np.array([0, 0, -1.15 * size])
        things.append(Thing("ball", tail, size * np.array([0.03, 0.4, 0.28]), coat, rotation))
    return things


@cache
def reef(width: int = 720, seed: int = 5) -> tuple[Tensor, Tensor, Tensor]:
    """The picture (3xHxW, sRGB), metres along the ray (1xHxW), +inf where it is open, and a box
    for each fish (Nx4, corners in px).
    """
    height = 2 * width // 3
    rng = np.random.default_rng(seed)
    heights, stone, rocks, bed, shade = _ground(rng)
    focal = 0.5 * width / np.tan(np.radians(VIEW) / 2)
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, height / 2 - 0.5 - np.arange(height))
    rays = np.stack([x / focal, y / focal, np.ones_like(x)], -1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays = rays @ turned(0, np.radians(PITCH)).T

    def at(points: Array, values: Array) -> Array:
        places = [points[:, 2], points[:, 0] + SIDE / 2]
        scale = (CELLS - 1) / SIDE
        return np.asarray(
            map_coordinates(values, [scale * p for p in places], order=1, mode="nearest")
        )

    distance, moving = np.full(len(rays), 0.3), np.arange(len(rays))
    for _ in range(300):
        points = EYE + distance[moving, None] * rays[moving]
        gap = points[:, 1] - at(points, heights)
        moving, gap = moving[gap > 0.001], gap[gap > 0.001]
        distance[moving] += np.clip(0.4 * gap, 0.002, 0.3)
        moving = moving[distance[moving] < SIDE]
    points = EYE + distance[:, None] * rays
    gone = (
        (points[:, 2] > SIDE - 0.1) | (np.abs(points[:, 0]) > SIDE / 2 - 0.1) | (distance >= SIDE)
    )
    distance[gone] = np.inf
    slanted = points + points[:, 1:2] * np.array([0.8, 0, 0.6])  # else grain stretches down a face
    share = at(points, stone.astype(float))[:, None]
    light = np.stack(
        [
            at(slanted, rocks[..., k]) * share[:, 0] + at(points, bed[..., k]) * (1 - share[:, 0])
            for k in range(3)
        ],
        -1,
    )
    light *= np.stack([at(points, shade[..., k]) for k in range(3)], -1)
    light[gone] = np.array([0.45, 0.62, 0.85])
    owner = np.full(len(rays), -1)
    for number, thing in enumerate(_school(rng)):
        along, normal, place = thing.hit(EYE, rays)
        nearer = along < distance
        lit = 0.45 + 0.8 * np.clip(normal[nearer] @ SUN, 0, 1)
        light[nearer] = thing.texture(place[nearer]) * lit[:, None]
        distance[nearer], owner[nearer] = along[nearer], number // 2
    boxes = []
    for number in np.unique(owner[owner >= 0]):
        rows, columns = np.nonzero(owner.reshape(height, width) == number)
        boxes.append([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
    linear = torch.from_numpy(light.clip(0, 1).astype(np.float32).reshape(height, width, 3))
    image = linear_to_srgb(linear).permute(2, 0, 1)
    metres = torch.from_numpy(distance.astype(np.float32).reshape(1, height, width))
    return image, metres, torch.tensor(np.array(boxes), dtype=torch.float32)
