"""The constants of scattering, which go together."""

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Scattering:
    """How scattered light is shared out: what a picture does not tell, and whoever makes or fits
    one has to agree on.

    Attributes:
        g: share of the scattered light that leaves the line of sight, 0…1.
        mu: share of the scattered light that is sent towards the camera, 0…1.
    """

    g: float
    mu: float

    CALIBRATED: ClassVar["Scattering"]
    """Goes with `PointSpread.calibrated`, for a subject that fills the view; μ keeps the paper's
    μ/g, so that the veil stays below a white plate. What `uwaug.RandomUnderwater` and
    `uwaug.fitting.fit_water` take.
    """

    PAPER: ClassVar["Scattering"]
    """Goes with `PointSpread.paper`. What `uwaug.Medium.from_water` takes."""


Scattering.CALIBRATED = Scattering(g=0.05, mu=0.075)
Scattering.PAPER = Scattering(g=0.2, mu=0.3)
