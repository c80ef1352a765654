"""Scenes with distances, rendered: what the depth network learns from. Textures are procedural.

Rooms, streets and landscapes, close things, views from above, walls, plain backdrops, open water;
with people, animals, fish, plants, posters and text; haze, shade, defocus and noise as in
photographs. One takes some 40 ms. `python -m benchmarks.depth.scenes --sheet FILE` shows some.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

Array = np.ndarray[Any, Any]
Texture = Callable[[Array], Array]
Rng = np.random.Generator

SHAPES = ((128, 160), (160, 128))
"""Heights and widths: landscape, portrait."""

KINDS = {
    "room": 0.25,
    "outdoors": 0.28,
    "close": 0.16,
    "above": 0.15,
    "wall": 0.06,
    "backdrop": 0.06,
    "water": 0.04,
}
_SHARES = np.array(list(KINDS.values())) / sum(KINDS.values())

_NOISE = np.random.default_rng(0).random((32, 32, 32)).astype(np.float32)

_FARTHEST = 1500.0
"""m; beyond is sky."""

_OPEN_BEHIND = 0.7
"""In the logarithm: how far open water or sky counts behind the farthest thing."""


def noise(points: Array, octaves: int = 4) -> Array:
    """Fractal noise in 0…1 (N), of places in space (Nx3)."""
    total, weight = np.zeros(len(points), np.float32), 0.0
    for octave in range(octaves):
        places = (points * 2.0**octave + 7.3 * octave).T
        total += 0.55**octave * map_coordinates(_NOISE, places, order=1, mode="grid-wrap")
        weight += 0.55**octave
    return np.clip(0.5 + 1.6 * (total / weight - 0.5), 0, 1)


def _hashed(*whole: Array) -> Array:
    """A number in 0…1 for each tuple of whole numbers."""
    mixed = sum(np.sin(127.1 * (k + 1) * part + 3.7 * k) for k, part in enumerate(whole))
    return np.abs(43758.5 * mixed) % 1


def colour(rng: Rng) -> Array:
    """Of a thing: mostly dull, now and then vivid."""
    value = np.exp(rng.normal(-1.0, 0.6))
    hue = rng.normal(size=3)
    return np.clip(value * np.exp(rng.choice([0.1, 0.25, 0.7]) * hue), 0.01, 1)


def texture(rng: Rng, kind: str | None = None) -> Texture:
    """The colours of a surface by place."""
    kinds = ["plain", "noise", "stone", "stripes", "tiles", "bricks", "text", "spots"]
    kind = kind or str(rng.choice(kinds, p=[0.26, 0.26, 0.18, 0.06, 0.07, 0.05, 0.06, 0.06]))
    first, second = colour(rng), colour(rng)
    size = np.exp(rng.uniform(-2.6, 0.3))
    stretch = np.exp(rng.normal(0, 0.7, 3))
    shift = rng.uniform(0, 32, 3)
    dirt, contrast = rng.uniform(0, 0.25), rng.uniform(0.2, 1)
    seed = rng.uniform(0, 50)

    def mixed(share: Array) -> Array:
        return first + contrast * (second - first) * share[:, None]

    def colours(points: Array) -> Array:
        places = points / size
        along, up = places[:, 0] + places[:, 2], places[:, 1] + 0.5 * places[:, 2]
        if kind == "plain":
            base = np.broadcast_to(first, points.shape)
        elif kind == "noise":
            base = mixed(noise(places * stretch + shift))
        elif kind == "stone":
            base = mixed((noise(6 * places + shift, 5) > 0.5) * 0.6 + 0.4 * noise(places + shift))
        elif kind == "stripes":
            base = mixed((np.sin(6.3 * (places @ (stretch / np.linalg.norm(stretch)))) > 0) * 1.0)
        elif kind == "tiles":
            edge = np.minimum(np.abs(along % 1 - 0.5), np.abs(up % 1 - 0.5)) > 0.47
            checks = (np.floor(along) + np.floor(up)) % 2
            base = mixed(np.where(edge, 1.0, checks * (contrast > 0.6)))
        elif kind == "bricks":
            row = np.floor(2 * up)
            column = along + 0.5 * (row % 2)
            mortar = (np.abs(2 * up - row - 0.5) > 0.44) | (np.abs(column % 1 - 0.5) > 0.46)
            base = mixed(np.where(mortar, 1.0, 0.3 * _hashed(row, np.floor(column))))
        elif kind == "text":
            row, letter = np.floor(6 * up), np.floor(14 * along)
            heading = _hashed(np.floor(up / 2) + seed, np.floor(along / 2)) > 0.75
            inked = (_hashed(row + seed, letter) > 0.35) & (6 * up - row > 0.45)
            base = np.where(heading[:, None], colour_of(np.floor(up / 2)), mixed(1.0 * inked))
        else:
            cells = np.floor(places)
            away = np.linalg.norm(places - cells - 0.5, axis=1)
            base = mixed(1.0 * (away < 0.2 + 0.3 * _hashed(*(cells.T + seed))))
        if dirt > 0.08:
            base = base * (1 - dirt + 2 * dirt * noise(3 * points / size + shift))[:, None]
        return base

    def colour_of(cell: Array) -> Array:
        return np.stack([_hashed(cell + seed, np.full_like(cell, k)) for k in range(3)], -1)

    return colours


def turned(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> Array:
    """A rotation, of angles in radians."""
    (cy, cp, cr), (sy, sp, sr) = np.cos([yaw, pitch, roll]), np.sin([yaw, pitch, roll])
    around_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    around_x = np.array([[1, 0, 0], [0, cp, sp], [0, -sp, cp]])
    around_z = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return around_y @ around_x @ around_z


@dataclass
class Thing:
    """A unit ball, box or upright cylinder, stretched, turned and put somewhere."""

    shape: str
    centre: Array
    reach: Array
    texture: Texture
    rotation: Array

    @property
    def radius(self) -> float:
        """Of the ball around it."""
        return float(self.reach.max() if self.shape == "ball" else np.linalg.norm(self.reach))

    def hit(self, eye: Array, rays: Array) -> tuple[Array, Array, Array]:
        """Where rays (Nx3) meet it: how far along (inf: nowhere), normals, places of its own."""
        start = (eye - self.centre) @ self.rotation / self.reach
        towards = rays @ self.rotation / self.reach
        towards = np.where(np.abs(towards) < 1e-9, 1e-9, towards)
        near, far = np.full(len(rays), -np.inf), np.full(len(rays), np.inf)
        slabs = {"ball": [], "box": [0, 1, 2], "cylinder": [1]}[self.shape]
        for axis in slabs:
            ends = (np.array([[-1.0], [1.0]]) - start[axis]) / towards[:, axis]
            near, far = np.maximum(near, ends.min(0)), np.minimum(far, ends.max(0))
        if self.shape != "box":
            axes = [0, 1, 2] if self.shape == "ball" else [0, 2]
            s, t = start[axes], towards[:, axes]
            a, b = (t * t).sum(1), t @ s
            root = b * b - a * (s @ s - 1)
            half = np.sqrt(np.maximum(root, 0)) / a
            near = np.where(root > 0, np.maximum(near, -b / a - half), np.inf)
            far = np.minimum(far, -b / a + half)
        distance = np.where((near < far) & (near > 1e-2), near, np.inf)
        place = start + np.where(np.isfinite(distance), distance, 0)[:, None] * towards
        if self.shape == "ball":
            normal = place / self.reach
        else:
            axis = np.abs(place).argmax(1)
            normal = np.eye(3)[axis] * np.sign(place)
            if self.shape == "cylinder":
                side = np.abs(place[:, 1]) < 0.999
                normal[side] = (place / self.reach * [1, 0, 1])[side]
                normal[~side] = [0, 1, 0] * np.sign(place[~side])
        normal = normal @ self.rotation.T
        normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-9
        return distance, normal, place * self.reach


def _up(height: float) -> Array:
    return np.array([0, height, 0])


def _at(base: Array, yaw: float, *offset: float) -> Array:
    return base + turned(yaw) @ np.array(offset)


def person(rng: Rng, foot: Array, height: float) -> list[Thing]:
    """Somebody who stands, of balls."""
    yaw, h = rng.uniform(0, 6.3), height
    shirt, trousers = texture(rng), texture(rng)
    tone = np.array([0.75, 0.5, 0.38]) * np.exp(rng.normal(-0.2, 0.45))
    hair = np.array([0.2, 0.15, 0.1]) * np.exp(rng.normal(0, 0.8))

    def skin(points: Array) -> Array:
        return np.broadcast_to(tone, points.shape)

    def of_hair(points: Array) -> Array:
        return np.broadcast_to(np.minimum(hair, 1), points.shape)

    straight = turned(yaw)
    parts = [
        ("ball", (0, 0.68, 0), (0.13, 0.19, 0.08), shirt),
        ("ball", (0, 0.9, 0), (0.055, 0.075, 0.06), skin),
        ("ball", (0, 0.93, -0.012), (0.06, 0.06, 0.062), of_hair),
        ("cylinder", (0, 0.83, 0), (0.03, 0.04, 0.03), skin),
    ]
    for side in (-1, 1):
        parts.append(("ball", (side * 0.06, 0.27, 0), (0.055, 0.28, 0.06), trousers))
        parts.append(("ball", (side * 0.15, 0.62, rng.normal(0, 0.03)), (0.035, 0.17, 0.04), shirt))
    return [
        Thing(shape, _at(foot, yaw, *(h * np.array(at))), h * np.array(reach), colours, straight)
        for shape, at, reach, colours in parts
    ]


def animal(rng: Rng, foot: Array, size: float) -> list[Thing]:
    """A body, a head with ears, four legs."""
    yaw, coat, s = (
        rng.uniform(0, 6.3),
        texture(rng, str(rng.choice(["noise", "spots", "plain"]))),
        size,
    )
    leg, neck = rng.uniform(0.15, 0.5), rng.uniform(0, 0.35)
    parts = [
        ("ball", (0, leg + 0.2, 0), (0.22, 0.22, 0.45)),
        ("ball", (0, leg + 0.35 + neck, 0.45), (0.16, 0.16, 0.2)),
        ("ball", (0, leg + 0.3 + neck / 2, 0.38), (0.1, 0.15 + neck / 2, 0.1)),
    ]
    for side in (-1, 1):
        parts.append(("ball", (side * 0.1, leg + 0.53 + neck, 0.42), (0.04, 0.1, 0.03)))
        parts += [
            ("ball", (side * 0.13, leg / 2, z), (0.05, leg / 2 + 0.1, 0.06)) for z in (-0.3, 0.3)
        ]
    return [
        Thing(shape, _at(foot, yaw, *(s * np.array(at))), s * np.array(reach), coat, turned(yaw))
        for shape, at, reach in parts
    ]


def fish(rng: Rng, at: Array, size: float) -> list[Thing]:
    """A flat body and a tail."""
    yaw, coat = (
        rng.uniform(0, 6.3),
        texture(rng, str(rng.choice(["stripes", "plain", "noise", "spots"]))),
    )
    deep = rng.uniform(0.15, 0.6)
    rotation = turned(yaw, rng.normal(0, 0.25))
    body = Thing("ball", at, size * np.array([0.1, deep, 1.0]), coat, rotation)
    tail_at = at + rotation @ np.array([0, 0, -1.15 * size])
    tail = Thing("ball", tail_at, size * np.array([0.03, 0.8 * deep, 0.25]), coat, rotation)
    return [body, tail]


def plant(rng: Rng, foot: Array, size: float) -> list[Thing]:
    """Leaves around a stem, or a crown of balls on a trunk."""
    green = np.array([0.25, 0.42, 0.12]) * np.exp(rng.normal(-0.3, 0.4, 3))
    lively, shift = rng.uniform(0.2, 1), rng.uniform(0, 32, 3)

    def foliage(points: Array) -> Array:
        return np.clip(
            green * (1 - lively + 2 * lively * noise(9 * points / size + shift, 5))[:, None], 0, 1
        )

    trunk = Thing(
        "cylinder",
        foot + _up(0.5 * size),
        size * np.array([0.06, 0.5, 0.06]),
        texture(rng, "noise"),
        turned(0),
    )
    things = [trunk] if rng.uniform() < 0.8 else []
    tree = rng.uniform() < 0.55
    for _ in range(rng.integers(4, 8) if tree else rng.integers(6, 14)):
        away = rng.normal(size=3) * size * (0.3 if tree else 0.25)
        at = foot + _up(size * (1.1 if tree else 0.6)) + away
        reach = size * (
            rng.uniform(0.2, 0.45, 3)
            if tree
            else np.array([0.08, 0.35, 0.012]) * np.exp(rng.normal(0, 0.3))
        )
        things.append(
            Thing("ball", at, reach, foliage, turned(rng.uniform(0, 6.3), rng.normal(0, 0.9)))
        )
    return things


def coral(rng: Rng, foot: Array, size: float) -> list[Thing]:
    """Knobs, fingers or a mound, half in the ground."""
    coat = texture(rng, str(rng.choice(["stone", "noise", "spots"])))
    kind = rng.uniform()
    if kind < 0.4:
        return [
            Thing(
                "ball",
                foot,
                size * np.exp(rng.normal(0, 0.4, 3)),
                coat,
                turned(rng.uniform(0, 6.3)),
            )
        ]
    things = []
    for _ in range(rng.integers(4, 10)):
        away = rng.normal(size=3) * size * [0.5, 0, 0.5]
        reach = size * (np.array([0.1, 0.7, 0.1]) if kind < 0.7 else rng.uniform(0.15, 0.4, 3))
        things.append(
            Thing(
                "ball",
                foot + away + [0, 0.5 * reach[1], 0],
                reach,
                coat,
                turned(rng.uniform(0, 6.3), rng.normal(0, 0.4)),
            )
        )
    return things


def table(rng: Rng, foot: Array, size: float) -> list[Thing]:
    """Legs, a top, perhaps a back, and something on it."""
    yaw, wood, s = rng.uniform(0, 6.3), texture(rng), size * np.exp(rng.normal(0, 0.25, 3))
    things = [Thing("box", foot + _up(2 * s[1]), s * [1, 0.06, 1], wood, turned(yaw))]
    for x in (-0.9, 0.9):
        for z in (-0.9, 0.9):
            at = _at(foot, yaw, x * s[0], s[1], z * s[2])
            things.append(Thing("box", at, s[1] * np.array([0.05, 1, 0.05]), wood, turned(yaw)))
    if rng.uniform() < 0.5:  # a chair
        at = _at(foot, yaw, 0, 3 * s[1], 0.9 * s[2])
        things.append(Thing("box", at, s * [1, 0.9, 0.06], wood, turned(yaw)))
    for _ in range(rng.integers(0, 4)):
        at = _at(
            foot, yaw, rng.uniform(-0.8, 0.8) * s[0], 2.06 * s[1], rng.uniform(-0.8, 0.8) * s[2]
        )
        things += solid(rng, at, 0.2 * size)
    return things


def solid(rng: Rng, foot: Array, size: float) -> list[Thing]:
    """A box, ball or cylinder on the ground."""
    reach = size * np.exp(rng.normal(0, 0.4, 3))
    shape = str(rng.choice(["box", "ball", "cylinder"], p=[0.45, 0.3, 0.25]))
    if shape == "cylinder":
        reach[2] = reach[0]
    sunk = rng.uniform(0.6, 1) if shape == "ball" else 1.0
    at = foot + _up(sunk * reach[1])
    tilt = rng.normal(0, 0.5) if shape == "box" and rng.uniform() < 0.15 else 0.0
    return [Thing(shape, at, reach, texture(rng), turned(rng.uniform(0, 6.3), tilt))]


def anything(rng: Rng, foot: Array, size: float, indoors: bool) -> list[Thing]:
    """Some thing of about `size`, half its width."""
    draw = rng.uniform()
    if draw < 0.45:
        return solid(rng, foot, size)
    if draw < 0.6:
        return person(rng, foot, rng.uniform(1.2, 1.9) if size > 0.2 else 6 * size)
    if draw < 0.7:
        return animal(rng, foot, 1.5 * size)
    if draw < 0.85:
        return table(rng, foot, size) if indoors else plant(rng, foot, 3 * size)
    return plant(rng, foot, 2 * size)


def poster(rng: Rng, wall: Array, yaw: float, thick: float = 0.02) -> Thing:
    """Something flat on a wall: a picture, a sign, a shelf, a door."""
    size = np.exp(rng.normal(-1, 0.6, 2))
    kind = rng.choice(["text", "noise", "plain", "stripes", "spots"], p=[0.4, 0.2, 0.2, 0.1, 0.1])
    return Thing(
        "box", wall, np.array([size[0], size[1], thick]), texture(rng, str(kind)), turned(yaw)
    )


Planes = list[tuple[Array, float, Texture]]


def _rooms_walls(rng: Rng, eye: float) -> tuple[Planes, list[Thing], float, float]:
    """Three walls and a ceiling, what hangs on them, and the room's half width and length."""
    yaw, length, wide = rng.normal(0, 0.5), rng.uniform(1.8, 8), rng.uniform(1.2, 4)
    top = max(rng.uniform(2.2, 3.3), eye + 0.4)
    common = texture(
        rng, str(rng.choice(["plain", "noise", "bricks", "tiles"], p=[0.6, 0.2, 0.1, 0.1]))
    )
    rotation = turned(yaw)
    planes: Planes = [(np.array([0, -1.0, 0]), -top, texture(rng, "plain"))]
    for axis, away in (
        ([0, 0, -1.0], length),
        ([1.0, 0, 0], wide),
        ([-1.0, 0, 0], rng.uniform(0.6, 1.2) * wide),
    ):
        planes.append(
            (rotation @ np.array(axis), -away, common if rng.uniform() < 0.75 else texture(rng))
        )
    things = []
    for _ in range(rng.integers(0, 6)):
        thick = float(rng.choice([0.02, 0.02, 0.15]))
        if rng.uniform() < 0.6:
            at = rotation @ np.array([rng.uniform(-0.8, 0.8) * wide, 0, length - thick])
            things.append(poster(rng, at + _up(rng.uniform(0.7, 2)), yaw, thick))
        else:
            at = rotation @ np.array([-wide + thick, 0, rng.uniform(0.4, 1) * length])
            things.append(poster(rng, at + _up(rng.uniform(0.7, 2)), yaw + np.pi / 2, thick))
    return planes, things, wide, length


