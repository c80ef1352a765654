"""What a random water is drawn from, and the records of what was drawn."""

import json
import math
import os
from bisect import bisect
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, get_args

import numpy as np
import torch

from uwaug._support import checks
from uwaug._support.checks import DOMAIN
from uwaug.formation.loops.switch import Path, path
from uwaug.optics.bands import default_bands
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.water import Water

__all__ = [
    "RANGES",
    "Distribution",
    "Lens",
    "Range",
    "Record",
    "as_range",
    "cameras_of",
    "collate_records",
    "require_scaling",
    "require_visibility",
    "spectra_of",
    "weighed",
]

Lens = str | os.PathLike[str] | Camera
"""A camera, its name, or the path of its file."""

Range = float | tuple[float, float]
Record = dict[str, Any]

# in the order in which they are drawn
RANGES = (
    "mixing",
    "visibility",
    "vertical_depth",
    "g",
    "mu",
    "blur_factor",
    "near",
    "far",
    "gamma",
    "distance",
    "contrast",
    "exposure",
)
_LOGARITHMIC = ("visibility", "contrast")
_LARGEST = 1e4
"""Of contents and gain in a record: far beyond any that was used."""

# What each picture draws a uniform number for. A new one goes to the end, so that keys of
# `RandomUnderwater.at` keep their pictures.
_DRAWS = ("applied", "first", "second", "camera", "field", *RANGES, "light")


@dataclass(frozen=True)
class Distribution:
    """All that is random, see `RandomUnderwater`.

    Attributes:
        waters: the weight of each, by name.
        cameras: names, of equal weight.
        ranges: (low, high) of each number that is drawn.
        field_range: (low, high) of the medium field.
        p, field_probability: of degrading a picture at all, and of an uneven water.
        lights: how many there are, of equal weight; 0 for daylight alone.
    """

    waters: Mapping[str, float]
    cameras: tuple[str, ...]
    ranges: Mapping[str, tuple[float, float]]
    field_range: tuple[float, float]
    p: float
    field_probability: float
    lights: int = 0

    def draw(self, batch: int, generator: torch.Generator | None) -> Record:
        """A record of a sample for each of `batch` pictures."""
        # 32 bits: all that a generator of torch takes from a seed
        seeds = torch.randint(2**32, (batch,), generator=generator).tolist()
        uniform = torch.rand(len(_DRAWS), batch, generator=generator, dtype=torch.float64)
        samples = []
        for numbers, seed in zip(uniform.T.tolist(), seeds, strict=True):
            samples.append(self._sample(dict(zip(_DRAWS, numbers, strict=True)), seed))
        return {"samples": samples}

    def _sample(self, u: Mapping[str, float], seed: int) -> Record:
        """A picture's sample from its uniform numbers."""
        names, weights = list(self.waters), list(accumulate(self.waters.values()))
        two = ("first", "second") if self.ranges["mixing"][1] > 0 else ("first",)
        sample: Record = {
            "applied": u["applied"] < self.p,
            "waters": [names[bisect(weights, u[which] * weights[-1])] for which in two],
            "camera": self.cameras[int(u["camera"] * len(self.cameras))],
            "field_seed": seed if u["field"] < self.field_probability else None,
            "field_range": list(self.field_range),
            "path": path(),
        }
        if self.lights:
            sample["light"] = int(u["light"] * self.lights)
        for name, (low, high) in self.ranges.items():
            if name in _LOGARITHMIC:
                sample[name] = low * (high / low) ** u[name]
            else:
                sample[name] = low + (high - low) * u[name]
        return sample

    def samples(self, params: Any, batch: int) -> list[Record]:
        """A record's sample for each of `batch` pictures, if the record suits this source."""
        if not isinstance(params, Mapping) or "samples" not in params:
            expected = "a record from make_params, {'samples': […]}"
            raise TypeError(f"params must be {expected}, got {params!r:.80}")
        samples: list[Record] = params["samples"]
        if not isinstance(samples, list) or not all(isinstance(one, Mapping) for one in samples):
            raise TypeError(f"params['samples'] must be a list of dicts, got {samples!r:.80}")
        count = len(samples)
        if count not in (1, batch):
            raise ValueError(f"params has {count} samples but image is a batch of {batch}")
        wanted = {"applied", "waters", "camera", "field_seed", "field_range", *self.ranges}
        if self.lights:
            wanted.add("light")
        for sample in samples:
            odd = ", ".join(sorted(wanted ^ (set(sample) - {"used", "path"})))
            if odd:
                raise ValueError(
                    f"params is of a transform with other options: they differ in {odd}"
                )
            _require_values(sample, self.ranges)
            _require_light(sample, self.lights)
            _require_known(sample["waters"], self.waters)
            _require_known([sample["camera"]], self.cameras)
        return samples * batch if count < batch else samples


def collate_records(records: Iterable[Mapping[str, Any] | str]) -> Record:
    """Make the record of a batch from those of its pictures, for `RandomUnderwater.transform`.

    Args:
        records: from `RandomUnderwater.make_params`, each of one picture, in the order of the
            batch; or their JSON.

    Raises:
        TypeError: if one is no record.
        ValueError: if one is of several pictures.

    Examples:
        >>> import json, torch, uwaug
        >>> aug, image = uwaug.RandomUnderwater(distance=3.0), torch.rand(2, 3, 20, 30)
        >>> records = [json.dumps(aug.make_params(one)) for one in image]
        >>> aug.transform(image, None, uwaug.transforms.collate_records(records)).shape
        torch.Size([2, 3, 20, 30])
    """
    if isinstance(records, (str, Mapping)):
        got = f"got a {type(records).__name__}"
        raise TypeError(f"records must be a list of records, one of each picture, {got}")
    samples = []
    for i, given in enumerate(records):
        found = _samples_of(given)
        if found is None:
            expected = "records from make_params, {'samples': […]}, or their JSON"
            raise TypeError(f"records must be {expected}, got {given!r:.80} at {i}")
        if len(found) != 1:
            raise ValueError(f"records must be of one picture each, got one of {len(found)} at {i}")
        samples += found
    return {"samples": samples}


