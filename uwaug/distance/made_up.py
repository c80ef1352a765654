"""Made-up distances, for pictures without maps."""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from uwaug._support import checks, codec
from uwaug._support.nouns import Drawn, number
from uwaug._support.ranges import Range
from uwaug.distance import cue
from uwaug.distance.sources import Source, require_ends

# How it was chosen, and what lost: benchmarks/CHOICES.md, "Made-up distances".

_OPEN_PROBABILITY = 0.75
"""Probability of open water where a picture has a place for it."""

_RAMP_PROBABILITY = 0.03
"""Probability that a picture gets a ramp instead. Nets that train on it learn that water hides by
distance, and not that this network is right.
"""

_LEAST_OPEN_SHARE = 0.03
"""Least share of a picture that is surely open water, where there is any, and of each patch."""

_SURE, _OPEN_FROM, _OPEN_TO = 0.7, 0.4, 0.6
"""Probabilities from which open water is sure, begins around a sure place, and is whole there."""

_GUIDE_PX = 2
"""Reach (px of the small copy) over which distances follow the picture's colours."""

_EDGE_VARIANCE = 0.02
"""Variance of colours (0…1) below which there is no edge."""


@codec.plain
@dataclass(frozen=True)
class MadeUp(Source):
    """Distances made up from each picture alone, drawn anew each time: no maps are needed.

    A small network that comes with the package guesses what is nearer than what, and where there is
    open water, such as sky. An exponent, a smooth field, and the presence of open water (in three
    of four) are drawn. Distances step where the picture has edges, and reach from near to far.
    Mirrored pictures get mirrored maps, from 1024² on nearly so. One of thirty pictures, or all
    with `cue="ramp"`, gets a ramp: what is lower in the picture is nearer.

    Order and sizes are guessed. That teaches a network that water hides far things more than near
    ones. It is no truth to restore pictures or to measure by; a large network is nearer to it, see
    `Network`. Pictures are sRGB.

    Attributes:
        near, far: m; numbers or (low, high), near above 0.
        cue: "network" or "ramp".

    Raises:
        ValueError: `near` or `far` is no such range, or there is no such cue.
    """

    reads_maps = False
    reads_pictures = True

    near: Range = number((0.7, 1.8), 0.0)
    far: Range = number((2.5, 8.0), 0.0)
    cue: Literal["network", "ramp"] = "network"

    def __post_init__(self) -> None:
        if require_ends(self.near, self.far) == 0:
            raise ValueError(f"near must lie above 0 m, as its logarithm counts, got {self.near}")
        checks.one_of("cue", self.cue, ("network", "ramp"))

    def ranges(self) -> dict[str, Range | None]:
        """See `Noun.ranges`. "scene" is the seed of the map."""
        return {**super().ranges(), "scene": (0.0, 1.0)}

    @torch.no_grad()
    def metres(self, distance: Tensor | None, image: Tensor, drawn: Drawn) -> Tensor:
        """See `Source.metres`."""
        white = 255.0 if image.dtype == torch.uint8 else 1.0
        rng = np.random.default_rng(int(drawn["scene"] * 2**53))
        picture = cue.small_copy(image).float() / white
        guide = avg_pool2d(picture[None], 2)[0]
        height, width = guide.shape[1:]
        if rng.uniform() < _RAMP_PROBABILITY or self.cue == "ramp":
            log, is_open = np.linspace(1, 0, height)[:, None].repeat(width, 1), np.zeros((1, 1))
        else:
            answers = cue.relative(picture, cue.learnt())
            log, is_open = (answer.double().numpy() for answer in answers)
        small = torch.from_numpy(_varied(log, is_open, rng)).float()
        depth = _upsampled(small, guide, image, white)
        near, far = drawn["near"], drawn["far"]
        z = depth.clamp(max=1) if float(small.max()) > 1 else depth
        z = z.mul_(math.log(far / near)).exp_().mul_(near)
        if z is not depth:
            # open water begins at 1.05 and is endless from 1.95: regression meets neither end
            z.div_(depth.neg_().add_(1.95).div_(0.9).clamp_(0, 1))
        return z[None].to(torch.promote_types(image.dtype, torch.float32))


