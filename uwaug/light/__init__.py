"""Light: daylight with a direction, and lamps."""

from uwaug.light.light import Light

__all__ = ["Light"]
