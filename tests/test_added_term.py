"""A term that is added to the sum shows everywhere: here a glow of the water itself."""

from pathlib import Path

import pytest
import torch
from scenes import coefficients, distances, picture
from torch import Tensor

import uwaug
from uwaug import Development, Lamp, Light, Medium, Underwater, form_image
from uwaug.fitting import fit
from uwaug.optics.curves import Curves

FORMED = Medium.image
IMAGE, DISTANCE = 0.5 * picture(48, 64), distances(48, 64)


def glowing(medium: Medium, z: Tensor, J: Tensor, soft: Tensor, T: Curves | None = None) -> Tensor:
    """`Medium.image` with one more term."""
    return FORMED(medium, z, J, soft, T) - 0.05 * torch.expm1(-z)


def by_default(metered: bool = False) -> Tensor:
    """A picture of `RandomUnderwater` as it comes, with or without its meter."""
    augment = uwaug.RandomUnderwater(development=uwaug.RandomDevelopment(metered=metered))
    record = augment.make_params(IMAGE[0], torch.Generator().manual_seed(3))
    return augment.transform(IMAGE[0], DISTANCE[0], record)


LIGHT = Light((Lamp((0.4, 0.0, 0.0), 2.0),), daylight=0.3)
DEVELOPED = Development(exposure=1.0, saturation=1.2, gamut=0.5)
WAYS = {
    "grey": lambda: Underwater(coefficients(), None)(IMAGE, DISTANCE),
    "spectral, developed": lambda: Underwater(
        Medium.from_water("II", surfaces="spectral"), None, development=DEVELOPED
    )(IMAGE, DISTANCE),
    "terms": lambda: form_image(IMAGE, DISTANCE, coefficients()).image,
    "under a lamp": lambda: Underwater(coefficients(), None, light=LIGHT)(IMAGE, DISTANCE),
    "default pictures": by_default,
}


@pytest.fixture(autouse=True)
def by_pytorch(monkeypatch: pytest.MonkeyPatch) -> None:
    """The compiled twin states the sum again; test_fast.py holds both together."""
    monkeypatch.setenv("UWAUG_FAST", "0")


@pytest.mark.parametrize("way", WAYS)
def test_in_pictures(way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = WAYS[way]()
    monkeypatch.setattr(Medium, "image", glowing)
    brighter = WAYS[way]() - before
    assert brighter.mean() > 0.01
    assert brighter.min() > -1e-3


def test_the_meter_sees_it(monkeypatch: pytest.MonkeyPatch) -> None:
    before = by_default(metered=True)
    monkeypatch.setattr(Medium, "image", glowing)
    change = by_default(metered=True) - before
    assert change.abs().max() > 0.01
    # the mean luminance of the scene is kept, so that the picture is not blown out
    assert change.mean().abs() < 0.1


def test_in_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    from uwaug.onnx import OnnxUnderwater, export_onnx

    module = Underwater(coefficients(), (0.5, 6.0), tolerance=0.02)
    dark = module(IMAGE, DISTANCE)
    monkeypatch.setattr(Medium, "image", glowing)
    path = export_onnx(module, tmp_path / "glowing.onnx")
    found = OnnxUnderwater(path)(IMAGE, DISTANCE)
    torch.testing.assert_close(found, module(IMAGE, DISTANCE), rtol=0, atol=2e-5)
    assert (found - dark).mean() > 0.01


def test_in_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    G, veil = (0.5, 0.3, 0.2), (0.1, 0.3, 0.4)
    water = Medium.from_coefficients(G, G, veil)
    monkeypatch.setattr(Medium, "image", glowing)
    observed = Underwater(water, None)(IMAGE, DISTANCE)

    def off() -> float:
        found = fit(IMAGE, observed, DISTANCE, model="haze", gain="fixed", progress=False).medium
        return float((found.veil_weights.sum(-1) - torch.tensor(veil)).abs().max())

    with_the_term = off()
    monkeypatch.setattr(Medium, "image", FORMED)
    assert with_the_term < 1e-3 < 0.02 < off()
