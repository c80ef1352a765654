"""What is random about a picture's water: from what it is drawn, and the records of what was."""

import math
from bisect import bisect
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from itertools import accumulate
from typing import Any, get_args

import numpy as np
import torch

from uwaug._support import checks
from uwaug._support.checks import DOMAIN
from uwaug._support.parse import from_json
from uwaug.distance.sample import DistanceKind
from uwaug.formation.development import Development
from uwaug.formation.loops.backend import RecordedEngine
from uwaug.optics.constituents import UNITS, Constituents

Range = float | tuple[float, float]
Record = dict[str, Any]

_LARGEST = 1e4
"""Of the gain in a record: far beyond any that was used."""


@dataclass(frozen=True)
class Quantity:
    """A number that each picture draws.

    Attributes:
        domain: its least and its largest value; infinity itself is never allowed.
        unit: of the number.
        log: whether it is drawn uniformly in its logarithm.
        whole: whether it is a whole number below the end of its range.
        makes_medium: whether a range of it gives each picture a medium of its own.
        content: whether `Constituents` draw it, for whoever has such waters; no option says it.
        maps: the kinds of distance map that it means something for.
    """

    domain: tuple[float, float]
    unit: str = ""
    log: bool = False
    whole: bool = False
    makes_medium: bool = False
    content: bool = False
    maps: tuple[str, ...] = get_args(DistanceKind)


QUANTITIES = {
    "mixing": Quantity(DOMAIN["mixing"], makes_medium=True),
    "visibility": Quantity(DOMAIN["visibility"], "m", log=True, makes_medium=True),
    "vertical_depth": Quantity(DOMAIN["vertical_depth"], "m", makes_medium=True),
    "g": Quantity(DOMAIN["g"], makes_medium=True),
    "mu": Quantity(DOMAIN["mu"], makes_medium=True),
    "blur_factor": Quantity(DOMAIN["blur_factor"], makes_medium=True),
    "near": Quantity(DOMAIN["near"], "m", maps=("relative", "inverse")),
    "far": Quantity(DOMAIN["far"], "m", maps=("relative", "inverse")),
    "gamma": Quantity(DOMAIN["gamma"], maps=("relative",)),
    "distance": Quantity(DOMAIN["distance"], "m"),
    "contrast": Quantity(DOMAIN["contrast"], log=True, makes_medium=True),
    "exposure": Quantity(DOMAIN["exposure"], "stops"),
    "light": Quantity((0.0, math.inf), whole=True),
    "chlorophyll": Quantity(DOMAIN["chlorophyll"], UNITS["chlorophyll"], content=True),
    "cdom": Quantity(DOMAIN["cdom"], UNITS["cdom"], content=True),
    "minerals": Quantity(DOMAIN["minerals"], UNITS["minerals"], content=True),
    "color_matrix": Quantity(DOMAIN["color_matrix"], makes_medium=True),
    "compensation": Quantity(DOMAIN["compensation"], "stops"),
    "white_balance": Quantity(DOMAIN["white_balance"]),
    "saturation": Quantity(DOMAIN["saturation"]),
    "black_point": Quantity(DOMAIN["black_point"]),
    "gamut": Quantity(DOMAIN["gamut"]),
    "tone": Quantity(DOMAIN["tone"]),
}
"""By the name of the option (or of the content of a water) that gives a number or a range of it, in
the order in which they are drawn. A new one goes to the end, so that keys of `RandomUnderwater.at`
keep their pictures.
"""

DEVELOPED = tuple(field.name for field in fields(Development))
"""Those of the quantities that are of the camera's development."""

_CHOICES = ("applied", "first", "second", "camera", "field")
"""What each picture draws a uniform number for before those of `QUANTITIES`; for all, whether
anything asks for them or not.
"""


