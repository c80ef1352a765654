"""`MarineSnow`: particles in the water that a camera sees one by one."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from uwaug._support import checks
from uwaug._support.codec import plain
from uwaug._support.nouns import SEEDS, Seeded, number, require_seed
from uwaug._support.ranges import Range, as_range
from uwaug._support.types import Array

# Diameter, m, from which particles are called marine snow, and counted (Alldredge and Silver,
# Progress in Oceanography 20, 1988).
COUNTED = 0.5e-3
SIZES = (50e-6, 5e-3)  # diameters, m; the water's b stands for smaller particles
# Smallest diameter over distance that is drawn, .4 px of a view of 60° that is 512 px wide; in
# views of more than that square in as many px of theirs, so that particles do not become more.
_MIN_ANGLE = 1e-3
_NEAREST_M = 0.05  # smallest distance along the axis; nearer is the port of the camera's housing
# Tangent beyond the edges of a view, to where there are particles: those that are near and out of
# focus may be partly in the picture.
_MARGIN = 0.06


class Particles(NamedTuple):
    """N particles before a camera."""

    x: Array  # tangents of the angles to the right
    y: Array  # and down
    z: Array  # distances along the axis of the camera, m
    diameter: Array  # of discs of the same area, m
    stretch: Array  # √ of long over short axis, 1…√2
    turn: Array  # angles of the long axis, radians
    brightness: Array  # shares of the reflectance, 0…1


@plain
@dataclass(frozen=True)
class MarineSnow(Seeded):
    """Particles in the water before a camera, by a seed.

    Their number falls with the third power of the diameter, n(d) ∝ d^−3, from 50 µm to 5 mm. Each
    has a place in the water, which moves before the camera, or the camera in it.

    Attributes:
        density: particles of .5 mm and more in a cubic metre, 1…100 000; in
            `uwaug.RandomUnderwater` also a range (low, high), drawn uniformly in its logarithm.
        reflectance: share of a white plate's light that the brightest particle sends back, 0…1. The
            others, evenly spread, send less.
        aperture: focal length of the lens over its f-number, m.
        focus: distance at which the lens is sharp, m.
        seed: a whole number from 0 to 2^32 − 1, for the same snow in all pictures of a shape; None
            for new snow each time.
        drift: distances by which the particles have moved to the right, down and away from the
            camera, m: less its own motion. New ones enter at the side.

    Source: G. A. Jackson et al., Deep-Sea Research I 44, 1997: exponents of 2.96 to 3.00 by
    diameters in images, from 1 µm to 1 cm.
    """

    density: Range = number(2000.0, 1.0, 1e5, logarithmic=True)
    reflectance: float = 0.2
    aperture: float = 3e-3
    focus: float = 1.5
    seed: int | None = None
    drift: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        as_range("snow: density", self.density, 1.0, 1e5)
        checks.within("snow: reflectance", self.reflectance, 0.0, 1.0)
        checks.within("snow: aperture", self.aperture, 0.0, 1.0)
        checks.positive("snow: focus", self.focus)
        if self.seed is not None:
            require_seed("snow: seed", self.seed)
        object.__setattr__(self, "drift", checks.vector("snow: drift", self.drift))

    def particles(self, right: float, down: float) -> Particles:
        """Draw the particles that a camera may see, up to these tangents of angles of view."""
        angle = _MIN_ANGLE * max(1.0, math.sqrt(3 * right * down))  # 1/√3 is tan 30°
        # A particle is drawn up to a distance s = d/angle. It lives in a box of water of its own, s
        # long and 2s·right × 2s·down wide, beyond which it comes again: as new, out of sight.
        # There are density·(COUNTED/angle)²·2·s^−3·ds in a cubic metre, so as many for each ds.
        edges = np.array([[right], [down]]) + _MARGIN
        assert not isinstance(self.density, tuple)  # see `Medium.with_snow`
        shortest, longest = SIZES[0] / angle, SIZES[1] / angle
        per_metre = self.density * (COUNTED / angle) ** 2 * 8 * edges.prod()
        seed = int(torch.randint(SEEDS, ())) if self.seed is None else self.seed
        shares = np.random.default_rng(seed).random((round(per_metre * (longest - shortest)), 7)).T
        s = shortest + shares[3] * (longest - shortest)
        box = np.stack([*2 * edges * s, s])
        places = (shares[:3] + np.array(self.drift)[:, None] / box) % 1
        x, y, z = (places - [[0.5], [0.5], [0.0]]) * box
        visible = (z > _NEAREST_M) & (np.abs([x, y]) < edges * z).all(0)
        columns = *shares[4:], angle * s, x, y, z
        stretch, turn, brightness, diameter, x, y, z = np.stack(columns)[:, visible]
        return Particles(x / z, y / z, z, diameter, np.sqrt(1 + stretch), np.pi * turn, brightness)

    def blur(self, z: Array) -> Array:
        """Diameters of the circles of confusion, as tangents, of points at distances z, m."""
        return self.aperture * np.abs(1 / z - 1 / self.focus)
