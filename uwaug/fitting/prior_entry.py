"""The water of a real picture, by the red-channel prior: `red_channel_prior`.

    I_c = t_c·J_c + (1 − t_c)·V_c            t_c = e^(−β_c z)

V is the light of open water: an even part of the picture, where red is darkest. Surfaces are
lighter than black, so t_c ≥ 1 − I_c/V_c, and darker than a white plate, so
t_c ≥ 1 − (1 − I_c)/(1 − V_c). In most places of most scenes something is nearly black, and the
first bound is nearly reached in each neighbourhood.

Galdran et al. have one t for all channels: the largest of the first bound of green and blue and the
second of red. Here each channel has its own rate β_c, and one distance serves them all. Where the
second bound is above the first, nothing is black there.

Source: Galdran, Pardo, Picón and Alvarez-Gila, *Automatic Red-Channel underwater image
restoration*, Journal of Visual Communication and Image Representation 26, 2015,
doi:10.1016/j.jvcir.2014.11.006.
"""

import warnings
from dataclasses import dataclass
from typing import get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import ColorSpace
from uwaug.fitting.prior_rates import SIDE, metric_rates, relative_rates
from uwaug.fitting.prior_water import open_water, veil_of
from uwaug.formation.colour import to_light
from uwaug.optics.medium import Medium

__all__ = ["WaterEstimate", "red_channel_prior"]

_SMALLEST = 48
"""px: short side of a picture."""


@dataclass(frozen=True, eq=False)
class WaterEstimate:
    """What a real picture tells about its water; made by `uwaug.fitting.red_channel_prior`.

    Attributes:
        veil (3 tensor): light of open water, linear, float64.
        rates (3 tensor): β of each channel, 1/m; if the distance was not known, for a distance of
            0…1, where 1 is the farthest surface.
        transmission (3xHxW tensor): of each pixel, float32; 0 in open water, NaN where the picture
            does not tell.
        open_water (1xHxW tensor): where open water was found, bool.
        metric: whether the rates are in 1/m.
        doubts: in words, what the picture does not tell well.
    """

    veil: Tensor
    rates: Tensor
    transmission: Tensor
    open_water: Tensor
    metric: bool
    doubts: tuple[str, ...]

    @property
    def medium(self) -> Medium:
        """The estimate as a water without forward scatter: G = β."""
        distances = "metres" if self.metric else "relative distance, 1 = farthest surface"
        note = f"estimate from a picture by the red-channel prior, {distances}"
        for doubt in self.doubts:
            note += f"; in doubt: {doubt}"
        medium = Medium.from_coefficients(self.rates, self.rates, self.veil)
        return Medium.of_tensors(medium.tensors(), medium.point_spread, (note,))

    def __repr__(self) -> str:
        veil, rates = (", ".join(f"{x:.3g}" for x in row) for row in (self.veil, self.rates))
        unit = "/m" if self.metric else " at relative distances"
        said = "".join(f"; in doubt: {doubt}" for doubt in self.doubts)
        return f"WaterEstimate(V = {veil}; β = {rates}{unit}{said})"


