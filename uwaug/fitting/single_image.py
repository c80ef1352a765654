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

import math
import warnings
from dataclasses import dataclass
from typing import get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import ColorSpace
from uwaug.fitting.data import mean_3x3
from uwaug.fitting.models import COLOURS
from uwaug.formation.colour import linear_to_srgb, to_light
from uwaug.optics.medium import Medium

_MIN_SIDE = 48  # px: short side of a picture
# px of the small copy, whose mean is compared with its neighbours': noise averages out, texture
# does not.
_BLOCK = 4
_EVEN = 0.006  # sRGB: RMS of blocks about the mean of 5×5 of them; 1.5 of 255 levels
_SHARE = 0.01  # of the picture, that open water fills at least
_RED = 0.9  # of green and blue: what red may have at most
# Linear light that is none of open water: of a lamp or a sensor's end; of shadow.
_CLIPPED, _BLACK = 0.97, 2e-3
# Share of the even blocks, of largest red-channel value, among which the one of least red is taken.
_TOP = 0.1
_OTHER = 0.15  # relative, by which another even part differs so that it is said
SIDE = 240  # px: short side at which a picture is looked at, up to twice as much
# px of these: neighbourhood that holds something dark. With 15, slopes were off by .05.
_WINDOW = 11
# Of the light of surfaces at a distance, all of which fade towards the veil. With the darkest alone
# red was up to .5 off in transmission, where its veil is as dark as dark surfaces.
_QUANTILES = (0.02, 0.1, 0.5, 0.9, 0.98)
# What the darkest of them counts, and the most light that it may reflect: between (1, .05), which
# trusts that near and far surfaces are alike, and (100, 0), which trusts that some are black.
_WEIGHT, _ALBEDO = 20.0, 0.02
_DARK_ALONE = 1e9
_READINGS = ((1.0, 0.05), (100.0, 0.0))  # these two: where they differ, neither is to be trusted
# Ratio of their rates, from where on they differ. Of 75 rates of the bundled scene in 25 waters,
# those that are not in doubt then are 19 % off at most; of the others half are more than 20 % off.
# (By transmissions, .1 apart, six reds were 23 to 63 % too large and not in doubt: a rate may be
# far off where little light is left.)
_APART = 1.25
# RMS in transmission, by which the darkest may miss what black surfaces show. Where something is
# black at all distances it is .01 to .03, and the estimate no more off; where not, .04 to .35, and
# the estimate .1 to .5. In the motorcycle's red, whose veil is as dark as what is darkest, both
# readings agree, and the rate is twice the true one.
_MISFIT = 0.04
# Transmission at the nearest surfaces, or loss at the farthest, below which a rate is a guess.
_GONE = 0.05
_BINS = 12  # steps of distance
_FEWEST = 50  # pixels of a step, or neighbourhoods of a picture
_FADED = 0.1  # of the light of what is taken for open water, that may come from a surface
# Relative, of the ratio of two channels' rates over neighbourhoods, from where on it is said.
_SCATTER = 0.05
# By how much the darkest of a neighbourhood is lighter than open water, so that it tells nothing;
# and the share of such neighbourhoods from which on it is said.
_LIGHT = 0.1
# By how much the second bound is above the first, and in how much of the scene, so that it is said.
# Where neighbourhoods held something black it was 1 % at most, in the bundled scene 5 to 22 %.
_CONTRARY, _CONTRARY_SHARE = 0.05, 0.03

