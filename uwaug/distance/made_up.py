"""Made-up distances, for pictures without maps."""

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from uwaug._support import checks, codec
from uwaug._support.nouns import Drawn
from uwaug._support.ranges import Range
from uwaug.distance import cue
from uwaug.distance.sources import LEAST_NEAR_M, Placed, require_ends

# How it was chosen, and what lost: benchmarks/CHOICES.md, "Made-up distances".

Floats = NDArray[np.float32]

_OPEN_PROBABILITY = 0.75  # of open water where a picture has a place for it
# of a ramp instead: nets learn that water hides by distance, and not that this network is right
_RAMP_PROBABILITY = 0.03
_OPEN = 1.2  # relative distance of open water, whose rim lies at the far end
_LEAST_OPEN_SHARE = 0.03  # of a picture that is surely open water, if any is, and of each patch
# probabilities from which open water is sure, begins around a sure place, and is whole there
_SURE, _OPEN_FROM, _OPEN_TO = 0.7, 0.4, 0.6
_GUIDE_PX = 2  # of the small copy, over which distances follow the picture's colours
_EDGE_VARIANCE = 0.02  # of colours (0…1), below which there is no edge


@codec.plain
@dataclass(frozen=True)
class MadeUp(Placed):
    """Distances made up from each picture alone, drawn anew each time: no maps are needed.

    A small network in the package guesses what is nearer than what, and where open water is, such
    as sky. An exponent, a smooth field, and the presence of open water (in three of four) are
    drawn. Open water lies at the far end; it is endless where near and far are given, or a
    contrast. It is no truth to restore or measure by.

    Attributes:
        near, far: see `Placed`; near above 0.
        cue: "network", with a ramp for one of thirty pictures; or "ramp": what is lower is nearer.
    """

    reads_maps = False
    reads_pictures = True

    cue: Literal["network", "ramp"] = "network"

    def __post_init__(self) -> None:
        require_ends(self.near, self.far, LEAST_NEAR_M)
        checks.one_of("cue", self.cue, ("network", "ramp"))

    def ranges(self) -> dict[str, Range | None]:
        """See `Noun.ranges`. "scene" is the seed of the map."""
        return {**super().ranges(), "scene": (0.0, 1.0)}

    @torch.no_grad()
    def metres(self, distance: Tensor | None, image: Tensor, drawn: Drawn, **view: Any) -> Tensor:
        rng = np.random.default_rng(int(drawn["scene"] * 2**53))
        white = 255 if image.dtype == torch.uint8 else 1
        picture = cue.small_copy(image).float() / white
        guide = avg_pool2d(picture[None], 2)[0].numpy()
        height, width = guide.shape[1:]
        if rng.uniform() < _RAMP_PROBABILITY or self.cue == "ramp":
            log, is_open = np.linspace(1, 0, height)[:, None].repeat(width, 1), np.zeros((1, 1))
        else:
            answers = cue.relative(picture, cue.learnt())
            log, is_open = (answer.double().numpy() for answer in answers)
        small = _varied(log, is_open, rng).astype(np.float32)
        lines = torch.from_numpy(_guided(small, guide)).to(image.device)
        large = _enlarged(lines, *image.shape[1:])
        depth = large[:3].mul_(image).sum(0).div_(white).add_(large[3])
        depth.clamp_(0, float(small.max()))  # without open water nothing lies beyond 1
        near, far = drawn["near"], drawn["far"]
        z = depth.clamp(max=1).mul_(math.log(far / near)).exp_().mul_(near)
        if not drawn.get("hides"):
            z.masked_fill_(depth > (1 + _OPEN) / 2, math.inf)
        return z[None].to(torch.promote_types(image.dtype, torch.float32))


def _varied(log: Any, is_open: Any, rng: np.random.Generator) -> Any:
    """Draw relative distances (HxW), alike to the left and the right: 0 near, 1 far, `_OPEN` open
    water; from their logarithms, up to scale and shift, and probabilities of open water.
    """
    from scipy.ndimage import label

    height, width = log.shape
    openness = np.clip((is_open - _OPEN_FROM) / (_OPEN_TO - _OPEN_FROM), 0, 1)
    patches, _ = label(openness > 0)
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
    return depth + (_OPEN - depth) * openness


def _guided(values: Floats, colours: Floats) -> Floats:
    """In the window around each pixel of a map (hxw), write it as linear in a picture's colours
    (3xhxw): three slopes and a start (4xhxw). He and Sun, arXiv:1505.00996.
    """
    down, across = map(_box, values.shape)
    pixels = np.concatenate([colours, values[None]])
    first, second = np.triu_indices(4)
    means = down @ pixels @ across.T
    moments = down @ (pixels[first] * pixels[second]) @ across.T
    rr, rg, rb, rv, gg, gb, gv, bb, bv, _ = moments - means[first] * means[second]
    rr, gg, bb = (variance + _EDGE_VARIANCE for variance in (rr, gg, bb))
    # 3x3 equations of each pixel by elimination: solvers take ten times as long
    g, b = rg / rr, rb / rr
    gg, gb, gv = gg - g * rg, gb - g * rb, gv - g * rv
    bb, bv = bb - b * rb, bv - b * rv
    g = gb / gg
    blue = (bv - g * gv) / (bb - g * gb)
    green = (gv - gb * blue) / gg
    red = (rv - rg * green - rb * blue) / rr
    slopes = np.stack([red, green, blue])
    start = means[3] - (slopes * means[:3]).sum(0)
    lines: Floats = down @ np.concatenate([slopes, start[None]]) @ across.T
    return lines


def _enlarged(maps: Tensor, height: int, width: int) -> Tensor:
    """Maps (Cxhxw) at another size, linear between their pixels."""
    rows = maps.shape[1]
    wide = interpolate(maps[None], (rows, width), mode="bilinear")[0]
    # `interpolate` of both sides takes three times as long
    index = torch.arange(height, dtype=maps.dtype, device=maps.device)
    places = ((index + 0.5) * (rows / height) - 0.5).clamp(0, rows - 1)
    above = places.long()
    below = (above + 1).clamp(max=rows - 1)
    large = wide.index_select(1, above)
    return large.lerp_(wide.index_select(1, below), (places - above)[:, None])


@cache
def _box(size: int) -> Floats:
    places = np.arange(size)
    window = abs(places[:, None] - places) <= _GUIDE_PX
    box: Floats = (window / window.sum(1, keepdims=True)).astype(np.float32)
    return box
