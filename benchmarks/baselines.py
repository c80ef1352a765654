"""What uwaug is measured against, each written as cleanly and as fast as its recipe allows."""

from itertools import pairwise

import cv2
import kornia
import numpy as np
import torch
from torch import Tensor

BINS = 30


def published(
    image: np.ndarray,
    distance: np.ndarray,
    field: np.ndarray,
    *,
    response: np.ndarray,
    beta: np.ndarray,
    G: np.ndarray,
    light: np.ndarray,
    light_rgb: np.ndarray,
    veil: np.ndarray,
    phi: float,
) -> np.ndarray:
    """The published recipe, with OpenCV: seven-band sums, β_c = −ln T/z, 30 hard bins, 15×15 kernels.

    Its exponentials are shared by the channels and nothing is computed twice: a harder baseline than the published
        loops.

    Args:
        image, distance, field: (H, W, 3), (H, W), (H, W), float32.
        response: (M, 3) camera weights of the M bands; beta, G, light, veil: (M,) per band; light_rgb: (3,).
        phi: px per metre.
    """
    path = distance * field

    def transmission(rates: np.ndarray) -> np.ndarray:
        mean = np.exp(distance[..., None] * -rates) @ response
        per_channel = -np.log(mean) / distance[..., None]
        return np.exp(-per_channel * path[..., None])

    direct_share = transmission(beta)
    forward_share = transmission(G) - direct_share
    lit = image * light_rgb
    direct, unblurred = lit * direct_share, lit * forward_share
    edges = np.linspace(0, path.max(), BINS + 1)
    forward = np.zeros_like(image)
    for near, far in pairwise(edges):
        inside = (path >= near) & (path < far)
        blurred = cv2.GaussianBlur(unblurred, (15, 15), phi * 0.5 * (near + far))
        forward[inside] = blurred[inside]
    smooth = cv2.GaussianBlur(distance, (21, 21), 60) * field
    backscatter = (1 - np.exp(smooth[..., None] * -G)) @ (response * veil[:, None])
    return direct + forward + backscatter


def naive_kornia(
    image: Tensor,
    distance: Tensor,
    field: Tensor,
    *,
    beta: Tensor,
    G: Tensor,
    light: Tensor,
    veil: Tensor,
    phi: float,
) -> Tensor:
    """The recipe as one writes it with kornia: one exponential per channel, 30 `gaussian_blur2d`, masks.

    Args:
        image (Bx3xHxW), distance and field (Bx1xHxW); beta, G, light, veil (3): per channel.
    """
    path = distance * field
    beta, G, light, veil = (v.view(1, 3, 1, 1) for v in (beta, G, light, veil))
    direct_share = torch.exp(-beta * path)
    unblurred = image * light * (torch.exp(-G * path) - direct_share)
    edges = torch.linspace(float(path.min()), float(path.max()) * (1 + 1e-6), BINS + 1)
    forward = torch.zeros_like(image)
    for near, far in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        sigma = phi * 0.5 * (near + far)
        size = 2 * int(np.ceil(3 * sigma)) + 1
        inside = (path >= near) & (path < far)
        forward = (
            forward
            + kornia.filters.gaussian_blur2d(unblurred, (size, size), (sigma, sigma)) * inside
        )
    return image * light * direct_share + forward + veil * (1 - torch.exp(-G * path))
