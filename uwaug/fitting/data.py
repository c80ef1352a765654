"""What a fit looks at: checked pictures, and pixels of them with the blurs of the clean picture,
which any width law mixes. The blurs do not depend on the water, so that they are made once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from uwaug._support import checks
from uwaug._support.codec import plain
from uwaug._support.types import Array, ColorSpace, Shape
from uwaug.blur.plan import BlurPlan, plan_blur
from uwaug.blur.stack import blurred, mixed, node_weights
from uwaug.formation.colour import decoded, require_values
from uwaug.optics.curves import FARTHEST

Places = NDArray[np.int64]

BLOCKS = 10
"""Blocks along the picture's short side; the residuals of one may depend on each other."""

_MIN_PIXELS = 500  # usable pixels that a fit needs
_MIN_SPAN = 0.03  # of the distances, as a share of their median; less is one distance
_SAME_PICTURE = 2e-3  # mean difference of two pictures that are one, as a share of their light
_WHITE = 0.98  # linear light, 253 of 255 in sRGB: the clean picture may be brighter than it says
_TOLERANCE = 2e-4  # of the blurs: what they are wrong by is the least that a residual can be
# Of the picture's short side: the widest blur that a law may ask for. The calibrated law reaches
# that of a 60° view after ten scattering lengths, where no light is left.
_WIDEST = 1 / 5
_BINS = 20  # of the distances, from each of which as many pixels are taken
_NEAR, _FAR = 0.05, 0.95  # quantiles of the finite distances that the range of distances goes by


@plain
@dataclass(frozen=True)
class Geometry:
    """What is known of the pictures before anything is fitted.

    Attributes:
        nearest, reference, farthest: distances that 5, 50 and 95 % of the pixels are nearer than,
            m; width laws refer to the median.
        size: height and width, px.
        widest: the largest width of a blur, px.
    """

    nearest: float
    reference: float
    farthest: float
    size: tuple[int, int]
    widest: float


