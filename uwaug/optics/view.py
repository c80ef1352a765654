"""The camera's view: which way the pixels of a picture look."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.codec import plain

Vector = tuple[float, float, float]
Size = tuple[int, int]

WIDE_DEGREES = 60.0  # stands for an angle that nobody has named
_WIDEST = 8.0  # largest width of a picture in focal lengths: 152°


@plain
@dataclass(frozen=True)
class View:
    """View of a pinhole camera. Planar depth, the blur of forward scatter, the direction of
    daylight, lamps and snow follow from it.

    Attributes:
        degrees: horizontal angle of view, 1…170. It stays when a picture is resized.
        focal_px: focal length, px, in place of degrees. It stays when a picture is cropped. With
            neither, 60° stand for an unknown view, through which no planar map is read.
        center: column and row of the camera's axis, px from the middle of the first pixel; None for
            the middle of the picture.

    Raises:
        TypeError, ValueError: if a number is outside its domain, or both angle and length come.

    Examples:
        >>> View(focal_px=525).crop((480, 640), left=288, top=216)
        View(degrees=None, focal_px=525, center=(31.5, 23.5))
    """

    degrees: float | None = None
    focal_px: float | None = None
    center: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.degrees is not None:
            checks.within("view: degrees", self.degrees, 1.0, 170.0)
        if self.focal_px is not None:
            checks.positive("view: focal_px", self.focal_px, "px")
        if self.degrees is not None and self.focal_px is not None:
            raise ValueError(f"view: degrees and focal_px say the same, got both of {self}")
        if self.center is not None:
            center = checks.pair("view: center", self.center, "(column, row) in px")
            for place in center:
                checks.within("view: center", place)
            object.__setattr__(self, "center", center)

    @staticmethod
    def of(value: "View | float") -> "View":
        """A view, or one of so many degrees."""
        if isinstance(value, (int, float)):
            return View(value)
        checks.instance("view", value, View, "; or give its angle in degrees")
        return value

    def focal(self, width: Any) -> Any:
        """Focal length, px, in a picture of this width, px."""
        if self.focal_px is not None:
            return self.focal_px
        degrees = WIDE_DEGREES if self.degrees is None else self.degrees
        return width / (2 * math.tan(math.radians(degrees / 2)))

    def angle(self, width: int) -> float:
        """Horizontal angle, degrees, of a picture of this width, px, around the axis."""
        return math.degrees(2 * math.atan(width / (2 * self.focal(width))))

    def require(self, width: int) -> None:
        """Refuse a focal length that is not in px of a picture of this width, px."""
        if self.focal_px is not None and width > _WIDEST * self.focal_px:
            expected = f"in px of the picture, {width}·f/w of a sensor w wide"
            raise ValueError(f"view: focal_px must be {expected}, got {self.focal_px:g}")

    def middle(self, size: Size) -> tuple[float, float]:
        """Column and row, px, of the axis in a picture of (height, width) `size`."""
        return self.center or ((size[1] - 1) / 2, (size[0] - 1) / 2)

    def planar(self, width: int) -> dict[str, Any]:
        """Focal length, None of an unknown view, and centre as `uwaug.distance.along_ray` takes
        them, which counts px from the corner of the first pixel.
        """
        center = self.center and tuple(place + 0.5 for place in self.center)
        is_known = self.degrees is not None or self.focal_px is not None
        return {"focal_px": self.focal(width) if is_known else None, "center": center}

    def crop(self, size: Size, left: int, top: int) -> "View":
        """The view of a crop that begins at a column and a row of a picture of (height, width)."""
        column, row = self.middle(size)
        return View(focal_px=self.focal(size[1]), center=(column - left, row - top))

    def resized(self, factor: float) -> "View":
        """The view of the picture at `factor` times its size."""
        focal_px = None if self.focal_px is None else self.focal_px * factor
        center: Any = self.center and tuple((x + 0.5) * factor - 0.5 for x in self.center)
        return View(self.degrees, focal_px, center)

    def rays(self, z: Tensor) -> "Rays":
        """Rays of the pixels of a map (Bx1xHxW)."""
        height, width = z.shape[-2:]
        focal, (column, row) = self.focal(width), self.middle((height, width))
        # in tensors, as a graph knows the size when it runs
        x = (torch.arange(width, dtype=z.dtype, device=z.device) - column) / focal
        y = (torch.arange(height, dtype=z.dtype, device=z.device) - row) / focal
        return Rays.of(x.reshape(1, 1, 1, -1), y.reshape(1, 1, -1, 1))


WIDE = View()  # an unknown view


class Rays(NamedTuple):
    """Rays of a picture, from a camera at the origin that looks along z; x points right, y down."""

    x: Tensor  # 1x1x1xW: tangent of each column's angle to the right
    y: Tensor  # 1x1xHx1: tangent of each row's angle down
    shortening: Tensor  # 1x1xHxW: 1/|(x, y, 1)|, length along z per length of a ray

    @staticmethod
    def of(x: Tensor, y: Tensor) -> "Rays":
        """Rays of these tangents."""
        return Rays(x, y, (1 + x.square() + y.square()).rsqrt())

    def along(self, vector: Vector) -> Tensor:
        """Component of a vector along each ray (1x1xHxW)."""
        return (self.x * vector[0] + (self.y * vector[1] + vector[2])) * self.shortening

    def distance(self, point: Vector) -> Tensor:
        """Distance of a point from the line of each ray (1x1xHxW)."""
        x, y, z = point
        # by the vector product: |point|² − along² would lose the digits of a point in view
        squared = (y - z * self.y).square() + (z * self.x - x).square()
        squared = squared + (x * self.y - y * self.x).square()
        return squared.sqrt() * self.shortening