def _laid_out(rng: Rng, kind: str, eye: float, pitch: float) -> tuple[Planes, list[Thing]]:
    """What stands where. The ground is at height 0, the camera at `eye`, looking along z."""
    ground = texture(
        rng, str(rng.choice(["plain", "noise", "stone", "tiles"], p=[0.3, 0.35, 0.25, 0.1]))
    )
    planes: Planes = [(np.array([0, 1.0, 0]), 0.0, ground)]
    things: list[Thing] = []

    def put(count: tuple[int, int], near: float, far: float, size: float, indoors: bool) -> None:
        for _ in range(rng.integers(*count)):
            z = np.exp(rng.uniform(np.log(near), np.log(far)))
            foot = np.array([rng.uniform(-0.8, 0.8) * z, 0, z])
            own = size * np.exp(rng.normal(0, 0.6)) * (1 if indoors else 1 + 0.05 * z)
            things.extend(anything(rng, foot, own, indoors))

    walled = kind == "room" or (kind in ("close", "above") and rng.uniform() < 0.45)
    if walled:
        walls, hung, wide, length = _rooms_walls(rng, eye)
        planes += walls
        things += hung
        if kind == "room":
            for _ in range(rng.integers(2, 12)):
                z = rng.uniform(0.8, length)
                x = rng.uniform(-1, 1) * min(wide, 0.8 * z)
                things += anything(rng, np.array([x, 0, z]), rng.uniform(0.12, 0.55), True)
    if kind == "outdoors":
        put((1, 14), 2, 60, 0.5, False)
        if rng.uniform() < 0.4:  # a street
            common, side = texture(rng), rng.uniform(3, 9)
            for sign in (-1, 1):
                z = rng.uniform(3, 10)
                while z < 90 and rng.uniform() < 0.85:
                    half = np.array([rng.uniform(2, 4), rng.uniform(2.5, 9), rng.uniform(3, 7)])
                    own = common if rng.uniform() < 0.4 else texture(rng)
                    at = np.array([sign * (side + half[0]), half[1], z + half[2]])
                    things.append(Thing("box", at, half, own, turned(rng.normal(0, 0.05))))
                    z += 2 * half[2] + rng.exponential(2)
        for _ in range(rng.integers(0, 5)):  # hills
            z = rng.uniform(60, 600)
            at = np.array([rng.uniform(-1, 1) * z, -0.05 * z, z])
            reach = z * np.array([rng.uniform(0.2, 0.8), rng.uniform(0.08, 0.35), 0.2])
            things.append(Thing("ball", at, reach, texture(rng, "noise"), turned(0)))
    if kind == "close":
        for _ in range(rng.integers(1, 4)):
            z = rng.uniform(0.35, 1.5)
            foot = np.array([rng.normal(0, 0.2) * z, 0, z])
            draw = rng.uniform()
            if draw < 0.3:  # a portrait: the head is before the camera
                height = rng.uniform(1.4, 1.9)
                aim = eye + z * np.tan(pitch)
                things += person(rng, foot + _up(aim - 0.87 * height), height)
            elif draw < 0.45:
                things += animal(rng, foot, rng.uniform(0.2, 0.7) * z)
            else:
                things += anything(rng, foot, rng.uniform(0.08, 0.35) * z, True)
        put((0, 7), 1.8, 12, 0.3, walled)
    if kind == "above":
        reef = rng.uniform() < 0.6
        for _ in range(rng.integers(1, 22)):
            foot = np.array([rng.uniform(-1.3, 1.3) * eye, 0, rng.uniform(-0.4, 2.2) * eye])
            size = eye * np.exp(rng.normal(-2.2, 0.6))
            things += coral(rng, foot, size) if reef else solid(rng, foot, size)
        for _ in range(rng.integers(0, 6)):
            at = (
                np.array([rng.uniform(-0.7, 0.7), rng.uniform(0.05, 0.7), rng.uniform(0, 1.5)])
                * eye
            )
            things += fish(rng, at, eye * rng.uniform(0.04, 0.15))
    if kind == "wall":
        yaw, away = rng.normal(0, 0.5), np.exp(rng.uniform(-0.5, 2))
        face = texture(rng)
        planes.append((turned(yaw) @ np.array([0, 0, -1.0]), -away, face))
        for _ in range(rng.integers(1, 12)):
            thick = float(rng.choice([0.01, 0.03, 0.1, 0.3]))
            at = turned(yaw) @ np.array([rng.uniform(-0.8, 0.8) * away, 0, away - thick])
            things.append(poster(rng, at + _up(eye + rng.uniform(-0.6, 0.6) * away), yaw, thick))
        if rng.uniform() < 0.4:
            put((1, 3), 0.5 * away, 0.9 * away, 0.15 * away, True)
    if kind == "backdrop":
        if rng.uniform() < 0.6:
            planes.clear()
        for _ in range(rng.integers(1, 5)):
            z = rng.uniform(0.8, 2.5)
            at = np.array(
                [rng.normal(0, 0.25) * z, 0 if planes else eye + rng.normal(-0.3, 0.2) * z, z]
            )
            things += anything(rng, at, rng.uniform(0.1, 0.3) * z, True)
    if kind == "water":
        for _ in range(rng.integers(1, 16)):
            z = np.exp(rng.uniform(-0.2, 2))
            at = np.array([rng.uniform(-0.7, 0.7) * z, eye + rng.uniform(-0.5, 0.5) * z, z])
            things += fish(rng, at, np.exp(rng.normal(-1.4, 0.6)))
        for _ in range(rng.integers(2, 14)):
            z = np.exp(rng.uniform(0, 2.5))
            things += coral(
                rng, np.array([rng.uniform(-0.8, 0.8) * z, 0, z]), 0.3 * np.exp(rng.normal(0, 0.6))
            )
    return planes, things[:90]


