"""A medium as NumPy arrays, for plans and loops."""

from typing import NamedTuple

from uwaug._support.types import Array
from uwaug.optics.point_spread import LENGTHS


class Weights(NamedTuple):
    """Arrays of B media in double precision.

    Attributes:
        beta, G (BxK, BxL arrays): rates, 1/m.
        direct, signal (Bx9xK, Bx9xL arrays): weights of T_β and T_G, three channels of the scene
            for each of the picture.
        veil (Bx3xL array): weights of V.
        b_mean, scale, exponent (B arrays): of the width law.
    """

    beta: Array
    direct: Array
    G: Array
    signal: Array
    veil: Array
    b_mean: Array
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
        lengths = (self.b_mean[:, None] * z).clip(*LENGTHS)
        widths: Array = self.scale[:, None] * lengths ** self.exponent[:, None]
        return widths