def _varied(log: Any, is_open: Any, rng: np.random.Generator) -> Any:
    """Draw relative distances (HxW), alike to the left and the right: 0 near, 1 far, 2 open water.

    Args:
        log (HxW): logarithms of distances, up to scale and shift.
        is_open (HxW): probabilities of open water.
        rng: source of the random numbers.
    """
    height, width = log.shape
    openness = np.clip((is_open - _OPEN_FROM) / (_OPEN_TO - _OPEN_FROM), 0, 1)
    patches, _ = ndimage.label(openness > 0)
    shares = np.bincount(patches.ravel()) / patches.size
    openness[shares[patches] < _LEAST_OPEN_SHARE] = 0
    closed = rng.uniform() > _OPEN_PROBABILITY or (is_open > _SURE).mean() < _LEAST_OPEN_SHARE
    if closed or openness.min() > 0:  # such as a blue wall
        openness = np.zeros_like(log)
    solid = log[openness < 0.5]
    low, high = np.percentile(solid, (1, 99))
    depth = np.clip((log - low) / (high - low), 0, 1) if high > low else np.full_like(log, 0.5)
    depth **= np.exp(rng.normal(0, 0.3))
    y, x = np.arange(height)[:, None] / height, (np.arange(width) + 0.5) / width - 0.5
    for down, across, phase in zip(*rng.normal(0, 3, (3, 4)), strict=True):
        depth = depth + rng.uniform(0, 0.06) * np.cos(down * y + phase) * np.cos(across * x)
    depth = np.clip(depth, 0, 1)
    return depth + (2 - depth) * openness


def _upsampled(values: Tensor, small: Tensor, picture: Tensor, white: float) -> Tensor:
    """Enlarge a small map (hxw) to a picture (3xHxW), with steps at the picture's edges. In each
    window it is linear in the colours of the small copy (3xhxw). He and Sun, arXiv:1505.00996.
    """

    def mean(x: Tensor) -> Tensor:
        for reach in ((_GUIDE_PX, 0), (0, _GUIDE_PX)):
            window = [2 * pixels + 1 for pixels in reach]
            x = avg_pool2d(x, window, 1, reach, count_include_pad=False)
        return x

    pairs = torch.stack([small[i] * small[j] for i in range(3) for j in range(i, 3)])
    moments = mean(torch.cat([small, values[None], pairs, small * values]))
    colours, value = moments[:3], moments[3]
    red, green, blue = colours
    common = moments[10:] - colours * value
    products = (red * red, red * green, red * blue, green * green, green * blue, blue * blue)
    rr, rg, rb, gg, gb, bb = moments[4:10] - torch.stack(products)
    rr, gg, bb = (variance + _EDGE_VARIANCE for variance in (rr, gg, bb))
    # the inverse of the 3x3 matrix of each pixel by its cofactors: solvers take ten times as long
    first = torch.stack([gg * bb - gb * gb, rb * gb - rg * bb, rg * gb - rb * gg])
    second = torch.stack([first[1], rr * bb - rb * rb, rg * rb - rr * gb])
    third = torch.stack([first[2], second[2], rr * gg - rg * rg])
    determinant = rr * first[0] + rg * first[1] + rb * first[2]
    slopes = torch.stack([(row * common).sum(0) for row in (first, second, third)]) / determinant
    start = value - (slopes * colours).sum(0)
    lines = mean(torch.cat([slopes / white, start[None]])).to(picture.device)

    def full(x: Tensor) -> Tensor:
        return interpolate(x[None, None], picture.shape[1:], mode="bilinear")[0, 0]

    result = full(lines[3])
    for slope, colour in zip(lines[:3], picture, strict=True):  # one by one: memory is the cost
        result.addcmul_(full(slope), colour.float())
    # regression overshoots: without open water nothing lies beyond 1
    return result.clamp_(0, float(values.max()))
