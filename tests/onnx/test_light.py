from pathlib import Path
from typing import Any

import pytest
import torch
from inputs import rand

import uwaug
from uwaug import Light, Medium, Underwater
from uwaug.onnx import OnnxUnderwater, check_onnx, export_onnx, read_module
from uwaug.onnx.check import limit_of

pytest.importorskip("onnxruntime")
pytest.importorskip("onnxscript")

MEDIUM = Medium.from_water("7C", vertical_depth=10.0)
LAMP = Light.lamp((0.3, -0.2, 0.0), (-0.05, 0.05, 1.0), power=4.0, cone=40.0)


def module(light: Light, **options: Any) -> Underwater:
    return Underwater(MEDIUM, light=light, focal_px=70.0, sides=(1, 144), **options)


def test_a_lamp_in_a_file(tmp_path: Path) -> None:
    """Checked over all sizes and distances; and what the file says makes the module again."""
    ours = module(Light.ambient() + LAMP + Light.parallel(40, 20, gradient=0.2), exposure=1.0)
    path = export_onnx(ours, tmp_path / "lamp.onnx", field="input", verify=False)
    assert check_onnx(path, ours).worst < 1e-5
    image, z = rand(1, 3, 20, 31).float(), 0.5 + 3 * rand(1, 1, 20, 31)
    field = 0.7 + 0.6 * rand(1, 1, 20, 31, seed=4).float()
    again = read_module(path)
    assert torch.equal(again(image, z.float(), field), ours(image, z.float(), field))
    found = OnnxUnderwater(path)(image, z.float(), field)
    torch.testing.assert_close(found, ours(image, z.float(), field), rtol=0, atol=1e-4)


def test_what_a_file_with_a_light_cannot_be(tmp_path: Path) -> None:
    path = tmp_path / "lamp.onnx"
    with pytest.raises(ValueError, match=r"parameters must be .frozen. where module\.light"):
        export_onnx(module(LAMP), path, parameters="inputs")
    with pytest.raises(ValueError, match="exposure is 'auto', which a file with a light"):
        export_onnx(module(LAMP, exposure="auto"), path)
    two = Light.lamp((0, 0, 0), (0, 0, 1), power=torch.ones(2))
    with pytest.raises(ValueError, match="light is for 2 pictures"):
        export_onnx(module(two), path)
    assert not path.exists()


def test_a_check_allows_what_single_precision_costs() -> None:
    """Of a published system's lamp: else its file would be refused for PyTorch's own rounding."""
    ours = uwaug.load_preset("jaffe-1990").module(focal_px=1870.0)
    image, ramp = rand(1, 3, 144, 145).float(), torch.linspace(0, 1, 145).expand(1, 1, 144, 145)
    z = torch.where(ramp > 0.5, 5.0, 1.0)
    plan = ours.plan((144, 145))
    medium = ours.medium.to(torch.float64)
    exact = ours.formed(image.double(), z.double(), None, medium, plan)
    apart = float((ours(image, z) - exact).abs().max())
    assert apart < limit_of(ours) == 2e-4
    assert apart > limit_of(Underwater(MEDIUM)) == 1e-5
    assert limit_of(Underwater(MEDIUM, light=Light.ambient(0.5))) == 1e-5
