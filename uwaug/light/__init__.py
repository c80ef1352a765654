"""Light: lamps near the camera, and daylight beside them."""

from uwaug.light.light import Light

__all__ = ["Light"]
