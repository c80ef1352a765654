"""`like`: waters that make pictures look like given photographs. It searches; it knows no physics
beyond that of the draws.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from dataclasses import field as option
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from uwaug._support import checks, codec
from uwaug._support.nouns import Uniform
from uwaug._support.once import muted
from uwaug.distance.made_up import MadeUp
from uwaug.distance.sources import Metres
from uwaug.formation.colour import linear_to_srgb, require_values
from uwaug.transforms.appearance import WATER_FEATURES, Values, water_features
from uwaug.transforms.draws import Record, read_draws, uniform_of
from uwaug.transforms.random_underwater import RandomUnderwater
from uwaug.transforms.samples import typed

_SHORT = 128
"""px, short side of the pictures that are looked at."""

_BROAD, _BETWEEN = 0.4, 0.2
"""Shares of the draws that are new, and that lie between two good ones; the others try the best on
more pictures: what is near on one may be so by what that picture shows. (Other shares, rounds and
numbers of draws kept: benchmarks/CHOICES.md, how constants were chosen.)
"""

_PARENTS = 15
"""The best of the new draws, between which others are made."""

_KEPT = ("water", "light", "development")
"""Nouns whose draws are kept; distances belong to a picture."""

_MORE = 4
"""Pictures on which the best are tried besides their first."""

_FAR = 1.0
"""Standard deviations of photographs from which a warning is due."""

_SPREADS, _COUNTS, *_ = map(np.array, zip(*WATER_FEATURES.values(), strict=True))
_UNITS = _SPREADS * np.sqrt(np.mean(_COUNTS**2)) / _COUNTS
"""What is 1 of each number: a standard deviation of photographs, on average."""


class Nearness(NamedTuple):
    """How near kept draws came to photographs; as text, in a sentence.

    Attributes:
        kept, drawn: distance of the kept draws and of new ones, median, in standard deviations of
            photographs, of a number on average.
        doubt: what is off, in words, where even the kept ones are far; else empty.
    """

    kept: float
    drawn: float
    doubt: str

    def __str__(self) -> str:
        usual = f"all that were tried {self.drawn:.2f}; 1 is the spread of real photographs"
        return f"the pictures that were kept are {self.kept:.2f} away from it, {usual}"


@codec.plain
@dataclass(init=False, eq=False, repr=False)
class UnderwaterLike(RandomUnderwater):
    """A `RandomUnderwater` that picks water and development from a few that were kept, see `like`.

    Args:
        kept: {"water": …, "light": …, "development": …}, as samples of `make_params` have them;
            picked with equal weight. What they leave out is drawn for each picture: distances, and
            the seeds of medium field, particles and noise.
        nearness: how near `like` came; not in `to_dict`.

    Raises:
        ValueError: if there is none, or one is none of this transform's draws.
    """

    kept: Sequence[Mapping[str, Any]] = ()
    nearness: Nearness | None = option(default=None, metadata={"stored": False})

    def __init__(
        self,
        water: Any = None,
        *,
        kept: Sequence[Mapping[str, Any]],
        nearness: Nearness | None = None,
        **options: Any,
    ) -> None:
        super().__init__(water, **options)
        self.kept, self.nearness = kept, nearness
        if not self.kept:
            raise ValueError("kept: expected at least one, got none")
        drawn = super()._sample(uniform_of(0))
        for sample in self.kept:
            read_draws({"samples": [_in_water(drawn, sample)]}, 1, self._nouns)

    def _sample(self, uniform: Uniform) -> Record:
        kept = self.kept[int(uniform("kept") * len(self.kept))]
        return _in_water(super()._sample(uniform), kept)


def like(
    reference: Tensor | Sequence[Tensor],
    pictures: Tensor | Sequence[Tensor],
    distance: Tensor | Sequence[Tensor] | None = None,
    *,
    augment: RandomUnderwater | None = None,
    draws: int = 300,
    keep: int = 10,
    seed: int = 0,
) -> UnderwaterLike:
    """Random waters in which pictures look like a photograph, "like that one".

    Draws of `augment` are held against the photograph by colour and veil: twelve numbers of a
    picture that hang on water more than on the scene. What is nearest is tried on more pictures,
    and kept. It says what looks alike and not which water it is; for that there is `uwaug.fit`.

    Args:
        reference: photographs taken under water, one or several (3xHxW, a batch, or a list), in
            sRGB even where `augment` takes linear light; `keep` draws are kept of each.
        pictures: some of your own, taken in air, as many-sided as your data set (the same). Four to
            eight will do. All are looked at small, with 128 px along their short side.
        distance: their maps (1xHxW, the same), as `augment` reads them; None where it reads none.
        augment: from which waters and developments to draw, and all other options; by default
            `RandomUnderwater()`, or without maps `RandomUnderwater(distance=MadeUp())`.
        draws: pictures that are made for each reference, of which 300 take some 3 s; at least 15
            times `keep`.
        keep: draws to keep.
        seed: of all that is random.

    Returns:
        A `RandomUnderwater` in every respect, whose draws are those kept. Medium field, particles,
        noise and made-up distances are drawn anew for each picture.

    Raises:
        TypeError, ValueError: if an argument does not suit, naming what came and what was expected.

    Warns:
        UserWarning: if even the kept draws look unlike a reference, and in what.

    Examples:
        >>> import torch
        >>> pictures, distance = torch.rand(2, 3, 32, 48), torch.full((2, 1, 32, 48), 3.0)
        >>> wet, _ = RandomUnderwater("7C").at(seed=0, epoch=0, index=0)(pictures, distance)
        >>> augment = like(wet[0], pictures, distance, draws=30, keep=2)
        >>> degraded, _ = augment(pictures, distance)
    """
    if augment is None:
        augment = RandomUnderwater(distance=Metres() if distance is not None else MadeUp())
    checks.instance("augment", augment, RandomUnderwater)
    if not 1 <= keep <= draws // 15:
        raise ValueError(f"draws must be 15 times keep or more, and keep 1, got {draws} and {keep}")
    photographs = [_features(photograph) for photograph in _small("reference", reference, 3)]
    scenes: list[Any] = _small("pictures", pictures, 3)
    maps = [None] * len(scenes) if distance is None else _small("distance", distance, 1)
    if len(maps) != len(scenes):
        raise ValueError(f"distance has {len(maps)} maps for {len(scenes)} pictures")
    trials = _Trials(augment, list(zip(scenes, maps, strict=True)), seed)
    kept, near, doubts = [], [], []
    with muted():
        new = [trials.new(i) for i in range(round(_BROAD * draws))]
        drawn = [_away(draw, photograph) for photograph in photographs for draw in new]
        for photograph in photographs:
            best = trials.best(new, photograph, draws, keep)
            kept += [draw.sample for draw in best]
            near += [_away(draw, photograph) for draw in best]
            doubts.append(_doubt(best, photograph))
    nearness = Nearness(
        float(np.median(near)), float(np.median(drawn)), "; ".join(filter(None, doubts))
    )
    if nearness.doubt:
        warnings.warn(nearness.doubt, stacklevel=2)
    options = {f.name: getattr(augment, f.name) for f in fields(RandomUnderwater) if f.init}
    return UnderwaterLike(**options, kept=tuple(kept), nearness=nearness)


class _Draw(NamedTuple):
    """Water and numbers of a sample, and what it looks like in those pictures it was tried on."""

    sample: Record
    first: int  # of these pictures, which stand in a ring
    seen: list[Values]


class _Trials:
    """Draws of a transform, tried on some scenes: pictures with their maps."""

    def __init__(self, augment: RandomUnderwater, scenes: list[Any], seed: int) -> None:
        self.augment, self.scenes = augment, scenes
        self.generator = torch.Generator().manual_seed(seed)

    def new(self, first: int) -> _Draw:
        (sample,) = self.augment.make_params(self.scenes[0][0], self.generator)["samples"]
        kept = {name: _without_seeds(sample[name]) for name in _KEPT}
        return self.tried(_Draw(kept, first, []))

    def between(self, first: _Draw, second: _Draw) -> _Draw:
        """A draw in the water of the first, with numbers between those of both."""
        mixed = self._mixed(first.sample, second.sample)
        return self.tried(_Draw(mixed, second.first + 1, []))

    def _mixed(self, first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
        mixed = {}
        for name, value in first.items():
            other = second.get(name)
            if isinstance(value, Mapping):
                mixed[name] = self._mixed(value, other or {})
            elif isinstance(value, float) and other is not None:
                share = float(torch.rand((), generator=self.generator, dtype=torch.float64))
                mixed[name] = (1 - share) * value + share * other
            else:
                mixed[name] = value
        return mixed

    def tried(self, draw: _Draw) -> _Draw:
        """The same draw, tried on one more picture."""
        picture, z = self.scenes[(draw.first + len(draw.seen)) % len(self.scenes)]
        (drawn,) = self.augment.make_params(picture, self.generator)["samples"]
        params = {"samples": [_in_water({**drawn, "applied": True}, draw.sample)]}
        made = self.augment.transform(picture, z, params)
        if self.augment.development.color_space == "linear":
            made = linear_to_srgb(made).clamp(0, 1)
        draw.seen.append(_features(made))
        return draw

    def best(self, new: list[_Draw], photograph: Values, draws: int, keep: int) -> list[_Draw]:
        """The draws that are nearest to a photograph, of new ones and of some between them."""

        def away(draw: _Draw) -> float:
            return _away(draw, photograph)

        parents = sorted(new, key=away)[:_PARENTS]
        among = list(new)
        for _ in range(round(_BETWEEN * draws)):
            first, second = torch.randperm(len(parents), generator=self.generator)[:2].tolist()
            among.append(self.between(parents[first], parents[second]))
        count = max(keep, round((1 - _BROAD - _BETWEEN) * draws / _MORE))
        tried = sorted(among, key=away)[:count]
        for draw in tried:
            for _ in range(_MORE):
                self.tried(draw)
        return sorted(tried, key=away)[:keep]


def _without_seeds(drawn: Mapping[str, Any]) -> dict[str, Any]:
    """What is drawn of a water and a camera, but for what belongs to a picture."""
    kept = {name: value for name, value in drawn.items() if not name.endswith("seed")}
    inner = {n: _without_seeds(value) for n, value in kept.items() if isinstance(value, Mapping)}
    return kept | inner


def _in_water(drawn: Record, kept: Mapping[str, Any]) -> Record:
    """A sample with what is kept in place of what was drawn."""
    changed = dict(drawn)
    for name, value in kept.items():
        if isinstance(value, tuple):  # as lists are read
            value = list(value)
        inner = isinstance(value, Mapping) and value and isinstance(drawn.get(name), Mapping)
        changed[name] = _in_water(drawn[name], value) if inner else value
    return changed


def _small(name: str, given: Any, channels: int) -> list[Tensor]:
    """Pictures or maps (CxHxW), small, on the host; of one, a batch, or a list of either."""
    small: list[Tensor] = []
    for tensor in given if isinstance(given, (list, tuple)) else [given]:
        if channels == 1 or getattr(tensor, "dtype", None) != torch.uint8:
            checks.floating(name, tensor, "" if channels == 1 else "; or uint8")
        checks.picture(name, tensor, channels)
        values = typed(tensor, Tensor).detach().cpu()
        values = values / 255 if values.dtype == torch.uint8 else values.float()
        values = values if values.ndim == 4 else values[None]
        scale = _SHORT / min(values.shape[-2:])
        size = [round(scale * side) for side in values.shape[-2:]]
        if channels == 1:
            small += interpolate(values, size, mode="nearest")
            continue
        require_values(values, "srgb", name)
        small += interpolate(values, size, mode="bilinear", antialias=True).clamp(0, 1)
    if not small:
        raise ValueError(f"{name}: expected at least one, got none")
    return small


def _features(srgb: Tensor) -> Values:
    """What a picture (3xHxW) looks like, in standard deviations of photographs (12)."""
    features = water_features(srgb.permute(1, 2, 0).numpy())
    values: Values = np.array([features[name] for name in WATER_FEATURES]) / _UNITS
    return values


def _away(draw: _Draw, photograph: Values) -> float:
    """How far a draw is from a photograph: mean over the pictures it was tried on."""
    return float(np.sqrt(((np.array(draw.seen) - photograph) ** 2).mean(1)).mean())


def _doubt(best: list[_Draw], photograph: Values) -> str:
    """What is off with draws that are far from a photograph."""
    away = np.median([_away(draw, photograph) for draw in best])
    if away < _FAR:
        return ""
    over = np.mean([np.mean(draw.seen, 0) for draw in best], 0) - photograph
    worst = np.argsort(-abs(over))[:3]
    words = [list(WATER_FEATURES.values())[i][3 if over[i] > 0 else 2] for i in worst]
    off = f"{away:.2f} standard deviations of photographs away: {', '.join(words)}"
    return f"even the nearest draws look unlike the reference, {off}"
