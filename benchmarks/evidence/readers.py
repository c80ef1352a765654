"""Does water in training help a small net that reads markers? `benchmarks.evidence.markers` asks.

Boards with AprilTags are pasted into photographs in air, as each arm degrades them, and seen
through the camera of the other tasks. A net is told where a tag is and says which of the 30 it is.
It is scored on tags of a film under water.

All arms have the same boards, made-up distances, places, order and steps. Those that are shown
underwater pictures get five frames of the film, without labels: no arm is scored on these five.
"""

import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from benchmarks.evidence.arms import ARMS, DEFAULTS, Arm, through_camera
from benchmarks.evidence.detector import Scene, made
from benchmarks.evidence.net import compared, logits, resampled_units, trained
from benchmarks.evidence.tasks import SIDE, Array, made_up

SIZE = (384, 288)
"""px: at which photographs and frames are seen. Tags of the film have sides of 25 to 34 px there.
"""

IDS = 30  # of AprilTag 16h5
BOARDS = {"count": 6, "low": 20, "high": 60}  # of a photograph; px of the sides of tags
RIM = 136 / 96  # the side of a board, of its tag's
FARTHEST = 3.0  # m, of a board
AROUND = 1.6  # the side of a crop, of its tag's
SCALES = (0.8, 1.25)  # times that, in training
SHIFT = 0.1  # of the side of a crop, in training
VIEWS = 2  # of each tag, turned anyhow
DRAWS = 3  # of each photograph, each with boards of its own
OTHER = 1000  # seed of the boards of a test, which no net is trained by

PLACES = 3  # a side, of what convolutions leave
STEPS = 2000
RATES = (6e-3, 1e-2)
RATE = RATES[-1]
"""Chosen by the dry arm on boards in land/val: .947 of tags (6e-3: .940). With means over all of a
crop, and 2e-2, it had hardly less, but when that net was trained for ten arms, those of
`RandomUnderwater()` and `uwaug.like` read .04 of boards in air, no more than by chance: so places
are kept. Nothing was chosen by what nets read of the film. With 2000 steps wet arms are not at
their end.
"""

FAINT = 20
"""Levels of contrast below which a tag is faint."""


class Tag(NamedTuple):
    """A marker in a picture."""

    block: str
    contrast: float  # levels
    side: float  # px
    is_read: bool  # by OpenCV
    name: int
    quad: Array  # 4x2: corners, px


def scenes_of(
    kit: Any, photographs: Sequence[Array], seed: int
) -> tuple[list[Scene], list[Tensor]]:
    """Photographs with boards, and distances (1xHxW, m): a board lies upon the nearest fifth of
    what it covers, but never beyond `FARTHEST`.
    """
    rng, scenes, maps = np.random.default_rng(seed), [], []
    for photograph in [*photographs] * DRAWS:
        small = cv2.resize(photograph, SIZE, interpolation=cv2.INTER_AREA)
        air, quads, names = kit.tag_scene(small, rng, ids=range(IDS), **BOARDS)
        small, air = (torch.from_numpy(x).permute(2, 0, 1) / 255 for x in (small, air))
        distance = made_up(small, rng)
        for quad in quads:
            middle = quad.mean(0)
            board = (middle + RIM * (quad - middle)).round().astype(np.int32)
            covered = cv2.fillConvexPoly(np.zeros(distance.shape, np.uint8), board, 1) > 0
            distance[covered] = np.percentile(distance[covered].clip(max=FARTHEST), 20)
        scenes.append(Scene(air, torch.from_numpy(squares(quads)), torch.from_numpy(names)))
        maps.append(torch.from_numpy(distance).float()[None])
    return scenes, maps


def squares(quads: Array) -> Array:
    """Upright squares (Nx4: left, top, right, bottom) in the middles of tags, of their sides."""
    middles = quads.mean(1)
    sides = np.linalg.norm(quads - np.roll(quads, 1, 1), axis=2).mean(1, keepdims=True)
    return np.concatenate([middles - sides / 2, middles + sides / 2], 1)