def red_channel_prior(
    picture: Tensor, distance: Tensor | None = None, *, color_space: ColorSpace = "srgb"
) -> WaterEstimate:
    """Estimate veil and attenuation from a real underwater picture: "make mine look like that one".

    Args:
        picture (3xHxW tensor): uint8 (0…255) or floating point (0…1), with open water in view.
        distance (1xHxW tensor): metres along the ray; NaN, 0 and negative are unknown; +inf is open
            water, which is then not searched for. None: the picture gives a relative distance.
        color_space: "srgb", or "linear" for linear light. All numbers refer to linear light.

    Returns:
        The estimate. What the picture does not tell well stands in its `doubts`, and in a warning.

    Raises:
        TypeError: if the picture or the distance is no such tensor.
        ValueError: if they do not suit; or if the scene does not allow an estimate: no open water
            in view, red not darker than green and blue there, open water at a near distance (a
            wall), one colour everywhere, or nothing darker than the water.

    The veil of open water is exact within noise. β needs surfaces that are nearly black at all
    distances, or alike at all. A smooth wall that has taken on the colour of the water cannot be
    told from it without distances.

    Examples:
        >>> import torch, uwaug
        >>> z = torch.full((1, 96, 96), torch.inf)
        >>> z[:, 40:] = torch.linspace(6, 1, 56)[:, None]
        >>> scene = torch.rand(3, 24, 24, generator=torch.Generator().manual_seed(0))
        >>> scene = (scene * (scene[:1] > 0.3)).repeat_interleave(4, 1).repeat_interleave(4, 2)
        >>> beta = (0.5, 0.3, 0.3)
        >>> water = uwaug.Medium.from_coefficients(beta, beta, veil=(0.1, 0.3, 0.4))
        >>> picture = uwaug.Underwater(water, color_space="linear")(scene, z)
        >>> found = uwaug.fitting.red_channel_prior(picture, z, color_space="linear")
        >>> found.veil.round(decimals=2).tolist()
        [0.1, 0.3, 0.4]
        >>> found.rates.round(decimals=1).tolist()
        [0.5, 0.3, 0.3]
    """
    _validate(picture, distance, color_space)
    light, z = _reduced(picture, distance, color_space)
    found = open_water(light, z)
    veil = veil_of(light, found.mask)
    if z is None:
        rates = relative_rates(light, veil, found.mask)
    else:
        rates = metric_rates(light, veil, found.mask, z)
    doubts = [*found.doubts, *rates.doubts]
    if doubts:
        warnings.warn(f"picture: {'; '.join(doubts)}", UserWarning, stacklevel=2)
    transmission = torch.exp(-rates.beta[:, None, None] * rates.distance)
    return WaterEstimate(
        veil=veil,
        rates=rates.beta,
        transmission=_enlarged(transmission.float(), picture),
        open_water=_enlarged(found.mask[None].float(), picture) > 0,
        metric=z is not None,
        doubts=tuple(doubts),
    )


def _validate(picture: Tensor, distance: Tensor | None, color_space: str) -> None:
    checks.one_of("color_space", color_space, get_args(ColorSpace))
    if not (isinstance(picture, Tensor) and picture.dtype == torch.uint8):
        checks.floating("picture", picture)
    checks.picture("picture", picture, 3)
    if picture.ndim == 4:
        raise ValueError(f"picture must be one, (3, H, W), got a batch {tuple(picture.shape)}")
    height, width = picture.shape[-2:]
    if min(height, width) < _SMALLEST:
        expected = f"expected {_SMALLEST} px at least on its short side"
        raise ValueError(f"picture is too small, {height}×{width} px: {expected}")
    if distance is None:
        return
    checks.floating("distance", distance)
    checks.picture("distance", distance, 1)
    checks.same_size("distance", distance, picture)
    checks.same_device("distance", distance, picture)
    if distance.ndim == 4:
        raise ValueError(f"distance must be one map, (1, H, W), got {tuple(distance.shape)}")
    checks.metres("distance", distance)


def _reduced(
    picture: Tensor, distance: Tensor | None, color_space: ColorSpace
) -> tuple[Tensor, Tensor | None]:
    """Linear light (3xhxw) as large as it is looked at, float64, and distances (hxw, NaN where
    unknown).
    """
    light = to_light(picture.detach().cpu(), color_space).double()
    height, width = picture.shape[-2:]
    block = max(1, min(height, width) // SIDE)
    rows, columns = height // block, width // block
    light = F.avg_pool2d(light[None], block)[0, :, :rows, :columns]
    if distance is None:
        return light, None
    middle = block // 2
    # a mean over an edge would be the distance of nothing
    z = distance.detach().cpu()[0, middle::block, middle::block][:rows, :columns].double()
    z = torch.where(z > checks.OPEN, torch.inf, z)
    return light, torch.where(z > 0, z, torch.nan)


def _enlarged(values: Tensor, picture: Tensor) -> Tensor:
    """Back to the size of the picture (CxHxW)."""
    size = (picture.shape[-2], picture.shape[-1])
    return F.interpolate(values[None], size, mode="nearest-exact")[0].to(picture.device)
