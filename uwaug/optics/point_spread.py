"""Width law of the forward scatter."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, get_args

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.checks import DOMAIN
from uwaug._support.codec import plain
from uwaug._support.types import Shape
from uwaug.optics.curves import raised

PAPER_SIZE = 518
"""Short side of the paper's pictures, px."""

FOCAL_LENGTH = 0.866
"""Focal length of a view 60° wide, as a share of the picture's width."""

LENGTHS = 1e-6, 1e4
"""Scattering lengths between which a width changes. A power below 1 has an infinite slope at 0, so
that σ(0) is tiny instead of 0; at 1e4 all light is gone.
"""


@plain
@dataclass(frozen=True)
class PointSpread:
    """Width law of the forward scatter, σ(z) = scale·(b̄ z)^exponent, in px.

    Attributes:
        scale: width at one scattering length, px ≥ 0; a float, or a tensor (B,) that can be
            learned.
        exponent: > 0; a float, or a tensor (B,).
        shape: "gaussian", or "exponential" for the classical transfer function e^(−2πσf), see
            `uwaug.blur.plan_blur`.
        reference_size: None if px are px of the image at hand; else the short side, px, of the
            image that `scale` refers to, so that the picture does not depend on its resolution.

    σ never falls with distance; planning looks at the two ends of a range only.

    Raises:
        ValueError: if a value is outside its domain, or a tensor has another shape.
    """

    NUMBERS: ClassVar = ("scale", "exponent")
    """Attributes that are continuous. Stacks, batches, graphs and files treat all alike."""

    scale: float | Tensor
    exponent: float | Tensor = 1.0
    shape: Shape = "gaussian"
    reference_size: float | None = None

    def __post_init__(self) -> None:
        for name, value in self.numbers().items():
            if isinstance(value, Tensor):
                _require_values(f"PointSpread.{name}", value, *DOMAIN[name])
            else:
                checks.within(f"PointSpread.{name}", value, *DOMAIN[name])
        checks.one_of("PointSpread.shape", self.shape, get_args(Shape))
        if self.reference_size is not None:
            checks.positive("PointSpread.reference_size", self.reference_size, "px")

    @staticmethod
    def paper(coefficient: float = 0.3) -> "PointSpread":
        """Law of the paper, φ = coefficient·b̄ (table 2: .3, figure 7: .8), in px of its pictures,
        whose short side is 518 px.
        """
        return PointSpread(coefficient, 1.0, reference_size=PAPER_SIZE)

    @staticmethod
    def calibrated(focal_px: float) -> "PointSpread":
        """Law fitted to Monte Carlo light transport with Petzold's measured phase functions and the
        Henyey–Greenstein function (HG) of mean cosine .924. Use it with g = .05 and μ = .075, which
        keep the paper's μ/g.

        Mean RMSE of direct + forward light over b̄z = .1…5, from
        `python -m benchmarks.accuracy.physics`:

            |                                          | Petzold's | HG .924 | .90   | .85   |
            | this law                                 | .0066     | .0075   | .0100 | .0181 |
            | one Gaussian, .080·focal_px, .51, g .066 | .0115     | .0108   | .0088 | .0123 |
            | the paper's                              | .037      | .053    | .050  | .046  |

        Its tails need more blurs, which takes about 1.5 times the time of that Gaussian.

        Args:
            focal_px: focal length, px of the image at hand; .866·width for a 60° field of view.

        Raises:
            ValueError: if it is no positive number.
        """
        checks.positive("focal_px", focal_px, "px")
        return PointSpread(0.030 * focal_px, 0.62, "exponential")

    @staticmethod
    def none() -> "PointSpread":
        """No blur: forward scatter adds light but moves none."""
        return PointSpread(0.0)

    @staticmethod
    def stack(
        laws: "Sequence[PointSpread]", rows: Sequence[int], dtype: torch.dtype
    ) -> "PointSpread":
        """Join the laws of media of `rows` rows each; numbers become tensors where laws differ."""
        if len({(law.shape, law.reference_size) for law in laws}) > 1:
            got = sorted(set(map(str, laws)))
            raise ValueError(
                f"media must share the shape and reference_size of their point spreads, got {got}"
            )

        def join(values: list[float | Tensor]) -> float | Tensor:
            if not any(isinstance(value, Tensor) or value != values[0] for value in values):
                return values[0]
            pairs = zip(values, rows, strict=True)
            return torch.cat([torch.as_tensor(x, dtype=dtype).expand(count) for x, count in pairs])

        joined: dict[str, Any] = {
            name: join([getattr(law, name) for law in laws]) for name in PointSpread.NUMBERS
        }
        return replace(laws[0], **joined)

    def numbers(self) -> dict[str, Any]:
        """The values of `NUMBERS` by name."""
        return {name: getattr(self, name) for name in self.NUMBERS}

    @property
    def has_tensors(self) -> bool:
        """True if a number is a tensor: one for each medium, or one that is learned."""
        return isinstance(self.scale, Tensor) or isinstance(self.exponent, Tensor)

    @property
    def requires_grad(self) -> bool:
        """True if a number records gradients."""
        values = self.numbers().values() if self.has_tensors else ()
        return any(isinstance(value, Tensor) and value.requires_grad for value in values)

    def rows(self, count: int, like: Tensor) -> dict[str, Tensor]:
        """The numbers by name, as tensors (count,) of the type and device of `like`."""
        return {
            name: (x.to(like) if isinstance(x, Tensor) else like.new_tensor(x)).expand(count)
            for name, x in self.numbers().items()
        }

    def require_rows(self, count: int) -> None:
        """Refuse tensors that are neither one number for all media nor one for each of `count`."""
        for name, value in self.numbers().items() if self.has_tensors else ():
            if isinstance(value, Tensor) and value.shape not in ((), (count,)):
                expected = f"() or ({count},), a number for each medium"
                got = tuple(value.shape)
                raise ValueError(f"PointSpread.{name} must have shape {expected}, got {got}")

    def map(self, function: Callable[[Tensor], Tensor]) -> "PointSpread":
        """Apply a function to the tensors of the law."""
        tensors = {n: value for n, value in self.numbers().items() if isinstance(value, Tensor)}
        changed: dict[str, Any] = {name: function(value) for name, value in tensors.items()}
        return replace(self, **changed) if changed else self

    def sigma(self, lengths: Any, size: tuple[int, int] | None) -> Any:
        """Widths σ, px, as a tensor or an array.

        Args:
            lengths (BxC'xHxW tensor; of a law of plain numbers also an array of any shape):
                scattering lengths b̄·z, ≥ 0.
            size: (height, width) of the image, px; None for px of `reference_size`.
        """
        scale, exponent = self.scale, self.exponent
        if isinstance(scale, Tensor):
            scale = scale.reshape(-1, 1, 1, 1).to(lengths)
        if isinstance(exponent, Tensor):
            exponent = exponent.reshape(-1, 1, 1, 1).to(lengths)
        return width_at(lengths, scale * pixel_scale(self.reference_size, size), exponent)

    def __str__(self) -> str:
        if not isinstance(self.scale, Tensor) and self.scale == 0:
            return "no blur"
        scale, exponent = (
            "learned" if isinstance(value, Tensor) else f"{value:.3g}"
            for value in (self.scale, self.exponent)
        )
        at = "" if self.reference_size is None else f" at {self.reference_size:g} px short side"
        return f"{self.shape} σ = {scale}·(b̄ z)^{exponent} px{at}"


