"""The model of image formation: direct, forward-scattered and backscattered light."""

from uwaug.formation.colour import linear_to_srgb, srgb_to_linear
from uwaug.formation.contrast import contrast_left
from uwaug.formation.demand import BlurDemand, blur_demand
from uwaug.formation.development import Development
from uwaug.formation.field import gaussian_random_field
from uwaug.formation.image import Terms, form_image
from uwaug.formation.learnable import LearnableMedium
from uwaug.formation.sensor import Sensor
from uwaug.formation.setting import Setting
from uwaug.formation.underwater import Underwater

__all__ = [
    "BlurDemand",
    "Development",
    "LearnableMedium",
    "Sensor",
    "Setting",
    "Terms",
    "Underwater",
    "blur_demand",
    "contrast_left",
    "form_image",
    "gaussian_random_field",
    "linear_to_srgb",
    "srgb_to_linear",
]
