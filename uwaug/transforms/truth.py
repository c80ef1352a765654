"""What water and camera did to a picture, in linear light: the truth for restoration."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwaug.formation.development import exposed
from uwaug.formation.image import terms_of
from uwaug.formation.setting import Setting
from uwaug.optics.curves import passed

_RATES = (1e-3, 30.0)  # 1/m: ends of the rates of water by `Coefficients`
_GRID = 17  # rates that are tried at a time
_ZOOMS = 4  # times that the two about the best are the next ends
_PIXELS = 4096  # about, by which rates are fitted

MAPS = ("clean", "z", "direct", "transmission", "signal", "veil")
"""Maps of a `Truth`."""


class Coefficients(NamedTuple):
    """A picture's water in the words of Akkaynak and Treibitz (2018), a number a channel:

        gain·(ambient·J·e^(−beta_d·z) + b_inf·(1 − e^(−beta_b·z)))

    The rates are the nearest single ones to the water's many, by least squares over the picture.

    Attributes:
        beta_d, beta_b: attenuation of the scene's light, and of the veil, 1/m.
        b_inf: veil of endless water, mean over directions; 1 is a white plate at the surface.
        ambient: light at depth on a white plate, relative to the surface.
        rmse: error of the picture in linear light that these coefficients leave.
    """

    beta_d: list[float]
    beta_b: list[float]
    b_inf: list[float]
    ambient: list[float]
    rmse: float


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
        coefficients: the nearest water of single exponentials; None under lamps, whose light is no
            function of distance alone.
    """

    clean: Tensor
    z: Tensor
    direct: Tensor
    transmission: Tensor
    signal: Tensor
    veil: Tensor
    gain: Tensor
    vertical_depth: float | None
    coefficients: Coefficients | None

    def record(self) -> dict[str, Any]:
        """All but the maps, as JSON holds it."""
        return {
            "gain": self.gain.tolist(),
            "vertical_depth": self.vertical_depth,
            "coefficients": self.coefficients and self.coefficients._asdict(),
        }


def truth_of(
    J: Tensor, z: Tensor, metres: Tensor, setting: Setting, vertical_depth: float | None
) -> Truth:
    """The truth of one picture, from linear light J of the scene (1x3xHxW) and distances z with the
    medium field and metres without (1x1xHxW).
    """
    medium, light = setting.medium.to(z), setting.light
    T, terms, gain = terms_of(J, z, setting, metres)
    unscattered, forward, *added = terms.values()
    signal, veil = unscattered + forward, sum(added[1:], added[0])
    white = z.new_ones(1, 3, 1, 1)
    direct, arriving = (
        passed(curve, white).expand_as(J) for curve in (T.direct, T.direct + T.scatter)
    )
    coefficients = None
    if light is None or not light.lamps:
        day = medium if light is None else medium.brightened(z.new_full((1, 1), light.daylight))
        lens, endless = z.new_tensor([0.0, math.inf])[:, None, None, None, None]
        ambient, level = passed(day.signal(lens), white), day.backscatter(z)
        rise = (veil.mean((-2, -1)) / level.mean((-2, -1))).nan_to_num(1.0)  # 0/0 without a veil
        b_inf = day.backscatter(endless) * rise[..., None, None]
        beta_d = _nearest(z, ambient * J, signal, lambda x: torch.exp(-x))
        beta_b = _nearest(z, b_inf, veil, lambda x: -torch.expm1(-x))
        rebuilt = ambient * J * torch.exp(-beta_d * z) - b_inf * torch.expm1(-beta_b * z)
        error = exposed(rebuilt - signal - veil, gain)
        numbers = {"beta_d": beta_d, "beta_b": beta_b, "b_inf": b_inf, "ambient": ambient}
        of_channels: dict[str, list[float]] = {k: x.flatten().tolist() for k, x in numbers.items()}
        coefficients = Coefficients(**of_channels, rmse=float(error.square().mean().sqrt()))
    matrix = gain if gain.ndim == 3 else torch.diag_embed(gain.expand(1, 3))
    maps = J[0], z[0], direct[0], arriving[0], signal[0], veil[0], matrix[0]
    return Truth(*maps, vertical_depth, coefficients)


def _nearest(z: Tensor, white: Tensor, light: Tensor, shape: Callable[[Tensor], Tensor]) -> Tensor:
    """Rates (1x3x1x1) of the white·shape(rate·z) that is nearest to light (1x3xHxW)."""
    step = z.numel() // _PIXELS | 1  # odd: not the same columns of every row
    maps = (x.expand_as(light).flatten(2) for x in (z, white, light))
    x, w, y = (values[:, :, None, ::step].double() for values in maps)
    low, high = (x.new_full((1, 3, 1), end).log() for end in _RATES)
    shares = torch.linspace(0, 1, _GRID, dtype=x.dtype, device=x.device)
    for _ in range(_ZOOMS):
        rates = (low + (high - low) * shares).exp()
        error = (w * shape(rates[..., None] * x) - y).square().sum(-1)
        best = error.argmin(-1, keepdim=True)
        low, high = (rates.gather(-1, (best + k).clamp(0, _GRID - 1)).log() for k in (-1, 1))
    nearest: Tensor = rates.gather(-1, best)[..., None].to(z)
    return nearest
