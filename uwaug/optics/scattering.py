"""Constants of scattering that go together."""

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Scattering:
    """Shares of the scattered light: g leaves the line of sight, μ is sent towards the camera, each
    0…1. A picture does not tell them, so whoever makes pictures and whoever fits them must agree.
    """

    g: float
    mu: float

    CALIBRATED: ClassVar["Scattering"]
    PAPER: ClassVar["Scattering"]


# For `PointSpread.calibrated` and a subject that fills the view. μ keeps the paper's μ/g, so that
# the veil stays below a white plate.
Scattering.CALIBRATED = Scattering(g=0.05, mu=0.075)
# for `PointSpread.paper`
Scattering.PAPER = Scattering(g=0.2, mu=0.3)
