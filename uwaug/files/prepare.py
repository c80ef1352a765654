"""Before a run: what there is to doubt about its maps, and waters like photographs."""

import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from uwaug._support.threads import one_thread
from uwaug.distance.doubts import REVERSED, doubts, evidence
from uwaug.distance.sources import Inverse, Metres, Relative
from uwaug.distance.unknown import NO_RANGE, in_words, of_metres, of_shares
from uwaug.files.films import frames_of
from uwaug.files.items import Item
from uwaug.files.pictures import read_picture
from uwaug.files.recipe import Recipe
from uwaug.files.record import reason_of
from uwaug.transforms.like import like

_SAMPLES = 8
"""Pictures of a run that are looked at, from the first to the last."""


def prepare(
    recipe: Recipe, items: Sequence[Item], references: Sequence[Path] = ()
) -> tuple[Recipe, list[str]]:
    """Look at eight pictures of a run, of films at the middle frame of each, before it begins.
    Those that cannot be read are left to the run, which names them.

    Args:
        recipe, items: as for `degrade`.
        references: photographs taken under water that pictures shall look like, see `uwaug.like`.

    Returns:
        The recipe to run, which draws waters like those of the references; and sentences: what
        speaks against the maps, see `uwaug.distance.doubts`, and how near the waters come.

    Raises:
        ValueError: if most of these maps are refused, with what is said of the first.
        OSError: if a reference cannot be read.
    """
    if recipe.sequence:  # the frames of a film are one witness, and in one water
        items = list(dict.fromkeys(film.candidates[0] for film in frames_of(items).values()))
    some = items[:: -(-len(items) // _SAMPLES) or 1]
    samples = _samples(recipe, some)
    refused = [sample.refused for sample in samples if sample.refused]
    sentences = _doubts(recipe, samples)
    if recipe.sequence and isinstance(recipe.transform.distance, (Relative, Inverse)):
        sentences.append(
            "each frame's map is stretched from near to far on its own: a film pumps where things "
            "come and go, unless its maps are metres"
        )
    if 2 * len(refused) > len(samples):
        raise ValueError("; ".join([refused[0], *sentences]))
    if grey := [s.item.name for s in samples if bool((s.image == s.image[:1]).all())]:
        got = f"{len(grey)} of {len(samples)} pictures looked at are grey, such as {grey[0]}"
        cure = "R = G = B, they come out in colour; if they are maps, name them by --distance"
        sentences.append(f"{got}: {cure}")
    if not references:
        return recipe, sentences
    photographs = [read_picture(path) for path in references]
    good = [sample for sample in samples if not sample.refused]
    images, maps = [s.image for s in good], [s.z for s in good if s.z is not None]
    with one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # all that there is to say is in what is returned
        augment, seed = recipe.transform, recipe.seed
        transform = like(photographs, images, maps or None, augment=augment, seed=seed)
    assert transform.nearness is not None
    near = f"like {', '.join(map(str, references))}: {transform.nearness}"
    sentences += filter(None, (near, transform.nearness.doubt))
    return replace(recipe, transform=transform), sentences


class _Sample(NamedTuple):
    """A picture (3xHxW) that is looked at, its map, and why that is refused."""

    item: Item
    image: Tensor
    z: Tensor | None
    refused: str


def _samples(recipe: Recipe, items: Sequence[Item]) -> list[_Sample]:
    source = recipe.transform.distance
    if isinstance(source, (Metres, Relative, Inverse)) and source.holes != "error":
        source = replace(source, holes="far")  # filling takes seconds, and refuses little
    samples = []
    for item in items:
        if item.distance is not None and not item.distance.is_file():
            continue
        with warnings.catch_warnings(), suppress(Exception):  # decoders raise whatever they like
            warnings.simplefilter("ignore")
            image, z, refused = read_picture(item.picture), None, ""
            try:
                z = recipe.read_map(item)
                if z is not None:
                    (drawn,) = recipe.drawn(item.name, 0)["samples"]
                    source.metres(z, image, drawn["distance"])
                    if isinstance(source, Metres) and source.holes == "error":
                        _require_told(z)
            except Exception as error:
                refused = reason_of(error)
                if not refused.startswith(str(item.distance)):
                    refused = f"{item.distance}: {refused}"
            samples.append(_Sample(item, image, z, refused))
    return samples


def _require_told(z: Tensor) -> None:
    """Refuse a map with a number that may be what a depth camera did not see, of which nothing is
    said; in a training it is only warned of.
    """
    alone = of_metres(z) & (z < NO_RANGE)
    if bool(alone.any()):
        raise ValueError(in_words(z, alone))


def _doubts(recipe: Recipe, samples: Sequence[_Sample]) -> list[str]:
    pairs = [(s.z, s.image) for s in samples if s.z is not None]
    maps, images = [z for z, _ in pairs], [image for _, image in pairs]
    if isinstance(recipe.transform.distance, Metres):
        return doubts(maps, images)
    shown = [evidence(z, image) for z, image in pairs]
    sentences = [each.size for each in shown if each.size][:1]
    is_said = getattr(recipe.transform.distance, "holes", "error") != "error"
    cure = "they get what --holes says" if is_said else ""
    sentences += [in_words(z, alone, cure) for z in maps if (alone := of_shares(z)).any()][:1]
    disparities = sum(each.convexity < REVERSED for each in shown)
    if 2 * sum(map(_like_mm, maps)) <= len(maps) or 2 * disparities > len(maps):
        return sentences
    return [
        "relative or inverse maps hold whole numbers of less than a tenth of what 16 bits do, as "
        "those in mm: leave out distance.kind and give --unit mm (Metres(), divide by 1000)",
    ]


def _like_mm(shares: Tensor) -> bool:
    """Whether a map that was read without unit spans next to nothing of 0…1, in whole numbers."""
    numbers = 65535 * shares[shares > 0]
    some = numbers[:: max(1, numbers.numel() // 4096)].sort().values
    few, rounded = some.numel() // 100, some.round()
    narrow = some.numel() >= 64 and float(some[-1 - few] - some[few]) < 6554
    return narrow and len(set(rounded.tolist())) > 16 and torch.allclose(some, rounded, 0, 0.01)
