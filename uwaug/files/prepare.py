"""Preparation of a run: doubts about its maps, and waters like photographs."""

import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from torch import Tensor

from uwaug._support.threads import one_thread
from uwaug.distance.doubts import doubts
from uwaug.distance.sources import Inverse, Metres, Relative
from uwaug.distance.unknown import NO_RANGE, in_words, of_metres, of_shares
from uwaug.files.films import frames_of, rigs_of, unjoined
from uwaug.files.items import Item, delay_of, find_items
from uwaug.files.pictures import read_picture
from uwaug.files.recipe import Recipe
from uwaug.files.record import reason_of
from uwaug.transforms.like import like

_SAMPLE_COUNT = 8  # pictures that are looked at, spread over the run
_REFERENCE_COUNT = 32  # photographs that are looked at, spread over all: a second each


def prepare(
    recipe: Recipe, items: Sequence[Item], references: Sequence[Path] = ()
) -> tuple[Recipe, list[str]]:
    """Look at eight pictures of a run, or the middle frames of eight films, before it begins.
    Refuses a run if most of their maps are refused. Pictures that cannot be read are left to it.

    Args:
        recipe, items: as for `degrade`.
        references: photographs taken under water that pictures shall look like (`uwaug.like`).

    Returns:
        The recipe to run, which draws waters like those of the references; and sentences to tell.
    """
    told = [delay_of(items)]
    if recipe.sequence:  # the frames of a film are one witness, and in one water
        frames = frames_of(items, recipe.rig)
        items = list(dict.fromkeys(frame.candidates[0] for frame in frames.values()))
        told.append(rigs_of(frames))
    else:
        told.append(unjoined(items))
    sentences = [*filter(None, told)]
    samples = _samples(recipe, items[:: -(-len(items) // _SAMPLE_COUNT) or 1])
    reasons = [sample.reason for sample in samples if sample.reason]
    sentences += _doubts(recipe, samples)
    if recipe.sequence and isinstance(recipe.transform.distance, (Relative, Inverse)):
        sentences.append(
            "each frame's map is stretched from near to far on its own: a film pumps where things "
            "come and go, unless its maps are metres"
        )
    if 2 * len(reasons) > len(samples):
        raise ValueError("; ".join([reasons[0], *sentences]))
    if grey := [s.item.name for s in samples if bool((s.image == s.image[:1]).all())]:
        got = f"{len(grey)} of {len(samples)} pictures looked at are grey, such as {grey[0]}"
        cure = "they come out in colour; if they are maps, name them by --distance"
        sentences.append(f"{got}: {cure}")
    if not references:
        return recipe, sentences
    accepted = [sample for sample in samples if not sample.reason]
    images, maps = [s.image for s in accepted], [s.z for s in accepted if s.z is not None]
    with one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the sentences say it all
        options: Any = {"augment": recipe.transform, "seed": recipe.seed}
        transform = like(map(read_picture, references), images, maps or None, **options)
    nearness = transform.nearness
    assert nearness is not None
    count = f"{len(references)} photographs" if references[1:] else references[0]
    sentences += filter(None, (f"like {count}: {nearness}", nearness.doubt))
    if references[1:] and (far := nearness.far()):
        names = ", ".join(str(references[i]) for i in far[:3])
        sentences.append(f"far: {names}{' and others' * (len(far) > 3)}")
    return replace(recipe, transform=transform), sentences


def references_of(paths: Sequence[Path]) -> list[Path]:
    """Photographs in files and folders; 32 of them, spread over all, if there are more."""
    files = [item.picture for path in paths for item in find_items(path)]
    count = min(len(files), _REFERENCE_COUNT)
    return [files[i * len(files) // count] for i in range(count)]


class _Sample(NamedTuple):
    item: Item
    image: Tensor  # 3xHxW
    z: Tensor | None  # map, 1xHxW
    reason: str  # for which it is refused


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
            image = read_picture(item.picture, background=recipe.background)
            z, reason = None, ""
            try:
                z = recipe.read_map(item)
                if z is not None:
                    (draw,) = recipe.drawn(item.name, 0)["samples"]
                    rays = recipe.transform.view.planar(image.shape[-1])
                    placed = source.placed(draw["distance"], lambda left: 1 / left)  # anywhere
                    source.metres(z, image, placed, **rays)
                    # a number that a depth camera may write where it has seen nothing
                    alone = of_metres(z) & (z < NO_RANGE)
                    if isinstance(source, Metres) and source.holes == "error" and bool(alone.any()):
                        raise ValueError(in_words(z, alone))
            except Exception as error:
                reason = reason_of(error)
                if not reason.startswith(str(item.distance)):
                    reason = f"{item.distance}: {reason}"
            samples.append(_Sample(item, image, z, reason))
    return samples


def _doubts(recipe: Recipe, samples: Sequence[_Sample]) -> list[str]:
    maps = [s.z for s in samples if s.z is not None]
    if isinstance(recipe.transform.distance, Metres):
        return doubts(maps)
    has_holes = getattr(recipe.transform.distance, "holes", "error") != "error"
    cure = "they get what --holes says" if has_holes else ""
    return [in_words(z, mask, cure) for z in maps if (mask := of_shares(z)).any()][:1]
