"""Draws: all that is random about one picture, and its record."""

import math
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any, NamedTuple

from torch.utils.data._utils.collate import default_collate_fn_map

from uwaug._support import checks
from uwaug._support.nouns import SEEDS, Drawn, Noun, require_names
from uwaug.formation.development import DOMAINS, LEAST_FACTOR

Record = dict[str, Any]
"""A plain dictionary, {"samples": […]} with one for each picture, as JSON holds it."""

NOUNS = ("water", "distance", "light", "development")
"""Arguments of `RandomUnderwater` that say what is random about a picture."""


class Batchable(Record):
    """A record that a loader joins with the others of a batch: one, with the samples of all."""

    def __reduce__(self) -> tuple[Any, ...]:  # to what torch.load takes
        return OrderedDict, (), None, None, iter(self.items())


default_collate_fn_map[Batchable] = lambda records, **_: Batchable(
    samples=[sample for record in records for sample in record["samples"]]
)


class Draw(NamedTuple):
    """All that is random about a picture."""

    applied: bool  # True if it is degraded at all
    water: Drawn
    distance: Drawn
    light: Drawn
    development: Drawn
    measured: Mapping[str, Any] = {}  # what one frame of a film settles for all of them
    moved: float = 0.0  # m by which field and snow of a film have drifted to the right
    motion: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of its camera, m right, down, forward

    @property
    def passed(self) -> tuple[float, float, float]:
        """How far the water has moved (m) to the right, down and away, as the camera sees it."""
        right, down, forward = self.motion
        return self.moved - right, -down, -forward


def of_frame(sample: Record, number: int) -> Record:
    """The sample of a record, for one frame of a film: its sensor's noise is its own."""
    development = dict(sample["development"])
    if noise := development.get("noise"):
        development["noise"] = {**noise, "seed": (noise["seed"] + number) % SEEDS}
    return {**sample, "development": development}


def read_draws(record: Any, count: int, nouns: Mapping[str, Noun]) -> list[Draw]:
    """Read the draws of `count` pictures. Refuses a record of other options or another batch."""
    samples = record.get("samples") if isinstance(record, Mapping) else None
    if not isinstance(samples, list) or not all(isinstance(s, Mapping) for s in samples):
        raise TypeError(f"params must be a record from make_params, got {record!r:.80}")
    if len(samples) not in (1, count):
        raise ValueError(f"params has {len(samples)} samples but image is a batch of {count}")
    for sample in samples:
        film = {name for name in Draw._field_defaults if name in sample}
        require_names(sample, {"applied", *nouns, *film}, "sample")
        if not isinstance(sample["applied"], bool):
            raise TypeError(f"params: applied must be true or false, got {sample['applied']!r:.80}")
        for name, noun in nouns.items():
            noun.require(sample[name], name)
        checks.within("params: moved", sample.get("moved", 0.0))
        checks.vector("params: motion", sample.get("motion", (0.0, 0.0, 0.0)))
        _require_measured(sample.get("measured", {}))
    draws = [Draw(**sample) for sample in samples]
    return draws if len(draws) == count else draws * count


def _require_measured(measured: Any) -> None:
    names = {"median", "exposure", "white_balance", "saturation"}
    require_names(measured, names if measured else set(), "measured")
    if not measured:
        return
    median = measured["median"]
    if not (isinstance(median, (int, float)) and median > 0):  # infinite in open water
        raise ValueError(f"params: measured.median must be above 0 m, got {median!r:.80}")
    checks.within("params: measured.exposure", measured["exposure"], -math.inf)
    checks.within("params: measured.saturation", measured["saturation"], *DOMAINS["saturation"])
    if measured["white_balance"] is not None:
        checks.vector("params: measured.white_balance", measured["white_balance"], LEAST_FACTOR)