Rates = tuple[Tensor, Tensor, list[str]]


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
        >>> estimate = uwaug.fitting.red_channel_prior(picture, z, color_space="linear")
        >>> estimate.veil.round(decimals=2).tolist()
        [0.1, 0.3, 0.4]
        >>> estimate.rates.round(decimals=1).tolist()
        [0.5, 0.3, 0.3]
    """
    checks.one_of("color_space", color_space, get_args(ColorSpace))
    if not (isinstance(picture, Tensor) and picture.dtype == torch.uint8):
        checks.floating("picture", picture)
    checks.picture("picture", picture, 3)
    if picture.ndim == 4:
        raise ValueError(f"picture must be one, (3, H, W), got a batch {tuple(picture.shape)}")
    height, width = picture.shape[-2:]
    if min(height, width) < _MIN_SIDE:
        expected = f"expected {_MIN_SIDE} px at least on its short side"
        raise ValueError(f"picture is too small, {height}×{width} px: {expected}")
    if distance is not None:
        checks.floating("distance", distance)
        checks.picture("distance", distance, 1)
        checks.same_size("distance", distance, picture)
        checks.same_device("distance", distance, picture)
        if distance.ndim == 4:
            raise ValueError(f"distance must be one map, (1, H, W), got {tuple(distance.shape)}")
        checks.metres("distance", distance)
    light, z = _reduced(picture, distance, color_space)
    water, doubts = open_water(light, z)
    veil = veil_of(light, water)
    if z is None:
        rates, relative, more = relative_rates(light, veil, water)
    else:
        rates, relative, more = metric_rates(light, veil, water, z)
    doubts += more
    if doubts:
        warnings.warn(f"picture: {'; '.join(doubts)}", UserWarning, stacklevel=2)

    def enlarged(values: Tensor) -> Tensor:
        return F.interpolate(values[None], (height, width), mode="nearest-exact")[0]

    return WaterEstimate(
        veil=veil,
        rates=rates,
        transmission=enlarged(torch.exp(-rates[:, None, None] * relative).float()).to(
            picture.device
        ),
        open_water=(enlarged(water[None].float()) > 0).to(picture.device),
        metric=z is not None,
        doubts=tuple(doubts),
    )


def _reduced(
    picture: Tensor, distance: Tensor | None, color_space: ColorSpace
) -> tuple[Tensor, Tensor | None]:
    """Linear light (3xhxw) as large as it is looked at, float64, and distances (hxw, NaN where
    unknown).
    """
    light = to_light(picture.detach().cpu(), color_space, "picture").double()
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


# ---- open water


def open_water(light: Tensor, z: Tensor | None) -> tuple[Tensor, list[str]]:
    """Where open water is (hxw, bool), and doubts about it: by the distances where they say +inf,
    else by how the picture looks.

    Args:
        light (3xHxW tensor): linear light.
        z (HxW tensor): metres, +inf for open water; or None.

    Raises:
        ValueError: if there is none.
    """
    blocks = F.avg_pool2d(light[None], _BLOCK)[0]
    even = _even(linear_to_srgb(blocks))
    if float(even.double().mean()) > 0.95:
        raise ValueError("picture is even all over: expected a scene with open water behind it")
    if z is not None and float(z.isposinf().double().mean()) >= _SHARE:
        return z.isposinf(), []
    parts = _parts(even)
    if not parts:
        raise ValueError(
            f"picture: no open water in view (no even part of {_SHARE:.0%} of it): give a picture "
            "with open water; see uwaug.fitting.fit_veil for one with distances and no open water"
        )
    usual, shares = [], []
    for part in parts:
        colour = blocks[:, part].median(1).values
        bright, red = float(colour.max()), float(colour[0])
        if _BLACK <= bright <= _CLIPPED and red < _RED * float(colour[1:].min()):
            usual.append((part, colour))
        shares.append(", ".join(f"{x:.2g}" for x in colour.tolist()))
    if not usual:
        raise ValueError(
            f"picture: the even parts (red, green, blue of {'; of '.join(shares[:3])}) do not look "
            "like open water, where red is darkest: white-balanced, a wall, or a water that the "
            "red-channel prior does not know. Give distances, with +inf for open water"
        )
    chosen, veil = usual[_chosen(blocks, [part for part, _ in usual])]
    doubts = []
    for part, colour in usual:
        if float((colour / veil - 1).abs().max()) > _OTHER:
            share = float(part.double().mean())
            doubts.append(f"the veil ({share:.0%} of the picture is as even, of another colour)")
            break
    wide = chosen.repeat_interleave(_BLOCK, 0).repeat_interleave(_BLOCK, 1)
    # what the blocks leave over is none
    height, width = light.shape[-2:]
    return F.pad(wide, (0, width - wide.shape[1], 0, height - wide.shape[0])), doubts


def veil_of(light: Tensor, mask: Tensor) -> Tensor:
    """Median light (3) of open water over 3×3 neighbours; edges to surfaces are left out if there
    is more.
    """
    grown = F.max_pool2d((~mask)[None].float(), 5, 1, 2)[0] > 0
    inside = mask & ~grown
    veil = mean_3x3(light)[:, inside if bool(inside.any()) else mask].median(1).values
    if bool((veil <= 0).any()):
        got = ", ".join(f"{x:.2g}" for x in veil.tolist())
        raise ValueError(f"picture: open water has the light {got}: expected some in each channel")
    return veil


def _even(blocks: Tensor) -> Tensor:
    """Blocks that differ from their neighbours by a slope at most, in all channels (hxw)."""

    def mean(values: Tensor) -> Tensor:
        return F.avg_pool2d(F.pad(values[None], (2, 2, 2, 2), mode="replicate"), 5, 1)[0]

    rough = mean((blocks - mean(blocks)).square()).sqrt().amax(0)
    return rough <= _EVEN


def _parts(even: Tensor) -> list[Tensor]:
    """Connected parts that are large enough, the largest first."""
    from scipy.ndimage import label

    numbers, count = label(even.cpu().numpy())
    labels = torch.from_numpy(numbers).to(even.device)
    sizes = torch.bincount(labels.flatten().long(), minlength=count + 1)[1:]
    order = sizes.argsort(descending=True).tolist()
    return [labels == k + 1 for k in order if int(sizes[k]) >= _SHARE * even.numel()]


def _chosen(blocks: Tensor, parts: list[Tensor]) -> int:
    """Which part holds the block of least red among those whose red channel is highest, min(1 − R,
    G, B), as Galdran et al. choose.
    """
    prior = torch.minimum(1 - blocks[0], blocks[1:].amin(0))
    anywhere = torch.stack(parts).any(0)
    high = prior[anywhere].quantile(1 - _TOP)
    red = torch.where(anywhere & (prior >= high), blocks[0], torch.inf)
    place = int(red.argmin())
    return next(i for i, part in enumerate(parts) if bool(part.flatten()[place]))


# ---- rates: β of each channel, the distances (hxw) that they go with, doubts


def metric_rates(light: Tensor, veil: Tensor, water: Tensor, z: Tensor) -> Rates:
    """From how the light of surfaces fades towards the veil, step by step of distance."""
    metres, apart = _steps(light, veil, z.masked_fill(water, torch.nan))
    beta = _fading(metres, apart, veil, _WEIGHT, _ALBEDO)
    _require_far(beta, z[water], metres)
    readings = torch.stack([_fading(metres, apart, veil, *reading) for reading in _READINGS])
    low, high = readings.amin(0), readings.amax(0)
    black = torch.exp(-_fading(metres, apart, veil, _DARK_ALONE, 0.0)[:, None] * metres)
    misfit = (black + apart[:, 0].T / veil[:, None]).square().mean(1).sqrt()
    doubts = []
    for c, colour in enumerate(COLOURS):
        transmission = torch.exp(-beta[c] * metres)
        if float(transmission.max()) < _GONE:
            doubts.append(f"the rate of {colour} (hardly any of it is left at any distance)")
        elif float(transmission.min()) > 1 - _GONE:
            doubts.append(f"the rate of {colour} (it hardly fades)")
        elif float(high[c] / low[c]) > _APART:
            ends = f"{float(low[c]):.3g} and {float(high[c]):.3g} /m"
            why = f"by what is dark and by what is alike it is {ends}"
            doubts.append(f"the rate of {colour} ({why})")
        elif float(misfit[c]) > _MISFIT:
            why = f"what is darkest misses what black surfaces would show by {float(misfit[c]):.2f}"
            doubts.append(f"the rate of {colour} ({why})")
    return beta, torch.where(water, torch.inf, z), doubts


def _steps(light: Tensor, veil: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
    """Mean distance of each of N steps, and there quantiles of light − veil (NxQx3)."""
    surfaces = z.isfinite()
    metres, colours = z[surfaces], mean_3x3(light)[:, surfaces]
    if len(metres) < _BINS * _FEWEST:
        expected = f"expected {_BINS * _FEWEST} at least that are no open water"
        raise ValueError(f"distance is known at {len(metres)} pixels of a small copy: {expected}")
    order = metres.argsort()
    low, high = (float(metres[order[int(q * (len(order) - 1))]]) for q in (0.005, 0.995))
    quantiles = colours.new_tensor(_QUANTILES)
    step = ((metres / low).log() / max(math.log(high / low), 1e-9) * _BINS).floor()
    means, rows = [], []
    for k in range(_BINS):
        inside = step == k
        if int(inside.sum()) >= _FEWEST:
            means.append(metres[inside].mean())
            rows.append(torch.quantile(colours[:, inside], quantiles, dim=1) - veil)
    if len(means) < 3 or high < 1.2 * low:
        got = f"surfaces from {low:.3g} to {high:.3g} m"
        raise ValueError(f"distance: {got} are too much alike to show how light fades")
    return torch.stack(means), torch.stack(rows)


def _fading(metres: Tensor, apart: Tensor, veil: Tensor, weight: float, albedo: float) -> Tensor:
    """β of each channel by least squares: all quantiles fade as (J − V)·e^(−βz), J is free. The
    darkest counts `weight` times and has J of 0 to `albedo`.
    """
    rates = torch.logspace(-3, 1.5, 2000, dtype=torch.float64) / metres.max()
    fades = torch.exp(-rates[:, None] * metres)
    best = []
    for c in range(3):
        light = apart[:, :, c]
        amplitude = (fades @ light) / fades.square().sum(1, keepdim=True)
        dark = -float(veil[c])
        amplitude[:, 0] = amplitude[:, 0].clamp(dark, dark + albedo)
        error = (light - fades[:, :, None] * amplitude[:, None]).square().sum(1)
        error[:, 0] *= weight
        best.append(rates[error.sum(1).argmin()])
    return torch.stack(best)


def _require_far(beta: Tensor, z: Tensor, metres: Tensor) -> None:
    """Refuse what looks like open water and has a distance that is none."""
    near = z[z.isfinite()]
    if 2 * len(near) < len(z):
        return
    middle = float(near.median())
    transmission = float(torch.exp(-beta.min() * middle))
    if transmission > _FADED or bool((metres > 1.1 * middle).any()):
        place = f"what looks like open water is {middle:.3g} m away"
        cure = "a wall? Give a picture with open water, +inf in its map"
        raise ValueError(
            f"picture: {place}, from where {transmission:.0%} of the light arrives: {cure}"
        )


def relative_rates(light: Tensor, veil: Tensor, water: Tensor) -> Rates:
    """From bounds of t in each neighbourhood: the channel of most veil gives the distance, and the
    ratios of the others' rates to its own are what most neighbourhoods agree on.
    """
    black, white = _bounds(light, veil, water)
    first, scene = int(veil.argmax()), ~water
    tells = scene & (black[first] > 0.05) & (black[first] < 0.9)
    if int(tells.sum()) < max(_FEWEST, 0.05 * int(scene.sum())):
        raise ValueError(
            "picture: hardly any surface is darker than the open water, so that nothing tells how "
            "light fades: give a picture with near surfaces, or distances"
        )
    bound = torch.maximum(black[first], white[first])
    depth = -bound.clamp(0.01, 1).log()
    blank = scene & (bound < -_LIGHT)
    far = float(depth[scene & ~blank].quantile(0.98))
    ratios, doubts = [], []
    for c, colour in enumerate(COLOURS):
        usable = tells & (black[c] > 0.05) & (black[c] < 0.9)
        if int(usable.sum()) < _FEWEST:
            raise ValueError(f"picture: no surface tells how {colour} fades: give distances")
        own = black[c][usable]
        ratio = own.log() / black[first][usable].log()
        weights = own * -own.log()  # what an error of the rate is worth in transmission
        middle = _median(ratio, weights)
        ratios.append(middle)
        scatter = float(_median((ratio / middle - 1).abs(), weights))
        if scatter > _SCATTER:
            doubts.append(f"the rate of {colour} (half of the picture is {scatter:.0%} off it)")
    contrary = scene & (white[first] > black[first] + _CONTRARY)
    shares = [float(part.sum() / scene.sum()) for part in (blank, contrary)]
    if shares[0] > _LIGHT or shares[1] > _CONTRARY_SHARE:
        doubts.append(f"all distances ({max(shares):.0%} of the scene has nothing dark in it)")
    relative = torch.where(water, torch.inf, depth / far)
    return torch.stack(ratios) * far, relative.masked_fill(blank, torch.nan), doubts


def _bounds(light: Tensor, veil: Tensor, water: Tensor) -> tuple[Tensor, Tensor]:
    """What t is more than, by what is darkest and by what is lightest in each neighbourhood (3xhxw
    each); open water is left out.
    """
    # a guided filter over them, or an opening, was no better
    shown, V = mean_3x3(light), veil[:, None, None]
    darkest = -_largest(-shown.masked_fill(water, math.inf))
    lightest = _largest(shown.masked_fill(water, -math.inf))
    darkest, lightest = (torch.where(x.isinf(), V, x) for x in (darkest, lightest))
    return 1 - darkest / V, 1 - (1 - lightest) / (1 - V)


def _largest(values: Tensor) -> Tensor:
    """Over each neighbourhood."""
    radius = max(1, round(_WINDOW * min(values.shape[-2:]) / SIDE / 2))
    wide = F.pad(values[None], (radius,) * 4, value=-math.inf)
    return F.max_pool2d(wide, 2 * radius + 1, 1)[0]


def _median(values: Tensor, weights: Tensor) -> Tensor:
    order = values.argsort()
    total = weights[order].cumsum(0)
    return values[order][torch.searchsorted(total, total[-1] / 2)]
