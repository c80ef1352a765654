"""Random water for every picture of a data set."""

from uwaug.transforms.conditions import Conditions
from uwaug.transforms.keep_visible import KeepVisible
from uwaug.transforms.like import like
from uwaug.transforms.measured import Measured
from uwaug.transforms.random_development import RandomDevelopment
from uwaug.transforms.random_light import RandomLight
from uwaug.transforms.random_underwater import RandomUnderwater
from uwaug.transforms.random_water import RandomWater

__all__ = [
    "Conditions",
    "KeepVisible",
    "Measured",
    "RandomDevelopment",
    "RandomLight",
    "RandomUnderwater",
    "RandomWater",
    "like",
]
