"""Names of before, for callers that are being rewritten; they go with the last of these."""

from torch import Tensor

from uwaug.formation.loops.backend import Path, can_render
from uwaug.optics.medium import Medium

__all__ = ["serves"]


def serves(
    light: Tensor, z: Tensor, medium: Medium, order: str, wanted: Path | None = None
) -> bool:
    """Whether the loops can form this picture."""
    return order == "line_of_sight" and can_render(light, z, medium, wanted)
