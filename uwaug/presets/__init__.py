"""What comes with the package: presets, published systems, a scene."""

from uwaug.presets.preset import Preset, list_presets, load_preset, published_systems

__all__ = ["Preset", "list_presets", "load_preset", "published_systems"]
