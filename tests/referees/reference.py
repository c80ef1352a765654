"""What the package is held against: float64 NumPy and SciPy, written straight from the
equations.
"""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.fft import dctn, idctn
from scipy.ndimage import gaussian_filter
from scipy.stats import halfnorm

from uwaug.optics.camera import load_camera
from uwaug.optics.water import Water

BANDS = np.arange(400.0, 701.0, 5.0)  # nm; 61 of them
NIKON = "Nikon 5100 (NPL)"


class Curves(NamedTuple):
    """T_β, T_G and the veil, each (3, …) over distances (…); of surfaces with spectra, T_β and T_G
    are matrices (3, 3, …).
    """

    direct: np.ndarray
    signal: np.ndarray
    veil: np.ndarray


def spectral_curves(
    water: Water,
    z: np.ndarray,
    *,
    depth: float,
    g: float,
    mu: float,
    bands: np.ndarray = BANDS,
    camera: np.ndarray | None = None,
) -> Curves:
    """The three integrals over wavelength as sums over the bands; `camera` (bands x 3): weights of
    each band, by default those of a Nikon.
    """
    z = np.asarray(z, dtype=np.float64)[..., None]
    bulk = water.at(bands)
    camera = load_camera(NIKON).weights(bands) if camera is None else camera
    light = camera * np.exp(-bulk.kd * depth)[:, None]
    beta, G = bulk.a + bulk.b, bulk.a + g * bulk.b
    with np.errstate(divide="ignore", invalid="ignore"):
        # (1 − e^(−Gz))/G, and z where G = 0
        column = np.where(G * z > 0, -np.expm1(-G * z) / G, z)
    terms = (np.exp(-beta * z) @ light, np.exp(-G * z) @ light, (mu * bulk.b * column) @ light)
    return Curves(*(np.moveaxis(t, -1, 0) for t in terms))


