"""Width law of the forward scatter."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import torch

from uwaug._support import checks
from uwaug._support.checks import DOMAIN
from uwaug._support.codec import plain
from uwaug._support.types import Shape
from uwaug.optics.view import Size, View

Unit = Literal["px", "paper", "focal"]

PAPER_SIDE = 518  # short side of the paper's pictures, px
# Scattering lengths between which a width changes. A power below 1 has an infinite slope at 0, so
# that σ(0) is tiny instead of 0; at 1e4 all light is gone.
LENGTHS = 1e-6, 1e4


@plain
@dataclass(frozen=True)
class Law:
    """What a width law is besides its numbers.

    Attributes:
        shape: "gaussian", or "exponential" for the classical transfer function e^(−2πσf).
        unit: "px" of the image at hand; "paper", px where the short side has 518, so that a picture
            does not depend on its resolution; or "focal", focal lengths of the view, so that it
            does not depend on crops either.
    """

    shape: Shape = "gaussian"
    unit: Unit = "px"

    def __post_init__(self) -> None:
        checks.one_of("PointSpread.shape", self.shape, get_args(Shape))
        checks.one_of("PointSpread.unit", self.unit, get_args(Unit))

    def pixels(self, size: Size, view: View) -> Any:
        """The unit in px of an image of (height, width) `size`."""
        if self.unit == "px":
            return 1.0
        sides: Any = size
        if isinstance(size[0], torch.SymInt):  # type: ignore[unreachable]
            # in a graph for any size; a quotient of symbolic numbers would enter it in single
            # precision
            sides = [torch.full((), side, dtype=torch.float64) for side in size]  # type: ignore[unreachable]
        if self.unit == "focal":
            return view.focal(sides[1])
        short = torch.minimum(*sides) if isinstance(sides, list) else min(sides)
        return short / PAPER_SIDE


def widths(z: Any, b_mean: Any, scale: Any, exponent: Any) -> Any:
    """σ(z) at distances z, m, finite, in units of the law; arrays or tensors that broadcast."""
    return scale * raised((b_mean * z).clip(*LENGTHS), exponent)


def raised(x: Any, exponent: Any) -> Any:
    """x^exponent, of x > 0."""
    if torch.compiler.is_compiling():
        return torch.exp(torch.log(x) * exponent)  # half of ONNX Runtime's time for a power
    return x**exponent


IN_PIXELS = {shape: Law(shape) for shape in get_args(Shape)}  # px of the image at hand


@plain
@dataclass(frozen=True)
class PointSpread:
    """Width law of the forward scatter, σ(z) = scale·(b̄ z)^exponent.

    Attributes:
        scale: width at one scattering length, in units, ≥ 0.
        exponent: > 0.
        shape, unit: see `uwaug.optics.point_spread.Law`.

    Raises:
        ValueError: if a value is outside its domain.
    """

    scale: float
    exponent: float = 1.0
    shape: Shape = "gaussian"
    unit: Unit = "px"

    def __post_init__(self) -> None:
        for name in ("scale", "exponent"):
            checks.within(f"PointSpread.{name}", getattr(self, name), *DOMAIN[name])
        self.law  # noqa: B018  refuses what is no law

    @cached_property
    def law(self) -> Law:
        """Shape and unit."""
        return Law(self.shape, self.unit)

    @staticmethod
    def paper(coefficient: float = 0.3) -> "PointSpread":
        """Law of the paper, φ = coefficient·b̄ (table 2: .3, figure 7: .8), in px of its pictures,
        whose short side is 518 px.
        """
        return PointSpread(coefficient, 1.0, unit="paper")

    @staticmethod
    def calibrated() -> "PointSpread":
        """Law fitted to Monte Carlo light transport with Petzold's measured phase functions and the
        Henyey–Greenstein function of mean cosine .924. Use it with g = .05 and μ = .075.

        The RMSE of direct + forward light over b̄z = .1…5 is .0066 and .0075; of the paper's law it
        is .037 and .053 (`python -m benchmarks.accuracy.physics`).
        """
        return PointSpread(0.030, 0.62, "exponential", "focal")

    @staticmethod
    def none() -> "PointSpread":
        """No blur: forward scatter adds light but moves none."""
        return PointSpread(0.0)
