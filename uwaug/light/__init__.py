"""Light: lamps near the camera, and daylight beside them."""

from uwaug.light.light import Lamp, Light

__all__ = ["Lamp", "Light"]
