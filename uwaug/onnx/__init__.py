"""ONNX: an `Underwater` module as a file, checked against float64 eager, and a runner for it.

The graph takes any batch, height and width. It cannot raise: NaN stays NaN (with a metered
exposure, in the whole picture), a negative distance counts as 0, +inf is open water; distances
outside the planned range keep the nearer end's blur, as in eager mode.
"""

from uwaug.onnx.check import Report, check_onnx
from uwaug.onnx.export import export_onnx
from uwaug.onnx.run import OnnxUnderwater, coefficients_of, read_metadata

__all__ = [
    "OnnxUnderwater",
    "Report",
    "check_onnx",
    "coefficients_of",
    "export_onnx",
    "read_metadata",
]