def width_at(lengths: Any, scale: float | Tensor, exponent: float | Tensor) -> Any:
    """scale·lengths^exponent, of tensors or arrays whose shapes broadcast."""
    x = lengths.clip(*LENGTHS)
    if isinstance(exponent, Tensor) or exponent != 1:
        # ONNX Runtime would compute x^1
        x = raised(x, exponent)
    return scale * x


def _require_values(name: str, value: Tensor, low: float, high: float) -> None:
    """Refuse a tensor of another shape than () or (B,), and one with values outside [low, high],
    NaN or infinite.
    """
    if value.ndim > 1 or not value.is_floating_point():
        got = f"{value.dtype} of shape {tuple(value.shape)}"
        raise ValueError(f"{name} must be a number or a floating-point tensor (B,), got {got}")
    tracing = torch.jit.is_tracing()  # type: ignore[attr-defined, no-untyped-call]
    unknown = value.is_meta or torch.compiler.is_compiling() or tracing
    if not value.is_leaf or unknown:
        return  # computed from parameters, or without values yet
    numbers = value.detach()
    if not bool(((numbers >= low) & (numbers <= high) & numbers.isfinite()).all()):
        raise ValueError(f"{name} must be {checks.bounds(low, high)}, got {numbers.tolist()}")


def pixel_scale(reference_size: float | None, size: tuple[int, int] | None) -> float | Tensor:
    """Pixels of an image of (height, width) `size` per pixel at the reference size."""
    if reference_size is None or size is None:
        return 1.0
    if isinstance(size[0], torch.SymInt):  # type: ignore[unreachable]
        # in a graph for any size; a quotient of symbolic numbers would enter it in single precision
        sides = [torch.full((), side, dtype=torch.float64) for side in size]  # type: ignore[unreachable]
        return torch.minimum(*sides) / reference_size
    return min(size) / reference_size
