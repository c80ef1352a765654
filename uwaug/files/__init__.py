"""Pictures, distance maps and labels in files, and runs over folders of them."""

from uwaug.files.items import Item, find_items
from uwaug.files.labels import open_labels
from uwaug.files.pictures import read_distance, read_picture, write_picture
from uwaug.files.record import read_record
from uwaug.files.run import Recipe, Result, Summary, degrade, replay

__all__ = [
    "Item",
    "Recipe",
    "Result",
    "Summary",
    "degrade",
    "find_items",
    "open_labels",
    "read_distance",
    "read_picture",
    "read_record",
    "replay",
    "write_picture",
]
