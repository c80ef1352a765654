"""Coefficients of a water from pictures, with errors, and no more of them than pictures support."""

from uwaug.fitting.api import fit
from uwaug.fitting.jerlov import fit_water
from uwaug.fitting.patches import Patch, fit_patches, read_patches
from uwaug.fitting.result import Candidate, Fit, Parameter, Remainder, load_fit
from uwaug.fitting.veil import fit_veil

__all__ = [
    "Candidate",
    "Fit",
    "Parameter",
    "Patch",
    "Remainder",
    "fit",
    "fit_patches",
    "fit_veil",
    "fit_water",
    "load_fit",
    "read_patches",
]
