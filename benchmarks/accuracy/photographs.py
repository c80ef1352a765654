"""How near do draws lie to real underwater photographs? 26 numbers of a picture, of which 12 hang
on the water more than on the scene, and five shares of two clouds of such numbers:

    recall            photographs inside the cloud of draws (Kynkäänniemi et al. 2019)
    coverage          photographs with a draw among their nearest neighbours (Naeem et al. 2020)
    precision         draws inside the cloud of photographs
    clipped density   draws that might be photographs (Salvy et al. 2025, arXiv 2507.01761)
    clipped coverage  draws that would cover as much, were they photographs (the same)

`results/photographs.csv` holds the numbers of 342 photographs of UIEB, RUIE, LSUI, U45, OceanDark,
and of the test sets of EUVP, UFO and SUIM; without those that a network made.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.distance import cdist
from scipy.stats import betabinom
from skimage.color import rgb2lab

from benchmarks.harness import RESULTS
from uwaug.transforms.appearance import WATER_FEATURES, correlation, water_features

Numbers = NDArray[np.float64]
Picture = NDArray[np.uint8]

MEASURES = ("recall", "coverage", "precision", "clipped density", "clipped coverage")

_NEIGHBOURS = 5
_SPLITS = 12
_MOST_OF_A_GROUP = 100
_MOST = 280


def load_photographs() -> tuple[Numbers, list[str], NDArray[Any]]:
    """Numbers of the photographs (N×26), their names, and the set of each photograph (N)."""
    text = (RESULTS / "photographs.csv").read_text()
    head, *lines = (line.split(",") for line in text.splitlines())
    numbers = np.array([line[2:] for line in lines], np.float64)
    return numbers, head[2:], np.array([line[1] for line in lines])


def numbers_of(picture: Picture) -> dict[str, float]:
    """26 numbers of a picture (HxWx3, sRGB, short side 256 px), by name."""
    srgb = picture.astype(np.float32) / 255
    lab = rgb2lab(srgb)
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    luminance = (linear @ np.array([0.2126, 0.7152, 0.0722]) + 0.002).astype(np.float32)
    return {
        **water_features(srgb),
        **_of_colour(srgb, lab),
        **_of_detail(lab[..., 0], luminance),
        "clip_hi": float(np.sqrt((picture.max(2) >= 253).mean())),
        "clip_lo": float(np.sqrt((picture.min(2) <= 2).mean())),
        **_of_layout(luminance),
    }


def _of_colour(srgb: Numbers, lab: Numbers) -> dict[str, float]:
    L, a, b = lab[..., 0], lab[..., 1], lab[..., 2]
    spread = srgb.reshape(-1, 3).std(0) + 0.004
    low, high = np.percentile(L, [5, 95])
    return {
        "L_p5": low,
        "L_p95": high,
        "ab_spread": np.sqrt(a.var() + b.var()),
        "sd_BG": np.log2(spread[2] / spread[1]),
        "corr_BG": correlation(srgb[..., 2], srgb[..., 1]),
        "rms": L.std() / 100,
    }


def _quarter(x: NDArray[np.float32]) -> NDArray[np.float32]:
    height, width = (size // 4 for size in x.shape)
    cut = x[: height * 4, : width * 4]
    small: NDArray[np.float32] = cut.reshape(height, 4, width, 4).mean((1, 3))
    return small


def _local_contrast(x: NDArray[Any], square: NDArray[Any], sigma: float) -> float:
    mean = gaussian_filter(x, sigma)
    variance = np.maximum(gaussian_filter(square, sigma) - mean * mean, 0)
    return float(np.log2(np.median(np.sqrt(variance) / mean) + 0.004))


def _of_detail(L: Numbers, luminance: NDArray[np.float32]) -> dict[str, float]:
    small, small_square = (_quarter(x) for x in (luminance, luminance * luminance))
    numbers = {
        "loc2": _local_contrast(luminance, luminance * luminance, 2.0),
        "loc6": _local_contrast(small, small_square, 1.5),
        "loc18": _local_contrast(small, small_square, 4.5),
    }
    side = min(L.shape)
    top, left = ((size - side) // 2 for size in L.shape)
    middle = L[top : top + side, left : left + side]
    window = np.hanning(side)[:, None] * np.hanning(side)
    power = np.abs(np.fft.fft2((middle - middle.mean()) * window)) ** 2
    frequency = np.fft.fftfreq(side)
    ring = np.round(np.hypot(frequency[:, None], frequency) * side).astype(int).ravel()
    radial = np.bincount(ring, power.ravel()) / np.maximum(np.bincount(ring), 1)
    radius = np.arange(len(radial)) / side
    used = (radius > 0.03) & (radius < 0.35)
    numbers["slope"] = np.polyfit(np.log(radius[used]), np.log(radial[used] + 1e-3), 1)[0]
    return numbers


def _of_layout(luminance: NDArray[np.float32]) -> dict[str, float]:
    height, width = luminance.shape
    third = height // 3
    y, x = np.mgrid[:height, :width]
    radius = np.hypot((y - height / 2) / (height / 2), (x - width / 2) / (width / 2))
    return {
        "top_bottom": np.log2(luminance[:third].mean() / luminance[-third:].mean()),
        "centre_edge": np.log2(luminance[radius < 0.5].mean() / luminance[radius > 1.05].mean()),
    }


def closeness(draws: list[dict[str, float]], sets: Sequence[str] = ()) -> Numbers:
    """`MEASURES` of draws, each by all numbers of a picture and by those of water (5x2); by the
    photographs of some sets, or of all.
    """
    photographs, names, groups = load_photographs()
    drawn = np.array([[numbers[name] for name in names] for numbers in draws])
    real, drawn = standardised(photographs, drawn, groups)
    chosen = np.isin(groups, sets or groups)
    real, groups = real[chosen], groups[chosen]
    water = [names.index(name) for name in WATER_FEATURES]
    of_water = _shares(real[:, water], drawn[:, water], groups)
    return np.stack([_shares(real, drawn, groups), of_water], 1)


def standardised(real: Numbers, drawn: Numbers, groups: NDArray[Any]) -> tuple[Numbers, Numbers]:
    """Both by mean and spread of the photographs; far outliers are held at 4."""
    kept = [np.flatnonzero(groups == group)[:_MOST_OF_A_GROUP] for group in np.unique(groups)]
    low, high = np.percentile(real, [0.5, 99.5], axis=0)
    clipped = np.clip(real[np.concatenate(kept)], low, high)
    mean, spread = clipped.mean(0), clipped.std(0)
    return np.clip((real - mean) / spread, -4, 4), np.clip((drawn - mean) / spread, -4, 4)


def _shares(real: Numbers, drawn: Numbers, groups: NDArray[Any]) -> Numbers:
    """`MEASURES`: means over random subsets of equal size."""
    generator, rows = np.random.default_rng(0), []
    for _ in range(_SPLITS):
        parts = [
            generator.permutation(np.flatnonzero(groups == group))[:_MOST_OF_A_GROUP]
            for group in np.unique(groups)
        ]
        part = np.concatenate(parts)
        count = min(_MOST, len(part), len(drawn))
        R = real[generator.permutation(part)[:count]]
        D = drawn[generator.permutation(len(drawn))[:count]]
        rows.append(_measures(cdist(R, R), cdist(R, D), cdist(D, D)))
    shares: Numbers = np.mean(rows, 0)
    return shares


def _measures(real: Numbers, apart: Numbers, drawn: Numbers) -> list[float]:
    """`MEASURES` of distances between photographs (NxN), to draws (NxM), between draws (MxM)."""
    k = _NEIGHBOURS
    of_real, of_drawn = (np.sort(distances, 1)[:, k] for distances in (real, drawn))
    near = apart < of_real[:, None]
    # balls of outliers are no larger than those of the others, and a draw counts once
    balls = np.minimum(of_real, np.median(of_real))[:, None]
    inside = np.minimum((apart <= balls).sum(0) / k, 1).mean()
    others = np.minimum(((real <= balls).sum(0) - 1) / k, 1).mean()
    covered = np.minimum(near.sum(1) / k, 1).mean()
    return [
        (apart < of_drawn).any(1).mean(),
        near.any(1).mean(),
        near.any(0).mean(),
        min(inside / others, 1.0),
        np.searchsorted(_covered_by_good(*apart.shape), covered) / (apart.shape[1] + 1),
    ]


@cache
def _covered_by_good(real: int, draws: int) -> Numbers:
    """What clipped coverage is, before its calibration, where 0…`draws` draws are photographs: of
    m the number that falls into the ball of a photograph is beta-binomial.
    """
    k, good = _NEIGHBOURS, np.arange(draws + 1)[:, None]
    few = np.arange(k)
    missing = betabinom.pmf(few, good, k, real - k) * (k - few) / k
    return 1 - missing.sum(1)
