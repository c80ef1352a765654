"""Underwater pictures that do not exist: a differentiable, batched, spectral model of how water degrades an image."""

from uwaug import distance
from uwaug.blur import BlurPlan, plan_blur, varying_blur
from uwaug.camera import Camera, load_camera
from uwaug.demand import blur_demand
from uwaug.field import gaussian_random_field
from uwaug.formation import Terms, form_image
from uwaug.medium import Medium, PointSpread
from uwaug.module import Underwater
from uwaug.onnx import OnnxUnderwater, check_onnx, export_onnx
from uwaug.presets import Preset, list_presets, load_preset
from uwaug.transforms import RandomUnderwater
from uwaug.water import JERLOV_TYPES, Water

__version__ = "0.1.0"

__all__ = [
    "JERLOV_TYPES",
    "BlurPlan",
    "Camera",
    "Medium",
    "OnnxUnderwater",
    "PointSpread",
    "Preset",
    "RandomUnderwater",
    "Terms",
    "Underwater",
    "Water",
    "blur_demand",
    "check_onnx",
    "distance",
    "export_onnx",
    "form_image",
    "gaussian_random_field",
    "list_presets",
    "load_camera",
    "load_preset",
    "plan_blur",
    "varying_blur",
]
