"""`like`: a search for waters that make pictures look like given photographs."""

import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from dataclasses import field as option
from functools import partial
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
from uwaug.transforms.draws import Record, read_draws
from uwaug.transforms.random_underwater import RandomUnderwater
from uwaug.transforms.samples import typed

_SHORT_SIDE_PX = 128  # of the pictures that are looked at

# Shares of the draws that are new, and that lie between two good ones; the others try the best on
# more pictures. (Other shares and numbers: benchmarks/CHOICES.md, how constants were chosen.)
_NEW_SHARE, _BETWEEN_SHARE = 0.4, 0.2
_LATER_SHARE = 0.4  # of the first photograph's tries, for each further one, which profits by them
_PARENTS = 15  # best new draws, between which others are made
_MORE_PICTURES = 4  # on which the best are tried besides their first
_KEPT = ("water", "light", "development")  # nouns whose draws are kept; distances are a picture's

# Standard deviations of photographs from which on draws are no longer near, and a warning is due:
# 70 and 88 % of real photographs are nearer, and a quarter of those with red and green swapped.
_FAIR_FROM, _FAR_FROM = 0.8, 1.0

_SPREADS, _COUNTS, *_ = map(np.array, zip(*WATER_FEATURES.values(), strict=True))
# of each number: a standard deviation of photographs, on average
_UNITS = _SPREADS * np.sqrt(np.mean(_COUNTS**2)) / _COUNTS


class Nearness(NamedTuple):
    """Nearness of draws to photographs; as text, a sentence.

    Attributes:
        kept, drawn: median distance of the kept draws, and of new ones, in standard deviations of
            photographs.
        doubt: what is off, in words, if even the draws for one of them are far; else empty.
        of_each: `kept`, for each photograph.
    """

    kept: float
    drawn: float
    doubt: str
    of_each: tuple[float, ...] = ()

    def __str__(self) -> str:
        unit = "where 1 is how much real underwater photographs differ from their mean"
        text = f"{_verdict(self.kept)}: {self.kept:.2f} away, {unit}"
        text = f"{text}, and random waters are {self.drawn:.2f} away"
        if len(self.of_each) > 1:
            verdicts = Counter(map(_verdict, sorted(self.of_each)))
            text += "; " + ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
        return text

    def far(self) -> list[int]:
        """Indices of the photographs that are far from anything that was tried."""
        return [i for i, unlikeness in enumerate(self.of_each) if unlikeness >= _FAR_FROM]


def _verdict(unlikeness: float) -> str:
    if unlikeness < _FAIR_FROM:
        return "near"
    return "fair" if unlikeness < _FAR_FROM else "far from all that was tried"


