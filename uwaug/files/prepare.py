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
from uwaug.distance.doubts import doubts
from uwaug.distance.sources import Inverse, Metres, Relative, Source
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
    """Look at eight pictures of a run before it begins. Those that cannot be read are left to the
    run, which names them.

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
    some = items[:: -(-len(items) // _SAMPLES) or 1]
    samples = _samples(recipe, [item for item in some if references or item.distance is not None])
    sentences = _doubts(recipe, samples)
    if not references:
        return recipe, sentences
    photographs = [read_picture(path) for path in references]
    usable = [sample for sample in samples if not sample.refused]
    images, maps = [s.image for s in usable], [s.distance for s in usable if s.distance is not None]
    with one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # all that there is to say is in what is returned
        transform = like(
            photographs, images, maps or None, augment=recipe.transform, seed=recipe.seed
        )
    assert transform.nearness is not None
    sentences.append(f"like {', '.join(map(str, references))}: {transform.nearness}")
    if transform.nearness.doubt:
        sentences.append(transform.nearness.doubt)
    return replace(recipe, transform=transform), sentences


class _Sample(NamedTuple):
    """A picture of a run, its map, and why that is refused."""

    image: Tensor
    distance: Tensor | None
    refused: str = ""


def _samples(recipe: Recipe, items: Sequence[Item]) -> list[_Sample]:
    source = recipe.transform.distance
    assert isinstance(source, Source)
    if isinstance(source, (Metres, Relative, Inverse)) and source.holes != "error":
        source = replace(source, holes="far")  # filling takes seconds, and refuses little
    samples = []
    for item in items:
        with warnings.catch_warnings(), suppress(Exception):  # decoders raise whatever they like
            warnings.simplefilter("ignore")
            image, z, refused = read_picture(item.picture), None, ""
            if item.distance is not None and not item.distance.is_file():
                continue
            try:
                z = recipe.read_map(item)
                if z is not None:
                    (drawn,) = recipe.drawn(item.name, 0)["samples"]
                    source.metres(z, image, drawn["numbers"])
            except Exception as error:
                refused = reason_of(error)
                if not refused.startswith(str(item.distance)):
                    refused = f"{item.distance}: {refused}"
            samples.append(_Sample(image, z, refused))
    return samples


def _doubts(recipe: Recipe, samples: Sequence[_Sample]) -> list[str]:
    refused = [sample.refused for sample in samples if sample.refused]
    if 2 * len(refused) > len(samples):
        raise ValueError(refused[0])
    pairs = [(s.distance, s.image) for s in samples if s.distance is not None]
    maps, images = [z for z, _ in pairs], [image for _, image in pairs]
    if recipe.takes_metres:
        return doubts(maps, images)
    if 2 * sum(map(_like_mm, maps)) <= len(maps):
        return []
    return [
        "relative or inverse maps hold whole numbers of less than a tenth of what 16 bits do, as "
        "those in mm: leave out distance.kind and give --unit mm (Metres(), divide by 1000)"
    ]


def _like_mm(shares: Tensor) -> bool:
    """Whether a map that was read without unit spans next to nothing of 0…1, in whole numbers."""
    numbers = 65535 * shares[shares > 0]
    some = numbers[:: max(1, numbers.numel() // 4096)].sort().values
    few, whole = some.numel() // 100, some.round()
    narrow = some.numel() >= 64 and float(some[-1 - few] - some[few]) < 6554
    return narrow and len(set(whole.tolist())) > 16 and torch.allclose(some, whole, 0, 0.01)
