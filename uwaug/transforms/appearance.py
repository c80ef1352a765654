"""Twelve numbers of a picture that follow from the water more than from the scene, and how near
draws lie to photographs by them.
"""

from collections import Counter
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from uwaug.formation.colour import srgb_to_linear

Values = NDArray[Any]

WATER_FEATURES = {
    "L_mean": (11.2, 1, "darker", "brighter"),
    "a_mean": (14.7, 2, "greener", "redder"),
    "b_mean": (17.2, 2, "bluer", "yellower"),
    "chroma": (12.1, 1, "paler", "more colourful"),
    "veil_L": (18.9, 1, "with a darker veil", "with a brighter veil"),
    "veil_a": (18.6, 2, "with a greener veil", "with a redder veil"),
    "veil_b": (24.0, 2, "with a bluer veil", "with a yellower veil"),
    "log_RG": (1.43, 2, "with less red", "with more red"),
    "log_BG": (0.915, 2, "with less blue", "with more blue"),
    "sd_RG": (0.84, 1, "with less contrast in red", "with more contrast in red"),
    "corr_RG": (0.343, 1, "with red less like green", "with red more like green"),
    "dark": (0.129, 1, "with deeper shadows", "hazier"),
}
"""For each number: its standard deviation in the 342 real photographs of benchmarks/results/
photographs.csv (short side 256 px); its weight in `like`, 2 for colour, which one looks at first
(the others then come out as near); words for a picture that has less of it, and more.
"""

# Standard deviations of photographs from which on draws are no longer near, and a warning is due:
# 70 and 88 % of real photographs are nearer, and a quarter of those with red and green swapped.
_FAIR_FROM, FAR_FROM = 0.8, 1.0

_SPREADS, _COUNTS, *_ = map(np.array, zip(*WATER_FEATURES.values(), strict=True))
# of each number: a standard deviation of photographs, on average
_UNITS = _SPREADS * np.sqrt(np.mean(_COUNTS**2)) / _COUNTS

_LOG_RG, _LOG_BG = (list(WATER_FEATURES).index(name) for name in ("log_RG", "log_BG"))
_HUE_UNIT = 0.5  # chord between hues that counts as much as a standard deviation: 29°
_PALE = 0.1  # of 1, saturation below which a colour has less and less of a hue

_BLOCKS = 16  # along a picture's short side, in which the veil is looked for
_JITTER = 1e-8  # variance added to each channel's: a constant one correlates with nothing


class Nearness(NamedTuple):
    """Nearness of draws to photographs; as text, a sentence.

    Attributes:
        kept, drawn: median distance of the kept draws, and of new ones, in standard deviations of
            photographs.
        doubt: what is off, in words, if even the draws for one of them are far; else empty.
        of_each: `kept`, for each photograph.
        hues: of the kept draws the median distance in hue alone, for each photograph.
    """

    kept: float
    drawn: float
    doubt: str
    of_each: tuple[float, ...] = ()
    hues: tuple[float, ...] = ()

    def __str__(self) -> str:
        unit = "where 1 is how much real underwater photographs differ from their mean"
        text = f"{_verdict(self.kept)}: {self.kept:.2f} away, {unit}"
        text = f"{text}, and random waters are {self.drawn:.2f} away"
        if len(self.of_each) > 1:
            verdicts = Counter(map(_verdict, sorted(self.of_each)))
            text += "; " + ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
        if any(hue >= FAR_FROM for hue in self.hues):
            text += "; colour: far"
        return text

    def far(self) -> list[int]:
        """Indices of the photographs that are far from anything that was tried."""
        return [i for i, unlikeness in enumerate(self.of_each) if unlikeness >= FAR_FROM]


def _verdict(unlikeness: float) -> str:
    if unlikeness < _FAIR_FROM:
        return "near"
    return "fair" if unlikeness < FAR_FROM else "far from all that was tried"


def unlikeness(draws: Values, photograph: Values) -> Values:
    """How far draws are from a photograph by the twelve numbers (…x12), in standard deviations of
    photographs (…); by hue alone, if that is farther.
    """
    distances: Values = np.sqrt((((draws - photograph) / _UNITS) ** 2).mean(-1))
    return np.maximum(distances, hue_apart(draws, photograph))


