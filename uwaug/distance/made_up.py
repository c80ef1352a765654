"""Distances of pictures that have no maps: made up."""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from uwaug._support import checks, codec
from uwaug._support.nouns import Drawn, number
from uwaug._support.ranges import Range
from uwaug.distance import cue
from uwaug.distance.sources import Source, require_ends

# How it was chosen, and what lost: benchmarks/CHOICES.md, "Made-up distances".

_OPEN_PROBABILITY = 0.75
"""That open water is drawn where a picture has a place for it."""

_RAMP_PROBABILITY = 0.1
"""That a picture gets a ramp instead, so that nets learn that water hides by distance, and not
that this network is right.
"""

_LEAST_OPEN_SHARE = 0.03
"""Of a picture that is open water for sure, where there is any."""

_SURE, _OPEN_FROM, _OPEN_TO = 0.7, 0.4, 0.6
"""Probabilities of open water: for sure; and where it begins and is whole around what is sure."""

_GUIDE_PX = 2
"""Of the small copy, over which its distances follow the picture's colours."""

_EDGE_VARIANCE = 0.01
"""Of colours, of 0…1, below which there is no edge."""


@codec.plain
@dataclass(frozen=True)
class MadeUp(Source):
    """No maps: each picture gets distances made up from itself alone, drawn anew each time.

    A small network of our own, which comes along, says what looks nearer than what, and where there
    is open water, such as sky; `cue="ramp"` does without: below is near. On it come, drawn anew, an
    exponent, a smooth field, and whether there is open water (in three of four); a tenth of the
    pictures get the ramp. Distances step where the picture has edges. All is scaled, in the
    logarithm, to reach from near to far. Mirrored pictures get mirrored maps.

    The depth cue is guessed: some things that look far to you are near here, and sizes are
    invented. It teaches a network that water hides some things more than others, which is good for
    robustness; it is no truth to restore pictures by, or to measure. A large network is nearer to
    the truth, see `Network`. Pictures are sRGB, as those are that the network has seen.

    Attributes:
        near, far: m; numbers or (low, high), near above 0.
        cue: "network" or "ramp".

    Raises:
        ValueError: `near` or `far` is no such range, or there is no such cue.
    """

    reads_maps = False
    reads_pictures = True

    near: Range = number((0.7, 2.0), 0.0)
    far: Range = number((2.2, 7.0), 0.0)
    cue: Literal["network", "ramp"] = "network"

    def __post_init__(self) -> None:
        if require_ends(self.near, self.far) == 0:
            raise ValueError(f"near must lie above 0 m, as its logarithm counts, got {self.near}")
        checks.one_of("cue", self.cue, ("network", "ramp"))

    def ranges(self) -> dict[str, Range | None]:
        """See `Noun.ranges`; all else that is random follows from "scene"."""
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
            # open water from 1.05, endless from 1.95: regression meets neither end exactly
            z.div_(depth.neg_().add_(1.95).div_(0.9).clamp_(0, 1))
        return z[None].to(torch.promote_types(image.dtype, torch.float32))


def _varied(log: Any, is_open: Any, rng: np.random.Generator) -> Any:
    """How far each place (HxW) is: 0 nearest, 1 farthest, 2 open water.

    Args:
        log (HxW): logarithms of distances, up to scale and shift.
        is_open (HxW): probabilities of open water.
        rng: what is random. All of it is alike to the left and the right.
    """
    height, width = log.shape
    opened = np.clip((is_open - _OPEN_FROM) / (_OPEN_TO - _OPEN_FROM), 0, 1)
    closed = rng.uniform() > _OPEN_PROBABILITY or (is_open > _SURE).mean() < _LEAST_OPEN_SHARE
    if closed or opened.min() > 0:  # of a blue wall, say
        opened = np.zeros_like(log)
    solid = log[opened < 0.5]
    low, high = np.percentile(solid, (1, 99))
    depth = np.clip((log - low) / (high - low), 0, 1) if high > low else np.full_like(log, 0.5)
    depth **= np.exp(rng.normal(0, 0.3))
    y, x = np.arange(height)[:, None] / height, (np.arange(width) + 0.5) / width - 0.5
    for down, across, phase in zip(*rng.normal(0, 3, (3, 4)), strict=True):
        depth = depth + rng.uniform(0, 0.06) * np.cos(down * y + phase) * np.cos(across * x)
    depth = np.clip(depth, 0, 1)
    return depth + (2 - depth) * opened


def _upsampled(values: Tensor, small: Tensor, picture: Tensor, white: float) -> Tensor:
    """A small map (hxw) at the size of a picture (3xHxW), with steps where the picture has them: in
    each window it is linear in the colours of the small copy (3xhxw). He and Sun, arXiv:1505.00996.
    """

    def mean(x: Tensor) -> Tensor:
        for reach in ((_GUIDE_PX, 0), (0, _GUIDE_PX)):
            window = [2 * pixels + 1 for pixels in reach]
            x = avg_pool2d(x, window, 1, reach, count_include_pad=False)
        return x

    pairs = (small[:, None] * small).flatten(0, 1)
    moments = mean(torch.cat([small, values[None], pairs, small * values]))
    colours, value = moments[:3], moments[3]
    spread = moments[4:13].reshape(3, 3, *values.shape) - colours[:, None] * colours
    spread.diagonal().add_(_EDGE_VARIANCE)
    common = moments[13:] - colours * value
    slopes = torch.linalg.solve(spread.permute(2, 3, 0, 1), common.permute(1, 2, 0)[..., None])
    slopes = slopes[..., 0].permute(2, 0, 1)
    start = value - (slopes * colours).sum(0)
    lines = mean(torch.cat([slopes / white, start[None]])).to(picture.device)

    def full(x: Tensor) -> Tensor:
        return interpolate(x[None, None], picture.shape[1:], mode="bilinear")[0, 0]

    result = full(lines[3])
    for slope, colour in zip(lines[:3], picture, strict=True):  # one by one: memory is the cost
        result.addcmul_(full(slope), colour.float())
    # regression overshoots: without open water nothing lies beyond 1
    return result.clamp_(0, float(values.max()))
