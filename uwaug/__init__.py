"""Underwater pictures that do not exist: a differentiable, batched, spectral model of how water
degrades an image.
"""

from uwaug import distance, fused
from uwaug.blur.demand import blur_demand
from uwaug.blur.plan import BlurPlan, plan_blur
from uwaug.blur.stack import varying_blur
from uwaug.comparing import Comparison, compare
from uwaug.contrast import contrast
from uwaug.draw import collate_records
from uwaug.field import gaussian_random_field
from uwaug.fitting import (
    Fit,
    Noise,
    SeriesFit,
    VeilFit,
    WaterFit,
    fit,
    fit_series,
    fit_veil,
    fit_water,
)
from uwaug.formation import Terms, form_image
from uwaug.light import Light
from uwaug.module import Underwater
from uwaug.onnx import OnnxUnderwater, check_onnx, export_onnx
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import JERLOV_TYPES, Water
from uwaug.presets import Preset, list_presets, load_preset, published_systems
from uwaug.prior import WaterEstimate, red_channel_prior
from uwaug.transforms import RandomUnderwater
from uwaug.visible import KeepVisible

__version__ = "0.1.0"

__all__ = [
    "JERLOV_TYPES",
    "BlurPlan",
    "Camera",
    "Comparison",
    "Fit",
    "KeepVisible",
    "Light",
    "Medium",
    "Noise",
    "OnnxUnderwater",
    "PointSpread",
    "Preset",
    "RandomUnderwater",
    "SeriesFit",
    "Terms",
    "Underwater",
    "VeilFit",
    "Water",
    "WaterEstimate",
    "WaterFit",
    "blur_demand",
    "check_onnx",
    "collate_records",
    "compare",
    "contrast",
    "distance",
    "export_onnx",
    "fit",
    "fit_series",
    "fit_veil",
    "fit_water",
    "form_image",
    "fused",
    "gaussian_random_field",
    "list_presets",
    "load_camera",
    "load_preset",
    "plan_blur",
    "published_systems",
    "red_channel_prior",
    "varying_blur",
]
