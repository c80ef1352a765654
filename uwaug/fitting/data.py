"""What a fit looks at: checked pairs, and pixels of them with the blurs of the clean picture that
any width law mixes. In line-of-sight order the blurs do not depend on the water, so that they are
made once.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, get_args

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import Array, ColorSpace, Shape
from uwaug.blur.plan import BlurPlan, plan_blur
from uwaug.blur.stack import blurred
from uwaug.formation.colour import to_light
from uwaug.optics.curves import FARTHEST

Pictures = Tensor | Sequence[Tensor]
Places = NDArray[np.int64]
_MIN_PIXELS = 500  # usable pixels, of all pairs together, that a fit needs
_MIN_PIXELS_OF_PAIR = 50  # usable pixels that each pair needs
# Span of the distances as a share of their median, below which they are one distance.
_MIN_SPAN = 0.03
_SAME = 2e-3  # mean difference of two pictures that are one, as a share of their light
_MIN_FIELD = 1e-3  # of a medium field; less water is none
_WHITE = 0.98  # linear light, 253 of 255 in sRGB: the clean picture may be brighter than it says
_TOLERANCE = 2e-4  # of the blurs: what they are wrong by is the least that a residual can be
# Of the picture's short side: the widest blur that a law may ask for. The calibrated law reaches
# that of a 60° view after ten scattering lengths, where no light is left.
_WIDEST = 1 / 5
_BINS = 20  # of the distances, from each of which as many pixels are taken
# Blocks along the picture's short side; the residuals of one may depend on each other.
_CLUSTERS = (10, 5, 3)
_TENTHS = 10  # parts of the distances, and of the brightness, that are clusters too
_MAX_CLUSTERS = 1_000_000  # more than the blocks of any picture
_NEAR, _FAR = 0.05, 0.95  # quantiles of the finite distances that the range of distances goes by
_NODES = 48  # distances at which spectra are summed. Between 2 m and 10 km they hold to 1e-7
_OPEN = 1e4  # m, stands for more: even pure water lets nothing through


@dataclass(frozen=True)
class Geometry:
    """What is known of the pictures before anything is fitted.

    Attributes:
        pairs: how many.
        short_side: of the pictures, px.
        reference: the median distance, m; width laws refer to it.
        farthest: the largest distance that counts, m.
        widest: the largest width of a blur, px.
        focal_px: focal length, px; None if it is unknown.
        unit: of distance.
    """

    pairs: int
    short_side: int
    reference: float
    farthest: float
    widest: float
    focal_px: float | None
    unit: str = "m"


class Pair(NamedTuple):
    """A scene without water and in it, checked.

    Attributes:
        clean, observed (3xHxW tensor): linear light, float64.
        z (1xHxW tensor): effective distance, m, finite, > 0 where `usable`.
        usable (1xHxW tensor): whether a pixel's distance is known and no value was clipped.
    """

    clean: Tensor
    observed: Tensor
    z: Tensor
    usable: Tensor

    @property
    def size(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.observed.shape[-2], self.observed.shape[-1]

    @property
    def position(self) -> Tensor:
        """Of each pixel (2xHxW), down and to the right of the middle, in half diagonals."""
        rows, columns = self.size
        y = torch.arange(rows, dtype=torch.float64) - (rows - 1) / 2
        x = torch.arange(columns, dtype=torch.float64) - (columns - 1) / 2
        return torch.stack(torch.meshgrid(y, x, indexing="ij")) * (2 / math.hypot(rows, columns))

    @property
    def detail(self) -> Tensor:
        """What is left of the clean picture (3xHxW) beside its mean over 3×3 pixels, 1 2 1."""
        kernel = torch.tensor([0.25, 0.5, 0.25], dtype=torch.float64)
        framed = F.pad(self.clean[:, None], (1, 1, 1, 1), mode="replicate")
        return self.clean - F.conv2d(framed, kernel.outer(kernel)[None, None])[:, 0]

    @property
    def slopes(self) -> Tensor:
        """Of the clean picture (2x3xHxW), down and to the right, per pixel."""
        framed = F.pad(self.clean[None], (1, 1, 1, 1), mode="replicate")[0]
        down = framed[:, 2:, 1:-1] - framed[:, :-2, 1:-1]
        right = framed[:, 1:-1, 2:] - framed[:, 1:-1, :-2]
        return torch.stack([down, right]) / 2

    @property
    def finite(self) -> Tensor:
        """Which pixels (1xHxW) are usable and not open water."""
        return self.usable & (self.z < FARTHEST)


@dataclass(frozen=True, eq=False)
class Observations:
    """Checked pairs of one scene or several, and what their files say.

    Attributes:
        pairs: one for each observed picture.
        color_space: of the files.
        bits: 8 if the observed values are those of bytes; None if they are not known to be rounded.
        unit: of distance, "m", or "unit" if its scale is unknown.
    """

    pairs: tuple[Pair, ...]
    color_space: ColorSpace
    bits: int | None
    unit: str

    @staticmethod
    def of(
        clean: Pictures | None,
        observed: Pictures,
        distance: Pictures,
        field: Pictures | None = None,
        mask: Pictures | None = None,
        color_space: ColorSpace = "srgb",
        relative: bool = False,
    ) -> "Observations":
        """One pair for each observed picture; what else is given once serves all of them.

        Args:
            clean: None if there is none: it is black then, and not looked at.
            observed, distance, field, mask, color_space, relative: as of `uwaug.fit`.

        Raises:
            TypeError, ValueError: if an input does not suit; if too few pixels can be used, the
                distances are all alike, or clean and observed are one picture.
        """
        checks.one_of("color_space", color_space, get_args(ColorSpace))
        inputs = {"clean": clean, "observed": observed, "distance": distance}
        inputs |= {"field": field, "mask": mask}
        columns = {name: _listed(name, x) for name, x in inputs.items() if x is not None}
        counts = {name: len(column) for name, column in columns.items()}
        for name, count in counts.items():
            if count not in (1, counts["observed"]):
                raise ValueError(f"{name}: expected one or as many as observed, got {counts}")
        light: dict[int, Tensor] = {}
        pairs = []
        for i in range(counts["observed"]):
            row = {name: column[i % len(column)] for name, column in columns.items()}
            pairs.append(_pair(row, color_space, light, relative))
            apart = float((pairs[i].clean - pairs[i].observed).abs().mean())
            if clean is not None and apart <= _SAME * float(pairs[i].clean.mean()):
                which = f" of pair {i + 1}" if counts["observed"] > 1 else ""
                cure = "give the same scene without water and in it"
                raise ValueError(f"clean and observed{which} are the same picture: {cure}")
        _require_usable(pairs)
        bits = _bits(columns["observed"][0])
        return Observations(tuple(pairs), color_space, bits, "unit" if relative else "m")

    @cached_property
    def distances(self) -> Tensor:
        """The distances (N) of the usable pixels that are not open water, m."""
        return torch.cat([pair.z[pair.finite] for pair in self.pairs])

    @cached_property
    def reference(self) -> float:
        """The median of the finite distances, m."""
        return float(self.distances.median())

    def geometry(self, focal_px: float | None = None) -> Geometry:
        """What is known of the pictures before anything is fitted."""
        return Geometry(
            pairs=len(self.pairs),
            short_side=min(min(pair.size) for pair in self.pairs),
            reference=self.reference,
            farthest=float(np.quantile(self.distances.numpy(), _FAR)),
            widest=min(widest_blur(pair.size) for pair in self.pairs),
            focal_px=None if focal_px is None else float(focal_px),
            unit=self.unit,
        )

    def sample_pixels(self, shapes: Sequence[Shape], count: int, seed: int) -> "Pixels":
        """Draw at most `count` pixels of all pairs together, spread evenly over their distances,
        with the blurs of `shapes` there.
        """
        rng = np.random.default_rng(seed)
        pairs = self.pairs
        drawn = [_stratified(pair, max(1, count // len(pairs)), rng) for pair in pairs]
        width = max(len(places) for places in drawn)
        # a pair of fewer pixels repeats them, without weight
        places = [torch.from_numpy(np.resize(row, width)) for row in drawn]

        def rows(name: str) -> Tensor:
            """One attribute of the pairs at their places (Px…x1xN)."""
            values = [
                getattr(pair, name).flatten(-2)[..., at]
                for pair, at in zip(pairs, places, strict=True)
            ]
            return torch.stack(values)[..., None, :]

        counted = torch.stack([torch.arange(width) < len(row) for row in drawn])
        clusters = []
        for along in _CLUSTERS:
            number = np.stack(
                [cluster_of(at.numpy(), i, pairs[i].size, along) for i, at in enumerate(places)]
            )
            clusters.append(np.unique(number, return_inverse=True)[1].reshape(number.shape))
        clean, z = rows("clean"), rows("z")
        clusters += [_quantiles(values.numpy()) for values in (z[:, 0, 0], clean[:, :, 0].mean(1))]
        return Pixels(
            clean=clean,
            observed=rows("observed"),
            z=z,
            position=rows("position"),
            detail=rows("detail"),
            slopes=rows("slopes"),
            weights=counted.double()[:, None, None].expand(-1, 3, 1, -1),
            clusters=clusters[0],
            others=tuple(clusters[1:]),
            stacks={shape: _stack(pairs, places, shape) for shape in shapes},
            reference=self.reference,
        )


class Stack(NamedTuple):
    """The clean pixels, blurred for a shape of point spread.

    Attributes:
        plan: of the blurs.
        blurs: each a Px3x1xN tensor.
        kept: of a pixel's own light, the share that each blur leaves where it is.
    """

    plan: BlurPlan
    blurs: list[Tensor]
    kept: list[float]


class ChebyshevGrid(NamedTuple):
    """Distances from which those of all pixels are interpolated: curves of 61 bands are smooth.

    Attributes:
        z (1x1x1xK tensor): Chebyshev's nodes of the logarithm of distance, m.
        weights (Px1xKxN tensor): of the nodes at each pixel.
    """

    z: Tensor
    weights: Tensor


@dataclass(frozen=True, eq=False)
class Pixels:
    """N pixels of each of P pairs; where a pair has fewer, the rest has no weight.

    Attributes:
        clean, observed (Px3x1xN tensor): linear light, float64.
        z (Px1x1xN tensor): effective distance, m.
        position (Px2x1xN tensor): down and to the right of the middle, in half diagonals.
        detail (Px3x1xN tensor): clean light beside the mean of 3×3 pixels.
        slopes (Px2x3x1xN tensor): of the clean light, down and to the right, per pixel.
        weights (Px3x1xN tensor): one over the standard deviation of the noise; 0 leaves out.
        clusters (PxN array): the part of the picture that a pixel is from, a number of its own in
            each pair.
        others: parts of other kinds, which something that is missing may hit alike: larger blocks,
            distances, brightness of the clean picture.
        stacks: by shape, as far as they were asked for.
        reference: distance that width laws refer to, m.
    """

    clean: Tensor
    observed: Tensor
    z: Tensor
    position: Tensor
    detail: Tensor
    slopes: Tensor
    weights: Tensor
    clusters: Places
    others: tuple[Places, ...]
    stacks: dict[Shape, Stack]
    reference: float

    def __len__(self) -> int:
        """How many pairs."""
        return len(self.clean)

    def of_values(self, clusters: Places) -> Places:
        """The cluster of each of P·3·N values, from those of pixels (PxN)."""
        pairs, n = clusters.shape
        return np.asarray(np.broadcast_to(clusters[:, None], (pairs, 3, n)).reshape(-1))

    def at(self, index: Any) -> "Pixels":
        """Pixels at an index: of pairs, or behind an ellipsis, of the pixels of each."""
        names = ("clean", "observed", "z", "position", "detail", "slopes", "weights", "clusters")
        values: dict[str, Any] = {name: getattr(self, name)[index] for name in names}
        values["others"] = tuple(numbers[index] for numbers in self.others)
        values["stacks"] = {
            shape: stack._replace(blurs=[blur[index] for blur in stack.blurs])
            for shape, stack in self.stacks.items()
        }
        return replace(self, **values)

    def subsample(self, count: int, seed: "int | np.random.Generator") -> "Pixels":
        """About `count` of the pixels, drawn at random; all if there are no more."""
        n = self.z.shape[-1]
        keep = max(1, count // len(self))
        if keep >= n:
            return self
        return self.at((..., np.random.default_rng(seed).choice(n, keep, replace=False)))

    def weighed(self, weights: Tensor) -> "Pixels":
        """The same pixels with other weights."""
        return replace(self, weights=weights)

    def with_noise(self, noise: Tensor) -> "Pixels":
        """The same pixels with noise (Px3x1xN, linear light) in the clean picture, and in its blurs
        what they leave of it in its place.
        """
        stacks = {}
        for shape, stack in self.stacks.items():
            noisy = [x + kept * noise for x, kept in zip(stack.blurs, stack.kept, strict=True)]
            stacks[shape] = stack._replace(blurs=noisy)
        return replace(self, clean=self.clean + noise, stacks=stacks)

    @cached_property
    def grid(self) -> ChebyshevGrid:
        """The nodes for the distances of these pixels."""
        places = self.z.clamp(max=_OPEN).log()
        low, high = float(places.min()), float(places.max())
        middle, half = (low + high) / 2, max((high - low) / 2, 1e-6)
        angles = (torch.arange(_NODES, dtype=torch.float64) + 0.5) * (math.pi / _NODES)
        x = ((places - middle) / half).clamp(-1, 1)
        # the polynomial that is 1 at one node and 0 at the others: Σ' 2/K·T_n(node)·T_n(x)
        orders = torch.arange(_NODES, dtype=torch.float64)
        at_nodes = torch.cos(orders[:, None] * angles) * (2 / _NODES)
        at_nodes[0] /= 2
        at_pixels = torch.cos(orders[:, None] * torch.acos(x))
        return ChebyshevGrid(
            z=(middle + half * torch.cos(angles)).exp().reshape(1, 1, 1, -1),
            weights=at_nodes.T @ at_pixels,
        )


def widest_blur(size: tuple[int, int]) -> float:
    """The largest width that a law may ask for, px."""
    return min(size) * _WIDEST


def cluster_of(places: Places, pair: int, size: tuple[int, int], along: int) -> Places:
    """The block of each place in a picture of `size`, of `along` blocks on its short side: a number
    that no block of another pair has.
    """
    side = max(1, min(size) // along)
    down, across = places // size[1] // side, places % size[1] // side
    return _MAX_CLUSTERS * pair + down * -(-size[1] // side) + across


def mean_3x3(light: Tensor) -> Tensor:
    """The mean (CxHxW) over 3×3 neighbours: single pixels would be the darkest for their noise."""
    return F.avg_pool2d(F.pad(light[None], (1, 1, 1, 1), mode="replicate"), 3, 1)[0]


def _listed(name: str, value: Any) -> list[Tensor]:
    """Pictures one by one, from a picture, a batch or a sequence."""
    if isinstance(value, Tensor):
        return list(value) if value.ndim == 4 else [value]
    if not isinstance(value, Sequence) or isinstance(value, str):
        checks.floating(name, value)
    pictures: list[Tensor] = []
    for picture in value:
        batch = isinstance(picture, Tensor) and picture.ndim == 4
        pictures += list(picture) if batch else [picture]
    if not pictures:
        raise ValueError(f"{name} is empty: a fit needs at least one")
    return pictures


def _pair(
    row: dict[str, Tensor], color_space: ColorSpace, light: dict[int, Tensor], relative: bool
) -> Pair:
    """A checked pair; `light` keeps what was decoded, so that one clean picture stays one."""
    first = next(iter(row))
    for name, value in row.items():
        picture = name in ("clean", "observed")
        as_bytes = isinstance(value, Tensor) and value.dtype == torch.uint8
        if not (picture and as_bytes) and not (name == "mask" and isinstance(value, Tensor)):
            checks.floating(name, value)
        checks.picture(name, value, 3 if picture else 1)
        if value.shape[-2:] != row[first].shape[-2:]:
            own, expected = tuple(value.shape[-2:]), tuple(row[first].shape[-2:])
            raise ValueError(f"{name} is {own} but {first} is {expected}: they must be aligned")
        if picture and id(value) not in light:
            light[id(value)] = to_light(value.detach().cpu(), color_space, name).double()
    observed = light[id(row["observed"])]
    clean = light[id(row["clean"])] if "clean" in row else torch.zeros_like(observed)
    if not relative:
        checks.metres("distance", row["distance"])
    z = row["distance"].detach().cpu().double()
    usable = z > 0
    z = torch.where(usable, z, 1.0).clamp(max=FARTHEST)
    if "field" in row:
        field = row["field"].detach().cpu().double()
        if not bool(((field >= 0) & field.isfinite()).all()):
            counts = checks.counted(field, "NaN", "negative", "infinite")
            raise ValueError(f"field is {counts}: expected finite values ≥ 0")
        usable = usable & (field > 0)
        z = torch.where(z < FARTHEST, z * field.clamp(min=_MIN_FIELD), z)
    if "mask" in row:
        usable = usable & (row["mask"].detach().cpu() > 0)
    if color_space == "srgb":
        inside = (observed > 0).any(0) & (observed < 1).all(0) & (clean < _WHITE).all(0)
        usable = usable & inside[None]
    return Pair(clean, observed, z, usable)


def _require_usable(pairs: Sequence[Pair]) -> None:
    """Refuse pictures of which too little can be used, saying what it is lost to; and distances
    that are all alike: attenuation is seen by what it does to distances.
    """
    usable = [int(pair.finite.sum()) for pair in pairs]
    if sum(usable) < _MIN_PIXELS:
        total = sum(pair.z.numel() for pair in pairs)
        sea = sum(int((pair.z >= FARTHEST).sum()) for pair in pairs)
        clipped = sum(int((pair.observed >= 1).any(0).sum()) for pair in pairs)
        dark = sum(int((pair.observed <= 0).all(0).sum()) for pair in pairs)
        raise ValueError(
            f"only {sum(usable)} pixels can be used, expected {_MIN_PIXELS}: of {total} pixels "
            f"{sea} lie in open water, {clipped} are saturated and {dark} black in observed; "
            "clean, observed, distance and mask must overlap, and exposure leave pixels unclipped"
        )
    for i, count in enumerate(usable):
        if count < _MIN_PIXELS_OF_PAIR:
            few = f"pair {i + 1} of {len(pairs)} has {count} pixels that can be used"
            raise ValueError(f"{few}, expected {_MIN_PIXELS_OF_PAIR}: leave it out")
    z = torch.cat([pair.z[pair.usable] for pair in pairs]).numpy()
    low, high = np.quantile(z, (0.02, 0.98))
    if high - low < _MIN_SPAN * float(np.median(z[z < FARTHEST])):
        cure = "β, G and veil need a scene with depth, or pictures at several distances"
        raise ValueError(f"distance is flat: all pixels lie at {low:.4g}–{high:.4g} m; {cure}")


def _bits(observed: Tensor) -> int | None:
    """Of the observed files: 8 of bytes; values of another type are not known to be rounded."""
    if observed.dtype == torch.uint8:
        return 8
    # pictures of 8 bits are often given as floating point
    steps = observed.detach().double().cpu() * 255
    return 8 if bool(((steps - steps.round()).abs() < 1e-3).all()) else None


def _quantiles(values: Array) -> Places:
    """Which tenth of them each value is in."""
    ends = np.quantile(values, np.linspace(0, 1, _TENTHS + 1)[1:-1])
    return np.searchsorted(ends, values)


def _stratified(pair: Pair, count: int, rng: np.random.Generator) -> Places:
    """The places of `count` usable pixels: as many from each of equal steps of distance, as far as
    there are.
    """
    places = rng.permutation(np.flatnonzero(pair.usable.numpy()))
    if len(places) <= count:
        return places
    z = pair.z.flatten().numpy()[places]
    low, high = np.quantile(z, (_NEAR, _FAR))
    step = np.clip((z - low) / max(high - low, 1e-9) * _BINS, 0, _BINS - 1).astype(np.int64)
    # the pixels of each step in turn: first one of each, then the second of each, …
    order = np.argsort(step, kind="stable")
    first = np.searchsorted(step[order], np.arange(_BINS))
    turn = np.empty(len(places), dtype=np.int64)
    turn[order] = np.arange(len(places)) - first[step[order]]
    return places[np.argsort(turn, kind="stable")[:count]]


def _stack(pairs: Sequence[Pair], places: Sequence[Tensor], shape: Shape) -> Stack:
    """The blurs of the clean pictures at the places."""
    widest = max(widest_blur(pair.size) for pair in pairs)
    longest = max(max(pair.size) for pair in pairs)
    plan = plan_blur(0.0, widest, _TOLERANCE, shape, longest)
    rows: list[list[Tensor]] = [[] for _ in plan.sigmas]
    clean, blurs = None, []
    for pair, at in zip(pairs, places, strict=True):
        # a series has one clean picture for all pairs
        if pair.clean is not clean:
            clean, blurs = pair.clean, blurred(pair.clean[None].float(), plan)
        for row, blur in zip(rows, blurs, strict=True):
            row.append(blur[0].flatten(1)[:, at].double())
    point = torch.zeros(1, 1, *pairs[0].size)
    middle = (0, 0, pairs[0].size[0] // 2, pairs[0].size[1] // 2)
    point[middle] = 1.0
    kept = [float(blur[middle]) for blur in blurred(point, plan)]
    return Stack(plan, [torch.stack(row)[:, :, None] for row in rows], kept)
