"""From a lamp to the surfaces of the scene.

A surface at r metres from the lamp gets cone(ψ)·cos(ι)/r² of its light, where ψ is the angle
to the lamp's axis and ι the angle of incidence. The
lamp is no point but as wide as its radius R: r² is the squared distance and R².
"""

from typing import NamedTuple

import torch
from torch import Tensor

from uwaug.light.rays import View
from uwaug.light.source import Lamp

__all__ = ["Beam", "Ray", "along", "beam_of", "before_camera", "column", "facing", "ray_of"]


class Ray(NamedTuple):
    """Rays of the camera as the lamp sees them: where they come nearest to it, and how far from it
    they are there, m.
    """

    middle: Tensor
    height: Tensor


class Beam(NamedTuple):
    """What a lamp sends to each pixel's surface (Bx1xHxW): the share of its light, and
    after how many metres.
    """

    share: Tensor
    metres: Tensor


def column(value: Tensor) -> Tensor:
    """A number of each sample (B) beside pictures."""
    return value.reshape(-1, 1, 1, 1)


def ray_of(lamp: Lamp, view: View) -> Ray:
    """The rays of a view as the lamp sees them."""
    middle = along(lamp.position, view)
    if lamp.ahead:  # |L|² − s₀² would lose the digits of a lamp in view
        x, y, z = (column(value) for value in lamp.position.unbind(-1))
        squared = (y - z * view.y).square() + (z * view.x - x).square()
        squared = squared + (x * view.y - y * view.x).square()
        squared = squared * view.shortening().square()
    else:
        squared = (column(lamp.position.square().sum(-1)) - middle.square()).clamp(min=0.0)
    return Ray(middle, torch.sqrt(squared + column(lamp.radius.square())))


def along(vector: Tensor, view: View) -> Tensor:
    """The part of a vector (B, 3) along each ray (Bx1xHxW)."""
    x, y, z = (column(value) for value in vector.unbind(-1))
    return (view.x * x + (view.y * y + z)) * view.shortening()


def beam_of(lamp: Lamp, view: View, ray: Ray, z: Tensor, normals: Tensor) -> Beam:
    """The light of a lamp on points at distance z (Bx1xHxW) whose `normals` are N with N·P = 1."""
    squared = (z - ray.middle).square() + ray.height.square()
    one_over = squared.rsqrt()
    before = z * along(lamp.direction, view) - before_camera(lamp)
    cone = lamp.cone_at(before * one_over)
    # N points away from the camera: (P − L)·N = 1 − L·N
    above = (1 - _dot(normals, lamp.position)).clamp(min=0.0)
    incident = above * _one_over_length(normals) * one_over
    share = cone * incident.clamp(max=1.0) * one_over.square()
    return Beam(share, squared * one_over)


def before_camera(lamp: Lamp) -> Tensor:
    """How far the lamp lies along its own axis from the camera, m."""
    return column((lamp.position * lamp.direction).sum(-1))


def facing(normals: Tensor, direction: Tensor) -> Tensor:
    """The cosine between a surface's normal and a direction (B, 3), 0 on its back (Bx1xHxW)."""
    return (-_dot(normals, direction) * _one_over_length(normals)).clamp(min=0.0)


def _dot(normals: Tensor, vector: Tensor) -> Tensor:
    x, y, z = (column(value) for value in vector.unbind(-1))
    return normals[:, :1] * x + normals[:, 1:2] * y + normals[:, 2:] * z


def _one_over_length(normals: Tensor) -> Tensor:
    x, y, z = normals[:, :1], normals[:, 1:2], normals[:, 2:]
    return (x.square() + y.square() + z.square()).rsqrt()
