"""Ways to blur every pixel with a width of its own, for the frontier.

All but `recipe.binned_blur` mirror the image at its edges. Tensors are planar, (1, C, H, W);
arrays are (H, W, C), as OpenCV, SciPy and scikit-image take them.
"""

import math
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from benchmarks.exact import blur_exact
from uwaug.blur.kernels import reflect
from uwaug.blur.plan import BlurPlan
from uwaug.blur.stack import blurred, mixed, node_weights

Array = np.ndarray[Any, Any]
Gaussian = Callable[[Array, float], Array]

_TILE = 64  # px


def planar(out: Tensor | Array) -> Tensor:
    return out if isinstance(out, Tensor) else torch.from_numpy(out).permute(2, 0, 1)[None]


def mirrored(size: int, margin: int) -> Tensor:
    """Indices into an axis of `size` samples that extend it by `margin` on both sides, half-sample
    symmetric.
    """
    return reflect(torch.arange(-margin, size + margin), size)


def exact(image: Tensor, sigma: Tensor, most: int | None = None) -> tuple[Tensor, float]:
    """`blur_exact` tile by tile, each with the surroundings that it reaches; and the time of all
    tiles, ms.

    With `most`, only so many tiles along the diagonal are done, and the time is scaled up.
    """
    h, w = image.shape[-2:]
    reach = math.ceil(8 * float(sigma.max())) + 1
    rows, columns = mirrored(h, reach), mirrored(w, reach)
    padded, widths = (t[0][:, rows][:, :, columns].double() for t in (image, sigma))
    out = image.new_zeros(image.shape, dtype=torch.float64)
    corners = [(y, x) for y in range(0, h, _TILE) for x in range(0, w, _TILE)]
    used = corners if most is None else corners[:: max(1, len(corners) // most)]
    began = time.perf_counter()
    for y, x in used:
        tile = out[0, :, y : y + _TILE, x : x + _TILE]
        _, th, tw = tile.shape
        window = (slice(y, y + th + 2 * reach), slice(x, x + tw + 2 * reach))
        down, across = reach + torch.arange(th)[:, None], reach + torch.arange(tw)
        at = (down * (tw + 2 * reach) + across).flatten()
        tile.copy_(blur_exact(padded[:, *window], widths[0][window], at).reshape(tile.shape))
    return out, 1e3 * (time.perf_counter() - began) * len(corners) / len(used)


def stack(image: Tensor, sigma: Tensor, plan: BlurPlan) -> Tensor:
    """Our stack."""
    return mixed(blurred(image, plan), node_weights(sigma, plan))


def stack_opencv(image: Tensor, sigma: Tensor, plan: BlurPlan) -> Tensor:
    """Our widths and weights, but every blur by OpenCV at full size."""
    planes = image[0].numpy()
    blurs = []
    for s in plan.sigmas:
        size = 2 * math.ceil(plan.reach * s) + 1
        blur = planes
        if s > 0:
            border = cv2.BORDER_REFLECT
            done = [cv2.GaussianBlur(c, (size, size), s, borderType=border) for c in planes]
            blur = np.stack(done)
        blurs.append(torch.from_numpy(blur)[None])
    return mixed(blurs, node_weights(sigma, plan))


def opencv_gaussian(image: Array, sigma: float) -> Array:
    return cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)


def scipy_gaussian(image: Array, sigma: float) -> Array:
    from scipy.ndimage import gaussian_filter

    return gaussian_filter(image, (sigma, sigma, 0), mode="reflect")


def skimage_gaussian(image: Array, sigma: float) -> Array:
    from skimage.filters import gaussian

    return gaussian(image, sigma, mode="reflect", channel_axis=-1)


def hard_bins(image: Array, sigma: Array, bins: int, gaussian: Gaussian) -> Array:
    """Each pixel from the blur of the nearest of `bins` widths, the middles of equal intervals."""
    low, high = float(sigma.min()), float(sigma.max())
    step = (high - low) / bins
    number = np.minimum(((sigma - low) * (1 / step)).astype(np.int32), bins - 1)
    out = np.empty_like(image)
    for k in range(bins):
        inside = number == k
        out[inside] = gaussian(image, low + (k + 0.5) * step)[inside]
    return out


def hard_bins_kornia(image: Tensor, sigma: Tensor, bins: int) -> Tensor:
    from kornia.filters import gaussian_blur2d

    low, high = float(sigma.min()), float(sigma.max())
    step = (high - low) / bins
    number = ((sigma - low) * (1 / step)).int().clamp(max=bins - 1)
    # kornia has no half-sample symmetric border
    margin = math.ceil(3 * high)
    rows, columns = (mirrored(n, margin) for n in image.shape[-2:])
    padded = image[..., rows, :][..., columns]
    inner = (..., slice(margin, -margin), slice(margin, -margin))
    out = torch.zeros_like(image)
    for k in range(bins):
        s = low + (k + 0.5) * step
        size = 2 * math.ceil(3 * s) + 1
        size = min(size, 2 * min(padded.shape[-2:]) - 1)
        blur = gaussian_blur2d(padded, (size, size), (s, s), border_type="replicate")
        out += blur[inner] * (number == k)
    return out


def linear_bins(image: Array, sigma: Array, nodes: int) -> Array:
    """Each pixel interpolated linearly in σ between the two nearest of `nodes` blurs, by OpenCV."""
    low, high = float(sigma.min()), float(sigma.max())
    place = (sigma - low) * ((nodes - 1) / (high - low))
    out = np.zeros_like(image)
    for k in range(nodes):
        weight = np.maximum(1 - np.abs(place - k), 0)
        blur = opencv_gaussian(image, low + k * (high - low) / (nodes - 1))
        out += weight[..., None] * blur
    return out


def two_passes(image: Tensor, sigma: Tensor) -> Tensor:
    """Along rows, then along columns, each with the pixel's own width: inexact, as the second pass
    reads pixels that the first blurred with other widths.
    """
    reach = math.ceil(3 * float(sigma.max()))
    rate = -0.5 * math.log2(math.e) / sigma**2
    weights = [torch.exp2(rate * n**2) for n in range(reach + 1)]
    total = 1 / (2 * sum(weights[1:]) + 1)
    for axis in (-1, -2):
        size = image.shape[axis]
        padded = image.index_select(axis, mirrored(size, reach))
        image = image.clone()
        for n in range(1, reach + 1):
            pair = padded.narrow(axis, reach - n, size) + padded.narrow(axis, reach + n, size)
            image.addcmul_(weights[n], pair)
        image.mul_(total)
    return image