def _sky(rng: Rng, towards: Array, kind: str) -> tuple[Array, Array]:
    """Colours of the open in directions (Nx3), and of the haze before it."""
    palette = [
        ([0.18, 0.36, 0.75], [0.62, 0.76, 0.9], 0.45),  # blue
        ([0.6, 0.65, 0.7], [0.85, 0.87, 0.9], 0.3),  # overcast
        ([0.25, 0.28, 0.5], [0.95, 0.6, 0.35], 0.12),  # sunset
        ([0.95, 0.95, 0.95], [1.0, 1.0, 1.0], 0.08),  # clipped
        ([0.02, 0.03, 0.08], [0.12, 0.1, 0.12], 0.05),  # night
    ]
    top, horizon, _ = palette[int(rng.choice(5, p=[share for *_, share in palette]))]
    if kind == "water":
        top, horizon = [0.15, 0.5, 0.65], [0.04, 0.25, 0.4]
    if kind == "backdrop":
        top = colour(rng) if rng.uniform() < 0.5 else np.full(3, rng.choice([0.02, 0.5, 0.85, 1.0]))
        horizon = np.array(top) * rng.uniform(0.6, 1.3)
    tint = np.exp(rng.normal(0, 0.12, 3))
    top, horizon = np.clip(tint * top, 0, 1), np.clip(tint * horizon, 0, 1)
    up = np.clip(towards[:, 1] * rng.uniform(1.2, 3), 0, 1)[:, None]
    rgb = horizon + (top - horizon) * up
    if kind not in ("water", "backdrop") and rng.uniform() < 0.6:
        places = 3 * towards / (np.abs(towards[:, 1:2]) + 0.25) + rng.uniform(0, 32, 3)
        cover = np.clip(4 * (noise(places, 5) - rng.uniform(0.3, 0.75)), 0, 1)[:, None]
        cover *= rng.uniform(0.3, 1)
        rgb = rgb * (1 - cover) + np.clip(horizon * rng.uniform(0.7, 1.4), 0, 1) * cover
    return rgb, horizon


