"""Which water is this? Coefficients from pictures, how sure they are, and no more of them than the
pictures support.
"""

from uwaug.fitting.api import fit, fit_series, fit_water
from uwaug.fitting.noise import Noise
from uwaug.fitting.results import (
    Candidate,
    Fit,
    JerlovType,
    Line,
    Parameter,
    SeriesFit,
    VeilFit,
    WaterFit,
    load_fit,
)
from uwaug.fitting.single_image import WaterEstimate, red_channel_prior
from uwaug.fitting.veil import fit_veil

__all__ = [
    "Candidate",
    "Fit",
    "JerlovType",
    "Line",
    "Noise",
    "Parameter",
    "SeriesFit",
    "VeilFit",
    "WaterEstimate",
    "WaterFit",
    "fit",
    "fit_series",
    "fit_veil",
    "fit_water",
    "load_fit",
    "red_channel_prior",
]
