"""Names of before, for callers that are being rewritten; they go with the last of these."""

from uwaug.formation.loops.backend import ready

__all__ = ["ready"]
