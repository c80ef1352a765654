"""Input of a fit: checked pictures, and a sample of their pixels with blurs of the clean picture.

Any width law is a mixture of these blurs. They do not depend on the water, so they are made once.
"""

import io
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from uwaug._support import checks
from uwaug._support.codec import plain
from uwaug._support.types import Array, ColorSpace, Shape
from uwaug.blur.plan import BlurPlan, plan_blur
from uwaug.blur.stack import blurred, mixed, node_weights
from uwaug.distance.doubts import doubts
from uwaug.formation.colour import decoded, encoded, require_values
from uwaug.formation.image import form
from uwaug.formation.inputs import batch_sizes
from uwaug.formation.setting import Setting
from uwaug.optics.curves import FARTHEST

Places = NDArray[np.int64]

BLOCKS = 10  # blocks along the picture's short side; the residuals of one may depend on each other
_MIN_PIXELS = 50  # usable pixels that a fit needs: three values of each for 12 to 17 numbers
MIN_SPAN = 0.03  # spread of the distances as a share of their median; less is one distance
_SAME_PICTURE = 2e-3  # mean difference, as a share of the light, below which two pictures are one
_CLIPPED_LIGHT = 0.98  # linear light of the clean picture, 253 of 255: it may have been brighter
_BLUR_TOLERANCE = 2e-4  # error of the blurs, below which no residual can fall
_WIDEST_BLUR = 1 / 5  # widest blur of a fitted width law, as a share of the picture's short side
_ROUGH_NOISE = 0.01  # linear light; the noise of a first fit
_BINS = 20  # equal steps of distance, from each of which as many pixels are taken
NEAR_QUANTILE, FAR_QUANTILE = 0.05, 0.95  # of the finite distances: the ends of their range


@plain
@dataclass(frozen=True)
class Geometry:
    """Quantiles of the distances, m, and sizes, px."""

    nearest: float  # at 5 %
    reference: float  # the median, to which width laws refer
    farthest: float  # at 95 %
    size: tuple[int, int]  # height and width
    widest: float  # largest width of a blur


