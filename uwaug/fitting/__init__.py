"""Which water is this? Coefficients from pictures, how sure they are, and no more of them than the
pictures support.
"""

from uwaug.fitting.api import fit
from uwaug.fitting.result import Candidate, Fit, Parameter, Remainder, load_fit

__all__ = [
    "Candidate",
    "Fit",
    "Parameter",
    "Remainder",
    "fit",
    "load_fit",
]
