"""Distances of pictures that have no maps: made up."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from uwaug._support import codec
from uwaug._support.ranges import Range
from uwaug.distance.sources import Numbers, Source, require_ends

# How it was chosen, and what lost: benchmarks/README.md, "Made-up distances".

_SMALL_PIXELS = 4096
"""Of the copy in which regions are found."""

_REGION_SCALE = 200.0
"""Of felzenszwalb: some 33 regions; 60 halves things."""

_PLAIN_STEP = 0.06
"""Difference of neighbours in a plain place, of 0…1."""

_LEAST_OPEN_SHARE = 0.05
"""Of a picture that open water takes, where there is any."""

_OPEN_PROBABILITY = 0.75
"""That a plain top is open water."""

_FADE_SHARE = 0.2
"""Of the height, over which open water begins where the picture has no edge."""

_GUIDE_PX = 2
"""Of the small copy, over which its distances follow the picture's colours."""

_EDGE_VARIANCE = 1e-3
"""Of colours, of 0…1, below which there is no edge."""


@codec.plain
@dataclass(frozen=True)
class MadeUp(Source):
    """No maps: each picture gets distances made up from itself alone, drawn anew each time.

    A ground with a horizon; regions of like colour that stand on it, each at a distance of its own;
    a smooth field; open water behind, in three of four pictures, where the top is plain. Distances
    step where the picture has edges. All is scaled, in the logarithm, to reach from near to far.

    The depth cue is invented: things that look far to you may be near here. It teaches a network
    that water hides some things more than others, which is good for robustness; it is no truth to
    restore pictures by, or to measure. Pictures are sRGB, as thresholds of its colours are.

    Attributes:
        near, far: m; numbers or (low, high), near above 0.
    """

    reads_maps = False
    reads_pictures = True

    near: Range = (0.5, 2.0)
    far: Range = (2.5, 12.0)

    def __post_init__(self) -> None:
        if require_ends(self.near, self.far) == 0:
            raise ValueError(f"near must lie above 0 m, as its logarithm counts, got {self.near}")

    def ranges(self) -> dict[str, Range]:
        """See `Source.ranges`; all else that is random follows from "scene"."""
        return {"near": self.near, "far": self.far, "scene": (0.0, 1.0)}

    @torch.no_grad()
    def metres(self, distance: Tensor | None, image: Tensor, numbers: Numbers) -> Tensor:
        """See `Source.metres`."""
        white = 255.0 if image.dtype == torch.uint8 else 1.0
        scale = min(1.0, math.sqrt(_SMALL_PIXELS / image[0].numel()))
        size = [max(1, round(scale * side)) for side in image.shape[1:]]
        every = max(1, int(0.25 / scale))  # four samples along each side of a small pixel will do
        sampled = image[:, ::every, ::every].float() / white
        small = interpolate(sampled[None], size, mode="area")[0].cpu()
        rng = np.random.default_rng(int(numbers["scene"] * 2**53))
        layout = torch.from_numpy(_layout(small.permute(1, 2, 0).double().numpy(), rng))
        depth = _upsampled(layout.float(), small, image, white)
        near, far = numbers["near"], numbers["far"]
        z = depth.clamp(max=1).mul_(math.log(far / near)).exp_().mul_(near)
        # open water from 1.05, endless from 1.95: regression meets neither end exactly
        z.div_(depth.neg_().add_(1.95).div_(0.9).clamp_(0, 1))
        return z[None].to(torch.promote_types(image.dtype, torch.float32))


def _layout(picture: Any, rng: np.random.Generator) -> Any:
    """How far each pixel of a small picture (HxWx3) is: 0 nearest, 1 farthest, 2 open water."""
    height, width, _ = picture.shape
    y = np.broadcast_to((np.arange(height)[:, None] + 0.5) / height, (height, width))
    x = np.broadcast_to((np.arange(width) + 0.5) / width, (height, width))
    regions = _regions(picture)
    flat, sizes = regions.ravel(), np.bincount(regions.ravel())

    steps = np.abs(np.diff(picture, axis=0, prepend=picture[:1])).max(-1)
    steps = np.maximum(steps, np.abs(np.diff(picture, axis=1, prepend=picture[:, :1])).max(-1))
    plain = np.logical_and.accumulate(steps < _PLAIN_STEP, axis=0)
    mostly = np.bincount(flat, plain.ravel()) > sizes / 2
    lowest = rng.uniform(0.3, 0.8)
    open_water = mostly[regions] * np.clip((lowest - y) / _FADE_SHARE, 0, 1)
    horizon = rng.uniform(-1, 0.4)
    closed = rng.uniform() > _OPEN_PROBABILITY or open_water.mean() < _LEAST_OPEN_SHARE
    if closed or open_water.min() > 0:  # of a row of pixels, say
        open_water[:] = 0
    else:
        below = (open_water > 0).sum(0)
        horizon = np.median(below[below > 0]) / height

    # a plane, in the logarithm; above its horizon all is far
    slant = rng.normal(0, 0.12) * (x - 0.5)
    ground = -np.log(np.maximum(y - horizon + slant, 0) + 0.08)
    foot = np.full(len(sizes), np.inf)
    np.minimum.at(foot, flat, ground.ravel())
    standing = rng.uniform()
    depth = ground + standing * (foot[regions] - ground)
    own = rng.uniform(0.1, 0.5) * rng.normal(size=len(sizes))[regions]
    waves, phases = rng.normal(0, 3, (2, 6)), rng.uniform(0, 2 * np.pi, 6)
    cosines = np.cos(waves[0] * x[..., None] + waves[1] * y[..., None] + phases)
    smooth = rng.uniform(0, 0.15) * cosines.sum(-1)
    depth += max(np.ptp(ground), 0.5) * (own + smooth)

    solid = depth[open_water < 0.5]
    low, high = np.percentile(solid, (1, 99)) if solid.size else (0.0, 0.0)
    depth = np.clip((depth - low) / (high - low), 0, 1) if high > low else np.full_like(depth, 0.5)
    return depth + (2 - depth) * open_water


def _regions(picture: Any) -> Any:
    """The number of each pixel's region of like colour (HxW). What is nowhere three pixels wide is
    the blur of an edge, and goes to the nearest region: distances of its own would be a seam.
    """
    from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter
    from skimage.segmentation import felzenszwalb

    regions = felzenszwalb(picture, _REGION_SCALE, 0.5, max(1, picture[..., 0].size // 300))
    inner = minimum_filter(regions, 3) == maximum_filter(regions, 3)
    wide = (np.bincount(regions.ravel(), inner.ravel()) > 0)[regions]
    if not wide.any():
        return regions
    rows, columns = distance_transform_edt(~wide, return_distances=False, return_indices=True)
    return regions[rows, columns]


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
