"""Pictures in files, one by one: read, degraded, written, recorded."""

from uwaug.jobs.depth import Depth
from uwaug.jobs.one import Outcome, degrade_file
from uwaug.jobs.recipe import Recipe
from uwaug.jobs.row import Row
from uwaug.jobs.rows import Rows

__all__ = ["Depth", "Outcome", "Recipe", "Row", "Rows", "degrade_file"]
