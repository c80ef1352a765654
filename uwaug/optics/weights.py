"""A medium as NumPy arrays, for plans and loops."""

from typing import NamedTuple

import numpy as np

from uwaug._support.types import Array
from uwaug.optics.point_spread import widths
from uwaug.optics.surfaces import mixed


class Weights(NamedTuple):
    """Arrays of B media in double precision."""

    beta: Array  # BxK: rates of the direct term, 1/m
    direct: Array  # Bx9xK: weights of T_β, three channels of the scene for each of the picture
    G: Array  # BxL: rates of signal and veil, 1/m
    signal: Array  # Bx9xL: weights of T_G
    veil: Array  # Bx3xL: weights of V
    b_mean: Array  # B: this and the next two are of the width law
    scale: Array
    exponent: Array

    def row(self, n: int) -> "Weights":
        return self if len(self.beta) == 1 else Weights(*[array[n : n + 1] for array in self])

    def brightened(self, gains: Array) -> "Weights":
        """The media as seen by a camera that mixes channels by matrices (B or 1, 3, 3)."""
        wide = self
        if len(gains) > len(self.beta):
            wide = Weights(*[array.repeat(len(gains), 0) for array in self])
        direct, signal = mixed(gains, self.direct), mixed(gains, self.signal)
        return wide._replace(direct=direct, signal=signal, veil=mixed(gains, self.veil))

    def widths(self, z: Array) -> Array:
        """Widths (BxN) of the forward scatter at distances (N), m, in units of the law."""
        numbers = self.b_mean[:, None], self.scale[:, None], self.exponent[:, None]
        return np.asarray(widths(z, *numbers))
