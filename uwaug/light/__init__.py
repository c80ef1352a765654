"""Light: daylight with a direction, and lamps."""

from uwaug.light.value import Light

__all__ = ["Light"]
