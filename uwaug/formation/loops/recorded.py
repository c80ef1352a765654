"""Names of before, for callers that are being rewritten; they go with the last of these."""

from uwaug.formation.loops.backend import can_differentiate as records
from uwaug.formation.loops.backward import render_with_gradients as recorded

__all__ = ["recorded", "records"]
