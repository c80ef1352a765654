"""`MarineSnow`: particles in the water that a camera sees one by one."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from uwaug._support import checks
from uwaug._support.codec import plain
from uwaug._support.nouns import SEEDS, Seeded, number, require_seed
from uwaug._support.ranges import Range, as_range
from uwaug._support.types import Array

COUNTED = 0.5e-3
"""m: diameter from which particles are called marine snow, and counted (Alldredge and Silver,
Progress in Oceanography 20, 1988).
"""

SIZES = (50e-6, 5e-3)
"""m: diameters. Smaller ones are what b of the water stands for."""

LEAST_ANGLE = 1e-3
"""Diameter over distance, .4 px of a view of 60° that is 512 px wide: what looks smaller is not
drawn.
"""

NEAREST = 0.05
"""m, along the axis: nearer is the port of the camera's housing."""

_MARGIN = 1.1
"""Of the view, in which particles are: of one that is out of focus a part may be in the picture."""


class Particles(NamedTuple):
    """N particles before a camera.

    Attributes:
        x, y (N arrays): tangents of the angles to the right and down.
        z (N array): distances along the axis of the camera, m.
        diameter (N array): of a disc of the same area, m.
        stretch (N array): √ of long over short axis, 1…√2.
        turn (N array): of the long axis, radians.
        brightness (N array): share of the reflectance, 0…1.
    """

    x: Array
    y: Array
    z: Array
    diameter: Array
    stretch: Array
    turn: Array
    brightness: Array


@plain
@dataclass(frozen=True)
class MarineSnow(Seeded):
    """Particles in the water before a camera, by a seed.

    Their number falls with the third power of the diameter, n(d) ∝ d^−3, from 50 µm to 5 mm. Of
    each apparent size d/z every metre of distance then has as many.

    Attributes:
        density: particles of .5 mm and more in a cubic metre, 1…100 000; in
            `uwaug.RandomUnderwater` also a range (low, high), drawn uniformly in its logarithm.
        reflectance: light that the brightest send back, of a white plate's, 0…1; others, evenly
            spread, send less, as aggregates are translucent.
        aperture: of the lens, m: focal length over f-number.
        focus: distance at which it is sharp, m.
        seed: a whole number from 0 to 2^32 − 1, of snow that is the same in all pictures, of any
            size; None: anew each time. Pictures that are drawn record their own.
        drift: m by which the particles have moved to the right; those that leave the view come
            back on its other side.

    Raises:
        TypeError, ValueError: if a number is none, or outside its domain.

    Source: G. A. Jackson et al., Deep-Sea Research I 44, 1997: exponents of 2.96 to 3.00 by
    diameters in images, from 1 µm to 1 cm.

    Examples:
        >>> medium = Medium.from_water("II").with_snow(MarineSnow(5000))  # doctest: +SKIP
    """

    density: Range = number(2000.0, 1.0, 1e5, logarithmic=True)
    reflectance: float = 0.2
    aperture: float = 3e-3
    focus: float = 1.5
    seed: int | None = None
    drift: float = 0.0

    def __post_init__(self) -> None:
        as_range("snow: density", self.density, 1.0, 1e5)
        checks.within("snow: reflectance", self.reflectance, 0.0, 1.0)
        checks.within("snow: aperture", self.aperture, 0.0, 1.0)
        checks.positive("snow: focus", self.focus)
        if self.seed is not None:
            require_seed("snow: seed", self.seed)
        checks.within("snow: drift", self.drift)

    def particles(self, right: float, down: float) -> Particles:
        """Those that a camera may see, by the tangents of the angles from the middle of its view to
        its edges.
        """
        half = _MARGIN * max(right, down)
        reach = SIZES[1] / LEAST_ANGLE
        # N(> d) is density·(COUNTED/d)², and of a metre at z the view has (2 half·z)² m³
        assert not isinstance(self.density, tuple)  # see `Medium.with_snow`
        each_metre = self.density * (COUNTED / LEAST_ANGLE * 2 * half) ** 2
        count = round(each_metre * reach)
        seed = int(torch.randint(SEEDS, ())) if self.seed is None else self.seed
        shares = np.random.default_rng(seed).random((count, 7)).T
        x, y, z, share, stretch, turn, brightness = shares
        z = z * reach
        diameter = LEAST_ANGLE * z / np.sqrt(1 - share)
        x, y = (2 * x - 1) * half, (2 * y - 1) * half
        seen = (z > NEAREST) & (diameter > SIZES[0]) & (diameter < SIZES[1])
        x = (x + self.drift / z.clip(NEAREST) + half) % (2 * half) - half
        seen &= (np.abs(x) < _MARGIN * right) & (np.abs(y) < _MARGIN * down)
        rest = np.sqrt(1 + stretch), np.pi * turn, brightness
        return Particles(*(values[seen] for values in (x, y, z, diameter, *rest)))

    def blur(self, z: Array) -> Array:
        """The diameter of the circle of confusion, as a tangent, of points at distances z, m."""
        return self.aperture * np.abs(1 / z - 1 / self.focus)
