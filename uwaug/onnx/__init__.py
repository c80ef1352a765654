"""ONNX files of `Underwater` modules: export, check and runner."""

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
