"""What tests and benchmarks of lamps share: random geometries, and the veil from its definition."""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug import Medium
from uwaug.light import Lamp

KINDS = ("behind", "beside", "in view")

RADIUS, ASYMMETRY, EDGE = 0.03, 0.924, 0.5


class Case(NamedTuple):
    """A lamp, and a point that is seen: tangents of its ray, and its distance, m."""

    lamp: Lamp
    x: float
    y: float
    z: float


def random_case(kind: str, rng: np.random.Generator) -> Case:
    """A lamp behind the camera, beside it, or in view of it; a scene at .2–20 m."""
    aim = np.array([*rng.uniform(-1, 1, 2), rng.uniform(2, 6)])
    if kind == "behind":
        place = np.array([*rng.uniform(-1, 1, 2), rng.uniform(-2, -0.1)])
    elif kind == "beside":
        turn, off = rng.uniform(0, 2 * math.pi), rng.uniform(0.2, 1.5)
        place = np.array([off * math.cos(turn), off * math.sin(turn), rng.uniform(-0.1, 0.1)])
    else:
        far = rng.uniform(0.5, 6)
        place = np.array([far * rng.uniform(-0.5, 0.5), far * rng.uniform(-0.4, 0.4), far])
        aim = place + rng.normal(size=3)
    power, cone = rng.uniform(0.5, 2), rng.uniform(20, 90)
    lamp = Lamp(tuple(place.tolist()), power, tuple((aim - place).tolist()), cone)
    x, y, z = rng.uniform(-0.55, 0.55), rng.uniform(-0.45, 0.45), 0.2 * 100 ** rng.uniform()
    return Case(lamp, x, y, z)


def beam(lamp: Lamp, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What a lamp sends to points (…x3), by inverse square and cone, and how far they are off."""
    off = points - np.array(lamp.position)
    radius = np.sqrt((off**2).sum(-1) + RADIUS**2)
    share = np.ones_like(radius)
    if lamp.cone is not None:
        cosine = off @ np.array(lamp.aim) / np.linalg.norm(lamp.aim) / radius
        inner, outer = (math.cos(math.radians(lamp.cone * part)) for part in (1 - EDGE, 1))
        share = np.clip((cosine - outer) / (inner - outer), 0, 1)
        share = share * share * (3 - 2 * share)
    return lamp.power * share / radius**2, radius


def light_by_definition(case: Case, water: Medium) -> Tensor:
    """The light (3) of a lamp that a white point sends to the camera through a water
    (`Medium.under_lamp`).
    """
    ray = np.array([case.x, case.y, 1.0])
    sent, radius = beam(case.lamp, case.z * ray / np.linalg.norm(ray))
    rates, weights = water.G[0].numpy(), water.signal_weights[0].numpy()
    return torch.from_numpy(sent * (weights @ np.exp(-rates * (case.z + radius))))


def veil_by_definition(case: Case, water: Medium, points: int = 20_001) -> Tensor:
    """The veil (3) of a lamp's light that a water (`Medium.under_lamp`) scatters once, summed along
    the ray in steps that are fine where the lamp is near.
    """
    ray = np.array([case.x, case.y, 1.0])
    ray /= np.linalg.norm(ray)
    middle, fine = float(ray @ np.array(case.lamp.position)), 1e-3
    t = np.linspace(np.arcsinh(-middle / fine), np.arcsinh((case.z - middle) / fine), points)
    s = middle + fine * np.sinh(t)
    sent, radius = beam(case.lamp, s[:, None] * ray)
    g, cosine = ASYMMETRY, -(s - middle) / radius
    phase = (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * cosine) ** 1.5)
    rates, weights = water.G[0].numpy(), water.veil_weights[0].numpy()
    left = np.exp(-np.multiply.outer(s + radius, rates)) @ weights.T
    density = (math.pi * phase * sent * fine * np.cosh(t))[:, None] * left
    return torch.from_numpy(np.trapezoid(density, t, axis=0))
