"""Random water for every picture of a data set."""

from uwaug.transforms.keep_visible import KeepVisible
from uwaug.transforms.like import UnderwaterLike, like
from uwaug.transforms.params import RandomDevelopment
from uwaug.transforms.random_underwater import RandomUnderwater

__all__ = [
    "KeepVisible",
    "RandomDevelopment",
    "RandomUnderwater",
    "UnderwaterLike",
    "like",
]