def _samples_of(record: Any) -> list[Record] | None:
    """A record's samples; None if it is no record."""
    if isinstance(record, str):
        try:
            record = json.loads(record)
        except json.JSONDecodeError:
            return None
    found = record.get("samples") if isinstance(record, Mapping) else None
    return found if isinstance(found, list) else None


def _require_values(sample: Mapping[str, Any], ranges: Iterable[str]) -> None:
    """Refuse a sample that no draw can have given."""
    names = sample["waters"]
    if not isinstance(names, list) or len(names) not in (1, 2) or isinstance(names[0], tuple):
        cure = "make a batch of records with uwaug.transforms.collate_records"
        raise ValueError(f"params: waters must be a list of 1 or 2 names, got {names!r}; {cure}")
    if not isinstance(sample["applied"], bool):
        raise ValueError(f"params: applied must be true or false, got {sample['applied']!r}")
    for name in ranges:
        checks.within(f"params: {name}", sample[name], *DOMAIN[name])
    as_range("field_range", sample["field_range"])
    if "path" in sample:
        checks.one_of("params: path", sample["path"], get_args(Path))
    if "used" not in sample:
        return
    found = sample["used"]
    if not isinstance(found, Mapping) or not {"contents", "gain"} <= set(found):
        raise ValueError(f"params: used must hold contents and gain, got {found!r:.80}")
    for name in ("contents", "gain"):
        checks.within(f"params: used.{name}", found[name], 0.0, _LARGEST)


def _require_light(sample: Mapping[str, Any], lights: int) -> None:
    if "light" in sample and sample["light"] not in range(lights):
        got = sample["light"]
        raise ValueError(f"params: light must be a whole number below {lights}, got {got!r:.40}")


def _require_known(names: Iterable[str], known: Iterable[str]) -> None:
    for name in names:
        if name not in known:
            has = ", ".join(known)
            raise ValueError(f"params asks for {name!r}, but this transform has {has}")


_NO_SPECTRUM = (
    " or the name of a Jerlov type. A picture, a fit or a medium has three coefficients and no "
    "spectrum: give it to uwaug.Underwater, such as "
    "uwaug.Underwater(uwaug.fitting.red_channel_prior(…).medium)"
)


def weighed(waters: Any) -> dict[str | Water, float]:
    """Each water's weight."""
    if isinstance(waters, (set, frozenset)):
        raise TypeError("waters must have an order, as draws follow it; got a set")
    listed = [waters] if isinstance(waters, (str, Water)) else list(waters)
    for water in listed:
        if not isinstance(water, str):
            checks.instance("waters", water, Water, _NO_SPECTRUM)
    if not isinstance(waters, Mapping):
        waters = Counter(listed)
    weights = list(waters.values())
    if weights and not (min(weights) >= 0 and 0 < sum(weights) < math.inf):
        raise ValueError(f"waters: expected weights ≥ 0 with a positive sum, got {weights}")
    return dict(waters)


def spectra_of(waters: Iterable[str | Water]) -> dict[str, Water]:
    """The waters by name, at the bands that media are made from: mixing needs no interpolation."""
    found = []
    for given in waters:
        water = Water.jerlov(given) if isinstance(given, str) else given
        found.append(water.at(default_bands(water)))
    return _by_name("waters", found)


def cameras_of(cameras: Iterable[Any]) -> dict[str, Camera]:
    """The cameras by name."""
    return _by_name("cameras", [load_camera(camera) for camera in cameras])


def _by_name(name: str, things: list[Any]) -> dict[str, Any]:
    named = {thing.name: thing for thing in things}
    if not things or len(named) < len(things):
        got = [thing.name for thing in things]
        wanted = "expected at least one, each with a name of its own (name=… gives one)"
        raise ValueError(f"{name}: {wanted}, got {got}")
    return named


_NUMBER = (int, float, np.number)


def as_range(name: str, value: Any) -> tuple[float, float]:
    """A number or (low, high) as (low, high), inside the domain of that name."""
    least, most = DOMAIN[name]
    try:
        if isinstance(value, (str, bool)):
            raise TypeError
        low, high = (value, value) if isinstance(value, _NUMBER) else map(float, value)
    except (TypeError, ValueError):
        low = high = math.nan
    if not (least <= low <= high <= most and high < math.inf):
        wanted = f"a number or a range (low, high) with low ≤ high, {checks.bounds(least, most)}"
        raise ValueError(f"{name} must be {wanted}; got {value!r}")
    return float(low), float(high)


def require_scaling(ranges: Mapping[str, tuple[float, float]], kind: str) -> None:
    """Refuse a near that may lie beyond far, or at 0 m where an inverse is scaled."""
    near, far = ranges["near"], ranges["far"]
    if near[1] >= far[0]:
        raise ValueError(f"near must lie below far, got near = {near} and far = {far} in metres")
    if kind == "inverse" and near[0] == 0:
        where = "above 0 m where distance_kind is 'inverse'"
        raise ValueError(f"near must lie {where}, got {near}")


def require_visibility(water: Water, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Refuse a visibility that this water cannot have."""
    for metres in ranges.get("visibility", ()):
        try:
            water.with_visibility(metres)
        except ValueError as error:
            unsuited = f"visibility={metres:g} does not suit water {water.name!r}"
            raise ValueError(f"{unsuited}: {error}") from None
