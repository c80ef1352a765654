"""Constants of scattering that go together."""

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Scattering:
    """Shares of the scattered light. A picture does not tell them, so that whoever makes pictures
    and whoever fits them have to agree.

    Attributes:
        g: share of the scattered light that leaves the line of sight, 0…1.
        mu: share of the scattered light that is sent towards the camera, 0…1.
    """

    g: float
    mu: float

    CALIBRATED: ClassVar["Scattering"]
    """Constants for `PointSpread.calibrated` and a subject that fills the view, as in
    `uwaug.RandomUnderwater` and `uwaug.fitting.fit_water`. μ keeps the paper's μ/g, so that the
    veil stays below a white plate.
    """

    PAPER: ClassVar["Scattering"]
    """Constants for `PointSpread.paper`, as in `uwaug.Medium.from_water`."""


Scattering.CALIBRATED = Scattering(g=0.05, mu=0.075)
Scattering.PAPER = Scattering(g=0.2, mu=0.3)