def medium_curves(medium: Any, z: np.ndarray, row: int = 0) -> Curves:
    """The curves of one row of a `Medium`, from its rates and weights; z = inf is the limit."""

    def array(tensor: torch.Tensor) -> np.ndarray:
        return tensor[row].detach().double().numpy()

    rates, scatter = array(medium.beta), array(medium.G)
    direct, signal = array(medium.direct_weights), array(medium.signal_weights)
    veil = array(medium.veil_weights)

    def depth(r: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            product = np.asarray(z, dtype=np.float64)[..., None] * r
        return np.where(r == 0, 0, product)

    near, far = np.exp(-depth(rates)), np.exp(-depth(scatter))
    return Curves(
        np.tensordot(direct, near, (-1, -1)),
        np.tensordot(signal, far, (-1, -1)),
        np.tensordot(veil, -np.expm1(-depth(scatter)), (-1, -1)),
    )


def matched(sigma: np.ndarray) -> np.ndarray:
    """Parameters s (N) of the sampled Gaussians whose variances are sigma² (N); sigma itself from
    .75 px on, to 1e-3. By Newton's method for the logarithm of the variance over −1/(2s²), which
    is almost a straight line.
    """
    parameter = sigma.astype(np.float64)
    narrow = (sigma > 1e-100) & (sigma < 0.75)
    wanted = 2 * np.log(parameter[narrow])[:, None]
    squares = np.arange(1, 13) ** 2
    power = wanted - math.log(2)  # where only the taps at ±1 px count
    for _ in range(20):
        taps = np.exp(power * squares)
        total = 0.5 + taps.sum(1, keepdims=True)
        variance = (squares * taps).sum(1, keepdims=True) / total
        fourth = (squares**2 * taps).sum(1, keepdims=True) / total
        power = power - (np.log(variance) - wanted) / (fourth / variance - variance)
    parameter[narrow] = np.sqrt(-0.5 / power[:, 0])
    return parameter


def gaussian_rows(centres: np.ndarray, sigma: np.ndarray, size: int) -> np.ndarray:
    """(P, size): sampled, normalised Gaussians on an axis continued by half-sample mirror
    images.
    """
    # the mean by then: the lowest frequency is down to e^(−44)
    sigma = np.minimum(sigma, 3.0 * size)
    reach = 9.0 * float(sigma.max(initial=0)) + 1
    turns = math.ceil(reach / (2 * size)) + 1
    sample = np.arange(size)
    images = [n + 2 * size * k for k in range(-turns, turns + 1) for n in (sample, -1 - sample)]
    width = np.maximum(sigma, 1e-3)[:, None]
    rows = sum(np.exp(-0.5 * ((n - centres[:, None]) / width) ** 2) for n in images)
    return rows / rows.sum(1, keepdims=True)


def varying_gaussian(
    image: np.ndarray, sigma: np.ndarray, at: np.ndarray | None = None
) -> np.ndarray:
    """(C, P): pixels `at` (flat indices; all by default) of an image (C, H, W), each under its own
    Gaussian.
    """
    c, h, w = image.shape
    at = np.arange(h * w) if at is None else at
    wide = np.broadcast_to(sigma, (h, w)).reshape(-1)[at]
    values, where = np.unique(wide, return_inverse=True)
    wide = matched(values)[where]
    out = np.empty((c, len(at)))
    for chunk in np.array_split(np.argsort(wide), math.ceil(len(at) / 1024)):
        rows = gaussian_rows(at[chunk] // w, wide[chunk], h)
        columns = gaussian_rows(at[chunk] % w, wide[chunk], w)
        for channel, plane in zip(out, image, strict=True):
            channel[chunk] = ((rows @ plane) * columns).sum(1)
    return out


def gaussian(image: np.ndarray, sigma: float) -> np.ndarray:
    """(C, H, W) under one Gaussian, by SciPy; by its transfer function where sampling no longer
    shows.
    """
    if sigma < 4:
        width = float(matched(np.array([sigma]))[0])
        return gaussian_filter(image, (0, width, width), mode="reflect", truncate=9)
    _, h, w = image.shape
    squared = np.add.outer((np.arange(h) / (2 * h)) ** 2, (np.arange(w) / (2 * w)) ** 2)
    transfer = np.exp(-2 * (np.pi * sigma) ** 2 * squared)
    return idctn(dctn(image, axes=(1, 2)) * transfer, axes=(1, 2))


@lru_cache
def mixed_waves(h: int, w: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Widths s at steps of 2 %, and what a Gaussian of each leaves of the cosine waves of either
    axis.
    """
    widths = np.exp(np.arange(math.log(0.04), math.log(1e5), 0.02))
    axes = []
    for size in (h, w):
        f = np.arange(size) / (2 * size)
        rows = np.exp(-2 * (np.pi * np.outer(widths, f)) ** 2)
        n = np.arange(-36, 37)
        for row, width in zip(rows, matched(widths[widths < 4]), strict=False):
            taps = np.exp(-0.5 * (n / width) ** 2) if width else 1.0 * (n == 0)
            row[:] = taps @ np.cos(2 * np.pi * np.outer(n, f)) / taps.sum()
        axes.append(rows)
    return widths, axes[0], axes[1]


def exponential_waves(sigma: float, h: int, w: int) -> np.ndarray:
    """What the transfer function e^(−2πσf) leaves of each cosine wave; below 2 px what the mixture
    of sampled Gaussians leaves that it stands for, of widths σ/|N(0, 1)|.
    """
    if sigma >= 2:
        f = np.hypot(np.arange(h)[:, None] / (2 * h), np.arange(w)[None] / (2 * w))
        return np.exp(-2 * np.pi * sigma * f)
    widths, down, across = mixed_waves(h, w)
    edges = np.sqrt(widths[1:] * widths[:-1])
    # share of widths below the edge above each
    below = np.concatenate([halfnorm.sf(sigma / edges), [1.0]])
    return (down * np.diff(below, prepend=0)[:, None]).T @ across


def exponential(image: np.ndarray, sigma: float) -> np.ndarray:
    """(C, H, W) under one exponential shape. Half-sample mirrors make it diagonal in the cosine
    transform.
    """
    waves = exponential_waves(sigma, *image.shape[1:])
    return idctn(dctn(image, axes=(1, 2)) * waves, axes=(1, 2))


def varying_exponential(image: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """(C, H·W): each pixel of an image (C, H, W) under its own exponential shape, as a sum of its
    cosine waves.
    """
    _, h, w = image.shape
    waves = dctn(image, axes=(1, 2), norm="ortho")
    down, across = (idctn(np.eye(n), axes=(0,), norm="ortho") for n in (h, w))
    out = np.empty((len(image), h * w))
    for p, width in enumerate(np.broadcast_to(sigma, (h, w)).reshape(-1)):
        kept = waves * exponential_waves(float(width), h, w)
        out[:, p] = down[p // w] @ kept @ across[p % w]
    return out


def terms(
    J: np.ndarray,
    z: np.ndarray,
    curves: Curves,
    sigma: np.ndarray,
    shape: str = "gaussian",
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Direct, forward and backscatter of one image (3, H, W)."""
    share = curves.signal - curves.direct
    blur = varying_exponential if shape == "exponential" else varying_gaussian
    scattered = passed(share, blur(J, sigma).reshape(J.shape))
    return passed(curves.direct, J), scattered, curves.veil


def passed(T: np.ndarray, J: np.ndarray) -> np.ndarray:
    """What numbers of three channels (3, H, W), or matrices (3, 3, H, W), leave of colours."""
    return T * J if T.ndim == 3 else (T * J).sum(1)


def picture(height: int, width: int, seed: int = 0, channels: int = 3) -> np.ndarray:
    """A picture (C, H, W) as pictures are: power ∝ 1/f², mean ½, standard deviation ¼ (a single
    pixel: 0).
    """
    noise = np.random.default_rng(seed).standard_normal((channels, height, width))
    f = np.hypot(np.arange(height)[:, None] / height, np.arange(width)[None] / width)
    f[0, 0] = math.inf
    image = idctn(noise / f, axes=(1, 2))
    spread = image.std((1, 2), keepdims=True)
    return 0.5 + 0.25 * image / np.where(spread > 0, spread, 1)


def psnr(x: torch.Tensor | np.ndarray, y: torch.Tensor | np.ndarray) -> float:
    """Decibel, for a peak of 1."""
    error = np.asarray(x, dtype=np.float64) - np.asarray(y, dtype=np.float64)
    return -10 * math.log10(max(float((error**2).mean()), 1e-30))
