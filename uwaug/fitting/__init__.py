"""Which water is this? Coefficients from pictures, how sure they are, and no more of them than the
pictures support.
"""

from uwaug.fitting.entry import fit
from uwaug.fitting.noise import Noise
from uwaug.fitting.report import Parameter
from uwaug.fitting.result import Candidate, Fit

__all__ = ["Candidate", "Fit", "Noise", "Parameter", "fit"]
