"""The setting of a picture: the water that it is taken in, its light and its camera."""

from dataclasses import dataclass

from torch import Tensor

from uwaug._support.codec import plain
from uwaug._support.types import ColorSpace
from uwaug.formation.development import NEUTRAL, Development
from uwaug.light import Light
from uwaug.optics.curves import Curves
from uwaug.optics.medium import Medium
from uwaug.optics.view import WIDE, View


@plain
@dataclass(frozen=True)
class Setting:
    """Water, light and camera of a picture, or of a batch: all that fits, states and files hold.

    Attributes:
        medium: of one row, or one for each picture.
        light: lamps and direction of daylight; None for daylight as the medium has it.
        development: steps of the camera.
        view: of the camera.
        color_space: of the stored picture.
        span: nearest, median and farthest effective distance of one picture, m, where they are
            measured.
    """

    medium: Medium
    light: Light | None = None
    development: Development = NEUTRAL
    view: View = WIDE
    color_space: ColorSpace = "srgb"
    span: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def curves(self, medium: Medium, z: Tensor, metres: Tensor | None = None) -> Curves | None:
        """Curves at every pixel, see `Light.curves`; None for those of the medium alone."""
        return None if self.light is None else self.light.curves(medium, z, self.view, metres)