def crop(picture: Array, square: Array, scale: float = 1, turn: float = 0, shift: Any = 0) -> Array:
    """What is around a square (48x48x3): larger or smaller, turned (°), shifted (of its side)."""
    middle = (square[:2] + square[2:]) / 2
    zoom = SIDE / (AROUND * (square[2] - square[0])) / scale
    matrix = cv2.getRotationMatrix2D(middle.tolist(), turn, zoom)
    matrix[:, 2] += (0.5 + np.asarray(shift)) * SIDE - middle
    return cv2.warpAffine(picture, matrix, (SIDE, SIDE), borderMode=cv2.BORDER_REFLECT)


def degraded(
    arm: Arm, scenes: Sequence[Scene], maps: Sequence[Tensor], seed: int
) -> tuple[Tensor, Tensor]:
    """Crops of an arm through the camera (bytes), and which tags they show."""
    rng, crops = np.random.default_rng(seed), []
    for scene, distance in zip(scenes, maps, strict=True):
        picture = arm(scene.image[None], distance[None])[0].permute(1, 2, 0).contiguous().numpy()
        for square in scene.boxes.numpy().repeat(VIEWS, 0):
            scale, turn = np.exp(rng.uniform(*np.log(SCALES))), rng.uniform(0, 360)
            crops.append(crop(picture, square, scale, turn, rng.uniform(-SHIFT, SHIFT, 2)))
    names = torch.cat([scene.classes for scene in scenes]).repeat_interleave(VIEWS)
    return through_camera(torch.from_numpy(np.stack(crops)).permute(0, 3, 1, 2), rng), names


def turned(batch: Tensor) -> Tensor:
    """By right angles. Mirrored, a tag would be another."""
    angles = torch.randint(4, (len(batch),)).tolist()
    pairs = zip(batch, angles, strict=True)
    return torch.stack([picture.rot90(angle, (1, 2)) for picture, angle in pairs])


def asked(
    make: Callable[[], Arm],
    scenes: tuple[list[Scene], list[Tensor]],
    crops: Tensor,
    rate: float,
    seed: int,
) -> Array:
    """What a net reads in crops (bytes): N names. It has been trained on the pictures of an arm."""
    torch.manual_seed(seed)
    began = time.process_time()
    pictures, names = degraded(make(), *scenes, seed)
    drawing = time.process_time() - began
    net = trained(pictures, names, IDS, STEPS, seed, rate, PLACES, turned)
    print(f"{drawing:.0f} + {time.process_time() - began - drawing:.0f} s", end="; ", flush=True)
    return logits(net, crops).argmax(1).numpy()


