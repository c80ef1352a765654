"""What an automatic exposure measures, by the compiled loops."""

import math
from typing import NamedTuple

import numpy as np
from torch import Tensor

from uwaug._support.types import Array
from uwaug.formation.loops import loops
from uwaug.optics.medium import Medium

__all__ = ["Measured", "measured"]


class Measured(NamedTuple):
    """Light of three channels (3): of the scene, of what arrives of it with the veil, both in the
    mean of some pixels; and the veil of the farthest pixel of all.
    """

    before: Array
    after: Array
    veil: Array


def measured(light: Tensor, z: Tensor, medium: Medium, pixels: Tensor) -> Measured:
    """Of one picture.

    Args:
        light (3xHxW tensor): of the scene, float32.
        z (1xHxW tensor): effective distances, m, float32.
        medium: of one row.
        pixels (N tensor): flat indices of those that are looked at.
    """
    G, signal, veil = (t.detach().numpy()[0].astype(np.float64) for t in _weights(medium))
    # 0 first: its exponential is 1, which leaves the scene as it is
    rates = np.append(0.0, G * -math.log2(math.e)).astype(np.float32)
    sums = np.empty((len(rates), 4))
    scene, metres = light.detach().contiguous().numpy(), z.detach().contiguous().numpy()
    loops.get().looks.add_up(scene.reshape(3, -1), metres.reshape(-1), pixels.numpy(), rates, sums)
    means = sums / len(pixels)
    arriving = (signal * means[1:, :3].T).sum(1) + veil @ (1 - means[1:, 3])
    return Measured(means[0, :3], arriving, veil @ -np.expm1(-G * float(z.amax())))


def _weights(medium: Medium) -> tuple[Tensor, Tensor, Tensor]:
    return medium.G, medium.signal_weights, medium.veil_weights