@codec.plain
@dataclass(init=False, eq=False, repr=False)
class UnderwaterLike(RandomUnderwater):
    """A `RandomUnderwater` that picks water, light and development from a few, see `like`.

    Args:
        kept: {"water": …, "light": …, "development": …}, as of `make_params`. What they leave
            out is drawn for each picture.
        nearness: of the kept draws to the photographs; not in `to_dict`.
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
        if not kept:
            raise ValueError("kept: expected at least one, got none")
        self.kept, self.nearness = kept, nearness
        sample = super()._sample(Uniform(bytes(8)))
        for draws in self.kept:
            read_draws({"samples": [_with_kept(sample, draws)]}, 1, self._nouns)

    def _sample(self, uniform: Uniform) -> Record:
        kept = self.kept[int(uniform("kept") * len(self.kept))]
        return _with_kept(super()._sample(uniform), kept)


def like(
    reference: Tensor | Iterable[Tensor],
    pictures: Tensor | Sequence[Tensor],
    distance: Tensor | Sequence[Tensor] | None = None,
    *,
    augment: RandomUnderwater | None = None,
    draws: int = 300,
    keep: int = 10,
    seed: int = 0,
) -> UnderwaterLike:
    """Find random waters in which pictures look like a photograph, by twelve numbers of colour and
    veil. They look alike; which water it is, `uwaug.fit` says.

    Args:
        reference: photographs taken under water (3xHxW, a batch, a list or an iterator), in sRGB
            even where `augment` takes linear light.
        pictures: four to eight of your own, taken in air, as varied as your data set.
        distance: their maps (1xHxW), as `augment` reads them; None where it reads none.
        augment: from which to draw; by default `RandomUnderwater()`, or without maps
            `RandomUnderwater(distance=MadeUp())`.
        draws: pictures that are made for the first reference, at least 15 times `keep`; 300 take
            some 3 s. Each further one takes less than a third of that.
        keep: draws to keep for each reference; a picture takes any of all.
        seed: of all random numbers.

    Returns:
        A `RandomUnderwater` whose draws are those kept; field, particles, noise and made-up
        distances are drawn anew for each picture.

    Warns:
        UserWarning: if even the kept draws look unlike a reference; says in what.

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
    photographs = [_features(photograph) for photograph, _ in _small("reference", reference, 3)]
    small = _small("pictures", pictures, 3)
    maps: list[Any] = [(None, 1.0)] * len(small)
    if distance is not None:
        maps = _small("distance", distance, 1)
    if len(maps) != len(small):
        raise ValueError(f"distance has {len(maps)} maps for {len(small)} pictures")
    scenes = [
        _Scene(picture, metres, replace(augment, view=augment.view.resized(scale)))
        for (picture, scale), (metres, _) in zip(small, maps, strict=True)
    ]
    trials = _Trials(scenes, torch.Generator().manual_seed(seed))
    kept: list[Record] = []
    of_each, doubt = [], ""
    with muted():
        new = [trials.new(i) for i in range(round(_NEW_SHARE * draws))]
        of_new = [_unlikeness(draw, photograph) for photograph in photographs for draw in new]
        for photograph in photographs:
            tries = draws * _LATER_SHARE if kept else draws
            best = trials.best(new, photograph, tries, keep)
            kept += [draw.sample for draw in best]
            of_each.append(float(np.median([_unlikeness(draw, photograph) for draw in best])))
            if of_each[-1] == max(of_each):
                doubt = _doubt(best, photograph, of_each[-1])
    if doubt:
        warnings.warn(doubt, stacklevel=2)
    medians = float(np.median(of_each)), float(np.median(of_new))
    nearness = Nearness(*medians, doubt, tuple(of_each))
    options = {f.name: getattr(augment, f.name) for f in fields(RandomUnderwater) if f.init}
    return UnderwaterLike(**options, kept=tuple(kept), nearness=nearness)


class _Scene(NamedTuple):
    """A small picture with its map, and the transform in its view."""

    picture: Tensor
    metres: Tensor | None
    augment: RandomUnderwater


class _Draw(NamedTuple):
    """Draws of a sample, and the features of the pictures on which they were tried."""

    sample: Record
    first: int  # index of the first of these pictures, which are tried in turn
    features: list[Values]