@dataclass(frozen=True)
class Params:
    """What one picture was drawn. A quantity that nothing asks for is missing.

    Attributes:
        applied: whether the picture is degraded at all.
        waters: the name of one, or of two to be mixed; of drawn contents, that of
            `Water.from_constituents`.
        camera: its name.
        field_seed: of the medium field; None for an even water.
        field_range: least and largest value of the field.
        path: who computes the picture, see `uwaug.fused`; None if a record does not say.
        numbers: by the names of `QUANTITIES`; "light" is the index of a light.
        used: what the numbers came to, in a record that was resolved.
    """

    applied: bool
    waters: tuple[str, ...]
    camera: str
    field_seed: int | None
    field_range: tuple[float, float]
    path: RecordedEngine | None
    numbers: Mapping[str, float]
    used: Mapping[str, float] | None = None

    def to_dict(self) -> Record:
        """The sample of a record."""
        sample: Record = {
            "applied": self.applied,
            "waters": list(self.waters),
            "camera": self.camera,
            "field_seed": self.field_seed,
            "field_range": list(self.field_range),
        }
        if self.path is not None:
            sample["path"] = self.path
        sample |= self.numbers
        if self.used is not None:
            sample["used"] = dict(self.used)
        return sample

    @staticmethod
    def from_dict(sample: Mapping[str, Any]) -> "Params":
        """The inverse of `to_dict`.

        Raises:
            ValueError: if no draw can have given one of the values.
        """
        names = sample["waters"]
        if not isinstance(names, list) or len(names) not in (1, 2) or isinstance(names[0], tuple):
            cure = "make a batch of records with uwaug.transforms.collate_records"
            raise ValueError(
                f"params: waters must be a list of 1 or 2 names, got {names!r}; {cure}"
            )
        if not isinstance(sample["applied"], bool):
            raise ValueError(f"params: applied must be true or false, got {sample['applied']!r}")
        numbers = {name: sample[name] for name in QUANTITIES if name in sample}
        for name, number in numbers.items():
            checks.within(f"params: {name}", number, *QUANTITIES[name].domain)
        if "path" in sample:
            checks.one_of("params: path", sample["path"], get_args(RecordedEngine))
        used = None
        if "used" in sample:
            used = sample["used"]
            if not isinstance(used, Mapping) or not {"contents", "gain"} <= set(used):
                raise ValueError(f"params: used must hold contents and gain, got {used!r:.80}")
            for name, most in {"contents": math.inf, "gain": _LARGEST}.items():
                checks.within(f"params: used.{name}", used[name], 0.0, most)
        return Params(
            applied=sample["applied"],
            waters=tuple(names),
            camera=sample["camera"],
            field_seed=sample["field_seed"],
            field_range=as_range("field_range", sample["field_range"]),
            path=sample.get("path"),
            numbers=numbers,
            used=used,
        )


