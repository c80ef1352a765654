"""Folders and lists of pictures: read, degraded, written and recorded, by one process or many.

README.md in this folder says what a run does and what is in a record.
"""

from uwaug.io.distances import DistanceFormat
from uwaug.jobs.items import Item, Items, labelled, preflight
from uwaug.jobs.picture import Degrader, Result, replay
from uwaug.jobs.pool import run
from uwaug.jobs.recipe import Recipe
from uwaug.jobs.sidecar import Sidecar

__all__ = [
    "Degrader",
    "DistanceFormat",
    "Item",
    "Items",
    "Recipe",
    "Result",
    "Sidecar",
    "labelled",
    "preflight",
    "replay",
    "run",
]
