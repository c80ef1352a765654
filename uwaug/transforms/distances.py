"""The distances of a batch of pictures, from what their maps hold or from the pictures alone."""

from collections.abc import Sequence

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import ColorSpace
from uwaug.distance.doubts import first_maps
from uwaug.distance.sizes import brought_to
from uwaug.distance.sources import Metres, Source
from uwaug.distance.unknown import FARTHEST_SEEN
from uwaug.formation.colour import linear_to_srgb, require_values
from uwaug.transforms.draws import Draw
from uwaug.transforms.measured import Measured
from uwaug.transforms.samples import naming


def metres_of(
    source: Source,
    pictures: Tensor,
    maps: Sequence[Tensor | None],
    draws: Sequence[Draw],
    color_space: ColorSpace,
) -> Tensor:
    """The distances (Nx1xHxW, m) of those pictures (Bx3xHxW) that are degraded. Those of `Metres()`
    come as they are, for `second_look`; of another source a device may have to wait for each.
    """
    results = []
    for i, (z, picture, draw) in enumerate(zip(maps, pictures, draws, strict=True)):
        if not draw.applied:
            continue
        if z is not None and isinstance(source, Metres) and checks.on_host(picture):
            first_maps.question(z, picture, stacklevel=4)
        if z is None or source != Metres():
            shown = _as_srgb(picture, color_space) if source.reads_pictures else picture
            with naming(i, len(pictures)):
                z = source.metres(z, shown, draw.numbers)
        z = brought_to(picture.shape[-2:], z.to(torch.promote_types(z.dtype, torch.float32)))
        results.append(z)
    return results[0][None] if len(results) == 1 else torch.stack(results)


def _as_srgb(picture: Tensor, color_space: ColorSpace) -> Tensor:
    if color_space == "srgb":
        return picture
    light = picture if picture.is_floating_point() else picture / 255
    return linear_to_srgb(light.clamp(0, 1))


def second_look(
    source: Source, seen: Sequence[Measured], pictures: Tensor, z: Tensor, chosen: Sequence[int]
) -> Tensor:
    """The same distances, looked at once more where what was measured of `Metres()` is odd."""
    if source != Metres() or all(s.nearest > 0 and s.farthest < FARTHEST_SEEN for s in seen):
        return z
    results = []
    for i, far in zip(chosen, z, strict=True):
        with naming(i, len(pictures)):
            results.append(source.metres(far, pictures[i], {}))
    return torch.stack(results)


def require(seen: Measured, picture: Tensor, color_space: ColorSpace) -> None:
    """Refuse a picture by what was measured; if that is odd, by a look at all of it."""
    if not (seen.darkest >= 0 and seen.brightest <= 1):
        require_values(picture, color_space)
