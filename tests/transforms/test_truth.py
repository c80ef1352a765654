"""Truth of pictures for restoration."""

import json
from dataclasses import replace
from typing import Any

import pytest
import torch
from augmenting import RAW, distances, picture
from torch import Tensor

import uwaug
from uwaug import PointSpread, RandomDevelopment, RandomUnderwater, RandomWater, form_image
from uwaug.formation.colour import srgb_to_linear
from uwaug.transforms.truth import Truth

CAMERA = RandomDevelopment(gamut=0, tone=1, noise=None)
CASES: dict[str, dict[str, Any]] = {
    "default": {},
    "lamps": {"light": uwaug.RandomLight(share=1.0)},
    "level": {"light": None},
    "a type in three channels": {"water": RandomWater("7C", color_matrix=None, field=None)},
    "snow": {"water": RandomWater(snow=uwaug.MarineSnow(3000.0))},
    "linear": {"development": replace(CAMERA, color_space="linear")},
}


def made(**options: Any) -> tuple[Tensor, Truth]:
    """A degraded picture and its truth."""
    aug = RandomUnderwater(**{"development": CAMERA} | options)
    record = aug.make_params(picture(), aug.generator_of(0, 0, 1))
    scenes = aug.scenes(picture(), 1 + distances(), record)
    truth = scenes.truth()
    assert truth is not None
    return scenes.formed(), truth


@pytest.mark.parametrize("name", CASES)
def test_maps_and_gain_rebuild_the_picture(name: str) -> None:
    degraded, truth = made(**CASES[name])
    light = torch.einsum("ij,jhw->ihw", truth.gain, truth.signal + truth.veil)
    if name == "linear":  # which goes on above white
        light, stored = light.clamp(min=0), degraded
    else:
        light, stored = light.clamp(0, 1), srgb_to_linear(degraded)
    assert (light - stored).abs().max() < 1e-3


GREY = {"color_matrix": None, "field": None}


def test_signal_is_what_arrives_directly_and_what_is_blurred() -> None:
    """By another way, the terms of `form_image`; the share of all light is none of fine detail."""
    aug = RandomUnderwater(RandomWater("1C", **GREY), light=None, development=RAW)
    scenes = aug.scenes(picture(), 3 * distances(), aug.make_params(picture()))
    truth, medium = scenes.truth(), scenes.scenes[0].setting.medium
    assert truth is not None
    terms = form_image(truth.clean, truth.z, medium)
    white = form_image(torch.ones_like(truth.clean), truth.z, medium)
    torch.testing.assert_close(truth.direct, white.direct)
    torch.testing.assert_close(truth.transmission, white.direct + white.forward)
    off = truth.signal - truth.direct * truth.clean - terms.forward
    assert off.square().mean().sqrt() < 1e-6  # the exposure is 1: both blurs have one plan
    assert (truth.signal / truth.transmission - truth.clean).abs().max() > 0.1


@pytest.mark.parametrize("even", [True, False])
def test_without_blur_signal_over_transmission_is_the_scene(even: bool) -> None:
    law = PointSpread.calibrated() if even else PointSpread.none()
    aug = RandomUnderwater(RandomWater("3C", point_spread=law, **GREY), development=CAMERA)
    image = torch.full_like(picture(), 0.3) if even else picture()
    truth = aug.scenes(image, 2 * distances(), aug.make_params(image)).truth()
    assert truth is not None
    torch.testing.assert_close(truth.signal / truth.transmission, truth.clean)
    assert bool((truth.direct < truth.transmission).all())


def test_numbers_can_be_written_and_a_picture_left_alone_has_none() -> None:
    _, truth = made()
    assert json.loads(json.dumps(truth.record()))["vertical_depth"] == truth.vertical_depth
    aug = RandomUnderwater(p=0.0)
    record = aug.make_params(picture())
    scenes = aug.scenes(picture(), distances(), record)
    assert scenes.truth() is None
    aug = RandomUnderwater("II")
    two = aug.scenes(picture(2), distances(2) + 1, aug.make_params(picture(2)))
    assert two.truth(1) is not None
    with pytest.raises(ValueError, match="truth is of one picture: give 0…1"):
        two.truth()
    with pytest.raises(IndexError, match=r"picture must be 0…0, got 1"):
        scenes.truth(1)
