"""Random water for every picture of a data set."""

from uwaug.transforms.draw import collate_records
from uwaug.transforms.keep_visible import KeepVisible
from uwaug.transforms.random_underwater import RandomUnderwater

__all__ = ["KeepVisible", "RandomUnderwater", "collate_records"]
