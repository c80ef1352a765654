"""Rays of a pinhole camera at the origin that looks along z; x points right, y down; in metres."""

import math
from typing import NamedTuple, Self

import torch
from torch import Tensor

Vector = tuple[float, float, float]


class Rays(NamedTuple):
    """Rays of a picture.

    Attributes:
        x (1x1x1xW tensor): tangent of each column's angle to the right.
        y (1x1xHx1 tensor): tangent of each row's angle down.
        shortening (1x1xHxW tensor): 1/|(x, y, 1)|, length along z per length of a ray.
    """

    x: Tensor
    y: Tensor
    shortening: Tensor

    @classmethod
    def of(cls, z: Tensor, view: float) -> Self:
        """Rays of a map (Bx1xHxW) that is `view` degrees wide; the axis goes through its middle."""
        height, width = z.shape[-2:]
        focal = width / 2 / math.tan(math.radians(view / 2))
        # in tensors, as a graph knows the size when it runs
        column = torch.arange(width, dtype=z.dtype, device=z.device) - (width - 1) / 2
        row = torch.arange(height, dtype=z.dtype, device=z.device) - (height - 1) / 2
        x, y = (column / focal).reshape(1, 1, 1, -1), (row / focal).reshape(1, 1, -1, 1)
        return cls(x, y, (1 + x.square() + y.square()).rsqrt())

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
