"""Export: a trace of `uwaug.formation.image.form`, checked before it is written."""

import json
import logging
import os
import warnings
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from uwaug import __version__
from uwaug._support import checks
from uwaug._support.atomic import written_whole
from uwaug._support.codec import to_plain
from uwaug._support.extras import require
from uwaug.blur.plan import BlurPlan
from uwaug.formation.demand import SIDES
from uwaug.formation.image import form
from uwaug.formation.setting import Setting
from uwaug.formation.underwater import EXPORTS, Underwater
from uwaug.light import Lamp
from uwaug.onnx.blurs import Blurs
from uwaug.onnx.check import check_onnx, plan_of
from uwaug.onnx.run import arguments_of, coefficients_of, described
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium

_OPSET = 18  # operator set of the file, the first that can add scattered values
_IR = 8  # version of the file's format, the lowest for this set: older runtimes refuse newer ones
# names of free sizes
_FREE = {
    "B": "batch",
    "H": "height",
    "W": "width",
    "K": "rates",
    "L": "scatter_rates",
    "M": "lamp_rates",
    "N": "lamp_scatter_rates",
}

_log = logging.getLogger(__name__)


def export_onnx(
    module: Underwater,
    path: str | os.PathLike[str],
    *,
    coefficients: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Path:
    """Write a module as an ONNX file that needs no uwaug to run.

    Args:
        module: with a `distance_range` and `sides`, which fix the plan of the blur. Learnable
            numbers are written as they stand.
        path: of the file; written whole after `check_onnx` has passed it, or not at all.
        coefficients: make numbers of the medium and the light inputs, with a row for each image,
            see `uwaug.onnx.coefficients_of`. One file then serves every water whose widths lie in
            the plan: export a module of all of them, `Underwater(Medium.stack(…))`.
        progress: a function that is told each step, such as `print`; None logs one line.

    Raises:
        ImportError: if the onnx extra is not installed, or torch is older than 2.13.
        TypeError, ValueError: if the module cannot be exported, or the file fails its check.

    Examples:
        >>> module = uwaug.load_preset("calibrated").module(sides=(32, 2160))  # doctest: +SKIP
        >>> uwaug.onnx.export_onnx(module, "calibrated.onnx")  # doctest: +SKIP
    """
    path = Path(path)
    onnx, *_ = require("onnx", "onnx", "onnxscript", "onnxruntime")
    if not EXPORTS:
        raise ImportError(f"to export needs torch ≥ 2.13, here is {torch.__version__}")
    _require_exportable(module, coefficients)
    if progress is None:
        _log.warning("uwaug exports %s: half a minute to three", path)
    tell = progress or _log.debug
    tell("tracing")
    with written_whole(path) as part:
        onnx.save(_model(module, coefficients, tell), part)
        try:
            check_onnx(part, module, progress=tell)
        except ValueError as error:
            # nobody sees the part
            raise ValueError(str(error).replace(str(part), str(path))) from error
    return path


def _require_exportable(module: Underwater, coefficients: bool) -> None:
    checks.instance("module", module, Underwater)
    if module.sides is None:
        cure = f"give Underwater(…, distance_range=(near, far), sides={SIDES})"
        raise ValueError(f"module has no plan of the blur for pictures of any size: {cure}")
    if len(module.medium) != 1 and not coefficients:
        raise ValueError(f"module holds {len(module.medium)} media: give coefficients=True")
    if module.medium.snow:
        cure = "export it of medium.with_snow(None)"
        raise ValueError(f"module has marine snow, which no file can draw: {cure}")


class _Traced(Medium):
    def _any_at_lens(self, z: Tensor) -> bool:
        return False  # ONNX has no expm1, by which digits would be kept


@dataclass(frozen=True)
class _TracedLamp(Lamp):
    """Lamp in a graph, with its light (Bx3) as a tensor."""

    light: Tensor | None = None

    def dyed(self, weights: Tensor) -> Tensor:
        assert self.light is not None
        return weights * self.light[..., None]


def _traced(setting: Setting, numbers: dict[str, Tensor]) -> Setting:
    of_medium: dict[str, Any] = {n: x for n, x in numbers.items() if n in Medium.TENSORS}
    medium = _Traced(**of_medium, law=setting.medium.law)
    if setting.light is None:
        return replace(setting, medium=medium)
    lamps = tuple(
        _TracedLamp(**vars(lamp), light=numbers["lamp_light"][:, place])
        for place, lamp in enumerate(setting.light.lamps)
    )
    light = copy(setting.light)  # without checks, which look at values
    vars(light).update(lamps=lamps, pitch=numbers.get("pitch"))
    return replace(setting, medium=medium, light=light)


class Graph(nn.Module):
    """Image formation as a function of tensors alone, with the blurs of one plan."""

    def __init__(self, module: Underwater, plan: BlurPlan) -> None:
        super().__init__()
        self.plan, self.blur = plan, Blurs(plan)
        self.setting = module.setting
        self.coefficients = coefficients_of(self.setting.medium, self.setting.light)

    def forward(self, *values: Tensor) -> Tensor:
        """Form a picture from image, distance, noise if there is a sensor, and coefficients if they
        are inputs.
        """
        image, distance, *inputs = values
        normals = None
        if self.setting.development.noise is not None:
            normals, *inputs = inputs
        numbers = dict(zip(self.coefficients, inputs, strict=True)) if inputs else self.coefficients
        return form(
            image,
            distance.clamp(0.0, FARTHEST),
            _traced(self.setting, numbers),
            plan=self.plan,
            blur=self.blur,
            normals=normals,
        )


def _examples(graph: Graph, coefficients: bool) -> dict[str, tuple[Tensor, dict[int, Any]]]:
    """Inputs of a graph by name: an example, and the names of its free sizes by axis."""
    dims = {axis: torch.export.Dim(name, min=1) for axis, name in _FREE.items()}
    # torch.export would take a multiple of a period for the rule, and a 1 for fixed
    image = torch.rand(2, 3, 41, 57, dtype=torch.float32)
    free = {0: dims["B"], 2: dims["H"], 3: dims["W"]}
    examples = {"image": (image, free), "distance": (torch.ones_like(image[:, :1]), free)}
    if graph.setting.development.noise is not None:
        examples["noise"] = torch.randn_like(image), free
    for name, rows in graph.coefficients.items() if coefficients else ():
        row, free = rows[:1], {0: dims["B"]}
        axis = described(name).partition(",")[0][-1]
        if axis in "KLMN":
            # two more rates without weight, as an example of one rate would fix that number
            row = pad(row, (0, 2))
            free[row.ndim - 1] = dims[axis]
        examples[name] = (row.expand(2, *row.shape[1:]).clone(), free)
    return examples


def _model(module: Underwater, coefficients: bool, tell: Callable[[str], None]) -> Any:
    plan = plan_of(module)
    graph = Graph(module, plan).eval()
    examples = _examples(graph, coefficients)
    values, sizes = zip(*examples.values(), strict=True)
    # two messages of the exporter, on what lies in torchvision and inside torch
    logging.getLogger("torch.onnx._internal.exporter._registration").setLevel(logging.ERROR)
    with torch.no_grad(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*LeafSpec", category=FutureWarning)
        program = torch.export.export(
            graph,
            values,
            dynamic_shapes=(sizes,),
            strict=False,
            # the exporter cannot prove that whole periods cover a picture of any size
            prefer_deferred_runtime_asserts_over_guards=True,
        )
        _drop_assertions(program)
        tell("translating and optimising")
        exported = torch.onnx.export(
            program,
            dynamo=True,
            input_names=list(examples),
            output_names=["output"],
            opset_version=_OPSET,
            verbose=False,
        )
    assert exported is not None
    model = exported.model_proto
    model.ir_version = _IR
    _drop_traces(model.graph)
    model.graph.doc_string = f"{module.medium}; {plan}"
    # names of free sizes; the output has those of the image
    for value in (*model.graph.input, *model.graph.output):
        value.doc_string = described(value.name)
        dims = value.type.tensor_type.shape.dim
        for axis, size in examples.get(value.name, examples["image"])[1].items():
            dims[axis].dim_param = size.__name__
    for key, text in _metadata(module, plan, coefficients).items():
        model.metadata_props.add(key=key, value=text)
    return model


def _metadata(module: Underwater, plan: BlurPlan, coefficients: bool) -> dict[str, str]:
    return {
        "uwaug_version": __version__,
        "uwaug_water": "; ".join(module.medium.notes),
        "uwaug_plan": str(plan),
        "uwaug_coefficients": "inputs" if coefficients else "constants",
        "uwaug_module": json.dumps(to_plain(arguments_of(module))),
    }


def _drop_assertions(program: torch.export.ExportedProgram) -> None:
    """Drop assertions that sizes differ, as they do in the example: they need not."""
    for node in list(program.graph.nodes):
        if node.target is torch.ops.aten._assert_scalar.default:
            program.graph.erase_node(node)
    program.graph.eliminate_dead_code()
    program.graph_module.recompile()


def _drop_traces(graph: Any) -> None:
    """Drop stack traces, as they name files of this machine."""
    for part in (*graph.node, *graph.input, *graph.output, *graph.initializer):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")
    del graph.value_info[:]
    graph.ClearField("metadata_props")
