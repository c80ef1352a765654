"""Names of before, for callers that are being rewritten; they go with the last of these."""

from uwaug.formation.loops.backend import VARIABLE, Path, has_numba, path, path_for, use

__all__ = ["VARIABLE", "Path", "followed", "path", "use"]
followed = path_for
_is_found = has_numba
