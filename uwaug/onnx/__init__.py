"""ONNX: an `Underwater` module as a file, checked against float64 eager, and a runner for it.

The graph takes any batch, height and width. It cannot raise: NaN stays NaN (with an automatic
exposure, in the whole picture), a negative distance counts as 0, +inf is open water; distances
outside the planned range keep the nearer end's blur, as in eager mode.
"""

from uwaug.onnx.check import Report, check_onnx
from uwaug.onnx.export import export_onnx, export_program
from uwaug.onnx.graph import parameters_of
from uwaug.onnx.metadata import read_metadata, read_module
from uwaug.onnx.runner import OnnxUnderwater

__all__ = [
    "OnnxUnderwater",
    "Report",
    "check_onnx",
    "export_onnx",
    "export_program",
    "parameters_of",
    "read_metadata",
    "read_module",
]
