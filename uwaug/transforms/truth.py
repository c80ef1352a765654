"""What water and camera did to a picture, in linear light: the truth for restoration."""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwaug.formation.image import terms_of
from uwaug.formation.setting import Setting
from uwaug.optics.curves import passed

MAPS = ("clean", "z", "direct", "transmission", "signal", "veil")
"""Maps of a `Truth`."""


class Truth(NamedTuple):
    """What water and camera did to a picture. In linear light the degraded picture is

        gain @ (signal + veil)

    but for the sensor's noise, which comes before the gain, and gamut and tone after it. Of grey
    surfaces (`RandomWater(color_matrix=None)`)

        signal = direct·J + (transmission − direct)·blur(J)

    so that signal/transmission is J where nothing is blurred: in even areas, and everywhere with
    `PointSpread.none()`. Colours with spectra mix channels, so that signal may be negative.

    Attributes:
        clean (3xHxW): the scene J without water.
        z (1xHxW): effective distance, m: scaled, without holes, times the medium field.
        direct (3xHxW): share of the surface's light that arrives from a white scene unscattered.
        transmission (3xHxW): the same, with what is scattered forward.
        signal (3xHxW): light that arrives from the scene, direct and blurred.
        veil (3xHxW): backscattered light.
        gain (3x3): matrix of the camera: exposure, white balance and saturation.
        vertical_depth: m; None of a `Medium`.
    """

    clean: Tensor
    z: Tensor
    direct: Tensor
    transmission: Tensor
    signal: Tensor
    veil: Tensor
    gain: Tensor
    vertical_depth: float | None

    def record(self) -> dict[str, Any]:
        """All but the maps, as JSON holds it."""
        return {"gain": self.gain.tolist(), "vertical_depth": self.vertical_depth}


def truth_of(
    J: Tensor, z: Tensor, metres: Tensor, setting: Setting, vertical_depth: float | None
) -> Truth:
    """The truth of one picture, from linear light J of the scene (1x3xHxW) and distances z with the
    medium field and metres without (1x1xHxW).
    """
    T, terms, gain = terms_of(J, z, setting, metres)
    unscattered, forward, *added = terms.values()
    signal, veil = unscattered + forward, sum(added[1:], added[0])
    white = z.new_ones(1, 3, 1, 1)
    direct, arriving = (
        passed(curve, white).expand_as(J) for curve in (T.direct, T.direct + T.scatter)
    )
    matrix = gain if gain.ndim == 3 else torch.diag_embed(gain.expand(1, 3))
    return Truth(J[0], z[0], direct[0], arriving[0], signal[0], veil[0], matrix[0], vertical_depth)
