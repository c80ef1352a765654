"""What `form_image`, `Underwater` and `contrast_left` refuse, and how they say so."""

import math
from typing import Any

import pytest
import torch
from scenes import coastal, coefficients

from uwaug import (
    Development,
    Medium,
    PointSpread,
    Sensor,
    Underwater,
    Water,
    contrast_left,
    form_image,
)

IMAGE, DISTANCE = torch.rand(2, 3, 6, 8), 5 * torch.rand(2, 1, 6, 8)
HOLED = DISTANCE.clone()
HOLED[0, 0, 0, :2] = torch.tensor([math.nan, -1.0])
THREE = Medium.stack([coefficients()] * 3)

SCENES: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"image": IMAGE.numpy()}, TypeError, "image must be a floating-point tensor, got ndarray"),
    (
        {"image": (255 * IMAGE).int()},
        TypeError,
        "image must be a floating-point tensor, got torch.int32",
    ),
    ({"image": IMAGE[0, 0]}, ValueError, r"image must have shape \(3, H, W\).*got \(6, 8\)"),
    ({"image": IMAGE[:, :1]}, ValueError, "image must have shape"),
    ({"image": IMAGE.permute(0, 2, 3, 1)}, ValueError, "image must have shape"),
    ({"image": IMAGE[..., :4]}, ValueError, r"distance is \(6, 8\) but image is \(6, 4\)"),
    ({"image": IMAGE * math.nan}, ValueError, "image.*NaN"),
    ({"image": IMAGE + math.inf}, ValueError, "image.*infinite"),
    ({"distance": 3.0}, TypeError, "distance must be a floating-point tensor, got float"),
    ({"distance": DISTANCE.int()}, TypeError, "distance.*int32"),
    ({"distance": DISTANCE[0, 0]}, ValueError, "distance must have shape"),
    ({"distance": DISTANCE.expand(2, 3, 6, 8)}, ValueError, "distance must have shape"),
    ({"distance": DISTANCE[..., :4]}, ValueError, "height and width must agree"),
    ({"distance": HOLED}, ValueError, "distance is NaN at 1 and negative at 1 of 96 pixels"),
    ({"distance": HOLED}, ValueError, r"fill unknown pixels first, see uwaug\.distance"),
    ({"distance": 1000 * DISTANCE}, ValueError, "divide by 1000: millimetres"),
    ({"distance": DISTANCE.to("meta")}, ValueError, r"distance is on meta but image is on cpu"),
    ({"medium": Water.jerlov("7C")}, TypeError, r"medium must be a uwaug\.Medium, got Water"),
    ({"medium": THREE}, ValueError, "batch sizes must agree or be 1.*'medium': 3"),
    ({"tolerance": 0.0}, ValueError, "tolerance.*0"),
    ({"tolerance": math.nan}, ValueError, "tolerance.*nan"),
    ({"tolerance": 2.0}, ValueError, "tolerance.*2"),
    ({"light": "lamp"}, TypeError, r"light must be a uwaug\.Light, got str"),
]


@pytest.mark.parametrize("change, error, message", SCENES)
def test_form_image_refuses(change: Any, error: type[Exception], message: str) -> None:
    given = {"image": IMAGE, "distance": DISTANCE, "medium": coefficients(), **change}
    with pytest.raises(error, match=message):
        form_image(**given)


CALLS: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"image": 255 * IMAGE}, ValueError, r"image reaches 2\d\d.*: .*divide a 0…255 image by 255"),
    ({"image": IMAGE - 0.5}, ValueError, r"image falls to -0\.\d*: .*place it before Normalize"),
    ({"field": -DISTANCE}, ValueError, "field is NaN at 0, negative at 96 and infinite at 0"),
    ({"field": DISTANCE + math.inf}, ValueError, "field.*infinite at 96"),
    ({"field": DISTANCE[..., :4]}, ValueError, r"field is \(6, 4\)"),
    ({"field": 1.0}, TypeError, "field must be a floating-point tensor, got float"),
]