@dataclass
class _Trials:
    """Draws of a transform, tried on some scenes."""

    scenes: list[_Scene]
    generator: torch.Generator

    def new(self, first: int) -> _Draw:
        sample = self._sample(self.scenes[0])
        kept = {name: _without_seeds(sample[name]) for name in _KEPT}
        return self.tried(_Draw(kept, first, []))

    def _sample(self, scene: _Scene) -> Record:
        (sample,) = scene.augment.make_params(scene.picture, self.generator)["samples"]
        return sample  # type: ignore[no-any-return]

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
        scene = self.scenes[(draw.first + len(draw.features)) % len(self.scenes)]
        sample = {**self._sample(scene), "applied": True}
        params = {"samples": [_with_kept(sample, draw.sample)]}
        result = scene.augment.transform(scene.picture, scene.metres, params)
        if scene.augment.development.color_space == "linear":
            result = linear_to_srgb(result).clamp(0, 1)
        draw.features.append(_features(result))
        return draw

    def best(self, pool: list[_Draw], photograph: Values, tries: float, keep: int) -> list[_Draw]:
        unlikeness = partial(_unlikeness, photograph=photograph)
        parents = sorted(pool, key=unlikeness)[:_PARENTS]
        for _ in range(round(_BETWEEN_SHARE * tries)):
            pair = torch.randperm(len(parents), generator=self.generator)[:2].tolist()
            first, second = (parents[i] for i in pair)
            mixed = self._mixed(first.sample, second.sample)
            pool.append(self.tried(_Draw(mixed, second.first + 1, [])))
        count = max(keep, round((1 - _NEW_SHARE - _BETWEEN_SHARE) * tries / _MORE_PICTURES))
        candidates = sorted(pool, key=unlikeness)[:count]
        for draw in candidates:
            while len(draw.features) <= _MORE_PICTURES:
                self.tried(draw)
        return sorted(candidates, key=unlikeness)[:keep]


def _without_seeds(draw: Mapping[str, Any]) -> dict[str, Any]:
    kept = {name: value for name, value in draw.items() if not name.endswith("seed")}
    inner = {n: _without_seeds(value) for n, value in kept.items() if isinstance(value, Mapping)}
    return kept | inner


def _with_kept(sample: Record, kept: Mapping[str, Any]) -> Record:
    changed = dict(sample)
    for name, value in kept.items():
        if isinstance(value, tuple):  # as lists are read
            value = list(value)
        # a light has no seed; that of daylight has no lamps
        has_seeds = name != "light" and value and isinstance(value, Mapping)
        if has_seeds and isinstance(sample.get(name), Mapping):
            value = _with_kept(sample[name], value)
        changed[name] = value
    return changed


def _small(name: str, tensors: Any, channels: int) -> list[tuple[Tensor, float]]:
    """Small copies (CxHxW), on the host, of a picture or map, a batch, or a list of either; and
    their scales.
    """
    small: list[tuple[Tensor, float]] = []
    for tensor in tensors if isinstance(tensors, (list, tuple, Iterator)) else [tensors]:
        if channels == 1 or getattr(tensor, "dtype", None) != torch.uint8:
            checks.floating(name, tensor, "" if channels == 1 else "; or uint8")
        checks.picture(name, tensor, channels)
        values = typed(tensor, Tensor).detach().cpu()
        values = values / 255 if values.dtype == torch.uint8 else values.float()
        values = values.reshape(-1, *values.shape[-3:])
        scale = _SHORT_SIDE_PX / min(values.shape[-2:])
        size = [round(scale * side) for side in values.shape[-2:]]
        if channels == 1:
            copies = interpolate(values, size, mode="nearest")
        else:
            require_values(values, "srgb", name)
            copies = interpolate(values, size, mode="bilinear", antialias=True).clamp(0, 1)
        small += [(copy, scale) for copy in copies]
    if not small:
        raise ValueError(f"{name}: expected at least one, got none")
    return small


def _features(srgb: Tensor) -> Values:
    features = water_features(srgb.permute(1, 2, 0).numpy())
    values: Values = np.array([features[name] for name in WATER_FEATURES]) / _UNITS
    return values


def _unlikeness(draw: _Draw, photograph: Values) -> float:
    return float(np.sqrt(((np.array(draw.features) - photograph) ** 2).mean(1)).mean())


def _doubt(best: list[_Draw], photograph: Values, unlikeness: float) -> str:
    if unlikeness < _FAR_FROM:
        return ""
    excess = np.mean([np.mean(draw.features, 0) for draw in best], 0) - photograph
    worst = np.argsort(-abs(excess))[:3]
    features = list(WATER_FEATURES.values())
    words = ", ".join(features[i][3 if excess[i] > 0 else 2] for i in worst)
    away = f"{unlikeness:.2f} standard deviations of photographs away"
    return f"even the nearest draws look unlike the reference, {away}: {words}"