@dataclass(frozen=True, eq=False)
class Pictures:
    """Checked pictures of one water.

    Attributes:
        clean (1x3xHxW or Bx3xHxW tensor): linear light, float64; black if there is none.
        observed (Bx3xHxW tensor): linear light, float64.
        z (Bx1xHxW tensor): m, finite, > 0.
        usable (Bx1xHxW tensor): whether a pixel's distance is known and no value was clipped.
        color_space: of what was given.
        clips: whether light beyond black and white was lost: of sRGB, and where none lies beyond.
    """

    clean: Tensor
    observed: Tensor
    z: Tensor
    usable: Tensor
    color_space: ColorSpace
    clips: bool

    @staticmethod
    def of(
        clean: Tensor | None, observed: Tensor, distance: Tensor, color_space: ColorSpace
    ) -> "Pictures":
        """Check what a fit is given.

        Args:
            clean, observed, distance, color_space: as of `uwaug.fit`; a clean picture of None is
                not looked at.

        Raises:
            TypeError, ValueError: if an input does not suit; if too few pixels can be used, the
                distances are all alike, or clean and observed are one picture.
        """
        checks.one_of("color_space", color_space, get_args(ColorSpace))
        given = {"observed": observed, "distance": distance}
        if clean is not None:
            given["clean"] = clean
        for name, value in given.items():
            if not (
                name != "distance" and isinstance(value, Tensor) and value.dtype == torch.uint8
            ):
                checks.floating(name, value)
            checks.picture(name, value, 1 if name == "distance" else 3)
            if value.shape[-2:] != observed.shape[-2:]:
                own, expected = tuple(value.shape[-2:]), tuple(observed.shape[-2:])
                raise ValueError(f"{name} is {own} but observed is {expected}: align them")
        rows = {name: x if x.ndim == 4 else x[None] for name, x in given.items()}
        checks.batches({name: len(x) for name, x in rows.items()})
        checks.metres("distance", distance)
        light, z = _light(rows["observed"], color_space, "observed"), rows["distance"]
        bare = torch.zeros_like(light[:1])
        if clean is not None:
            bare = _light(rows["clean"], color_space, "clean")
            if float((bare - light).abs().mean()) <= _SAME_PICTURE * float(bare.mean()):
                cure = "give the same scene without water and in it"
                raise ValueError(f"clean and observed are the same picture: {cure}")
        z = z.detach().cpu().double()
        usable = z > 0
        clips = color_space == "srgb" or bool(light.min() >= 0 and light.max() <= 1)
        if clips:
            inside = (light > 0).any(1) & (light < 1).all(1) & (bare < _WHITE).all(1)
            usable = usable & inside[:, None]
        count = max(len(light), len(z), len(bare))
        z = torch.where(z >= checks.OPEN, FARTHEST, torch.where(z > 0, z, 1.0))
        z = z.expand(count, -1, -1, -1)
        pictures = Pictures(
            bare, light.expand(count, -1, -1, -1), z, usable.expand_as(z), color_space, clips
        )
        pictures._require_usable()
        return pictures

    @property
    def finite(self) -> Tensor:
        """Which pixels (Bx1xHxW) are usable and not open water."""
        return self.usable & (self.z < FARTHEST)

    @cached_property
    def geometry(self) -> Geometry:
        """Distances and sizes."""
        near, middle, far = np.quantile(self.z[self.finite].numpy(), (_NEAR, 0.5, _FAR)).tolist()
        size = (self.z.shape[-2], self.z.shape[-1])
        return Geometry(near, middle, far, size, min(size) * _WIDEST)

    def sample(self, shapes: Sequence[Shape], count: int, seed: int) -> "Pixels":
        """Draw at most `count` pixels of all pictures together, spread evenly over their distances,
        with the blurs of `shapes` there.
        """
        rng = np.random.default_rng(seed)
        each = max(1, count // len(self.z))
        drawn = [
            _stratified(z.numpy(), used.numpy(), each, rng)
            for z, used in zip(self.z.flatten(1), self.usable.flatten(1), strict=True)
        ]

        def at_places(light: Tensor) -> Tensor:
            """The values of (1 or B)xCxHxW at the places (1xCx1xN)."""
            rows = [light[i % len(light)].flatten(1)[:, places] for i, places in enumerate(drawn)]
            return torch.cat(rows, 1)[None, :, None]

        stacks = {}
        for shape in shapes:
            plan = plan_blur(0.0, self.geometry.widest, _TOLERANCE, shape, max(self.geometry.size))
            blurs = [at_places(x).double() for x in blurred(self.clean.float(), plan)]
            stacks[shape] = Stack(plan, blurs)
        observed = at_places(self.observed)
        return Pixels(
            clean=at_places(self.clean),
            observed=observed,
            z=at_places(self.z),
            weights=torch.ones_like(observed),
            blocks=blocks_of(drawn, self.geometry.size),
            stacks=stacks,
            size=self.geometry.size,
        )

    def _require_usable(self) -> None:
        """Refuse pictures of which too little can be used, saying what it is lost to; and distances
        that are all alike: attenuation is seen by what it does to distances.
        """
        usable = int(self.finite.sum())
        if usable < _MIN_PIXELS:
            lost = {
                "lie in open water": self.z >= FARTHEST,
                "are saturated": (self.observed >= 1).any(1),
                "are black in observed": (self.observed <= 0).all(1),
            }
            counts = ", ".join(f"{int(where.sum())} {name}" for name, where in lost.items())
            raise ValueError(
                f"only {usable} pixels can be used, expected {_MIN_PIXELS}: of {self.z.numel()} "
                f"{counts}; distances must be known, and exposure leave pixels unclipped"
            )
        z = self.z[self.usable].numpy()
        low, high = np.quantile(z, (0.02, 0.98))
        if high - low < _MIN_SPAN * float(np.median(z[z < FARTHEST])):
            cure = "β, G and veil need a scene with depth, or pictures at several distances"
            raise ValueError(f"distance is flat: all pixels lie at {low:.4g}–{high:.4g} m; {cure}")


class Stack(NamedTuple):
    """The clean pixels, blurred for a shape of point spread: the plan, and its blurs (1x3x1xN)."""

    plan: BlurPlan
    blurs: list[Tensor]


@dataclass(frozen=True, eq=False)
class Pixels:
    """N pixels of all pictures.

    Attributes:
        clean, observed (1x3x1xN tensor): linear light, float64.
        z (1x1x1xN tensor): m.
        weights (1x3x1xN tensor): one over the standard deviation of the noise; 0 leaves out.
        blocks (N array): the block of the picture that a pixel is from, counted from 0.
        stacks: by shape, as far as they were asked for.
        size: of the pictures, px.
    """

    clean: Tensor
    observed: Tensor
    z: Tensor
    weights: Tensor
    blocks: Places
    stacks: dict[Shape, Stack]
    size: tuple[int, int]

    @property
    def blocks_of_values(self) -> Places:
        """The block of each of 3·N values."""
        return np.tile(self.blocks, 3)

    def softened(self, shape: Shape, sigma: Tensor) -> Tensor:
        """The clean pixels (1x3x1xN), each blurred by its own width (1x1x1xN), px."""
        plan, blurs = self.stacks[shape]
        return mixed(blurs, node_weights(sigma, plan))

    def subsample(self, count: int, seed: "int | np.random.Generator") -> "Pixels":
        """`count` of the pixels, drawn at random; all if there are no more."""
        n = self.z.shape[-1]
        if count >= n:
            return self
        places = np.random.default_rng(seed).choice(n, count, replace=False)
        names = ("clean", "observed", "z", "weights", "blocks")
        values: dict[str, Any] = {name: getattr(self, name)[..., places] for name in names}
        stacks = {
            shape: Stack(plan, [blur[..., places] for blur in blurs])
            for shape, (plan, blurs) in self.stacks.items()
        }
        return replace(self, **values, stacks=stacks)


def blocks_of(places: Sequence[Places], size: tuple[int, int]) -> Places:
    """The block of each of the places of each picture of a `size`: numbers counted from 0, that no
    two pictures share.
    """
    side = max(1, min(size) // BLOCKS)
    across, most = -(-size[1] // side), size[0] * size[1]
    numbers = [
        most * i + at // size[1] // side * across + at % size[1] // side
        for i, at in enumerate(places)
    ]
    return np.unique(np.concatenate(numbers), return_inverse=True)[1]


def _light(picture: Tensor, color_space: ColorSpace, name: str) -> Tensor:
    picture = picture.detach().cpu()
    require_values(picture, color_space, name)
    return decoded(picture, color_space).double()


def _stratified(
    z: Array, usable: NDArray[np.bool_], count: int, rng: np.random.Generator
) -> Places:
    """The places of `count` usable pixels of a picture: as many from each of equal steps of
    distance, as far as there are.
    """
    places = rng.permutation(np.flatnonzero(usable))
    if len(places) <= count:
        return places
    here = z[places]
    low, high = np.quantile(here, (_NEAR, _FAR))
    step = np.clip((here - low) / max(high - low, 1e-9) * _BINS, 0, _BINS - 1).astype(np.int64)
    # the pixels of each step in turn: first one of each, then the second of each, …
    order = np.argsort(step, kind="stable")
    first = np.searchsorted(step[order], np.arange(_BINS))
    turn = np.empty(len(places), dtype=np.int64)
    turn[order] = np.arange(len(places)) - first[step[order]]
    return places[np.argsort(turn, kind="stable")[:count]]
