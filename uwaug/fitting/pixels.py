"""What a fit looks at: pixels of one or several pairs, with the blurs of the clean picture that
any width law mixes. In line-of-sight order these do not depend on the water, so that they are made
once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from uwaug._support.types import Shape
from uwaug.blur.plan import BlurPlan, plan_blur
from uwaug.blur.stack import blurred
from uwaug.optics.curves import FARTHEST

__all__ = [
    "Pair",
    "Pixels",
    "Stack",
    "gather",
    "known_distances",
    "reference_distance",
    "thinned",
    "tiles",
    "widest_blur",
]

Places = NDArray[np.int64]

_TOLERANCE = 2e-4
"""Of the blurs: what they are wrong by is the least that a residual can be."""

_WIDEST = 1 / 5
"""Of the picture's short side: the widest blur that a law may ask for. The calibrated law reaches
that of a 60° view after ten scattering lengths, where no light is left.
"""

_BINS = 20
"""Of the distances, from each of which as many pixels are taken."""

_TILES = (10, 5, 3)
"""Blocks along the picture's short side; the residuals of one may depend on each other."""

_MANY = 1_000_000
"""More than the blocks of any picture."""

_NEAR, _FAR = 0.05, 0.95
"""Quantiles of the finite distances that the range of distances goes by."""