@dataclass(frozen=True, eq=False)
class Pictures:
    """Checked pictures of one water, in linear light, float64."""

    clean: Tensor  # 1x3xHxW or Bx3xHxW; black if there is none
    observed: Tensor  # Bx3xHxW
    z: Tensor  # Bx1xHxW: m, finite, > 0
    usable: Tensor  # Bx1xHxW: True where the distance is known and no value was clipped
    color_space: ColorSpace  # of the input
    clips: bool  # True if light beyond black and white was lost, as in sRGB
    jpeg: int | None = None  # quality at which the observed were stored; None: without loss

    @staticmethod
    def of(
        clean: Tensor | None,
        observed: Tensor,
        distance: Tensor,
        color_space: ColorSpace,
        jpeg: int | None = None,
    ) -> "Pictures":
        """Check the input of a fit; arguments and errors are those of `uwaug.fit`."""
        checks.one_of("color_space", color_space, get_args(ColorSpace))
        if jpeg is not None:
            checks.within("jpeg", jpeg, 1, 100)
        checks.batches(batch_sizes(observed=observed, distance=distance, clean=clean))
        checks.metres("distance", distance)
        for sentence in doubts(distance):
            warnings.warn(f"{sentence.partition(':')[0]}: a fit needs metres", stacklevel=3)
        wet = _light(observed, color_space, "observed")
        dry = torch.zeros_like(wet[:1])
        if clean is not None:
            dry = _light(clean, color_space, "clean")
            if float((dry - wet).abs().mean()) <= _SAME_PICTURE * float(dry.mean()):
                raise ValueError("clean and observed are the same picture")
        z = (distance if distance.ndim == 4 else distance[None]).detach().cpu().double()
        usable = z > 0
        clips = color_space == "srgb" or bool(wet.min() >= 0 and wet.max() <= 1)
        if clips:
            unclipped = (wet > 0).any(1) & (wet < 1).all(1) & (dry < _CLIPPED_LIGHT).all(1)
            usable = usable & unclipped[:, None]
        count = max(len(wet), len(z), len(dry))
        z = torch.where(z >= checks.OPEN, FARTHEST, torch.where(z > 0, z, 1.0))
        wet, z, usable = (x.expand(count, -1, -1, -1) for x in (wet, z, usable))
        pictures = Pictures(dry, wet, z, usable, color_space, clips, jpeg)
        pictures._require_usable()
        return pictures

    @property
    def finite(self) -> Tensor:
        """True where a pixel is usable and no open water (Bx1xHxW)."""
        return self.usable & (self.z < FARTHEST)

    @cached_property
    def geometry(self) -> Geometry:
        quantiles = (NEAR_QUANTILE, 0.5, FAR_QUANTILE)
        nearest, reference, farthest = np.quantile(self.z[self.finite].numpy(), quantiles).tolist()
        size = (self.z.shape[-2], self.z.shape[-1])
        return Geometry(nearest, reference, farthest, size, min(size) * _WIDEST_BLUR)

    def sample(
        self, shapes: Sequence[Shape], count: int, seed: int, widest: float | None = None
    ) -> "Pixels":
        """Draw at most `count` pixels of all pictures together, spread evenly over their distances,
        with the blurs of `shapes` there, up to a width (px) or else the geometry's.
        """
        rng = np.random.default_rng(seed)
        share = max(1, count // len(self.z))
        places = [
            _stratified(z.numpy(), usable.numpy(), share, rng)
            for z, usable in zip(self.z.flatten(1), self.usable.flatten(1), strict=True)
        ]

        def at_places(light: Tensor) -> Tensor:
            """Values of (1 or B)xCxHxW at the places (1xCx1xN)."""
            rows = [light[i % len(light)].flatten(1)[:, at] for i, at in enumerate(places)]
            return torch.cat(rows, 1)[None, :, None]

        stacks = {}
        widest, side = widest or self.geometry.widest, max(self.geometry.size)
        for shape in shapes:
            plan = plan_blur(0.0, widest, _BLUR_TOLERANCE, shape, side)
            blurs = [at_places(x).double() for x in blurred(self.clean.float(), plan)]
            stacks[shape] = Stack(plan, blurs)
        observed, area = at_places(self.observed), math.prod(self.geometry.size)
        return Pixels(
            clean=at_places(self.clean),
            observed=observed,
            z=at_places(self.z),
            weights=torch.full_like(observed, 1 / _ROUGH_NOISE),
            places=np.concatenate([i * area + at for i, at in enumerate(places)]),
            blocks=blocks_of(places, self.geometry.size),
            stacks=stacks,
            size=self.geometry.size,
        )

    def rendered(self, setting: Setting) -> Tensor:
        """The observed pictures (Bx3xHxW, linear light) as a setting makes them of the clean."""
        clean, z = self.clean.float().expand(len(self.z), -1, -1, -1), self.z.float()
        with torch.no_grad():
            return form(clean, z, replace(setting, color_space="linear"))

    def lost(self, light: Tensor, jpeg: int) -> Tensor:
        """What pictures (Bx3xHxW, linear light) lose when they are stored as JPEG of a quality."""
        light = light.clamp(0, 1)
        values = encoded(light, self.color_space, torch.uint8, 1.0)
        values = torch.stack([_through_jpeg(value, jpeg) for value in values])
        return decoded(values, self.color_space) - light

    def _require_usable(self) -> None:
        usable = int(self.finite.sum())
        if usable < _MIN_PIXELS:
            got = f"only {usable} of {self.z.numel()} pixels can be used, expected {_MIN_PIXELS}"
            raise ValueError(f"{got}: neither open water nor black or white, their distance known")
        z = self.z[self.usable].numpy()
        low, high = np.quantile(z, (0.02, 0.98))
        if high - low < MIN_SPAN * float(np.median(z[z < FARTHEST])):
            got = f"distance is flat: all pixels lie at {low:.4g}–{high:.4g} m"
            raise ValueError(f"{got}: give a scene with depth, or pictures at several distances")


class Stack:
    """Blurs of the clean pixels (1x3x1xN each) for a shape of point spread, and their plan."""

    def __init__(self, plan: BlurPlan, blurs: list[Tensor]) -> None:
        self.plan, self.blurs = plan, blurs
        self._sigma, self._soft = torch.empty(0), torch.empty(0)

    def softened(self, sigma: Tensor) -> Tensor:
        """The clean pixels (1x3x1xN), each blurred by a width `sigma` (1x1x1xN, px)."""
        # most steps of a fit leave the widths alone
        if not torch.equal(sigma, self._sigma):
            self._sigma, self._soft = sigma, mixed(self.blurs, node_weights(sigma, self.plan))
        return self._soft


@dataclass(frozen=True, eq=False)
class Pixels:
    clean: Tensor  # 1x3x1xN: linear light, float64
    observed: Tensor
    z: Tensor  # 1x1x1xN: m
    weights: Tensor  # 1x3x1xN: one over the standard deviation of the noise; 0 leaves out
    places: Places  # (N) where a pixel is, row by row of each picture
    blocks: Places  # (N) number of the block of the picture that a pixel is from, from 0
    stacks: dict[Shape, Stack]  # blurs for each shape that was asked for
    size: tuple[int, int]  # height and width of the pictures, px

    @property
    def blocks_of_values(self) -> Places:
        return np.tile(self.blocks, 3)

    def subsample(self, count: int, seed: int) -> "Pixels":
        n = self.z.shape[-1]
        if count >= n:
            return self
        places = np.random.default_rng(seed).choice(n, count, replace=False)
        names = ("clean", "observed", "z", "weights", "places", "blocks")
        values: dict[str, Any] = {name: getattr(self, name)[..., places] for name in names}
        values["stacks"] = {
            shape: Stack(stack.plan, [blur[..., places] for blur in stack.blurs])
            for shape, stack in self.stacks.items()
        }
        return replace(self, **values)


def blocks_of(places: Sequence[Places], size: tuple[int, int]) -> Places:
    """Number of the block, from 0, of each place, row by row, of each picture of a size."""
    side = max(1, min(size) // BLOCKS)
    columns, area = -(-size[1] // side), size[0] * size[1]
    numbers = [
        area * i + at // size[1] // side * columns + at % size[1] // side
        for i, at in enumerate(places)
    ]
    return np.unique(np.concatenate(numbers), return_inverse=True)[1]


def _through_jpeg(values: Tensor, quality: int) -> Tensor:
    file = io.BytesIO()
    Image.fromarray(values.permute(1, 2, 0).numpy()).save(file, "JPEG", quality=quality)
    return torch.from_numpy(np.array(Image.open(file))).permute(2, 0, 1)


def _light(picture: Tensor, color_space: ColorSpace, name: str) -> Tensor:
    picture = (picture if picture.ndim == 4 else picture[None]).detach().cpu()
    require_values(picture, color_space, name)
    return decoded(picture, color_space).double()


def _stratified(
    z: Array, usable: NDArray[np.bool_], count: int, rng: np.random.Generator
) -> Places:
    """Places of `count` usable pixels of a picture, as evenly by distance as there are pixels."""
    places = np.flatnonzero(usable)
    if len(places) <= count:
        return places
    z = z[places]
    low, high = np.quantile(z, (NEAR_QUANTILE, FAR_QUANTILE))
    step = np.clip((z - low) / max(high - low, 1e-9) * _BINS, 0, _BINS - 1).astype(np.int64)
    share = 1 / np.bincount(step)[step]
    return rng.choice(places, count, replace=False, p=share / share.sum())