@dataclass(frozen=True)
class Distribution:
    """From what `Params` are drawn, see `RandomUnderwater`.

    Attributes:
        waters: the weight of each, by name.
        constituents: those of the waters whose contents are drawn, by name.
        cameras: names, of equal weight.
        ranges: (low, high) of each quantity that is drawn.
        field_range: (low, high) of the medium field.
        p, field_probability: of degrading a picture at all, and of an uneven water.
    """

    waters: Mapping[str, float]
    constituents: Mapping[str, Constituents]
    cameras: tuple[str, ...]
    ranges: Mapping[str, tuple[float, float]]
    field_range: tuple[float, float]
    p: float
    field_probability: float

    @property
    def makes_media(self) -> bool:
        """Whether each picture gets a medium of its own."""
        # a contrast is that at the picture's own distances
        if "contrast" in self.ranges or self.constituents:
            return True
        return any(
            QUANTITIES[name].makes_medium and low < high
            for name, (low, high) in self.ranges.items()
        )

    @property
    def varies(self) -> bool:
        """Whether two draws may differ in anything that shows."""
        if self.p == 0:
            return False
        alternatives = [name for name, weight in self.waters.items() if weight > 0]
        uneven = self.field_probability > 0 and self.field_range[0] < self.field_range[1]
        chosen = len(alternatives) > 1 or bool(self.constituents) or len(self.cameras) > 1
        sometimes = self.p < 1 or 0 < self.field_probability < 1
        # the end of a range of whole numbers is not drawn
        ranged = any(
            low < high - QUANTITIES[name].whole for name, (low, high) in self.ranges.items()
        )
        return sometimes or uneven or chosen or ranged

    def draw(self, count: int, generator: torch.Generator | None) -> list[Params]:
        """Params for each of `count` pictures."""
        # 32 bits: all that a generator of torch takes from a seed
        seeds = torch.randint(2**32, (count,), generator=generator, device="cpu").tolist()
        rows = (*_CHOICES, *QUANTITIES)
        shape = len(rows), count
        uniform = torch.rand(shape, generator=generator, dtype=torch.float64, device="cpu")
        names, weights = list(self.waters), list(accumulate(self.waters.values()))
        which = ("first", "second") if self.ranges["mixing"][1] > 0 else ("first",)
        drawn = []
        for column, seed in zip(uniform.T.tolist(), seeds, strict=True):
            u = dict(zip(rows, column, strict=True))
            numbers: dict[str, float] = {}
            for name, (low, high) in self.ranges.items():
                log, whole = QUANTITIES[name].log, QUANTITIES[name].whole
                value = low * (high / low) ** u[name] if log else low + (high - low) * u[name]
                numbers[name] = int(value) if whole else value
            params = Params(
                applied=u["applied"] < self.p,
                waters=tuple(
                    self._drawn_water(names[bisect(weights, u[n] * weights[-1])], u) for n in which
                ),
                camera=self.cameras[int(u["camera"] * len(self.cameras))],
                field_seed=seed if u["field"] < self.field_probability else None,
                field_range=self.field_range,
                path=None,
                numbers=numbers,
            )
            drawn.append(params)
        return drawn

    def _drawn_water(self, name: str, shares: Mapping[str, float]) -> str:
        """The name of a water that was picked, with what is drawn of its contents. Of two waters
        both are drawn at the same shares of their ranges.
        """
        drawn_from = self.constituents.get(name)
        return name if drawn_from is None else drawn_from.drawn(shares).name

    def _require_water(self, name: Any) -> None:
        """Refuse the name of a water that cannot have been drawn."""
        if name in self.waters and name not in self.constituents:
            return
        if isinstance(name, str) and "=" in name:
            contents = Constituents.parse(name)
            if any(ranges.holds(contents) for ranges in self.constituents.values()):
                return
        has = ", ".join(self.waters)
        raise ValueError(f"params asks for {name!r}, but this transform has {has}")

    def read(self, record: Any, count: int) -> list[Params]:
        """The params of each of `count` pictures from a record.

        Raises:
            TypeError, ValueError: if it is no record, or none that this distribution can have
                given.
        """
        if not isinstance(record, Mapping) or "samples" not in record:
            expected = "a record from make_params, {'samples': […]}"
            raise TypeError(f"params must be {expected}, got {record!r:.80}")
        samples = record["samples"]
        if not isinstance(samples, list) or not all(isinstance(s, Mapping) for s in samples):
            raise TypeError(f"params['samples'] must be a list of dicts, got {samples!r:.80}")
        if len(samples) not in (1, count):
            raise ValueError(f"params has {len(samples)} samples but image is a batch of {count}")
        keys = {"applied", "waters", "camera", "field_seed", "field_range", *self.ranges}
        read = []
        for sample in samples:
            odd = ", ".join(sorted(keys ^ (set(sample) - {"used", "path"})))
            if odd:
                raise ValueError(
                    f"params is of a transform with other options: they differ in {odd}"
                )
            params = Params.from_dict(sample)
            for name in params.waters:
                self._require_water(name)
            if params.camera not in self.cameras:
                has = ", ".join(self.cameras)
                raise ValueError(f"params asks for {params.camera!r}, but this transform has {has}")
            if "light" in self.ranges:
                light, lights = params.numbers["light"], int(self.ranges["light"][1])
                if light not in range(lights):
                    below = f"a whole number below {lights}"
                    raise ValueError(f"params: light must be {below}, got {light!r:.40}")
            read.append(params)
        return read * count if len(read) < count else read


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
        >>> records = [json.dumps(aug.make_params(picture)) for picture in image]
        >>> aug.transform(image, None, uwaug.transforms.collate_records(records)).shape
        torch.Size([2, 3, 20, 30])
    """
    if isinstance(records, (str, Mapping)):
        got = f"got a {type(records).__name__}"
        raise TypeError(f"records must be a list of records, one of each picture, {got}")
    samples = []
    for i, record in enumerate(records):
        parsed: Any = record
        if isinstance(record, str):
            try:
                parsed = from_json(record)
            except ValueError:
                parsed = None
        of_record = parsed.get("samples") if isinstance(parsed, Mapping) else None
        if not isinstance(of_record, list):
            expected = "records from make_params, {'samples': […]}, or their JSON"
            raise TypeError(f"records must be {expected}, got {record!r:.80} at {i}")
        if len(of_record) != 1:
            got = f"got one of {len(of_record)} at {i}"
            raise ValueError(f"records must be of one picture each, {got}")
        samples += of_record
    return {"samples": samples}


def as_range(name: str, value: Any) -> tuple[float, float]:
    """A number or (low, high) as (low, high), inside the domain of that name."""
    least, most = DOMAIN[name]
    try:
        if isinstance(value, (str, bool)):
            raise TypeError
        alone = isinstance(value, (int, float, np.number))
        low, high = (value, value) if alone else map(float, value)
    except (TypeError, ValueError):
        low = high = math.nan
    if not (least <= low <= high <= most and high < math.inf):
        unit = QUANTITIES[name].unit if name in QUANTITIES else ""
        domain = f"{checks.bounds(least, most)} {unit}".rstrip()
        expected = f"a number or a range (low, high) with low ≤ high, {domain}"
        raise ValueError(f"{name} must be {expected}; got {value!r}")
    return float(low), float(high)