class Pair(NamedTuple):
    """A scene without water and in it, checked.

    Attributes:
        clean, observed (3xHxW tensor): linear light, float64.
        z (1xHxW tensor): effective distance, m, finite, > 0 where `usable`.
        usable (1xHxW tensor): whether a pixel's distance is known and no value was clipped.
    """

    clean: Tensor
    observed: Tensor
    z: Tensor
    usable: Tensor

    @property
    def size(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.clean.shape[-2], self.clean.shape[-1]

    @property
    def known(self) -> Tensor:
        """Which pixels (1xHxW) are usable and not open water."""
        return self.usable & (self.z < FARTHEST)


class Stack(NamedTuple):
    """The blurs (Px3x1xN tensors) of the clean pixels for a shape of point spread."""

    plan: BlurPlan
    blurs: list[Tensor]


@dataclass(frozen=True, eq=False)
class Pixels:
    """N pixels of each of P pairs; where a pair has fewer, the rest has no weight.

    Attributes:
        clean, observed (Px3x1xN tensor): linear light, float64.
        z (Px1x1xN tensor): effective distance, m.
        weights (Px3x1xN tensor): one over the standard deviation of the noise; 0 leaves out.
        blocks (PxN array): the part of the picture that a pixel is from, a number of its own in
            each pair.
        coarser: the same for larger parts.
        stacks: by shape, as far as they were asked for.
        reference: distance that width laws refer to, m.
    """

    clean: Tensor
    observed: Tensor
    z: Tensor
    weights: Tensor
    blocks: Places
    coarser: tuple[Places, ...]
    stacks: dict[Shape, Stack]
    reference: float

    def __len__(self) -> int:
        """How many pairs."""
        return len(self.clean)

    @property
    def block_of_value(self) -> Places:
        """The block of each value, P·3·N of them."""
        return self.of_values(self.blocks)

    def of_values(self, blocks: Places) -> Places:
        """What holds for pixels (PxN), for each of their values."""
        pairs, n = blocks.shape
        return np.asarray(np.broadcast_to(blocks[:, None], (pairs, 3, n)).reshape(-1))

    def at(self, index: Any) -> "Pixels":
        """Those at an index: of pairs, or behind an ellipsis, of the pixels of each."""
        stacks = {}
        for shape, (plan, blurs) in self.stacks.items():
            stacks[shape] = Stack(plan, [blur[index] for blur in blurs])
        return replace(
            self,
            clean=self.clean[index],
            observed=self.observed[index],
            z=self.z[index],
            weights=self.weights[index],
            blocks=self.blocks[index],
            coarser=tuple(one[index] for one in self.coarser),
            stacks=stacks,
        )

    def weighed(self, weights: Tensor) -> "Pixels":
        """The same pixels with other weights."""
        return replace(self, weights=weights)


def known_distances(pairs: Sequence[Pair]) -> Tensor:
    """The distances (N) of the usable pixels that are not open water, m."""
    return torch.cat([pair.z[pair.known] for pair in pairs])


def reference_distance(pairs: Sequence[Pair]) -> float:
    """The median of the known distances, m."""
    return float(known_distances(pairs).median())


def widest_blur(size: tuple[int, int]) -> float:
    """The largest width that a law may ask for, px."""
    return min(size) * _WIDEST


def gather(
    pairs: Sequence[Pair], shapes: Sequence[Shape], count: int, rng: np.random.Generator
) -> Pixels:
    """At most `count` pixels of all pairs together, spread evenly over their distances, and the
    blurs of `shapes` there.
    """
    each = max(1, count // len(pairs))
    chosen = [_spread(pair, each, rng) for pair in pairs]
    width = max(len(one) for one in chosen)
    rows: dict[str, list[Tensor]] = {name: [] for name in ("clean", "observed", "z", "weights")}
    blocks = np.zeros((len(_TILES), len(pairs), width), dtype=np.int64)
    for i, (pair, pixels) in enumerate(zip(pairs, chosen, strict=True)):
        padded = torch.from_numpy(np.resize(pixels, width))
        usable = torch.arange(width) < len(pixels)
        rows["clean"].append(pair.clean.flatten(1)[:, padded])
        rows["observed"].append(pair.observed.flatten(1)[:, padded])
        rows["z"].append(pair.z.flatten(1)[:, padded])
        rows["weights"].append(usable.double().expand(3, -1))
        for k, along in enumerate(_TILES):
            blocks[k, i] = tiles(padded.numpy(), i, pair.size, along)
    tensors = {name: torch.stack(values)[:, :, None] for name, values in rows.items()}
    stacks = {}
    for shape in shapes:
        stacks[shape] = _stack(pairs, chosen, width, shape)
    numbered = [np.unique(one, return_inverse=True)[1].reshape(one.shape) for one in blocks]
    return Pixels(
        **tensors,
        blocks=numbered[0],
        coarser=tuple(numbered[1:]),
        stacks=stacks,
        reference=reference_distance(pairs),
    )


def thinned(pixels: Pixels, count: int, rng: np.random.Generator) -> Pixels:
    """About `count` of the pixels, drawn at random."""
    n = pixels.z.shape[-1]
    keep = max(1, count // len(pixels))
    if keep >= n:
        return pixels
    return pixels.at((..., rng.choice(n, keep, replace=False)))


def tiles(places: Places, pair: int, size: tuple[int, int], along: int) -> Places:
    """The block of each place in a picture of `size`, of `along` blocks on its short side: a number
    that no block of another pair has.
    """
    side = max(1, min(size) // along)
    down, across = places // size[1] // side, places % size[1] // side
    return _MANY * pair + down * -(-size[1] // side) + across


def _spread(pair: Pair, count: int, rng: np.random.Generator) -> Places:
    """The places of `count` usable pixels: as many from each of equal steps of distance, as far as
    there are.
    """
    places = rng.permutation(np.flatnonzero(pair.usable.numpy()))
    if len(places) <= count:
        return places
    z = pair.z.flatten().numpy()[places]
    low, high = np.quantile(z, (_NEAR, _FAR))
    step = np.clip((z - low) / max(high - low, 1e-9) * _BINS, 0, _BINS - 1).astype(np.int64)
    # the pixels of each step in turn: first one of each, then the second of each, …
    order = np.argsort(step, kind="stable")
    first = np.searchsorted(step[order], np.arange(_BINS))
    turn = np.empty(len(places), dtype=np.int64)
    turn[order] = np.arange(len(places)) - first[step[order]]
    return places[np.argsort(turn, kind="stable")[:count]]


def _stack(pairs: Sequence[Pair], chosen: Sequence[Places], width: int, shape: Shape) -> Stack:
    """The blurs at the chosen pixels."""
    widest = max(widest_blur(pair.size) for pair in pairs)
    longest = max(max(pair.size) for pair in pairs)
    plan = plan_blur(0.0, widest, _TOLERANCE, shape, longest)
    rows: list[list[Tensor]] = [[] for _ in plan.sigmas]
    kept: tuple[Tensor, list[Tensor]] | None = None
    for pair, pixels in zip(pairs, chosen, strict=True):
        padded = torch.from_numpy(np.resize(pixels, width))
        # a series has one clean picture for all pairs
        if kept is None or kept[0] is not pair.clean:
            kept = (pair.clean, blurred(pair.clean[None].float(), plan))
        for row, blur in zip(rows, kept[1], strict=True):
            row.append(blur[0].flatten(1)[:, padded].double())
    return Stack(plan, [torch.stack(row)[:, :, None] for row in rows])
