"""Which water is this? Coefficients from pictures, how sure they are, and no more of them than the
pictures support.
"""

from uwaug.fitting.entry import fit
from uwaug.fitting.noise import Noise
from uwaug.fitting.report import Parameter
from uwaug.fitting.result import Candidate, Fit
from uwaug.fitting.series import fit_series
from uwaug.fitting.series_result import Line, SeriesFit

__all__ = ["Candidate", "Fit", "Line", "Noise", "Parameter", "SeriesFit", "fit", "fit_series"]
