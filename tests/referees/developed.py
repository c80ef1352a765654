"""What a camera does between sensor and file, in NumPy, stage by stage, written straight from the
equations.
"""

import math
from dataclasses import dataclass

import numpy as np

Array = np.ndarray
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass
class Camera:
    """The numbers of a development; see `uwaug.Development`."""

    exposure: float = 0.0
    white_balance: float = 0.0
    saturation: float = 1.0
    gamut: float = 0.0
    tone: float = 1.0

    def develop(self, light: Array, looks: Array, scene: Array | None, burnt: float) -> Array:
        """Light (3xHxW) as the camera shows it.

        looks (N): flat indices of the pixels at which it measures.
        scene: light of the scene, if a meter keeps its luminance.
        burnt: share of these pixels that may be brighter than white.
        """
        gain = 2**self.exposure
        if scene is not None:
            gain = metered(scene, light, looks, self.exposure, burnt)
        light = gain * balanced(light, looks, self.white_balance)
        luminance = np.tensordot(LUMINANCE, light, 1)
        light = luminance + self.saturation * (light - luminance)
        return curved(compressed(light, self.gamut), self.tone)


def metered(scene: Array, light: Array, looks: Array, stops: float, burnt: float) -> float:
    """The gain that keeps luminance, some stops brighter, and no more pixels above white."""
    before, after = (LUMINANCE @ x.reshape(3, -1)[:, looks].mean(1) for x in (scene, light))
    brightest = np.sort(light.reshape(3, -1)[:, looks].max(0))
    white = max(brightest[-round(burnt * len(looks))], 1 / 64)
    return min(2**stops * min(max(before / after, 1 / 8), 64.0), 2 ** min(stops, 0.0) / white)


def balanced(light: Array, looks: Array, share: float) -> Array:
    """A share of a grey-world correction, with the luminance kept."""
    means = light.reshape(3, -1)[:, looks].clip(min=0).mean(1)
    before = LUMINANCE @ means
    if share <= 0 or before <= 0:
        return light
    gains = np.array([min(before / mean, 16.0) if mean > 0 else 16.0 for mean in means]) ** share
    gains *= before / (LUMINANCE @ (gains * means))
    return gains[:, None, None] * light


def compressed(light: Array, share: float) -> Array:
    """Distances from grey above .75, along a curve with power 2 that never reaches 1."""
    out = light.copy()
    for at in np.ndindex(*light.shape[1:]):
        colour = light[(slice(None), *at)]
        most = colour.max()
        for c, value in enumerate(colour):
            if most <= 0:
                inside = 0.0  # where all is black, for any share of light that is negative
            else:
                distance = 1 - value / most
                x = max(distance - 0.75, 0.0) / 0.25
                inside = most * (1 - min(distance, 0.75) - 0.25 * x / math.sqrt(1 + x * x))
            out[(c, *at)] = (1 - share) * value + share * inside
    return out


def curved(light: Array, contrast: float) -> Array:
    """A curve in x^c/(x^c + k) through 0, .18 and 1, odd, and straight beyond 1."""
    if contrast == 1:
        return light
    grey = 0.18**contrast
    k = 0.82 * grey / (0.18 - grey)
    size = np.abs(light).clip(min=1e-4)
    curve = (1 + k) * size**contrast / (size**contrast + k)
    straight = 1 + contrast * k / (1 + k) * (size - 1)
    return light / size * np.where(size > 1, straight, curve)
