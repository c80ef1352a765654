"""Development: the steps of a camera between its sensor and a file.

In linear light, after the sum of all terms, in this order:

    noise           of the photons that the sensor counts, and of reading it out
    exposure        J → 2^stops·J; metered, on top of one gain for each picture that keeps the mean
                    luminance of the scene, as a camera does when the water takes the light
    white balance   each channel times (Y/mean)^share, then all so that the luminance Y is kept
    saturation      J → Y + saturation·(J − Y), Y the luminance of each pixel
    gamut           colours outside of sRGB, which have negative channels, move inside
    tone            a curve through black, mid-grey and white

The three after the noise are linear: one gain, or one matrix, for each picture. If they depend on
the picture, its light is measured at some pixels spread over it, without blur and noise.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.codec import plain
from uwaug._support.compiled import compiled
from uwaug._support.types import Array
from uwaug.formation.colour import LUMINANCE
from uwaug.formation.sensor import Sensor
from uwaug.optics.curves import Curves
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import raised

MID_GREY = 0.18  # linear light that a change of contrast leaves as it is
GAINS = (1 / 8, 64.0)  # of a metered exposure, −3 to +6 stops: from ISO 100 to 6400 are 6
DARKEST = 1e-30  # mean light below which there is none to meter: quotients of less have no slope
MOST = 16.0  # largest ratio of luminance to a channel's mean that a white balance makes up for
GAMUT_FROM = 0.75  # (max − c)/max from which on colours are compressed; at 1 a channel is 0
_BEYOND = 1 / (1 - GAMUT_FROM)
_STRAIGHT_OFFSET = 1e6  # stands for the infinite offset of a straight curve
TOE = 1e-4  # light below which tone is straight: less contrast is infinitely steep at 0
# Number of pixels at which the light is measured. Spread by a quasi-random sequence, they see
# stripes and rows of any period in pictures of any size, and the mean luminance of noise is right
# within 2 %. (A grid of every fourth pixel is off by 10 % at 16 px.)
METERED = 2048
LEAST_FACTOR = 1e-6  # of a white balance that was set
BURNT = 0.02  # share of the metered pixels that may burn out
# CIE chroma at L* = 0, and more of it by L*: mean colours of 97 % of 342 photographs stay below
CHROMA = (30.0, 0.4)
# from linear sRGB to X/X_n, Y, Z/Z_n of D65 (IEC 61966-2-1)
XYZ = ((0.4339, 0.3762, 0.1899), LUMINANCE, (0.0178, 0.1095, 0.8727))
LEAST_LIGHT = 1e-4  # of a channel, as cube roots have no slope at 0
_BITS = 20
TURN = 1 << _BITS  # a whole side, in the unit of `STEPS`
# Steps between metered pixels along rows and columns: 1/x and 1/x² with x³ = x + 1 (Roberts 2018,
# the R₂ sequence), as odd whole numbers, which ONNX Runtime multiplies exactly.
STEPS = (791_547, 597_521)
# smallest and largest value of each number of a development
DOMAINS = {
    "exposure": (-10.0, 10.0),
    "white_balance": (-1.0, 1.0),
    "saturation": (0.0, 4.0),
    "gamut": (0.0, 1.0),
    "tone": (0.25, 4.0),
}


@plain
@dataclass(frozen=True)
class Development:
    """The steps of a camera between its sensor and a file; none by default.

    Attributes:
        exposure: −10…10 stops.
        white_balance: share of a grey-world correction, up to 1, which keeps luminance; 0 and less
            for none. Or three factors of the channels, as of a camera that was set.
        saturation: 0 for grey, 1 to leave colours as they are, up to 4.
        gamut: share of gamut compression, 0…1. 0 clips negative channels; 1 squeezes distances from
            grey, (max − c)/max, above .75 to below 1 (Academy, S-2020-001, power 2). If metered,
            more than 0 also lowers the saturation of mean colours that no photograph has.
        tone: exponent c of the curve (1 + k)·x^c/(x^c + k), .25…4, with p = .18^c and
            k = .82·p/(.18 − p); black, mid-grey and white stay, and its slope at mid-grey is
            c·k/(p + k). Light above white goes on along the slope there.
        metered: True for a gain of each picture, 1/8…64, below the exposure's stops. It keeps the
            mean luminance of the scene; with stops above 0 the brightest channel of all but 2 % of
            the pixels stays at or below white, before white balance and saturation.
        noise: the sensor, see `uwaug.Sensor`; None for light without noise.

    Numbers may be tensors (B), as those of `stack`.

    Raises:
        TypeError, ValueError: if a value is out of its range.
    """

    exposure: float | Tensor = 0.0
    white_balance: float | Tensor | tuple[float, float, float] = 0.0
    saturation: float | Tensor = 1.0
    gamut: float | Tensor = 0.0
    tone: float | Tensor = 1.0
    metered: bool = False
    noise: Sensor | None = None

    def __post_init__(self) -> None:
        checks.truth("development: metered", self.metered)
        if self.noise is not None:
            checks.instance("development: noise", self.noise, Sensor)
            self.noise.require_fixed("development: noise")
        for name, domain in DOMAINS.items():
            value = getattr(self, name)
            if name == "white_balance" and isinstance(value, tuple):
                checks.vector("development: white_balance", value, LEAST_FACTOR)
            elif not isinstance(value, Tensor):
                checks.within(f"development: {name}", value, *domain)

    @staticmethod
    def stack(developments: "Sequence[Development]", like: Tensor) -> "Development":
        """Join the developments of a batch, all metered or none, on the device of `like`."""
        columns = [[getattr(d, name) for d in developments] for name in DOMAINS]
        numbers = torch.tensor(columns, dtype=like.dtype).to(like.device)
        named = dict(zip(DOMAINS, numbers, strict=True))
        sensors = [d.noise for d in developments if d.noise is not None]
        noise = Sensor.stack(sensors, like) if sensors else None
        return Development(**named, metered=developments[0].metered, noise=noise)

    @property
    def brightening(self) -> float:
        """Factor by which small differences may grow, without meter and white balance."""
        return float(2.0 ** float(self.exposure)) * max(float(self.saturation), 1.0)

    def gain(self, J: Tensor, z: Tensor, medium: Medium, T: Curves | None = None) -> Tensor:
        """Gain of the linear steps for each picture: one number (B or 1, 1), a number for each
        channel (B or 1, 3), or a matrix (B or 1, 3, 3). Arguments as for `Medium.image`.
        """
        return self.gain_of(metered(J, z, medium, T) if self.measures else None, J)

    @property
    def measures(self) -> bool:
        """True if the gain depends on the picture."""
        share = self.white_balance
        return self.metered or (not isinstance(share, tuple) and _balances(share))

    def settled(
        self, J: Tensor, z: Tensor, medium: Medium, T: Curves | None = None
    ) -> "Development":
        """The development as one picture settles it, for others of the same scene; see `gain`."""
        if not self.measures:
            return self
        means, share = metered(J, z, medium, T), self.white_balance
        exposure, (_, saturation) = float(self.exposure), self._linear(means, J)
        if self.metered:
            exposure = math.log2(float(_automatic(means, exposure)))
        if not isinstance(share, tuple):
            red, green, blue = _balance(means.positive, max(float(share), 0.0))[0].tolist()
            share = (red, green, blue)
        settled: dict[str, Any] = {"exposure": exposure, "white_balance": share}
        return replace(self, **settled, saturation=float(saturation), metered=False)

    def gain_of(self, means: "Means | None", like: Tensor) -> Tensor:
        """The `gain` for what `metered` has measured, of the type of `like`."""
        gain, saturation = self._linear(means, like)
        if isinstance(saturation, Tensor):
            saturation = saturation[..., None]
        elif saturation == 1:
            return gain
        unit = torch.eye(3, dtype=gain.dtype, device=gain.device)
        grey = gain.new_tensor(LUMINANCE).expand(3, 3)
        return (grey + saturation * (unit - grey)) * gain[:, None]

    def _linear(self, means: "Means | None", like: Tensor) -> tuple[Tensor, float | Tensor]:
        """Gain of exposure and white balance (B or 1, 1 or 3), and saturation: one, or (B, 1)."""
        stops, saturation, gamut = (
            _of_rows(number, 2) for number in (self.exposure, self.saturation, self.gamut)
        )
        if means is not None and self.metered:
            gain = _automatic(means, stops)
        else:
            gain = like.new_ones(1, 1) * 2.0**stops
        if isinstance(self.white_balance, tuple):
            gain = gain * like.new_tensor(self.white_balance)
        elif means is not None and _balances(self.white_balance):
            gain = gain * _balance(means.positive, _of_rows(self.white_balance, 2))
        if means is None or not self.metered or (isinstance(gamut, float) and gamut == 0):
            return gain, saturation
        held = _held(saturation, means.positive * gain)
        return gain, held if isinstance(gamut, float) else torch.where(gamut > 0, held, saturation)

    def shaped(self, light: Tensor) -> Tensor:
        """Light (Bx3xHxW) after gamut and tone."""
        gamut, tone = _of_rows(self.gamut, 4), _of_rows(self.tone, 4)
        if isinstance(gamut, Tensor) or gamut > 0:
            light = compressed(light, gamut)
        return curved(light, tone) if isinstance(tone, Tensor) or tone != 1 else light


def _balances(share: float | Tensor) -> bool:
    return isinstance(share, Tensor) or share > 0


def _of_rows(number: Any, axes: int) -> float | Tensor:
    return number.reshape(-1, *[1] * (axes - 1)) if isinstance(number, Tensor) else float(number)


NEUTRAL = Development()


def exposed(light: Tensor, gain: Tensor) -> Tensor:
    """Light (Bx3xHxW) times a gain, see `Development.gain`."""
    if gain.ndim == 2:
        return light * gain[..., None, None]
    return torch.unflatten(gain @ light.flatten(2), -1, light.shape[-2:])


class Means(NamedTuple):
    """Light of each picture as a camera measures it."""

    scene: Tensor  # Bx3: mean light of the scene
    arriving: Tensor  # Bx3: mean light that arrives
    positive: Tensor  # Bx3: the same without negative channels, of colours outside sRGB
    highlight: Tensor  # Bx1: what the brightest channel of `BURNT` of the pixels exceeds


def metered(J: Tensor, z: Tensor, medium: Medium, T: Curves | None = None) -> Means:
    """The means of some pixels, without the blur; arguments as for `Development.gain`."""
    traced = torch.compiler.is_compiling() or not isinstance(z.shape[-1], int)
    points = (_points if traced else metering_points)(z.shape[-2], z.shape[-1], z.device)
    light = _at(J, points)
    if T is not None:
        T = Curves(*(_at(curve, points) for curve in T))
    arriving = medium.image(_at(z, points), light, light, T)
    scene, means, positive = (x.mean((-2, -1)) for x in (light, arriving, arriving.clamp(min=0.0)))
    highlight = _brightest(arriving).flatten(1).topk(round(BURNT * METERED)).values[:, -1:]
    return Means(scene, means, positive, highlight)


def _automatic(means: Means, stops: Any) -> Tensor:
    """Gain (B, 1) that gives pictures the mean luminance of their scenes, so many stops brighter;
    1 without any light.
    """
    before, after = _luminance(means.scene), _luminance(means.arriving)
    dark = after <= DARKEST
    gain = torch.where(dark, 1.0, before / torch.where(dark, 1.0, after))
    brightened: Tensor = gain.clamp(*GAINS) * 2.0**stops
    least = stops.clamp(max=0.0) if isinstance(stops, Tensor) else min(stops, 0.0)
    return brightened.minimum(2.0**least / means.highlight.clamp(min=1 / GAINS[1]))


def _balance(means: Tensor, share: float | Tensor) -> Tensor:
    """Factors (B, 3) of a white balance, for mean light (B, 3)."""
    share = share.clamp(min=0.0) if isinstance(share, Tensor) else share
    before = _luminance(means)
    lit = before > DARKEST
    before = torch.where(lit, before, 1.0)
    balance: Tensor = (before / means.maximum(before / MOST)) ** share
    after = _luminance(balance * means)
    balance = balance * before / torch.where(after > DARKEST, after, before)
    return torch.where(lit, balance, 1.0)


def _held(saturation: Any, mean: Tensor) -> Tensor:
    """Saturation (B, 1) by which the mean light (B, 3) has no more than `CHROMA`."""
    grey, to_xyz = _luminance(mean), mean.new_tensor(XYZ).mT
    held: Tensor = grey.new_zeros(grey.shape) + saturation
    for _ in range(2):
        vivid = (grey + held * (mean - grey)).clamp(min=LEAST_LIGHT)
        x, y, z = ((vivid @ to_xyz) ** (1 / 3))[..., None].unbind(1)
        chroma = ((500 * (x - y)) ** 2 + (200 * (y - z)) ** 2 + LEAST_LIGHT).sqrt()
        most = CHROMA[0] + CHROMA[1] * (116 * y - 16)
        held = held.minimum(held * most / chroma)
    return held


@compiled
def gain_at(
    means: Array,
    highlight: float,
    stops: float,
    metered: bool,
    white_balance: float,
    factors: Array,
    saturation: float,
    is_held: bool,
) -> Array:
    """`Development.gain_of` of one picture, as a matrix (3, 3), for the loops; of the first three
    `Means` (3x3), and of the `factors` (3) of a white balance that was set.
    """
    luminance = np.array(LUMINANCE)
    gain = 2.0**stops
    if metered:
        before, after = (means[0] * luminance).sum(), (means[1] * luminance).sum()
        automatic = before / after if after > DARKEST else 1.0
        gain *= min(max(automatic, GAINS[0]), GAINS[1])
        gain = min(gain, 2.0 ** min(stops, 0.0) / max(highlight, 1 / GAINS[1]))
    gains = factors * gain
    before = (means[2] * luminance).sum()
    if white_balance > 0 and before > DARKEST:
        balance = (before / np.maximum(means[2], before / MOST)) ** white_balance
        after = (balance * means[2] * luminance).sum()
        gains *= balance * (before / after if after > DARKEST else 1.0)
    if metered and is_held:
        mean = gains * means[2]
        grey = (mean * luminance).sum()
        for _ in range(2):
            vivid = np.maximum(grey + saturation * (mean - grey), LEAST_LIGHT)
            x, y, z = (np.array(XYZ) * vivid).sum(1) ** (1 / 3)
            chroma = math.sqrt((500 * (x - y)) ** 2 + (200 * (y - z)) ** 2 + LEAST_LIGHT)
            most = CHROMA[0] + CHROMA[1] * (116 * y - 16)
            saturation *= min(most / chroma, 1.0)
    matrix = np.empty((3, 3))
    for row in range(3):
        matrix[row] = (1 - saturation) * luminance
        matrix[row, row] += saturation
    matrix *= gains  # columns, as gains come first
    return matrix


def _points(height: int, width: int, device: torch.device) -> Tensor:
    count = torch.arange(METERED, dtype=torch.int64, device=device)
    # by bits of a whole side: a remainder and a quotient take five times as long
    row, column = (((count * step + TURN // 2) & (TURN - 1)) for step in STEPS)
    return (row * height >> _BITS) * width + (column * width >> _BITS)


@lru_cache(maxsize=8)
def metering_points(height: int, width: int, device: torch.device) -> Tensor:
    """Flat indices (`METERED`) of pixels that are spread evenly over a picture."""
    # tensors of inference mode cannot be used outside
    with torch.inference_mode(False):
        return _points(height, width, device)


def _at(values: Tensor, pixels: Tensor) -> Tensor:
    """Pixels (N flat indices) of a picture or map (Bx…xHxW), as one row (Bx…x1xN)."""
    flat = values.flatten(-2)
    # index_select takes 18 times as long
    return flat.gather(-1, pixels.expand(*flat.shape[:-1], -1))[..., None, :]


def _luminance(light: Tensor) -> Tensor:
    return (light * light.new_tensor(LUMINANCE)).sum(-1, keepdim=True)


def _brightest(light: Tensor) -> Tensor:
    # not amax(1), whose shape ONNX Runtime's symbolic inference does not know
    red, green, blue = light.unbind(1)
    return red.maximum(green).maximum(blue)[:, None]


def compressed(light: Tensor, share: float | Tensor) -> Tensor:
    """Light (Bx3xHxW) with colours outside of the gamut moved inside by a share of the way."""
    brightest = _brightest(light)
    lit = brightest > 0
    distance = 1 - light / torch.where(lit, brightest, 1.0)
    beyond = (distance - GAMUT_FROM).clamp(min=0.0) * _BEYOND
    squeezed = beyond * (1 + beyond * beyond).rsqrt()
    change = (beyond - squeezed) * ((1 - GAMUT_FROM) * share)
    # the limit where no channel is above 0, as below the black point
    return light + torch.where(lit, change * brightest, -share * light)


def tone_offset(contrast: float) -> float:
    """Offset k of the curve for which mid-grey stays; a large one for a straight curve."""
    grey = MID_GREY**contrast
    return _STRAIGHT_OFFSET if contrast == 1 else (1 - MID_GREY) * grey / (MID_GREY - grey)


def curved(light: Tensor, contrast: float | Tensor) -> Tensor:
    """Light along the curve (1 + k)·x^c/(x^c + k), odd, through 0, mid-grey and 1, for a contrast c
    (a number, or Bx1x1x1). It is straight below `TOE`, and above 1, where curves of c < 1 have a
    pole.
    """
    k: Any = _STRAIGHT_OFFSET
    if isinstance(contrast, Tensor):
        grey = MID_GREY**contrast
        below = MID_GREY - grey
        straight = below.abs() < 1e-7
        k = torch.where(straight, k, (1 - MID_GREY) * grey / torch.where(straight, 1.0, below))
    else:
        k = tone_offset(contrast)
    size = light.abs().clamp(min=TOE)
    inside = size.clamp(max=1.0)
    power = raised(inside, contrast)
    beyond = (size - inside) * (contrast * k / (1 + k))
    curve: Tensor = light / size * ((1 + k) * power / (power + k) + beyond)
    return curve
