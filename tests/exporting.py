"""What the tests of uwaug.onnx share, in a module that a spawned worker can import by name."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import Dataset

from uwaug import Medium, Underwater
from uwaug.onnx import OnnxUnderwater, export

NEAR, FAR = 0.25, 10.0
COARSE = 0.02
"""A tolerance with few blurs, as to export one takes seconds: a file is what its plan is."""


def scene(batch: int = 2, height: int = 45, width: int = 62) -> tuple[Tensor, Tensor]:
    """Image and distance."""
    rng = torch.Generator().manual_seed(0)
    image = torch.rand(batch, 3, height, width, generator=rng)
    return image, NEAR + (FAR - NEAR) * torch.rand(batch, 1, height, width, generator=rng) ** 2


def in_water(module: Underwater, medium: Medium, image: Tensor, distance: Tensor) -> Tensor:
    """A module's picture in another water, with its own plan, in double precision."""
    from uwaug.formation.image import form
    from uwaug.onnx.check import plan_of

    return form(
        image.double(),
        distance.double(),
        replace(module.setting, medium=medium.to(torch.float64)),
        plan=plan_of(module),
    )


def without_graph(path: Path, module: Underwater, **metadata: str | None) -> Path:
    """A file with the metadata of a module, or others (None: without), that gives its image back.

    To export takes seconds, and this nothing.
    """
    import onnx
    from onnx import TensorProto, helper

    def value(name: str, channels: int) -> Any:
        shape = ["batch", channels, "height", "width"]
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    nodes = [helper.make_node("Identity", ["image"], ["output"])]
    inputs, outputs = [value("image", 3), value("distance", 1)], [value("output", 3)]
    graph = helper.make_graph(nodes, "identity", inputs, outputs)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8)
    written = export._metadata(module, export.plan_of(module), coefficients=False)
    for key, text in {**written, **metadata}.items():
        if text is not None:
            model.metadata_props.add(key=key, value=text)
    onnx.save(model, path)
    return path


class Pictures(Dataset):
    """Four pictures through a file."""

    def __init__(self, run: OnnxUnderwater) -> None:
        self.run, self.scene = run, scene(4)

    def __len__(self) -> int:
        return 4

    def __getitem__(self, i: int) -> Tensor:
        return self.run(self.scene[0][i], self.scene[1][i])
