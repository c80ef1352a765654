"""What the doors of `formation` refuse, by the name of the argument."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
import torch
from scenes import coastal, coefficients

import uwaug
from uwaug import Development, Medium, PointSpread, Sensor, Underwater, Water

IMAGE, DISTANCE = torch.rand(2, 3, 6, 8), 5 * torch.rand(2, 1, 6, 8)
HOLED = DISTANCE.clone()
HOLED[0, 0, 0, :2] = torch.tensor([math.nan, -1.0])
THREE = Medium.stack([coefficients()] * 3)
SPECTRAL = Medium.from_water("7C", surfaces="spectral")

Door = Callable[..., Any]
formed: Door = partial(uwaug.form_image, image=IMAGE, distance=DISTANCE, medium=coefficients())
called: Door = partial(Underwater(coastal()), image=IMAGE, distance=DISTANCE)
module: Door = partial(Underwater, medium=coastal())
left: Door = partial(uwaug.contrast_left, distance=DISTANCE, medium=coefficients())

# a door, the argument, what it gets, and what is said of it
DOORS: list[tuple[Door, str, Any, str]] = [
    (formed, "image", IMAGE.numpy(), "got ndarray"),
    (formed, "image", (255 * IMAGE).int(), "got torch.int32"),
    (formed, "image", IMAGE[0, 0], r"must have shape .*got \(6, 8\)"),
    (formed, "image", IMAGE.permute(0, 2, 3, 1), "must have shape"),
    (formed, "image", IMAGE * math.nan, "NaN"),
    (formed, "image", IMAGE + math.inf, "infinite"),
    (formed, "distance", 3.0, "got float"),
    (formed, "distance", DISTANCE.int(), "int32"),
    (formed, "distance", DISTANCE.expand(2, 3, 6, 8), "must have shape"),
    (formed, "distance", DISTANCE[..., :4], r"is \(6, 4\) but image is \(6, 8\)"),
    (formed, "distance", HOLED, "is NaN at 1 and negative at 1 of 96 pixels"),
    (formed, "distance", 1000 * DISTANCE, "divide by 1000"),
    (formed, "distance", DISTANCE.to("meta"), "is on meta but image is on cpu"),
    (formed, "medium", Water.jerlov("7C"), "got Water"),
    (formed, "", {"medium": THREE}, "batch sizes must agree or be 1.*'medium': 3"),
    (formed, "tolerance", 0.0, "0"),
    (formed, "tolerance", math.nan, "nan"),
    (formed, "light", "lamp", "got str"),
    (called, "image", 255 * IMAGE, r"reaches 2\d\d.*divide a 0…255 image by 255"),
    (called, "image", IMAGE - 0.5, r"falls to -0\.\d*: .*before Normalize"),
    (called, "field", -DISTANCE, "expected values ≥ 0"),
    (called, "field", DISTANCE[..., :4], r"is \(6, 4\)"),
    (called, "field", 1.0, "got float"),
    (module, "medium", Water.jerlov("7C"), r"must be a uwaug\.Medium"),
    (module, "color_space", "rgb", "rgb"),
    (module, "tolerance", 0.0, "0"),
    (module, "distance_range", (5.0, 1.0), r"\(5.0, 1.0\)"),
    (module, "distance_range", (math.nan, 1.0), "nan"),
    (module, "sides", (64, 32), "1 ≤ smallest ≤ largest"),
    (module, "sides", (32, 1e6), "≤ 16384 px"),
    (module, "sides", (32, 64.5), "whole numbers"),
    (module, "", {"distance_range": None, "sides": (32, 64)}, "sides need a distance_range"),
    (module, "development", {"tone": 2.0}, r"must be a uwaug\.Development"),
    (module, "light", "lamp", r"must be a uwaug\.Light"),
    (module, "learnable", True, r"medium\.as_coefficients\(\)"),
    (module, "", {"learnable": True, "medium": SPECTRAL}, r"medium\.as_coefficients\(\)"),
    (module, "learnable", ["beta"], "rates.* got 'beta'"),
    (Development, "exposure", "bright", "bright"),
    (Development, "exposure", math.nan, "nan"),
    (Development, "white_balance", (2.0, 1.0), "three numbers"),  # the loops would read past it
    (Development, "gamut", 2.0, r"in \[0, 1\]"),
    (Development, "noise", 8000, r"must be a uwaug\.Sensor, got int"),
    (lambda full_well: Development(noise=Sensor(full_well)), "full_well", 0, "≥ 1"),
    (lambda full_well: Development(noise=Sensor(full_well)), "full_well", (1e3, 2e3), "1000"),
    (left, "distance", HOLED, "is NaN at 1 and negative at 1"),
    (left, "medium", Water.jerlov("7C"), "got Water"),
    (left, "", {"medium": THREE}, "batch sizes must agree or be 1"),
    (PointSpread, "scale", -1.0, "finite and ≥ 0, got -1"),
    (PointSpread, "scale", torch.ones(3), "must be a number, got a tensor"),
    (lambda exponent: PointSpread(1.0, exponent), "exponent", 0.0, "got 0"),
    (lambda shape: PointSpread(1.0, 1.0, shape), "shape", "lorentzian", "lorentzian"),
    (lambda unit: PointSpread(1.0, 1.0, "gaussian", unit), "unit", "m", "px, paper, focal"),
]


@pytest.mark.parametrize("door, argument, value, words", DOORS)
def test_it_is_refused(door: Door, argument: str, value: Any, words: str) -> None:
    given = {argument: value} if argument else value
    with pytest.raises((TypeError, ValueError), match=f"{argument}.*{words}"):
        door(**given)