@pytest.mark.parametrize("change, error, message", CALLS)
def test_underwater_refuses_a_scene(change: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        Underwater(coastal())(**{"image": IMAGE, "distance": DISTANCE, **change})


SPECTRAL = Medium.from_water("7C", surfaces="spectral")
OPTIONS: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"medium": Water.jerlov("7C")}, TypeError, r"medium must be a uwaug\.Medium"),
    ({"color_space": "rgb"}, ValueError, "color_space.*rgb"),
    ({"tolerance": 0.0}, ValueError, "tolerance.*0"),
    ({"distance_range": (5.0, 1.0)}, ValueError, r"distance_range.*\(5.0, 1.0\)"),
    ({"distance_range": (-1.0, 1.0)}, ValueError, r"distance_range.*-1"),
    ({"distance_range": (math.nan, 1.0)}, ValueError, "distance_range.*nan"),
    ({"distance_range": 5.0}, TypeError, r"distance_range must be .* in metres, got 5\.0"),
    ({"sides": (64, 32)}, ValueError, "sides must be whole numbers, 1 ≤ smallest ≤ largest"),
    ({"sides": (32, 1e6)}, ValueError, r"≤ 16384 px, got \(32, 1000000.0\)"),
    ({"sides": (32, 64.5)}, ValueError, "sides must be whole numbers"),
    ({"sides": ("a", "b")}, TypeError, r"sides must be \(smallest, largest\)"),
    ({"distance_range": None, "sides": (32, 64)}, ValueError, "sides need a distance_range"),
    ({"development": {"tone": 2.0}}, TypeError, r"development must be a uwaug\.Development"),
    ({"light": "lamp"}, TypeError, r"light must be a uwaug\.Light"),
    ({"learnable": True}, ValueError, r"learnable: .*medium\.as_coefficients\(\)"),
    ({"learnable": True, "medium": SPECTRAL}, ValueError, r"medium\.as_coefficients\(\)"),
    ({"learnable": ["beta"]}, ValueError, "learnable must be one of .*rates.* got 'beta'"),
]


@pytest.mark.parametrize("change, error, message", OPTIONS)
def test_underwater_refuses_an_option(change: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        Underwater(**{"medium": coastal(), **change})


DEVELOPMENTS: list[tuple[dict[str, Any], str]] = [
    ({"exposure": "bright"}, "exposure must be"),
    ({"exposure": math.nan}, "exposure must be"),
    ({"white_balance": 1.5}, "white_balance must be"),
    ({"gamut": 2.0}, r"gamut must be in \[0, 1\]"),
    ({"tone": 0.1}, "tone must be"),
    ({"noise": Sensor(0)}, "full_well must be finite and ≥ 1"),
    ({"noise": Sensor((1e3, 2e3))}, r"full_well must be .* got \(1000"),
    ({"noise": Sensor(1e3, -1)}, "read_noise must be"),
    ({"noise": 8000}, r"noise must be a uwaug\.Sensor, got int"),
]


@pytest.mark.parametrize("change, message", DEVELOPMENTS)
def test_a_development_refuses(change: Any, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        Development(**change)


CONTRASTS: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"distance": DISTANCE[0, 0]}, ValueError, "distance must have shape"),
    ({"distance": HOLED}, ValueError, "distance is NaN at 1 and negative at 1"),
    ({"medium": Water.jerlov("7C")}, TypeError, r"medium must be a uwaug\.Medium, got Water"),
    ({"medium": THREE}, ValueError, "batch sizes must agree or be 1"),
    ({"reflectance": -0.1}, ValueError, "reflectance must be finite and ≥ 0, got -0.1"),
    ({"reflectance": -torch.ones(1)}, ValueError, "reflectance falls to -1"),
    ({"reflectance": torch.ones(7)}, ValueError, r"reflectance is \(7,\): expected what"),
    ({"light": "lamp"}, TypeError, r"light must be a uwaug\.Light, got str"),
]


@pytest.mark.parametrize("change, error, message", CONTRASTS)
def test_contrast_left_refuses(change: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        contrast_left(**{"distance": DISTANCE, "medium": coefficients(), **change})


LAWS: list[tuple[tuple[Any, ...], str]] = [
    ((-1.0,), "scale must be finite and ≥ 0, got -1"),
    ((torch.ones(3),), "scale must be a number, got a tensor"),
    ((1.0, 0.0), "exponent must be finite and ≥ 0.001, got 0"),
    ((1.0, 1.0, "lorentzian"), "shape.*lorentzian"),
    ((1.0, 1.0, "gaussian", "m"), "unit must be one of px, paper, focal, got 'm'"),
]


@pytest.mark.parametrize("arguments, message", LAWS)
def test_a_width_law_refuses(arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        PointSpread(*arguments)
