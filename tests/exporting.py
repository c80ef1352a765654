"""What the tests of uwaug.onnx share, in a module that a spawned worker can import by name."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import Dataset

import uwaug
from uwaug import Underwater, list_presets
from uwaug.onnx import OnnxUnderwater, read_metadata
from uwaug.onnx.metadata import stored_in
from uwaug.presets import published_systems

NEAR, FAR = 0.25, 10.0
COARSE = 0.02
"""A tolerance with few blurs, as to export one takes seconds: a file is what its plan is."""
# of one shape of law
PAPERS = [name for name in list_presets() if name not in ("calibrated", *published_systems())]


def scene(
    batch: int = 2, height: int = 45, width: int = 62, seed: int = 0
) -> tuple[Tensor, Tensor, Tensor]:
    """Image, distance and field."""
    rng = torch.Generator().manual_seed(seed)
    image = torch.rand(batch, 3, height, width, generator=rng)
    distance = NEAR + (FAR - NEAR) * torch.rand(batch, 1, height, width, generator=rng) ** 2
    return image, distance, 0.3 + 1.4 * torch.rand(batch, 1, height, width, generator=rng)


def eager(
    path: Path, module: Underwater, image: Tensor, distance: Tensor, **given: object
) -> Tensor:
    """Float64 eager through the public model, with the file's plan."""
    stored = stored_in(path, read_metadata(path))
    assert stored.sides == module.sides
    plan = module.plan((image.shape[-2], image.shape[-1]))
    field, medium = given.get("field"), given.get("medium", module.medium)
    field = None if field is None else field.double()
    j = image.double()
    if image.dtype == torch.uint8:
        j = j / 255
    if module.color_space == "srgb":
        j = torch.where(j <= 0.04045, j / 12.92, ((j + 0.055) / 1.055) ** 2.4)
    out = uwaug.form_image(j, distance.double(), medium, field, plan=plan).image
    if module.color_space == "srgb":
        power = 1.055 * out.clamp(min=1e-9) ** (1 / 2.4) - 0.055
        out = torch.where(out <= 0.0031308, out * 12.92, power)
    return (255 * out).round().clamp(0, 255) if image.dtype == torch.uint8 else out


def stored_tensors(model: Any) -> list[Any]:
    """What an ONNX model holds, and the body of its loop over strips."""
    (scan,) = (node for node in model.graph.node if node.op_type == "Scan")
    body = next(one.g for one in scan.attribute if one.name == "body")
    return [*model.graph.initializer, *body.initializer]


def apart(got: Tensor, wanted: Tensor) -> float:
    """The largest difference."""
    return float((got.double() - wanted.double()).abs().max())


class Pictures(Dataset):
    """Four pictures through a file."""

    def __init__(self, run: OnnxUnderwater) -> None:
        self.run, self.scene = run, scene(4)

    def __len__(self) -> int:
        return 4

    def __getitem__(self, i: int) -> Tensor:
        return self.run(self.scene[0][i], self.scene[1][i])
