"""`like`: a search for conditions in which pictures look like given photographs."""

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from uwaug._support import checks
from uwaug._support.once import muted
from uwaug.distance.made_up import MadeUp
from uwaug.distance.sources import Metres
from uwaug.formation.colour import linear_to_srgb, require_values
from uwaug.transforms.appearance import (
    FAR_FROM,
    WATER_FEATURES,
    Nearness,
    Values,
    hue_apart,
    in_words,
    unlikeness,
    water_features,
)
from uwaug.transforms.conditions import Conditions, laid_over, mixed
from uwaug.transforms.draws import Record
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


def like(
    reference: Tensor | Iterable[Tensor],
    pictures: Tensor | Sequence[Tensor],
    distance: Tensor | Sequence[Tensor] | None = None,
    *,
    augment: RandomUnderwater | None = None,
    draws: int = 300,
    keep: int = 10,
    seed: int = 0,
) -> RandomUnderwater:
    """Find conditions in which pictures look like a photograph, by twelve numbers of colour and
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
        The same transform with `conditions` of its own: water, light and camera of the draws that
        were kept, and their nearness. Field, particles, noise and made-up distances are drawn anew
        for each picture.

    Warns:
        UserWarning: if even the kept draws look unlike a reference; says in what.

    Examples:
        >>> import torch
        >>> pictures, distance = torch.rand(2, 3, 32, 48), torch.full((2, 1, 32, 48), 3.0)
        >>> wet, _ = RandomUnderwater.severity(3).at(seed=0, epoch=0, index=0)(pictures, distance)
        >>> augment = like(wet[0], pictures, distance, draws=30, keep=2)
        >>> degraded, _ = augment(pictures, distance)
    """
    if augment is None:
        augment = RandomUnderwater(distance=Metres() if distance is not None else MadeUp())
    checks.instance("augment", augment, RandomUnderwater)
    if not 1 <= keep <= draws // 15:
        raise ValueError(f"draws must be 15 times keep or more, and keep 1, got {draws} and {keep}")
    photographs = [_features(photograph) for photograph, _ in _small("reference", reference, 3)]
    search = Search(augment, pictures, distance, seed)
    with muted():
        search.draw(round(_NEW_SHARE * draws))
        new = np.array([tried.features[0] for tried in search.pool])
        of_new = [unlikeness(new, photograph) for photograph in photographs]
        best = [
            search.nearest(photograph, draws * (_LATER_SHARE if n else 1.0), keep)
            for n, photograph in enumerate(photographs)
        ]
    of_each = [
        float(np.median([draw.unlike(photograph) for draw in kept]))
        for kept, photograph in zip(best, photographs, strict=True)
    ]
    farthest, doubt = int(np.argmax(of_each)), ""
    if of_each[farthest] >= FAR_FROM:
        excess = np.mean([np.mean(draw.features, 0) for draw in best[farthest]], 0)
        away = f"{of_each[farthest]:.2f} standard deviations of photographs away"
        words = in_words(excess - photographs[farthest])
        doubt = f"even the nearest draws look unlike the reference, {away}: {words}"
        warnings.warn(doubt, stacklevel=2)
    medians = float(np.median(of_each)), float(np.median(of_new))
    hues = tuple(
        float(np.median([hue_apart(np.array(draw.features), photograph).mean() for draw in kept]))
        for kept, photograph in zip(best, photographs, strict=True)
    )
    rows = tuple(draw.condition for kept in best for draw in kept)
    nearness = Nearness(*medians, doubt, tuple(of_each), hues)
    return replace(augment, conditions=Conditions(rows, nearness=nearness))


class _Scene(NamedTuple):
    """A small picture with its map, and the transform in its view."""

    picture: Tensor
    metres: Tensor | None
    augment: RandomUnderwater


class Tried(NamedTuple):
    """A condition, and the features of the pictures on which it was tried."""

    condition: Mapping[str, Any]
    first: int  # index of the first of these pictures, which are tried in turn
    features: list[Values]

    def unlike(self, photograph: Values) -> float:
        """Mean distance of these pictures from a photograph."""
        return float(unlikeness(np.array(self.features), photograph).mean())


class Search:
    """Conditions that a transform draws, tried on pictures in air.

    Attributes:
        pool: those that were tried.
    """

    def __init__(self, augment: RandomUnderwater, pictures: Any, distance: Any, seed: int) -> None:
        small, maps = _small("pictures", pictures, 3), []
        if distance is not None:
            maps = _small("distance", distance, 1)
            if len(maps) != len(small):
                raise ValueError(f"distance has {len(maps)} maps for {len(small)} pictures")
        metres: list[Any] = [z for z, _ in maps] or [None] * len(small)
        self._scenes = [
            _Scene(picture, z, replace(augment, view=augment.view.resized(scale)))
            for (picture, scale), z in zip(small, metres, strict=True)
        ]
        self._generator = torch.Generator().manual_seed(seed)
        self.pool: list[Tried] = []

    def draw(self, count: int, pictures: int = 1) -> None:
        """Try so many new conditions, each on so many of the pictures, which take turns."""
        for i in range(count):
            sample = self._sample(self._scenes[0])
            condition = {name: _without_seeds(sample[name]) for name in _KEPT}
            self._try(Tried(condition, i, []), pictures)

    def nearest(self, photograph: Values, tries: float, keep: int) -> list[Tried]:
        """The conditions that are nearest to a photograph, after further tries."""

        def unlike(tried: Tried) -> float:
            return tried.unlike(photograph)

        parents = sorted(self.pool, key=unlike)[:_PARENTS]
        for _ in range(round(_BETWEEN_SHARE * tries)):
            pair = torch.randperm(len(parents), generator=self._generator)[:2].tolist()
            first, second = (parents[i] for i in pair)
            share = float(torch.rand((), generator=self._generator))
            condition = mixed(first.condition, second.condition, share)
            self._try(Tried(condition, second.first + 1, []), 1)
        count = round((1 - _NEW_SHARE - _BETWEEN_SHARE) * tries / _MORE_PICTURES)
        candidates = sorted(self.pool, key=unlike)[: max(keep, count)]
        for tried in candidates:
            self._try(tried, 1 + _MORE_PICTURES)
        return sorted(candidates, key=unlike)[:keep]

    def _sample(self, scene: _Scene) -> Record:
        (sample,) = scene.augment.make_params(scene.picture, self._generator)["samples"]
        return sample  # type: ignore[no-any-return]

    def _try(self, tried: Tried, pictures: int) -> None:
        if not tried.features:
            self.pool.append(tried)
        while len(tried.features) < pictures:
            scene = self._scenes[(tried.first + len(tried.features)) % len(self._scenes)]
            sample = laid_over({**self._sample(scene), "applied": True}, tried.condition)
            result = scene.augment.transform(scene.picture, scene.metres, {"samples": [sample]})
            if scene.augment.development.color_space == "linear":
                result = linear_to_srgb(result).clamp(0, 1)
            tried.features.append(_features(result))


def _without_seeds(draw: Mapping[str, Any]) -> dict[str, Any]:
    kept = {name: value for name, value in draw.items() if not name.endswith("seed")}
    inner = {n: _without_seeds(value) for n, value in kept.items() if isinstance(value, Mapping)}
    return kept | inner


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
    return np.array([features[name] for name in WATER_FEATURES])
