"""Warnings that maps may not hold metres, given before pictures are made of them."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from uwaug._support import checks
from uwaug._support.once import Once
from uwaug.distance.sizes import size_in_words
from uwaug.distance.unknown import FARTHEST_SEEN, alone_of_metres, in_words, of_metres, scattered

_CELLS_ACROSS = 72  # of a small copy along the shorter side; nine pixels are read in each
REVERSED = -0.1  # convexity below which near and far are exchanged; one true crop in 100 has less
_REVERSED_LEAST_MAPS = 4  # whose convexity is judged: one may be a bowl, or a made-up ramp
_RUN_MAPS = 8  # first maps of a process that are judged together

_INVERSE = "Inverse(near, far) (--set distance.kind=Inverse)"

_SCALES = (
    f"look relative, 0…1 or standardised: where large is near, {_INVERSE}; where 0 is near, "
    "Relative instead",
    "are whole numbers, as metres hardly are: --unit mm or cm (divide by 1000 or 100); or, if they "
    f"are disparities or 8 bits of a network, {_INVERSE}",
    "look like millimetres or centimetres, as their median is beyond 100 m: --unit mm or cm "
    "(divide by 1000 or 100); or like disparities: from_disparity",
    "look like kilometres, as all is nearer than 5 cm: --unit 1000 (multiply by 1000); or like "
    "metres that were divided: leave --unit out",
    "span all that 16 bits hold, as maps do that were stretched: if they are relative, 0…1, "
    f"{_INVERSE} where large is near, Relative where 0 is near",
    "are all multiples of 8 mm: of SUN RGB-D, turn the bits back (numbers >> 3 | numbers << 13)",
)
_STRETCHED, _EIGHTS = 4, 5

_LARGEST_16_BITS_M = (65.535, 655.35)  # in mm and in cm
_STAND_IN_SHARE = 0.2  # of a map's pixels at most: more may be a wall


class Evidence(NamedTuple):
    """Properties of one map that `judged` needs, in some 600 numbers."""

    digest: int  # hash of a small copy, which tells maps apart
    size: str  # sentence, if the map has another size than its picture
    holes: float  # share of unknown pixels
    specks: float  # share of infinite pixels, where they are scattered
    alone: str  # sentence, if a number is far from all others
    top: float  # that number
    scale: int  # index into `_SCALES`, or -1
    convexity: float  # above 0 for distances, below for disparities; NaN where it cannot be told


def doubts(distance: Tensor | Sequence[Tensor], image: Tensor | Sequence[Tensor]) -> list[str]:
    """Tell why maps may not be metres along the ray that fit their pictures.

    Several maps are judged by what most of them show. Near and far are told apart by surfaces: in
    the picture of a plane 1/z is linear, so that the logarithm of distances is convex and that of
    disparities concave. Not found: planar depth, relative maps beyond 1, disparities of flat
    scenes, shifts against the picture.

    Args:
        distance: a map (1xHxW; 0, negative and NaN = unknown, +inf = open water), several maps of
            any size, or a batch (Bx1xHxW).
        image: as many pictures (3xHxW, uint8 or 0…1).

    Returns:
        Sentences, each with its cure.
    """
    maps = [distance] if isinstance(distance, Tensor) and distance.ndim == 3 else list(distance)
    pictures = [image] if isinstance(image, Tensor) and image.ndim == 3 else list(image)
    if len(maps) != len(pictures):
        raise ValueError(f"distance is {len(maps)} maps but image is {len(pictures)} pictures")
    return judged(map(evidence, maps, pictures))


class FirstMaps(Once):
    """Doubts about the first maps of a process: of the first one, then of the first eight."""

    def renew(self) -> None:
        super().renew()
        self.entries: dict[int, Evidence] = {}

    def question(self, distance: Tensor, image: Tensor, stacklevel: int = 2) -> None:
        """Warn, once, of doubts about a map (1xHxW) and those before it."""
        if not self.due():
            return
        entry = evidence(distance, image)._replace(size="")  # `brought_to` tells the size
        first = not self.entries
        self.entries.setdefault(entry.digest, entry)
        if len(self.entries) == _RUN_MAPS:
            self.looks_left = 0
        if (first or not self.looks_left) and (sentences := judged(self.entries.values())):
            self.warn("; ".join(sentences), stacklevel + 1)


first_maps = FirstMaps(looks=4 * _RUN_MAPS)
"""Doubts of this process. Where one map serves many pictures, it waits for 32 and no more."""


def evidence(distance: Tensor, image: Tensor) -> Evidence:
    """Collect what a map (1xHxW) and its picture (3xHxW) show, for `judged`."""
    checks.floating("distance", distance)
    checks.picture("distance", distance, 1)
    checks.picture("image", image, 3)
    z = distance.detach().float()
    (h, w), (height, width) = z.shape[-2:], image.shape[-2:]
    size = "" if (h, w) == (height, width) else size_in_words((h, w), (height, width))
    if not z.numel():
        return Evidence(0, size, 0.0, 0.0, "", torch.nan, -1, torch.nan)
    short = min(h, w)
    cells = min(_CELLS_ACROSS, max(1, short // 3))
    rows, columns = (min(4 * _CELLS_ACROSS, cells * side // short) for side in (h, w))
    points = interpolate(z[None], (3 * rows, 3 * columns), mode="nearest-exact")[0, 0]
    is_valid = points > 0
    nine = torch.where(is_valid, points, torch.nan).reshape(rows, 3, columns, 3).transpose(1, 2)
    log = nine.flatten(2).nanmedian(-1).values.log()
    holes = 1 - float(is_valid.float().mean())
    specks = scattered(torch.where(z >= checks.OPEN, torch.inf, z)).float().mean()
    alone = of_metres(z) | alone_of_metres(z)
    is_stand_in = 0 < float(alone.float().mean()) < _STAND_IN_SHARE
    words = in_words(z, alone, "if they are unknown, set them to 0") if is_stand_in else ""
    top = float(z[alone][0]) if is_stand_in else torch.nan
    digest = hash(points.cpu().numpy().tobytes())
    scale = _scale(points)
    # in a file of 16 bits the largest number is unknown, as 0 is
    if bool(z.isnan().any() and (z == 0).any()):
        high = float(torch.where(z < checks.OPEN, z, 0.0).amax())
        if any(0.9 * end < high < end for end in _LARGEST_16_BITS_M):
            scale = _STRETCHED
    return Evidence(digest, size, holes, float(specks), words, top, scale, _convexity(log))


def judged(evidences: Iterable[Evidence]) -> list[str]:
    """Write the sentences of `doubts`, by what most of the maps show."""
    entries = list({entry.digest: entry for entry in evidences}.values())
    sentences = [entry.size for entry in entries if entry.size][:1]
    holes = sorted(entry.holes for entry in entries)
    if _is_majority([share > 0.5 for share in holes]):
        median = 100 * holes[len(holes) // 2]
        sentences.append(f"{median:.0f} % of the distances are unknown: see what --holes makes up")
    specks = sorted(entry.specks for entry in entries)
    if _is_majority([share > 0 for share in specks]):
        got = f"{100 * specks[len(specks) // 2]:.2g} % of the distances are +inf, scattered among"
        cure = "open water, unless --holes behind (holes='behind') fills them"
        sentences.append(f"{got} near ones: {cure}")
    for scale, sentence in enumerate(_SCALES):
        if _is_majority([entry.scale == scale for entry in entries]):
            sentences.append(f"distances {sentence}")
    # a stand-in comes again, a facade does not
    tops = [entry.top for entry in entries if entry.top > FARTHEST_SEEN]
    if _is_majority([bool(entry.alone) for entry in entries]) or len(set(tops)) < len(tops):
        sentences += [entry.alone for entry in entries if entry.alone][:1]
    # a logarithm says little of stretched maps, which have shifts of their own
    concave = [
        entry.scale not in (0, _STRETCHED) and entry.convexity < REVERSED for entry in entries
    ]
    if len(entries) >= _REVERSED_LEAST_MAPS and _is_majority(concave):
        sentences.append(
            f"distances look like disparity or inverse depth, large where near: {_INVERSE}; "
            "from_disparity where focal length and baseline are known; but frames of one scene are "
            "one witness (--sequence)"
        )
    return list(dict.fromkeys(sentences))


def may_be_mm(shares: Tensor) -> bool:
    """True if a map that was read without unit holds whole numbers in less than a tenth of 0…1."""
    numbers = 65535 * shares[shares > 0]
    sample = numbers[:: max(1, numbers.numel() // 4096)].sort().values
    margin, rounded = sample.numel() // 100, sample.round()
    is_narrow = sample.numel() >= 64 and float(sample[-1 - margin] - sample[margin]) < 6554
    has_numbers = len(set(rounded.tolist())) > 16
    return is_narrow and has_numbers and torch.allclose(sample, rounded, 0, 0.01)


def _is_majority(votes: list[bool]) -> bool:
    return 2 * sum(votes) > len(votes)


def _scale(points: Tensor) -> int:
    """Index into `_SCALES` for the points of a map, or -1."""
    negative = points[points < 0]
    # one negative number may stand for unknown pixels
    if negative.numel() > 0.05 * points.numel() and bool((negative != negative[0]).any()):
        return 0
    metres = points[(points > 0) & (points < checks.OPEN)]
    if metres.numel() < 64:
        return -1
    low, high = checks.extent(metres)
    sampled = metres[:: max(1, metres.numel() // 4096)]
    if high <= 1.0001:
        # both ends, or 8 bits divided by 255; those near a lens may all be nearer than 1 m
        relative = (low < 0.02 and high > 0.3) or _are_whole(255 * sampled, 8)
        return 0 if relative else 3 if high < 0.05 else -1
    if not _are_whole(sampled, 16):
        return 2 if float(sampled.median()) > 100 else _EIGHTS if _are_eights(sampled) else -1
    return 1


def _are_eights(metres: Tensor) -> bool:
    """True for whole multiples of 8 mm, unless they are of centimetres, too."""
    return _are_whole(metres / 0.008, 16) and not _are_whole(metres / 0.04, 1)


def _are_whole(values: Tensor, least: int) -> bool:
    """True for whole numbers of which at least so many differ."""
    whole = values.round()
    return bool(torch.allclose(values, whole, 0, 1e-3)) and len(set(whole.tolist())) >= least


def _convexity(log: Tensor) -> float:
    """Convexity, −1…1, of the logarithm of a map (HxW) where it slopes between edges."""
    bend, weight, step = 0.0, 0.0, 3
    if min(log.shape) <= 4 * step:
        return torch.nan
    for along in (log, log.T):
        before, middle, after = along[: -2 * step], along[step:-step], along[2 * step :]
        slope, curve = (after - before).abs() / 2, before + after - 2 * middle
        inside = curve.isfinite() & (slope > 0.01) & (slope < 0.25) & (curve.abs() < 0.03 + slope)
        slope, curve = slope[inside], curve[inside]
        bend += float(((curve / slope.square()).clamp(-1, 1) * slope).sum())
        weight += float(slope.sum())
    return bend / weight if weight > 0.002 * log.numel() else torch.nan
