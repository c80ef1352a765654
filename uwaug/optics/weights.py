"""A medium as NumPy arrays, for plans and loops."""

from typing import NamedTuple

import numpy as np

from uwaug._support.types import Array
from uwaug.optics.point_spread import widths


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
        """The n-th medium, as a batch of one."""
        return self if len(self.beta) == 1 else Weights(*[array[n : n + 1] for array in self])

    def seen_by(self, gains: Array) -> "Weights":
        """The media before a camera that mixes channels by matrices (B or 1, 3, 3)."""
        count = max(len(gains), len(self.beta))
        wide = self
        if count > len(self.beta):
            wide = Weights(*[array.repeat(count, 0) for array in self])
        direct = (gains @ wide.direct.reshape(count, 3, -1)).reshape(wide.direct.shape)
        signal = (gains @ wide.signal.reshape(count, 3, -1)).reshape(wide.signal.shape)
        return wide._replace(direct=direct, signal=signal, veil=gains @ wide.veil)

    def widths(self, z: Array) -> Array:
        """Widths (BxN) of the forward scatter at distances (N), m, in units of the law."""
        numbers = self.b_mean[:, None], self.scale[:, None], self.exponent[:, None]
        return np.asarray(widths(z, *numbers))
