"""Referees for the blur: each pixel blurred by itself, in float64. Slow."""

import math

import numpy as np
import torch
from scipy.fft import dctn, idctn
from torch import Tensor

from uwaug.blur.kernels import sampled_parameter


def blur_exact(image: Tensor, sigma: Tensor, at: Tensor | None = None) -> Tensor:
    """Each pixel from its own sampled, normalised Gaussian: no stack, no grids, cut at 8σ.

    Args:
        image (CxHxW tensor): any float type.
        sigma (HxW tensor): widths, px, ≥ 0.
        at (P int64 tensor): flat indices of the pixels wanted; all by default.

    Returns:
        (CxP) float64 tensor.
    """
    c, h, w = image.shape
    at = torch.arange(h * w) if at is None else at
    image, flat = image.double(), sigma.double().flatten()
    out = image.new_empty(c, len(at))
    order = flat[at].argsort()  # neighbours in width share the reach of their kernels
    for chunk in torch.split(order, 2048):
        pixels = at[chunk]
        rows = gaussian_rows(pixels // w, flat[pixels], h)
        columns = gaussian_rows(pixels % w, flat[pixels], w)
        for channel in range(c):
            out[channel, chunk] = ((rows @ image[channel]) * columns).sum(1)
    return out


def gaussian_rows(centres: Tensor, sigma: Tensor, size: int) -> Tensor:
    """Rows of sampled, normalised Gaussians of variance sigma² on a half-sample symmetric axis.

    Args:
        centres (P float64 tensor): sample positions.
        sigma (P float64 tensor): widths in px, ≥ 0; 0 gives the unit impulse.
        size: samples of the axis.

    Returns:
        (P, size) float64 tensor whose rows sum to 1.
    """
    reach = int(torch.ceil(8 * sigma.max()).item()) if sigma.numel() else 0
    offsets = torch.arange(-reach, reach + 1, dtype=torch.float64)
    parameter = torch.from_numpy(sampled_parameter(sigma.numpy()))
    taps = torch.exp(-0.5 * (offsets / parameter[:, None]) ** 2)
    folded = (centres[:, None].long() + offsets.long()) % (2 * size)
    folded = torch.where(folded < size, folded, 2 * size - 1 - folded)
    rows = torch.zeros(len(centres), size, dtype=torch.float64).scatter_add_(1, folded, taps)
    return rows / rows.sum(1, keepdim=True)


def exact_exponential(image: Tensor, sigma: Tensor, at: Tensor) -> Tensor:
    """As `blur_exact`, under each pixel's own e^(−2πσf): a sum of the picture's cosine waves."""
    _, h, w = image.shape
    waves = dctn(image.double().numpy(), axes=(1, 2), norm="ortho")
    down, across = (idctn(np.eye(n), axes=(0,), norm="ortho") for n in (h, w))
    f = np.hypot(np.arange(h)[:, None] / (2 * h), np.arange(w) / (2 * w))
    out = np.empty((len(image), len(at)))
    for n, p in enumerate(at.tolist()):
        width = float(sigma.flatten()[p])
        # what is left out is down to e^−40
        highest = 40 / (np.pi * max(width, 1e-9))
        k, m = (min(size, math.ceil(highest * size)) for size in (h, w))
        spent = waves[:, :k, :m] * np.exp(-2 * np.pi * width * f[:k, :m])
        out[:, n] = down[p // w, :k] @ spent @ across[p % w, :m]
    return torch.from_numpy(out)
