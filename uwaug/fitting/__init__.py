"""Which water is this? Coefficients from pictures, how sure they are, and no more of them than the
pictures support.
"""

from uwaug.fitting.api import fit
from uwaug.fitting.jerlov import fit_water
from uwaug.fitting.result import Candidate, Fit, Parameter, Remainder, load_fit
from uwaug.fitting.veil import fit_veil

__all__ = [
    "Candidate",
    "Fit",
    "Parameter",
    "Remainder",
    "fit",
    "fit_veil",
    "fit_water",
    "load_fit",
]
