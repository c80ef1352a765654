"""Lamps near the camera, daylight beside them, and particles in their light."""

from uwaug.light.light import Lamp, Light

__all__ = ["Lamp", "Light"]
