"""What is done to pictures in air before a net is trained on them: one function an arm.

Each takes pictures (Bx3xHxW, 0…1) and distances (Bx1xHxW, m, +inf for open water), draws from
torch's global generator, and gives pictures back. All arms then see through the same camera.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from io import BytesIO
from typing import Any

import numpy as np
import torch
from kornia import augmentation
from PIL import Image
from torch import Tensor
from torch.nn.functional import interpolate

import uwaug
from benchmarks.accuracy.like import transferred
from benchmarks.evidence.tasks import SIDE, Array, Pool

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


def by_hand(images: Tensor, distances: Tensor) -> Tensor:
    """Three coefficients and a veil, as one writes them down: sRGB values, red fades first. A scene
    reaches from .3 m to 1.3…5.3 m, where open water is.
    """
    solid = torch.where(distances.isinf(), 0, distances)
    farthest = solid.amax((1, 2, 3), keepdim=True)
    reach = (distances / farthest).clamp(max=1)
    metres = 0.3 + reach * drawn([1.0], [5.0], len(images))
    fading = drawn([0.3, 0.05, 0.05], [1.2, 0.5, 0.5], len(images))
    veil = drawn([0.0, 0.2, 0.2], [0.3, 0.8, 0.8], len(images))
    direct = torch.exp(-fading * metres)
    return images * direct + veil * (1 - direct)


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
    system = partial(uwaug.published.system(name), generator=torch.default_generator)
    degraded = []
    for image, distance in zip(images, distances, strict=True):
        water = TYPES[int(torch.randint(len(TYPES), ()))]
        degraded.append(system(image, distance, water))
    return torch.stack(degraded)


def ours(**options: Any) -> Arm:
    """`RandomUnderwater` with these options."""
    augment = uwaug.RandomUnderwater(**options)
    return lambda images, distances: augment(images, distances)[0]


DEFAULTS = "RandomUnderwater()"
ARMS: dict[str, Callable[[], Arm]] = {
    "no water": lambda: none,
    "jitter, blur": lambda: jitter,
    "by hand": lambda: by_hand,
    "Li 2020": lambda: li_2020,
    "SLURPP 2025": lambda: slurpp_2025,
    DEFAULTS: ours,
    "p=0.5": lambda: ours(p=0.5),
    # μ = 1.5·g: veils may be brighter than a white plate in the same place
    "mu=None": lambda: ours(water=uwaug.RandomWater(mu=None)),
    "light=None": lambda: ours(light=None),
}
"""What makes each arm, by its name in the table."""


def coloured_alike(references: list[Array], pool: Pool, trials: int) -> Arm:
    """Each picture with the colours of one of those shown, drawn."""
    shown = [interpolate(x[None], (SIDE, SIDE), mode="area")[0] for x in tensors(references)]

    def arm(images: Tensor, distances: Tensor) -> Tensor:
        picked = torch.randint(len(shown), (len(images),)).tolist()
        return torch.stack([transferred(x, shown[i]) for x, i in zip(images, picked, strict=True)])

    return arm


def tensors(pictures: Sequence[Array]) -> Iterator[Tensor]:
    """Pictures (HxWx3, uint8) as 3xHxW, 0…1."""
    return (torch.from_numpy(picture).permute(2, 0, 1) / 255 for picture in pictures)


def like(references: list[Array], pool: Pool, trials: int) -> Arm:
    """`uwaug.like` by so many draws a reference, tried on eight pictures of the pool."""
    picked = torch.linspace(0, len(pool.labels) - 1, 8).long()
    pictures, distances = list(pool.images[picked]), list(pool.distances[picked])
    augment = uwaug.like(
        list(tensors(references)),
        pictures,
        distances,
        draws=trials,
        keep=max(1, trials // 30),
        seed=int(torch.randint(2**31, ())),
    )
    return lambda images, distances: augment(images, distances)[0]


SHOWN: dict[str, Callable[[list[Array], Pool, int], Arm]] = {
    "colour transfer": coloured_alike,
    "uwaug.like": like,
}
"""What makes each arm that is shown pictures of the test set, without labels, before training."""


def degraded(arm: Arm, pool: Pool, draws: int, seed: int) -> tuple[Tensor, Tensor]:
    """Pictures of an arm through the camera, 8 bits, so many draws of each; and their labels."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    pairs = [*zip(pool.images.split(64), pool.distances.split(64), strict=True)] * draws
    pictures = torch.cat([through_camera(arm(*pair), rng) for pair in pairs])
    return pictures, pool.labels.repeat(draws)


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
