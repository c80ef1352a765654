"""Which water is this? Coefficients from pictures, how sure they are, and no more of them than the
pictures support.
"""

from uwaug.fitting.entry import fit
from uwaug.fitting.noise import Noise
from uwaug.fitting.prior_entry import WaterEstimate, red_channel_prior
from uwaug.fitting.report import Candidate, Parameter
from uwaug.fitting.result import Fit
from uwaug.fitting.series import fit_series
from uwaug.fitting.series_result import Line, SeriesFit
from uwaug.fitting.veil import fit_veil
from uwaug.fitting.veil_result import VeilFit
from uwaug.fitting.water import fit_water
from uwaug.fitting.water_result import JerlovType, WaterFit

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
    "red_channel_prior",
]