def measured(
    kit: Any,
    photographs: tuple[Sequence[Array], Sequence[Array]],
    shown: list[Array],
    frames: Sequence[tuple[Array, list[Tag]]],
    arms: Sequence[str],
    nets: int,
    answered: Path,
) -> dict[str, Any]:
    """Shares that OpenCV and nets read of the tags of frames (HxWx3, uint8): of all, of faint and
    of clear ones, and of all in stretched green; and of boards in air. Photographs are those to
    train on, and others for these boards. What a net reads is kept in `answered`, and asked once.
    """
    scenes = scenes_of(kit, photographs[0], 0)
    dry, of_dry = degraded(ARMS["no water"](), *scenes_of(kit, photographs[1], OTHER), OTHER)
    tags = [tag for _, of in frames for tag in of]
    film = np.stack([picture for frame in frames for picture in crops_of(*frame)])
    pictures = torch.from_numpy(np.concatenate([film, green(film)])).permute(0, 3, 1, 2)
    truth, contrast = np.array([tag.name for tag in tags]), np.array([t.contrast for t in tags])
    by_opencv = [np.array([tag.is_read for tag in tags])]
    of_film, of_green = {"OpenCV": by_opencv}, {"OpenCV": by_opencv}
    in_air: dict[str, list[float]] = {}
    for seed, arm in product(range(nets), arms):
        path = answered / f"{arm}, {seed}.npy"
        if not path.exists():
            make = partial(made, arm, shown, *scenes)
            np.save(path, asked(make, scenes, torch.cat([pictures, dry]), RATE, seed))
        plain, stretched, air = np.split(np.load(path), [len(tags), 2 * len(tags)])
        of_film.setdefault(arm, []).append(plain == truth)
        of_green.setdefault(arm, []).append(stretched == truth)
        in_air.setdefault(arm, []).append(float((air == of_dry.numpy()).mean()))
        shares = of_film[arm][-1].mean(), of_green[arm][-1].mean(), in_air[arm][-1]
        print(f"{arm}, {seed}:", *(f"{share:.3f}" for share in shares), flush=True)
    parts = {
        "all": (of_film, contrast >= 0),
        "faint": (of_film, contrast < FAINT),
        "clear": (of_film, contrast >= FAINT),
        "green": (of_green, contrast >= 0),
    }
    weights, tables = weights_of([tag.block for tag in tags]), {}
    for part, (right, inside) in parts.items():
        those = {arm: [net[inside] for net in of] for arm, of in right.items()}
        reference = DEFAULTS if DEFAULTS in right else "OpenCV"
        tables[part] = table(those, weights[:, inside], reference)
    tag_counts = {part: int(inside.sum()) for part, (_, inside) in parts.items()}
    how = {"steps": STEPS, "rate": RATE, "scenes": len(scenes[0]), "faint": FAINT}
    return {**how, "tags": tag_counts, "tables": tables, "air": in_air}


def green(crops: Array) -> Array:
    """Crops (Nx48x48x3, uint8) by their green alone, 2nd to 98th percentile from black to white."""
    low, high = np.percentile(crops[..., 1], (2, 98), axis=(1, 2), keepdims=True)
    grey = (crops[..., 1] - low) / np.maximum(high - low, 1)
    return np.repeat((255 * grey.clip(0, 1)).round().astype(np.uint8)[..., None], 3, 3)


def seen(picture: Array, tags: Sequence[Tag]) -> tuple[Array, Array]:
    """A frame at the size at which nets see it, and squares around its tags."""
    scale = SIZE[0] / picture.shape[1]
    small = cv2.resize(picture, SIZE, interpolation=cv2.INTER_AREA)
    return small, squares(scale * np.array([tag.quad for tag in tags]))


def crops_of(picture: Array, tags: Sequence[Tag]) -> list[Array]:
    """Of the tags of a frame."""
    small, places = seen(picture, tags)
    return [crop(small, square) for square in places]


def table(right: dict[str, list[Array]], weights: Array, reference: str) -> dict[str, Any]:
    """Shares of tags that nets read rightly, by weights: all tags first, then resamples."""
    counts = np.maximum(weights.sum(1), 1e-9)
    shares = {arm: np.stack([weights @ net / counts for net in of]) for arm, of in right.items()}
    return compared(shares, reference)


def weights_of(blocks: Sequence[str]) -> Array:
    """Weights of tags: all of them first, then in resamples of their blocks."""
    often = resampled_units(blocks)
    return np.concatenate([np.ones_like(often[:1]), often])


def choose(kit: Any, folder: Path) -> None:
    """What the dry arm reads of boards in photographs that it has not seen, by step."""
    torch.set_num_threads(1)
    train, val = (
        scenes_of(kit, [sample.image for sample in kit.load(f"land/{part}", folder)], seed)
        for part, seed in (("train", 0), ("val", OTHER))
    )
    crops, names = degraded(ARMS["no water"](), *val, OTHER)
    for rate in RATES:
        read = asked(ARMS["no water"], train, crops, rate, 0)
        print(f"{rate}: {(read == names.numpy()).mean():.3f}", flush=True)
