"""What the tests of uwaug.onnx share, in a module that a spawned worker can import by name."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import Dataset

from uwaug import Medium, Underwater, list_presets
from uwaug.onnx import OnnxUnderwater
from uwaug.onnx.graph import Options, plan_of
from uwaug.onnx.metadata import written
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
    module: Underwater,
    image: Tensor,
    distance: Tensor,
    field: Tensor | None = None,
    medium: Medium | None = None,
) -> Tensor:
    """The module in double precision, in another water."""
    medium = (medium or module.medium).to(dtype=torch.float64)
    field = None if field is None else field.double()
    image = image if image.dtype == torch.uint8 else image.double()
    with torch.no_grad():
        return module.formed(image, distance.double(), field, medium, plan_of(module))


def apart(result: Tensor, expected: Tensor) -> float:
    """The largest difference."""
    return float((result.double() - expected.double()).abs().max())


def bare(
    path: Path,
    module: Underwater,
    options: Options | None = None,
    nodes: tuple[tuple[str, list[str], str], ...] = (("Identity", ["image"], "output"),),
    **metadata: str | None,
) -> Path:
    """A file with the metadata of a module, or others (None: without), and a graph of some nodes.

    To export takes seconds, and this nothing.
    """
    import onnx
    from onnx import TensorProto, helper

    options = options or Options()
    kind = TensorProto.UINT8 if options.image == "uint8" else TensorProto.FLOAT
    sizes = ["batch", 3, "height", "width"]
    inputs = [
        helper.make_tensor_value_info("image", kind, sizes),
        helper.make_tensor_value_info("distance", TensorProto.FLOAT, ["batch", 1, *sizes[2:]]),
    ]
    outputs = [helper.make_tensor_value_info("output", kind, [None] * 4)]
    graph = helper.make_graph(
        [helper.make_node(kind, takes, [gives]) for kind, takes, gives in nodes],
        "bare",
        inputs,
        outputs,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8)
    for key, value in {**written(module, plan_of(module), options), **metadata}.items():
        if value is not None:
            model.metadata_props.add(key=key, value=value)
    onnx.save(model, path)
    return path


def stored_tensors(model: Any) -> list[Any]:
    """What an ONNX model holds."""
    return list(model.graph.initializer)


class Pictures(Dataset):
    """Four pictures through a file."""

    def __init__(self, run: OnnxUnderwater) -> None:
        self.run, self.scene = run, scene(4)

    def __len__(self) -> int:
        return 4

    def __getitem__(self, i: int) -> Tensor:
        return self.run(self.scene[0][i], self.scene[1][i])
