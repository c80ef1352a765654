"""What a shell completes: names of waters and of presets."""

from uwaug.optics.water import JERLOV_TYPES
from uwaug.presets.files import list_presets

__all__ = ["complete_preset", "complete_water"]


def complete_water(incomplete: str) -> list[str]:
    """The Jerlov types that begin so."""
    return [name for name in JERLOV_TYPES if name.startswith(incomplete.upper())]


def complete_preset(incomplete: str) -> list[str]:
    """The bundled presets that begin so."""
    return [name for name in list_presets() if name.startswith(incomplete)]
