"""Preparation of a run: a look at some of its pictures, and waters like photographs."""

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
from uwaug.distance.unknown import NO_RANGE, in_words, of_metres
from uwaug.files.exif import focal_lengths
from uwaug.files.pictures import open_picture, read_picture
from uwaug.files.recipe import Recipe
from uwaug.files.record import reason_of
from uwaug.files.search import pictures_in
from uwaug.files.table import Row
from uwaug.optics.view import WIDE_DEGREES, View
from uwaug.transforms.like import like

_SAMPLE_COUNT = 8  # pictures that are looked at, spread over the run
_REFERENCE_COUNT = 32  # photographs that are looked at, spread over all: a second each


def prepare(
    recipe: Recipe, rows: Sequence[Row], references: Sequence[Path] = ()
) -> tuple[Recipe, list[str]]:
    """Look at eight pictures of a run before it begins. Refuses it if most of their maps are
    refused. Pictures that cannot be read are left to it.

    Args:
        recipe, rows: as for `degrade`.
        references: photographs taken under water that pictures shall look like (`uwaug.like`).

    Returns:
        The recipe to run, which draws waters like those of the references; and sentences to tell.
    """
    source, sentences = recipe.transform.distance, []
    samples = _samples(recipe, rows[:: -(-len(rows) // _SAMPLE_COUNT) or 1])
    if isinstance(source, Metres):
        sentences += doubts([sample.z for sample in samples if sample.z is not None])
    elif any(row.film for row in rows) and isinstance(source, (Relative, Inverse)):
        sentences.append(
            "each frame's map is stretched from near to far on its own: a film pumps where things "
            "come and go, unless its maps are metres"
        )
    lengths = {sample.lengths: sample.name for sample in samples if sample.lengths}
    if len(lengths) == 1 and recipe.transform.view == View():
        (((film_mm, focal_px), name),) = lengths.items()
        said = f"EXIF says {film_mm:g} mm on film of 35 mm, as of {name}: --focal-px {focal_px}"
        sentences.append(f"{said} would take it; without, the view is {WIDE_DEGREES:g}° wide")
    fine = (sample for sample in samples if sample.image.is_floating_point())
    grey = [sample.name for sample in fine if (sample.image == sample.image[:1]).all()]
    if 0 < len(grey) < len(samples):
        cure = "a map? Then give its folder as --distance, and that of pictures alone"
        sentences.append(f"{grey[0]} is grey and of 16 bits, unlike others: {cure}")
    reasons = [sample.reason for sample in samples if sample.reason]
    if 2 * len(reasons) > len(samples):
        raise ValueError("; ".join([reasons[0], *sentences]))
    if not references:
        return recipe, sentences
    accepted = [sample for sample in samples if not sample.reason]
    images, maps = [s.image for s in accepted], [s.z for s in accepted if s.z is not None]
    with one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the sentences say it all
        options: Any = {"augment": recipe.transform, "seed": recipe.seed}
        transform = like(map(read_picture, references), images, maps or None, **options)
    assert transform.conditions is not None
    nearness = transform.conditions.nearness
    assert nearness is not None
    count = f"{len(references)} photographs" if references[1:] else references[0]
    sentences += filter(None, (f"like {count}: {nearness}", nearness.doubt))
    if references[1:] and (far := nearness.far()):
        names = ", ".join(str(references[i]) for i in far[:3])
        sentences.append(f"far: {names}{' and others' * (len(far) > 3)}")
    return replace(recipe, transform=transform), sentences


def references_of(paths: Sequence[Path]) -> list[Path]:
    """Photographs in files and folders; 32 of them, spread over all, if there are more."""
    files = [file for path in paths for file in pictures_in(path)]
    count = min(len(files), _REFERENCE_COUNT)
    return [files[i * len(files) // count] for i in range(count)]


class _Sample(NamedTuple):
    name: str
    image: Tensor  # 3xHxW
    lengths: tuple[float, int] | None  # focal, by EXIF
    z: Tensor | None  # map, 1xHxW
    reason: str  # for which it is refused


def _samples(recipe: Recipe, rows: Sequence[Row]) -> list[_Sample]:
    samples = []
    for row in rows:
        with warnings.catch_warnings(), suppress(Exception):  # decoders raise whatever they like
            warnings.simplefilter("ignore")
            image, _, exif = open_picture(row.picture)
            lengths = focal_lengths(exif, *image.shape[1:])
            z, reason = None, ""
            try:
                z = recipe.read_map(row)
                if z is not None:
                    _require_metres(recipe, row.name, z, image)
            except Exception as error:
                reason = f"{row.distance}: {reason_of(error).removeprefix(f'{row.distance}: ')}"
            samples.append(_Sample(row.name, image, lengths, z, reason))
    return samples


def _require_metres(recipe: Recipe, name: str, z: Tensor, image: Tensor) -> None:
    """Refuse a map (1xHxW) as the run would."""
    source = recipe.transform.distance
    if isinstance(source, Metres) and source.holes == "error":
        # a number that a depth camera may write where it has seen nothing
        alone = of_metres(z) & (z < NO_RANGE)
        if bool(alone.any()):
            raise ValueError(in_words(z, alone))
    elif isinstance(source, (Metres, Relative, Inverse)) and source.holes != "error":
        source = replace(source, holes="far")  # filling takes seconds, and refuses little
    (draw,) = recipe.drawn(name, 0)["samples"]
    rays = recipe.transform.view.planar(image.shape[-1])
    placed = source.placed(draw["distance"], lambda left: 1 / left)  # anywhere
    source.metres(z, image, placed, **rays)
