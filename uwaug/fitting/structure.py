"""Models of a water, from few numbers to many, and what a fit needs to know of its numbers."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

from torch import Tensor

from uwaug._support.types import Shape
from uwaug.fitting.model import Natural

__all__ = [
    "COLOURS",
    "MODELS",
    "Bounds",
    "Gain",
    "Geometry",
    "Law",
    "Model",
    "Quantity",
    "Structure",
]

COLOURS = ("red", "green", "blue")

Veil = Literal["none", "shared", "own"]
Law = Literal["paper", "calibrated", "gaussian", "exponential"]
Gain = Literal["fixed", "free", "channels"]


@dataclass(frozen=True)
class Model:
    """One of the candidates.

    Attributes:
        name: what it is called.
        veil: whether there is one, and whether its coefficient G is that of the direct light or one
            of its own.
        law: of the forward scatter, or None.
        words: what it models.
    """

    name: str
    veil: Veil
    law: Law | None
    words: str

    @property
    def shape(self) -> Shape | None:
        """Of the point spread; None if no light is scattered forward."""
        if self.law is None:
            return None
        return "exponential" if self.law in ("exponential", "calibrated") else "gaussian"

    @property
    def own_law(self) -> bool:
        """Whether width and exponent are numbers of their own."""
        return self.law in ("gaussian", "exponential")


_CANDIDATES = (
    Model("attenuation", "none", None, "direct light alone"),
    Model("haze", "shared", None, "direct light and veil, one coefficient for both"),
    Model("veil", "own", None, "direct light and veil, a coefficient for each"),
    Model("paper", "own", "paper", "forward scatter too, the paper's width law"),
    Model("calibrated", "own", "calibrated", "forward scatter too, the calibrated width law"),
    Model("gaussian", "own", "gaussian", "forward scatter too, a Gaussian with a law of its own"),
    Model("exponential", "own", "exponential", "forward scatter too, an exponential of its own"),
)

MODELS = {model.name: model for model in _CANDIDATES}
"""By name, from the fewest numbers to the most."""


class Bounds(NamedTuple):
    """Least and largest value of a number that is fitted, and where a fit may begin."""

    low: float
    high: float
    begin: float


class Quantity(NamedTuple):
    """What is reported.

    Attributes:
        name, unit: of the quantity.
        shows: the least change of it that shows in the picture.
    """

    name: str
    unit: str
    shows: float


class Geometry(NamedTuple):
    """What is known of the pictures before anything is fitted.

    Attributes:
        pairs: how many.
        short_side: of the pictures, px.
        reference: the median distance, m.
        farthest: the largest distance that counts, m.
        widest: the largest width of a blur, px.
        focal_px: focal length, px; None if it is unknown.
        unit: of distance.
    """

    pairs: int
    short_side: int
    reference: float
    farthest: float
    widest: float
    focal_px: float | None
    unit: str = "m"


class Structure(Protocol):
    """What a fit needs to know of its numbers."""

    @property
    def name(self) -> str:
        """Of the candidate."""

    @property
    def bounds(self) -> Mapping[str, Bounds]:
        """Of each number that is fitted, by name."""

    @property
    def shape(self) -> Shape | None:
        """Of the point spread."""

    @property
    def quantities(self) -> list[Quantity]:
        """What is reported."""

    def natural(self, theta: Tensor) -> Natural:
        """The numbers that pictures depend on; differentiable."""

    def reported(self, theta: Tensor) -> Tensor:
        """The value of each of `quantities`; differentiable."""
