"""From a lamp to the surfaces of the scene.

A surface at r metres from the lamp gets power·cone(ψ)·cos(ι)/r² of its light, where ψ is the angle
to the lamp's axis and ι the angle of incidence; 1 is a white plate in daylight at the surface. The
lamp is no point but as wide as its radius R: r² is the squared distance and R².
"""

from typing import NamedTuple

import torch
from torch import Tensor

from uwaug.light.rays import View
from uwaug.light.source import Lamp

__all__ = ["Beam", "Ray", "beam_of", "column", "facing", "ray_of"]


class Ray(NamedTuple):
    """Rays of the camera as the lamp sees them: where they come nearest to it, and how far from it
    they are there, m.
    """

    middle: Tensor
    height: Tensor


class Beam(NamedTuple):
    """What a lamp sends to each pixel's surface (Bx1xHxW): a share of its light, over metres."""

    share: Tensor
    metres: Tensor


def column(value: Tensor) -> Tensor:
    """A number of each sample (B) beside pictures."""
    return value.reshape(-1, 1, 1, 1)


def ray_of(lamp: Lamp, view: View) -> Ray:
    """The rays of a view as the lamp sees them."""
    x0, y0, z0 = (column(value) for value in lamp.position.unbind(-1))
    short = view.shortening()
    middle = (view.x * x0 + view.y * y0 + z0) * short
    # |L × ray|, as |L|² − s₀² would cancel
    across = (y0 - z0 * view.y).square() + (z0 * view.x - x0).square()
    across = across + (x0 * view.y - y0 * view.x).square()
    height = torch.sqrt(across * short.square() + column(lamp.radius).square())
    return Ray(middle, height)


def along_axis(lamp: Lamp, view: View) -> tuple[Tensor, Tensor]:
    """Cosines of the angles between rays and the lamp's axis; how far the lamp lies along it, m."""
    dx, dy, dz = (column(value) for value in lamp.direction.unbind(-1))
    cosine = (view.x * dx + view.y * dy + dz) * view.shortening()
    return cosine, column((lamp.position * lamp.direction).sum(-1))


def beam_of(lamp: Lamp, view: View, ray: Ray, z: Tensor, normals: Tensor) -> Beam:
    """The light of a lamp on points at distance z (Bx1xHxW) whose `normals` are N with N·P = 1."""
    squared = (z - ray.middle).square() + ray.height.square()
    one_over = squared.rsqrt()
    cosine, onto = along_axis(lamp, view)
    cone = lamp.cone_at((z * cosine - onto) * one_over)
    # N points away from the camera: (P − L)·N = 1 − L·N
    before = 1 - _dot(normals, lamp.position)
    incident = before.clamp(min=0.0) * _one_over_length(normals) * one_over
    share = cone * incident.clamp(max=1.0) * one_over.square() * column(lamp.power)
    return Beam(share, squared * one_over)


def facing(normals: Tensor, direction: Tensor) -> Tensor:
    """The cosine between a surface's normal and a direction (B, 3), 0 on its back (Bx1xHxW)."""
    return (-_dot(normals, direction) * _one_over_length(normals)).clamp(min=0.0)


def _dot(normals: Tensor, vector: Tensor) -> Tensor:
    x, y, z = (column(value) for value in vector.unbind(-1))
    return normals[:, :1] * x + normals[:, 1:2] * y + normals[:, 2:] * z


def _one_over_length(normals: Tensor) -> Tensor:
    x, y, z = normals[:, :1], normals[:, 1:2], normals[:, 2:]
    return (x.square() + y.square() + z.square()).rsqrt()
