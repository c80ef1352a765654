"""Distance maps in files by a depth network: made once, and read by every run."""

import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from uwaug._support import codec
from uwaug._support.atomic import remove_left, written_whole
from uwaug.distance import Inverse, Metres, Network, Relative
from uwaug.files.items import Item
from uwaug.files.pictures import read_distance, read_picture
from uwaug.files.sheet import write_sheet

_MOST = 65535
_MADE_BY = "depth.json"


def write_maps(
    network: Network,
    items: Sequence[Item],
    out: str | Path,
    *,
    resume: bool = False,
    force: bool = False,
    sheet: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[int, int, list[str]]:
    """Write what a network says of pictures, as PNG of 16 bits with their names.

    Maps of inverse depth are stretched from 0, far, to 65535, near, as their scale means nothing;
    relative ones are 65535 times as much; metres become mm, 65.5 m at most. depth.json in the
    folder says which network made them.

    Args:
        network: of a file.
        items: which pictures, see `find_items`.
        out: a folder, made if need be.
        resume: go on where a run was stopped.
        force: write over what is there.
        sheet: draw some of the maps on sheet.jpg: what is near is bright.
        progress: is told after each picture how many are done, and of how many.

    Returns:
        How many maps were written, how many were there, and what went wrong: each begins with a
        picture's name.

    Raises:
        FileExistsError: if there is something in `out`, without `resume` and `force`; or if another
            network has made it.
        ValueError: if two pictures would have one map, or a map would be written over a picture.
        OSError: if `out` cannot be written.
    """
    out = Path(out)
    maps = [(out / item.name).with_suffix(".png") for item in items]
    places = Counter(maps)
    for place, item in zip(maps, items, strict=True):
        if places[place] > 1:
            raise ValueError(f"{item.name} and another picture would both be {place}: rename one")
        if os.path.realpath(place) == os.path.realpath(item.picture):
            raise ValueError(f"{place} is a picture, and would be written over: another folder?")
    digest = hashlib.sha256(Path(str(network.model)).read_bytes()).hexdigest()
    made_by: dict[str, Any] = json.loads(
        json.dumps({**asdict(network), "model": digest}, default=str)
    )
    made_by["holds"] = codec.to_plain(network.holds)
    made_by.pop("_session")
    kept = out / _MADE_BY
    if out.is_dir() and os.listdir(out) and not force:
        if not resume:
            cure = "another folder, resume to go on, or force to write over it"
            raise FileExistsError(f"{out} is not empty: {cure}")
        if not kept.is_file() or json.loads(kept.read_text(encoding="utf-8")) != made_by:
            raise FileExistsError(f"{out} was made by another network: choose another folder")
    out.mkdir(parents=True, exist_ok=True)
    with written_whole(kept) as part:
        part.write_text(json.dumps(made_by, indent=1), encoding="utf-8")
    for folder in {place.parent for place in maps}:
        folder.mkdir(parents=True, exist_ok=True)
        remove_left(folder)
    written, skipped, failures = 0, 0, []
    for done, (item, place) in enumerate(zip(items, maps, strict=True), 1):
        if resume and not force and place.is_file():
            skipped += 1
        else:
            try:
                image = read_picture(item.picture)
                image = image / 255 if not image.is_floating_point() else image
                _write(place, _numbers(network(image), network))
                written += 1
            except (ValueError, OSError) as error:
                failures.append(f"{item.name}: {error}")
        if progress is not None:
            progress(done, len(items))
    if sheet:
        pairs = [
            (i.picture, [place]) for i, place in zip(items, maps, strict=True) if place.is_file()
        ]
        near_is_large = isinstance(network.holds, Inverse)
        write_sheet(out / "sheet.jpg", pairs, lambda path: _shown(path, near_is_large))
    return written, skipped, failures


def _numbers(depth: Tensor, network: Network) -> NDArray[np.uint16]:
    """A map (1xHxW) as whole numbers."""
    values = depth[0].double().numpy()
    low, high = float(values.min()), float(values.max())
    if not np.isfinite(high - low):
        raise ValueError(f"the network gives {low} to {high}: expected finite numbers")
    match network.holds:
        case Metres():
            if low < 0:
                raise ValueError(f"the network gives {low:.4g} m: are they metres?")
            values = values * 1000
        case Relative():
            if low < 0 or high > 1:
                raise ValueError(f"the network gives {low:.4g} to {high:.4g}: expected 0…1")
            values = values * _MOST
        case _:
            values = (values - low) * (_MOST / (high - low) if high > low else 0.0)
    whole: NDArray[np.uint16] = np.rint(values.clip(0, _MOST)).astype(np.uint16)
    return whole


def _write(place: Path, numbers: NDArray[np.uint16]) -> None:
    with written_whole(place) as part:
        Image.fromarray(numbers).save(part, "PNG")


def _shown(path: Path, near_is_large: bool) -> Tensor:
    """A map as a grey picture (3xHxW), near bright."""
    values = read_distance(path, None)
    values = (values - values.min()) / (values.max() - values.min()).clamp(min=1e-9)
    return (values if near_is_large else 1 - values).expand(3, -1, -1)
