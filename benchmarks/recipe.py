"""The published recipe, as cleanly and as fast as it allows, and as one writes it with kornia.

Its bands: 400 to 700 nm in steps of 50; the scene is lit at 600, 550 and 450 nm; g = .2, μ = .3,
1 m deep. It takes sRGB values for light, and σ ∝ z.
"""

from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import cv2
import kornia
import numpy as np
import torch
from torch import Tensor

import uwaug

Array = np.ndarray[Any, Any]

BINS = 30
WAVELENGTHS = np.arange(400.0, 701.0, 50.0)  # nm
CHANNELS = [4, 3, 1]  # 600, 550 and 450 nm of these
SIDE, MU, DEPTH = 0.2, 0.3, 1.0  # g, μ, m
SCALE = 0.3  # px for each scattering length


class Bands(NamedTuple):
    """What the recipe knows of a water and a camera.

    Attributes:
        beta, G, veil (M): of each of M bands; the veil at infinite distance.
        light (3): that reaches the scene, of the channels.
        response (M, 3): what the camera makes of the bands.
        phi: width of the blur, px for each metre.
    """

    beta: Array
    G: Array
    veil: Array
    light: Array
    response: Array
    phi: float


def bands(water: str, phi: float | None = None) -> Bands:
    """Those of a Jerlov type, in float32; of another `phi` if one is given."""
    found = _coefficients(water)
    light = found["light"][CHANNELS]
    response = uwaug.load_camera("Nikon 5100 (NPL)").weights(WAVELENGTHS)
    arrays = (found["beta"], found["G"], found["veil"], light, response)
    if phi is None:
        phi = SCALE * float(uwaug.Water.jerlov(water).at(WAVELENGTHS).b.mean())
    return Bands(*(values.astype(np.float32) for values in arrays), phi)


def three_wavelengths(water: str) -> dict[str, Tensor]:
    """Coefficients of the channels, (3) each, taken at one wavelength for each."""
    found = _coefficients(water)
    return {name: torch.from_numpy(values[CHANNELS]) for name, values in found.items()}


def _coefficients(water: str) -> dict[str, Array]:
    seven = uwaug.Water.jerlov(water).at(WAVELENGTHS)
    light = np.exp(-seven.kd * DEPTH)
    G = seven.a + SIDE * seven.b
    veil = MU * seven.b * light / G
    return {"beta": seven.a + seven.b, "G": G, "veil": veil, "light": light}


def field(height: int, width: int, rng: np.random.Generator) -> Array:
    """Periodic Gaussian random field, scaled to 0.7…1.3 and divided by its mean."""
    noise = rng.standard_normal((height, width), dtype=np.float32)
    spectrum = np.fft.rfft2(noise) * _amplitudes(height, width)
    waves = np.fft.irfft2(spectrum, s=(height, width))
    low, high = waves.min(), waves.max()
    values = 0.7 + 0.6 * (waves - low) / (high - low)
    return (values / values.mean()).astype(np.float32, copy=False)


@lru_cache(maxsize=8)
def _amplitudes(height: int, width: int) -> Array:
    k = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    k[0, 0] = np.inf
    return (k**-2).astype(np.float32)


def binned_blur(image: Array, width: Array, phi: float = 1.0) -> Array:
    """Each pixel from one of 30 blurs, of equal steps from 0 to the widest, with 15×15 kernels.

    The widest pixels fall out of the last bin and stay black, as published.

    Args:
        image (HxWx3 array), width (HxW array): float32.
        phi: px for each unit of `width`.
    """
    out = np.zeros_like(image)
    edges = np.linspace(0, width.max(), BINS + 1)
    for low, high in pairwise(edges):
        inside = (width >= low) & (width < high)
        blurred = cv2.GaussianBlur(image, (15, 15), phi * 0.5 * (low + high))
        out[inside] = blurred[inside]
    return out


def published(image: Array, distance: Array, field: Array, bands: Bands) -> Array:
    """The published recipe, with OpenCV: sums over the bands, β_c = −ln T/z, 30 hard bins, 15×15
    kernels.

    Its exponentials are shared by the channels and nothing is computed twice: a harder baseline
    than the published loops.

    Args:
        image, distance, field: (H, W, 3), (H, W), (H, W), float32.
        bands: in float32.
    """
    path = distance * field

    def transmission(rates: Array) -> Array:
        mean = np.exp(distance[..., None] * -rates) @ bands.response
        per_channel = -np.log(mean) / distance[..., None]
        return np.exp(-per_channel * path[..., None])

    direct_share = transmission(bands.beta)
    forward_share = transmission(bands.G) - direct_share
    lit = image * bands.light
    direct, unblurred = lit * direct_share, lit * forward_share
    forward = binned_blur(unblurred, path, bands.phi)
    smooth = cv2.GaussianBlur(distance, (21, 21), 60) * field
    arrived = 1 - np.exp(smooth[..., None] * -bands.G)
    backscatter = arrived @ (bands.response * bands.veil[:, None])
    return direct + forward + backscatter


def naive_kornia(
    image: Tensor, distance: Tensor, field: Tensor, channels: dict[str, Tensor], phi: float
) -> Tensor:
    """The recipe as one writes it with kornia: one exponential per channel, 30 `gaussian_blur2d`,
    masks.

    Args:
        image (Bx3xHxW), distance and field (Bx1xHxW).
        channels: see `three_wavelengths`, of the image's type.
        phi: px for each metre.
    """
    path = distance * field
    names = ("beta", "G", "light", "veil")
    beta, G, light, veil = (channels[name].view(1, 3, 1, 1) for name in names)
    direct_share = torch.exp(-beta * path)
    unblurred = image * light * (torch.exp(-G * path) - direct_share)
    edges = torch.linspace(float(path.min()), float(path.max()) * (1 + 1e-6), BINS + 1)
    forward = torch.zeros_like(image)
    for near, far in pairwise(edges.tolist()):
        sigma = phi * 0.5 * (near + far)
        size = 2 * int(np.ceil(3 * sigma)) + 1
        inside = (path >= near) & (path < far)
        blurred = kornia.filters.gaussian_blur2d(unblurred, (size, size), (sigma, sigma))
        forward = forward + blurred * inside
    return image * light * direct_share + forward + veil * (1 - torch.exp(-G * path))
