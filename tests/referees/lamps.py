"""What tests and benchmarks of lamps share: random geometries, and the veil from its definition."""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from uwaug.light.geometry import View

from uwaug import Light, Medium
from uwaug.light.light import Lamp

KINDS = ("behind", "beside", "in view")


class Case(NamedTuple):
    """A lamp, and a point that is seen: tangents of its ray, and its distance, m."""

    light: Light
    x: float
    y: float
    z: float

    @property
    def lamp(self) -> Lamp:
        """The only source."""
        (lamp,) = self.light.sources
        assert isinstance(lamp, Lamp)
        return lamp

    @property
    def view(self) -> View:
        """The one ray."""
        x, y = (torch.tensor([[[[value]]]], dtype=torch.float64) for value in (self.x, self.y))
        return View(x, y)


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
    light = Light.lamp(
        place.tolist(),
        (aim - place).tolist(),
        power=rng.uniform(0.5, 2),
        cone=rng.uniform(20, 90),
        falloff=rng.uniform(0.2, 1),
    )
    x, y, z = rng.uniform(-0.55, 0.55), rng.uniform(-0.45, 0.45), 0.2 * 100 ** rng.uniform()
    return Case(light, x, y, z)


def veil_by_definition(case: Case, water: Medium, points: int = 20_001) -> Tensor:
    """The veil (3) of a lamp's light that a water (`Medium.under`) scatters once, summed along the
    ray in steps that are fine where the lamp is near.
    """
    lamp = case.lamp
    ray = np.array([case.x, case.y, 1.0])
    ray /= np.linalg.norm(ray)
    place, axis = lamp.position[0].numpy(), lamp.direction[0].numpy()
    middle, fine = float(ray @ place), 1e-3
    t = np.linspace(np.arcsinh(-middle / fine), np.arcsinh((case.z - middle) / fine), points)
    s = middle + fine * np.sinh(t)
    off = s[:, None] * ray - place
    radius = np.sqrt((off**2).sum(1) + float(lamp.radius) ** 2)
    g, cosine = float(lamp.asymmetry), -(s - middle) / radius
    phase = (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * cosine) ** 1.5)
    inner = math.cos(math.radians(float(lamp.cone * (1 - lamp.falloff))))
    outer = math.cos(math.radians(float(lamp.cone)))
    share = np.clip((off @ axis / radius - outer) / (inner - outer), 0, 1)
    share = share * share * (3 - 2 * share)
    rates, weights = water.G[0].numpy(), water.veil_weights[0].numpy()
    left = np.exp(-np.multiply.outer(s + radius, rates)) @ weights.T
    density = (math.pi * phase * share / radius**2 * fine * np.cosh(t))[:, None] * left
    return torch.from_numpy(float(lamp.power) * np.trapezoid(density, t, axis=0))
