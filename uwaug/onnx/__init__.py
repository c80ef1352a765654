"""ONNX files of `Underwater` modules: export, check and runner.

The graph takes any batch, height and width. It cannot raise. NaN stays NaN, in the whole picture
with a metered exposure. A negative distance counts as 0, and +inf is open water. Distances outside
the planned range get the nearer end's blur, as in PyTorch.
"""

from uwaug.onnx.check import Report, check_onnx
from uwaug.onnx.export import export_onnx
from uwaug.onnx.run import OnnxUnderwater, coefficients_of, input_rows, read_metadata

__all__ = [
    "OnnxUnderwater",
    "Report",
    "check_onnx",
    "coefficients_of",
    "export_onnx",
    "input_rows",
    "read_metadata",
]
