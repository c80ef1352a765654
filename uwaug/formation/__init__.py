"""The model of image formation: direct, forward-scattered and backscattered light."""

from uwaug.formation import loops as fused
from uwaug.formation.contrast import contrast
from uwaug.formation.demand import BlurDemand, blur_demand
from uwaug.formation.development import Development
from uwaug.formation.field import gaussian_random_field
from uwaug.formation.learnable import LearnableMedium
from uwaug.formation.model import form_image
from uwaug.formation.scene import Scene, Terms
from uwaug.formation.setup import Setup
from uwaug.formation.underwater import Underwater

__all__ = [
    "BlurDemand",
    "Development",
    "LearnableMedium",
    "Scene",
    "Setup",
    "Terms",
    "Underwater",
    "blur_demand",
    "contrast",
    "form_image",
    "fused",
    "gaussian_random_field",
]
