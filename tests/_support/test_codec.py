"""Dataclasses as plain dictionaries, and back."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from uwaug import (
    Camera,
    Constituents,
    Development,
    PointSpread,
    RandomDevelopment,
    RandomLight,
    RandomUnderwater,
    RandomWater,
    Water,
    load_camera,
)
from uwaug._support import codec
from uwaug.distance import Network

LAW = PointSpread(0.5, 0.7, "exponential")
VALUES = {
    "width law": PointSpread.paper(),
    "development": Development(metered=True, tone=1.3, gamut=0.5),
    "contents": Constituents(chlorophyll=(1, 5), cdom=0.3),
    "water": Water.jerlov("5C").with_contrast(0.2, 3),
    "camera": load_camera("Sigma SDMerill (NPL)"),
    "camera of one's own": Camera([400, 700], [[0, 1, 1], [1, 1, 0]], "on"),
    "all at once": ("a", (1, 2.5, None, True), PointSpread(2.0)),
}


CLASSES = (PointSpread, Development, Constituents, Water, Camera)
DEEP: Any = 1
for _ in range(5000):
    DEEP = [DEEP]


@pytest.mark.parametrize("name", VALUES)
def test_there_and_back_as_json(name: str) -> None:
    value = VALUES[name]
    stored = json.loads(json.dumps(codec.to_plain(value)))
    assert codec.from_plain(stored, *CLASSES) == value


def test_what_is_as_by_default_is_not_stored() -> None:
    assert codec.to_plain(Development()) == {"kind": "Development"}
    stored = {"kind": "PointSpread", "scale": 0.5, "exponent": 0.7, "shape": "exponential"}
    assert codec.to_plain(LAW) == stored
    assert codec.from_plain({"scale": 2.0}, PointSpread) == PointSpread(2.0)


def test_arrays_paths_and_mappings() -> None:
    plain = codec.to_plain({1: np.float32(2), "a": np.arange(3), "b": torch.eye(2), "c": Path("x")})
    assert plain == {"1": 2.0, "a": [0, 1, 2], "b": [[1, 0], [0, 1]], "c": "x"}


def test_what_cannot_be_written() -> None:
    of_no_room = dataclass(type("Unknown", (), {}))()
    for value in (print, of_no_room, {"law": object()}):
        with pytest.raises(TypeError, match="cannot be written as numbers and words"):
            codec.to_plain(value)


@pytest.mark.parametrize(
    "data, expected, message",
    [
        ({"kind": "Sea"}, CLASSES, "PointSpread.*, got 'Sea'"),
        ({"kind": "pointspread"}, (PointSpread,), "did you mean PointSpread"),
        ({"kind": "PointSpread", "width": 2}, (PointSpread,), "has no 'width', only sc"),
        ({"scale": 1, "sahpe": "gaussian"}, (PointSpread,), "did you mean shape?"),
        ({"kind": "PointSpread", "shape": "gaussian"}, CLASSES, "missing.*'scale'"),
        ({"kind": "PointSpread", "scale": -2}, (PointSpread,), "PointSpread.scale must be"),
        ({"a": {"b": {"kind": "PointSpread", "scale": 2}}}, (), "no object is expected here"),
        ({"metered": "perhaps"}, (RandomDevelopment,), "metered must be true or false"),
        ({"metered": 0}, (RandomDevelopment,), "metered must be true or false"),
        ({"noise": {"seed": 1, "full_well": True}}, (RandomDevelopment,), "full_well must be"),
        ({"multiple": 2.5}, (Network,), "multiple must be a whole number"),
        ({"p": True}, (RandomUnderwater,), "p must be a number"),
        ({"p": DEEP}, (RandomUnderwater,), "nested too deeply"),
        ({"share": "none"}, (RandomLight,), "got 'none'"),
        ({"distance": {"kind": "Water"}}, (RandomUnderwater,), "got 'Water'"),
    ],
)
def test_what_cannot_be_read(data: Any, expected: tuple[type, ...], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        codec.from_plain(data, *expected)


def test_words_for_truth_and_none() -> None:
    for word, truth in (("False", False), ("off", False), ("On", True)):
        assert codec.from_plain({"metered": word}, RandomDevelopment).metered is truth
    plain = {"kind": "RandomWater", "field": "none"}
    assert codec.to_plain(RandomWater(field=None)) == plain
    assert codec.from_plain(plain, RandomWater).field is None


def test_a_name_stands_for_one_class() -> None:
    with pytest.raises(TypeError, match=r"'PointSpread' is taken by .*uwaug\.optics\.point_spread"):
        codec.plain(dataclass(type("PointSpread", (), {})))
    assert codec.from_plain({"scale": 2.0}, PointSpread) == PointSpread(2.0)