def scene(rng: Rng, shape: tuple[int, int]) -> tuple[Array, Array, Array]:
    """A picture (HxWx3 bytes), the logarithm of its distances along the axis (HxW, float16; what is
    open lies a little behind all else), and where it is open (HxW).
    """
    while True:
        rgb, log, is_open, owners = _rendered(rng, shape)
        largest = np.bincount(owners.ravel() + 1).max() / owners.size
        if largest < 0.8 or rng.uniform() < 0.1:
            return rgb, log, is_open


def _rendered(rng: Rng, shape: tuple[int, int]) -> tuple[Array, Array, Array, Array]:
    height, width = shape
    kind = str(rng.choice(list(KINDS), p=_SHARES))
    focal = 0.5 * max(shape) / np.tan(np.radians(rng.uniform(36, 80)) / 2)
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, height / 2 - 0.5 - np.arange(height))
    degrees = {
        "room": rng.normal(-10, 12),
        "outdoors": rng.normal(-4, 10),
        "close": rng.normal(-10, 14),
        "above": rng.uniform(-90, -40),
        "wall": rng.normal(0, 10),
        "backdrop": rng.normal(-4, 8),
        "water": rng.normal(0, 18),
    }[kind]
    pitch = np.radians(degrees)
    looking = turned(0, pitch, np.radians(rng.normal(0, 4)))
    # their part along the axis is 1, so that what they count is distance along the axis
    rays = np.stack([x / focal, y / focal, np.ones_like(x)], -1).reshape(-1, 3) @ looking.T
    heights = {
        "room": rng.uniform(0.7, 1.9),
        "outdoors": np.exp(rng.uniform(-0.6, 1.4)),
        "close": rng.uniform(0.12, 0.9),
        "above": np.exp(rng.uniform(-1, 1)),
        "wall": rng.uniform(0.8, 1.8),
        "backdrop": rng.uniform(0.3, 1.2),
        "water": np.exp(rng.uniform(-0.5, 1.2)),
    }
    eye = np.array([0, heights[kind], 0])
    planes, things = _laid_out(rng, kind, eye[1], pitch)

    count = len(rays)
    distance, owner = np.full(count, np.inf), np.full(count, -1)
    normal, place = np.zeros((count, 3)), np.zeros((count, 3))
    for number, (facing, offset, _) in enumerate(planes):
        slope = rays @ facing
        along = (offset - eye @ facing) / np.where(slope < -1e-9, slope, -1e-9)
        nearer = (slope < -1e-9) & (along > 1e-2) & (along < distance)
        distance[nearer], owner[nearer], normal[nearer] = along[nearer], number, facing
    directions = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    for number, thing in enumerate(things, len(planes)):
        offset = thing.centre - eye
        away = np.linalg.norm(offset)
        if thing.radius >= away:
            continue
        candidates = np.flatnonzero(
            directions @ (offset / away) > np.sqrt(1 - (thing.radius / away) ** 2)
        )
        if not candidates.size:
            continue
        along, facing, own = thing.hit(eye, rays[candidates])
        nearer = along < distance[candidates]
        chosen = candidates[nearer]
        distance[chosen], owner[chosen] = along[nearer], number
        normal[chosen], place[chosen] = facing[nearer], own[nearer]
    distance[distance > _FARTHEST] = np.inf
    owner[np.isinf(distance)] = -1
    points = eye + np.where(np.isfinite(distance), distance, 0)[:, None] * rays
    flat = (owner >= 0) & (owner < len(planes))
    place[flat] = points[flat]

    rgb, haze = _sky(rng, directions, kind)
    light = _lit(rng, points, normal, owner, things, len(planes), kind)
    textures = [surface for *_, surface in planes] + [thing.texture for thing in things]
    for number in np.unique(owner[owner >= 0]):
        own = owner == number
        rgb[own] = np.clip(textures[number](place[own]), 0, 1) * light[own]
    is_open = owner < 0
    if kind in ("outdoors", "water") or (kind == "close" and rng.uniform() < 0.2):
        reach = np.exp(rng.uniform(0.7, 2.5) if kind == "water" else rng.uniform(2.5, 7))
        clear = np.exp(-np.where(is_open, 0, distance) / reach)[:, None]
        rgb = rgb * clear + haze * (1 - clear)
    elif rng.uniform() < 0.5:  # a lamp or a flash
        lamp = (
            np.array([rng.normal(), rng.uniform(0.8, 2.2), rng.uniform(0, 3)])
            if rng.uniform() < 0.7
            else eye
        )
        squares = ((points - lamp) ** 2).sum(1) / np.median(((points - lamp) ** 2).sum(1)).clip(
            1e-3
        )
        fading = 1 / (0.6 + rng.uniform(0.1, 0.6) * squares)
        rgb = rgb * np.where(is_open, 1, fading)[:, None]
    log = np.log(np.maximum(np.where(is_open, 1.0, distance), 0.03))
    farthest = np.percentile(log[~is_open], 99.5) if (~is_open).any() else 0.0
    log = np.where(is_open, farthest + _OPEN_BEHIND, np.minimum(log, farthest + 0.5))
    picture = _photographed(rng, rgb.reshape(height, width, 3), log.reshape(shape), kind)
    return (
        picture,
        log.reshape(shape).astype(np.float16),
        is_open.reshape(shape),
        owner.reshape(shape),
    )


