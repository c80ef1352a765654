"""Pictures and distances as callers give them, checked, as pairs that can be fitted."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import ColorSpace
from uwaug.fitting.pixels import Pair, known_distances, reference_distance, widest_blur
from uwaug.fitting.structure import Geometry
from uwaug.formation.colour import to_light
from uwaug.optics.curves import FARTHEST

__all__ = ["bits_of", "distances_apart", "geometry_of", "pairs_of", "require_pixels"]

_FEWEST = 500
"""Usable pixels, of all pairs together, that a fit needs."""

_FLAT = 0.03
"""Span of the distances as a share of their median, below which they are one distance."""

_SAME = 2e-3
"""Mean difference of two pictures that are one, as a share of their light."""

_THINNEST = 1e-3
"""Of a medium field; less water is none."""

_FEWEST_OF_ONE = 50
"""Usable pixels that each pair needs."""

_WHITE = 0.98
"""Linear light, 253 of 255 in sRGB: the clean picture may be brighter than it says."""

Pictures = Tensor | Sequence[Tensor]


def pairs_of(
    clean: Pictures,
    observed: Pictures,
    distance: Pictures,
    field: Pictures | None,
    mask: Pictures | None,
    color_space: ColorSpace,
    *,
    relative: bool = False,
) -> list[Pair]:
    """One pair for each observed picture; what else is given once serves all of them."""
    given = {"clean": clean, "observed": observed, "distance": distance}
    if field is not None:
        given["field"] = field
    if mask is not None:
        given["mask"] = mask
    columns = {name: _listed(name, value) for name, value in given.items()}
    count = len(columns["observed"])
    for name, one in columns.items():
        if len(one) not in (1, count):
            got = {name: len(one) for name, one in columns.items()}
            raise ValueError(f"{name}: expected one or as many as observed, got {got}")
    light: dict[int, Tensor] = {}
    pairs = []
    for i in range(count):
        row = {name: one[i % len(one)] for name, one in columns.items()}
        pairs.append(_pair(row, color_space, light, relative))
    _require_water(pairs)
    return pairs


def _listed(name: str, value: Any) -> list[Tensor]:
    """Pictures one by one, from a picture, a batch or a sequence."""
    if isinstance(value, Tensor):
        return list(value) if value.ndim == 4 else [value]
    if not isinstance(value, Sequence) or isinstance(value, str):
        checks.floating(name, value)
    found = []
    for one in value:
        batch = isinstance(one, Tensor) and one.ndim == 4
        found += list(one) if batch else [one]
    if not found:
        raise ValueError(f"{name} is empty: a fit needs at least one")
    return found


def _pair(
    row: dict[str, Tensor], color_space: ColorSpace, light: dict[int, Tensor], relative: bool
) -> Pair:
    """A checked pair; `light` keeps what was decoded, so that one clean picture stays one."""
    for name, value in row.items():
        whole = name in ("clean", "observed") and _bytes(value)
        if not whole and not (name == "mask" and isinstance(value, Tensor)):
            checks.floating(name, value)
        checks.picture(name, value, 3 if name in ("clean", "observed") else 1)
        if value.shape[-2:] != row["clean"].shape[-2:]:
            mine, wanted = tuple(value.shape[-2:]), tuple(row["clean"].shape[-2:])
            raise ValueError(f"{name} is {mine} but clean is {wanted}: they must be aligned")
    for name in ("clean", "observed"):
        if id(row[name]) not in light:
            light[id(row[name])] = _light(name, row[name], color_space)
    clean, observed = light[id(row["clean"])], light[id(row["observed"])]
    if not relative:
        checks.metres("distance", row["distance"])
    z = row["distance"].detach().cpu().double()
    usable = z > 0
    z = torch.where(usable, z, 1.0).clamp(max=FARTHEST)
    if "field" in row:
        field = _field(row["field"])
        usable = usable & (field > 0)
        z = torch.where(z < FARTHEST, z * field.clamp(min=_THINNEST), z)
    if "mask" in row:
        usable = usable & (row["mask"].detach().cpu() > 0)
    if color_space == "srgb":
        inside = (observed > 0).any(0) & (observed < 1).all(0) & (clean < _WHITE).all(0)
        usable = usable & inside[None]
    return Pair(clean, observed, z, usable)


def _field(value: Tensor) -> Tensor:
    field = value.detach().cpu().double()
    if not bool(((field >= 0) & field.isfinite()).all()):
        counts = checks.counted(field, "NaN", "negative", "infinite")
        raise ValueError(f"field is {counts}: expected finite values ≥ 0")
    return field


def _bytes(value: object) -> bool:
    return isinstance(value, Tensor) and value.dtype == torch.uint8


def _light(name: str, value: Tensor, color_space: ColorSpace) -> Tensor:
    try:
        return to_light(value.detach().cpu(), color_space).double()
    except ValueError as error:
        raise ValueError(str(error).replace("image", name, 1)) from None


def _require_water(pairs: Sequence[Pair]) -> None:
    """Refuse pairs that are one picture."""
    for i, pair in enumerate(pairs):
        apart = float((pair.clean - pair.observed).abs().mean())
        if apart <= _SAME * float(pair.clean.mean()):
            which = f" of pair {i + 1}" if len(pairs) > 1 else ""
            cure = "give the same scene without water and in it"
            raise ValueError(f"clean and observed{which} are the same picture: {cure}")


def require_pixels(pairs: Sequence[Pair]) -> None:
    """Refuse pictures of which too little can be used, saying what it is lost to."""
    each = [int(pair.known.sum()) for pair in pairs]
    usable = sum(each)
    if usable >= _FEWEST:
        _require_each(each)
        return
    known = sum(int((pair.z < FARTHEST).sum()) for pair in pairs)
    clipped = sum(int(((pair.observed >= 1).any(0)).sum()) for pair in pairs)
    dark = sum(int((pair.observed <= 0).all(0).sum()) for pair in pairs)
    total = sum(pair.z.numel() for pair in pairs)
    reasons = f"of {total} pixels {total - known} lie in open water, {clipped} are saturated"
    reasons += f" and {dark} black in observed"
    cure = "clean, observed, distance and mask must overlap, and exposure leave pixels unclipped"
    raise ValueError(f"only {usable} pixels can be used, expected {_FEWEST}: {reasons}; {cure}")


def bits_of(observed: Pictures) -> int | None:
    """Of the observed files: 8 of bytes; values of another type are not known to be rounded."""
    one = observed if isinstance(observed, Tensor) else observed[0]
    if one.dtype == torch.uint8:
        return 8
    # pictures of 8 bits are often given as floating point
    steps = one.detach().double().cpu() * 255
    return 8 if bool(((steps - steps.round()).abs() < 1e-3).all()) else None


def _require_each(usable: Sequence[int]) -> None:
    for i, count in enumerate(usable):
        if count < _FEWEST_OF_ONE:
            got = f"pair {i + 1} of {len(usable)} has {count} pixels that can be used"
            raise ValueError(f"{got}, expected {_FEWEST_OF_ONE}: leave it out")


def distances_apart(pairs: Sequence[Pair]) -> None:
    """Refuse distances that are all alike: attenuation is seen by what it does to distances."""
    known = torch.cat([pair.z[pair.usable] for pair in pairs])
    low, high = np.quantile(known.numpy(), (0.02, 0.98))
    middle = reference_distance(pairs)
    if high - low < _FLAT * middle:
        cure = "β, G and veil need a scene with depth, or pictures at several distances"
        raise ValueError(f"distance is flat: all pixels lie at {low:.4g}–{high:.4g} m; {cure}")


def geometry_of(pairs: Sequence[Pair], focal_px: float | None, *, relative: bool) -> Geometry:
    """What is known of pictures before anything is fitted."""
    return Geometry(
        pairs=len(pairs),
        short_side=min(min(pair.size) for pair in pairs),
        reference=reference_distance(pairs),
        farthest=float(np.quantile(known_distances(pairs).numpy(), 0.95)),
        widest=min(widest_blur(pair.size) for pair in pairs),
        focal_px=None if focal_px is None else float(focal_px),
        unit="unit" if relative else "m",
    )
