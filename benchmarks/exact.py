"""Referees for the blur: each pixel blurred by itself, in float64. Slow."""

import torch
from torch import Tensor

from uwaug.blur.banded import sampled_parameter


def blur_exact(image: Tensor, sigma: Tensor, at: Tensor | None = None) -> Tensor:
    """The reference: each pixel from its own sampled, normalised Gaussian, in float64. Slow: no stack, no grids, cut at
    8σ.

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
    """Rows of sampled, normalised Gaussians of variance sigma² on a half-sample symmetric axis: the exact reference.

    Args:
        centres (P float64 tensor): sample positions.
        sigma (P float64 tensor): widths in px, ≥ 0; 0 gives the unit impulse.
        size (int): samples of the axis.

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