def _lit(
    rng: Rng, points: Array, normal: Array, owner: Array, things: list[Thing], first: int, kind: str
) -> Array:
    """The light on each point (Nx3): a sun or a lamp with soft shadows, and the sky's."""
    towards = np.array([rng.normal(), rng.uniform(0.4, 1.8), rng.normal(-0.4, 1)])
    towards /= np.linalg.norm(towards)
    ambient = rng.uniform(0.25, 0.85)
    direct = np.maximum(normal @ towards, 0)
    if rng.uniform() < 0.8:
        deep = rng.uniform(0.3, 0.9)
        for number, thing in enumerate(things[:50], first):
            offset = thing.centre - points
            along = offset @ towards
            radius = float(thing.reach.mean())
            aside = np.sqrt(np.maximum((offset * offset).sum(1) - along * along, 0)) / radius
            shaded = np.clip((1.3 - aside) / 0.6, 0, 1) * (along > 0) * (owner != number)
            direct = direct * (1 - deep * shaded)
    contact = rng.uniform(0.1, 0.5) * np.exp(
        -np.abs(points[:, 1]) / (0.4 if kind == "outdoors" else 0.1)
    )
    contact = 1 - contact * (owner >= first)
    upward = 0.75 + 0.25 * normal[:, 1]
    warm = np.exp(rng.normal(0, 0.06, 3))
    shade = (ambient * upward * contact)[:, None] + ((1 - ambient) * direct)[:, None] * warm
    return np.asarray(1.3 * shade)