def hue_apart(draws: Values, photograph: Values) -> Values:
    """How far the mean colours of draws (…x12) are from a photograph's in hue, in units of 29°."""
    apart: Values = abs(_hue(draws) - _hue(photograph)) / _HUE_UNIT
    return apart


def _hue(numbers: Values) -> Values:
    """The hue of a mean colour in the complex plane: of length 1, shorter of what is pale."""
    light = np.exp2(np.stack([numbers[..., _LOG_RG], numbers[..., _LOG_BG]]))  # of green 1
    red, blue = light ** (1 / 2.2)
    brightest = np.maximum(np.maximum(red, blue), 1)
    third = np.exp(2j * np.pi / 3)
    around = (red + third + blue * third.conjugate()) / brightest
    hue: Values = around / np.maximum(abs(around), _PALE)
    return hue


def in_words(excess: Values) -> str:
    """What is most off in draws whose numbers (12) exceed those of a photograph by so much."""
    features = list(WATER_FEATURES.values())
    worst = np.argsort(-abs(excess / _UNITS))[:3]
    return ", ".join(features[i][3 if excess[i] > 0 else 2] for i in worst)


def water_features(srgb: Values) -> dict[str, float]:
    """Twelve numbers of a picture (HxWx3, sRGB, floating point 0…1): means of CIE L*, a*, b* and
    chroma; medians of L*, a*, b* where the veil is; log2 of red and blue over green, in linear
    light; log2 of the ratio of the spreads of red and green, and their correlation; the mean of the
    darkest green or blue nearby, which a veil lifts.
    """
    from scipy.ndimage import minimum_filter
    from skimage.color import rgb2lab

    side = max(2, min(srgb.shape[:2]) // _BLOCKS)
    lab = rgb2lab(srgb)
    L, a, b = np.moveaxis(lab, -1, 0)
    light = srgb_to_linear(torch.from_numpy(srgb.astype(np.float64))).numpy()
    mean, spread = light.reshape(-1, 3).mean(0) + 0.004, srgb.reshape(-1, 3).std(0) + 0.004
    veil = _veil(srgb, lab, side)
    numbers = {
        "L_mean": L.mean(),
        "a_mean": a.mean(),
        "b_mean": b.mean(),
        "chroma": np.hypot(a, b).mean(),
        **dict(zip(("veil_L", "veil_a", "veil_b"), veil, strict=True)),
        "log_RG": np.log2(mean[0] / mean[1]),
        "log_BG": np.log2(mean[2] / mean[1]),
        "sd_RG": np.log2(spread[0] / spread[1]),
        "corr_RG": correlation(srgb[..., 0], srgb[..., 1]),
        "dark": minimum_filter(srgb[..., 1:].min(-1), side - 1).mean(),
    }
    return {name: float(value) for name, value in numbers.items()}


def correlation(a: Values, b: Values) -> float:
    """Correlation of two channels; 0 if one is constant."""
    a, b = a - a.mean(), b - b.mean()
    spreads = (np.mean(a**2) + _JITTER) * (np.mean(b**2) + _JITTER)
    return float(np.mean(a * b) / np.sqrt(spreads))


def _veil(srgb: Values, lab: Values, side: int) -> Values:
    """Median L*, a*, b* of those square blocks that have least texture and least red."""
    from skimage.util import view_as_blocks

    def blocks(x: Values) -> Values:
        height, width = (size // side * side for size in x.shape)
        return np.reshape(view_as_blocks(x[:height, :width], (side, side)), (-1, side * side))

    texture = blocks(lab[..., 0]).std(1)
    less_red = blocks(srgb[..., 1:].max(-1) - srgb[..., 0]).mean(1)
    ranks = texture.argsort().argsort() - less_red.argsort().argsort()
    veil = ranks.argsort()[: max(2, len(ranks) // 10)]
    return np.array([np.median(blocks(lab[..., channel])[veil]) for channel in range(3)])
