"""What is done to pictures in air before a net is trained on them: one function an arm.

Each takes pictures (Bx3xHxW, 0…1) and distances (Bx1xHxW, m, +inf for open water), draws from
torch's global generator, and gives pictures back. All arms then see through the same camera.
"""

from collections.abc import Callable
from io import BytesIO
from typing import Any

import numpy as np
import torch
from kornia import augmentation
from PIL import Image
from torch import Tensor
from torch.nn.functional import interpolate

import uwaug
from uwaug import RandomDevelopment

Arm = Callable[[Tensor, Tensor], Tensor]

TYPES = ("I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C")


def drawn(low: Any, high: Any, count: int) -> Tensor:
    """Numbers of each picture and channel, uniform between two numbers or colours (Bx3x1x1)."""
    low, high = torch.tensor(low), torch.tensor(high)
    return (low + (high - low) * torch.rand(count, low.numel()))[..., None, None]


def none(images: Tensor, distances: Tensor) -> Tensor:
    """As they are."""
    return images


def jitter(images: Tensor, distances: Tensor) -> Tensor:
    """What most recipes do to colours, and a blur."""
    colours = augmentation.ColorJitter(0.4, 0.4, 0.4, 0.1, p=1.0)
    blur = augmentation.RandomGaussianBlur((5, 5), (0.1, 1.5), p=0.5)
    return blur(colours(images))


def fog(images: Tensor, distances: Tensor) -> Tensor:
    """The formula of Albumentations' AtmosphericFog with its defaults: sRGB values, a grey, and
    distances of its own, from 0 at the bottom to 1 at the top.
    """
    depth = torch.linspace(1, 0, images.shape[-2])[:, None]
    left = torch.exp(-drawn([1.0], [3.0], len(images)) * depth)
    return images * left + 200 / 255 * (1 - left)


def by_hand(images: Tensor, distances: Tensor) -> Tensor:
    """Three coefficients and a veil, as one writes them down: sRGB values, red fades first. The
    ranges of the first run are lost; its rings had .18, .49, .46.
    """
    fading = drawn([0.25, 0.05, 0.05], [0.8, 0.35, 0.35], len(images))
    veil = drawn([0.02, 0.3, 0.25], [0.35, 0.7, 0.7], len(images))
    left = torch.exp(-fading * distances)
    return images * left + veil * (1 - left)


def li_2020(images: Tensor, distances: Tensor) -> Tensor:
    """UWCNN, in a type drawn for each picture."""
    return _published("li-2020", images, distances)


def slurpp_2025(images: Tensor, distances: Tensor) -> Tensor:
    """The loader of SLURPP: a type drawn for each picture, times a number from .01 to 1, for the
    middle of which the table stands.
    """
    times = drawn([0.02], [2.0], len(images))
    return _published("slurpp-2025", images, distances * times)


def _published(name: str, images: Tensor, distances: Tensor) -> Tensor:
    degraded = []
    for image, distance in zip(images, distances, strict=True):
        water = TYPES[int(torch.randint(len(TYPES), ()))]
        degraded.append(uwaug.published.augment(name, water=water)(image, distance)[0])
    return torch.stack(degraded)


def ours(**options: Any) -> Arm:
    """`RandomUnderwater` with these options."""
    augment = uwaug.RandomUnderwater(**options)
    return lambda images, distances: augment(images, distances)[0]


DEFAULTS = "RandomUnderwater()"
ARMS: dict[str, Callable[[], Arm]] = {
    "no water": lambda: none,
    "jitter, blur": lambda: jitter,
    "grey fog": lambda: fog,
    "by hand": lambda: by_hand,
    "Li 2020": lambda: li_2020,
    "SLURPP 2025": lambda: slurpp_2025,
    DEFAULTS: ours,
    "p=0.5": lambda: ours(p=0.5),
    # candidates for other defaults: to be picked by the part "choose", told by "judge"
    "saturation 1": lambda: ours(development=RandomDevelopment(saturation=1.0)),
    "mu .015–.075": lambda: ours(mu=(0.015, 0.075)),
    "mu .015–.075, p=0.5": lambda: ours(mu=(0.015, 0.075), p=0.5),
}
"""What makes each arm, by its name in the table."""


def degraded(arm: Arm, images: Tensor, distances: Tensor, seed: int) -> Tensor:
    """Pictures of an arm through the camera, 8 bits; one draw a picture."""
    torch.manual_seed(seed)
    pairs = zip(images.split(64), distances.split(64), strict=True)
    pictures = torch.cat([arm(*pair) for pair in pairs])
    return through_camera(pictures, np.random.default_rng(seed))


def through_camera(pictures: Tensor, rng: np.random.Generator) -> Tensor:
    """A resolution of .35 to 1, JPEG of a quality of 40 to 95: the same for all arms of a seed."""
    side, seen = pictures.shape[-1], []
    for picture in pictures:
        small = max(1, round(side * rng.uniform(0.35, 1.0)))
        coarse = interpolate(picture[None], (small, small), mode="area")
        full = interpolate(coarse, (side, side), mode="bilinear")[0]
        levels = full.clamp(0, 1).mul(255).round().byte().permute(1, 2, 0).numpy()
        file = BytesIO()
        Image.fromarray(levels).save(file, "JPEG", quality=int(rng.integers(40, 96)))
        seen.append(torch.from_numpy(np.array(Image.open(file))).permute(2, 0, 1))
    return torch.stack(seen)