def _photographed(rng: Rng, rgb: Array, log: Array, kind: str) -> Array:
    """Defocus, exposure, colour of the light, vignette, blur and noise; bytes."""
    if rng.uniform() < (0.6 if kind in ("close", "backdrop") else 0.25):
        focus = np.percentile(log, rng.choice([5, 20, 50, 90]))
        blur = np.minimum(np.abs(1 - np.exp(focus - log)) * rng.uniform(0.5, 5), 6)
        sharp, below = rgb, 0.0
        for sigma in (0.8, 1.6, 3.0, 6.0):
            share = np.clip((blur - below) / (sigma - below), 0, 1)[..., None]
            rgb = rgb * (1 - share) + gaussian_filter(sharp, (sigma, sigma, 0)) * share
            below = sigma
    rgb = (
        rgb
        * rng.uniform(0.6, 1.3)
        / (np.percentile(rgb, 95) + 0.05)
        * np.exp(rng.normal(0, 0.07, 3))
    )
    y, x = np.mgrid[-1 : 1 : rgb.shape[0] * 1j, -1 : 1 : rgb.shape[1] * 1j]
    rgb = rgb * (1 - rng.uniform(0, 0.25) * (x * x + y * y) / 2)[..., None]
    rgb = np.clip(rgb, 0, 1) ** rng.uniform(0.5, 1.0)
    sigma = rng.uniform(0, 0.7)
    rgb = gaussian_filter(rgb, (sigma, sigma, 0)) + rng.normal(0, rng.uniform(0, 0.02), rgb.shape)
    return (255 * np.clip(rgb, 0, 1)).astype(np.uint8)


def sheet(path: Path, seed: int, rows: int = 8, columns: int = 6) -> None:
    """Scenes, each with its map (white is near, blue is open)."""
    from PIL import Image

    rng, cells = np.random.default_rng(seed), []
    for _ in range(rows * columns):
        rgb, log, is_open = scene(rng, SHAPES[0])
        solid_log = log[~is_open] if (~is_open).any() else log
        nearness = 1 - np.clip((log - solid_log.min()) / (np.ptp(solid_log) + 1e-3), 0, 1)
        shown = np.repeat((255 * nearness)[..., None], 3, -1).astype(np.uint8)
        shown[is_open] = [40, 80, 200]
        cells.append(np.concatenate([rgb, shown], 1))
    lines = [np.concatenate(cells[k * columns : (k + 1) * columns], 1) for k in range(rows)]
    Image.fromarray(np.concatenate(lines)).save(path)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sheet", type=Path, required=True, help="the picture to write")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    sheet(arguments.sheet, arguments.seed)
