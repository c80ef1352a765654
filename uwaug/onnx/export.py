"""Export: a trace of `uwaug.formation.image.form`, checked before it is written."""

import json
import logging
import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
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
from uwaug.formation.inputs import effective_distance
from uwaug.formation.underwater import Underwater
from uwaug.onnx.blurs import Blurs
from uwaug.onnx.check import check_onnx, plan_of
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

_OPSET = 18
"""Operator set of the file, the first that can add scattered values."""

_TORCH = (2, 13)
"""Oldest release of torch that exports. 2.6 cannot trace free sizes."""

_DOC = {
    "image": "linear light or sRGB, see uwaug_module; 0…1, red, green, blue",
    "distance": "metres along the ray, ≥ 0; +inf is open water",
    "noise": "standard normals, new ones for each picture: what the sensor's noise is made of",
    "beta": "rates of the direct light, 1/m, ≥ 0",
    "direct_weights": "weights of T_β for each channel (of spectra: channel, scene's channel)",
    "G": "rates of signal and veil, 1/m, ≥ 0",
    "signal_weights": "weights of T_G, as direct_weights",
    "veil_weights": "weights of V for each channel",
    "b_mean": "scattering coefficient of the width law, 1/m",
    "scale": "width of the blur at one scattering length, px of the law",
    "exponent": "of the width law",
    "output": "the picture under water, as image",
}


def export_onnx(
    module: Underwater,
    path: str | os.PathLike[str],
    *,
    coefficients: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Path:
    """Write a module as an ONNX file that needs no uwaug to run.

    Inputs, all float32: image (Bx3xHxW), distance (Bx1xHxW, m), noise (Bx3xHxW, standard normals)
    if the development has a sensor, and coefficients if asked for. Output: as the image.

    Args:
        module: with a `distance_range` and `sides`, which fix the plan of the blur. Learnable
            numbers are written as they stand.
        path: of the file; written whole after `check_onnx` has passed it, or not at all. A symbolic
            link stays, and its target is replaced.
        coefficients: make the medium's numbers inputs, with a row for each image, see
            `uwaug.onnx.coefficients_of`. One file then serves every water whose widths lie in the
            plan: export a module of all of them, `Underwater(Medium.stack(…))`.
        progress: a function that is told each step, such as `print`.

    Returns:
        The path.

    Raises:
        ImportError: if the onnx extra is not installed, or torch is older than 2.13.
        OSError: if the folder is missing or cannot be written to, or `path` is no regular file.
        TypeError, ValueError: if the module cannot be exported, or the file fails its check.

    Examples:
        >>> module = uwaug.load_preset("survey").module(sides=(32, 2160))  # doctest: +SKIP
        >>> uwaug.onnx.export_onnx(module, "survey.onnx")  # doctest: +SKIP
    """
    path = Path(path)
    onnx, *_ = require("onnx", "onnx", "onnxscript", "onnxruntime")
    if tuple(int(part) for part in torch.__version__.split(".")[:2]) < _TORCH:
        wanted = ".".join(map(str, _TORCH))
        raise ImportError(f"to export needs torch ≥ {wanted}, here is {torch.__version__}")
    _require_exportable(module, coefficients)
    tell = progress or (lambda _: None)
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
    """Refuse anything but a module that a file can hold."""
    cure = "; export Underwater(Medium.stack(…)) with coefficients=True to change the water"
    checks.instance("module", module, Underwater, cure)
    if module.sides is None:
        cure = f"give Underwater(…, distance_range=(near, far), sides={SIDES})"
        raise ValueError(f"module has no plan of the blur for pictures of any size: {cure}")
    if len(module.medium) != 1 and not coefficients:
        held = f"{len(module.medium)} media, of which only one can be in a file"
        raise ValueError(f"module holds {held}: give coefficients=True")
    if module.medium.snow:
        cure = "export it of medium.with_snow(None)"
        raise ValueError(f"module has marine snow, which no file can draw: {cure}")
    if module.light is not None and coefficients:
        raise ValueError("coefficients cannot be inputs of a file with lamps: give one water")


@dataclass(frozen=True, eq=False)
class _InLamplight(Medium):
    """Medium with itself under lamps, which a trace cannot compute."""

    lamplit: Medium | None = None

    def under_lamp(self) -> Medium:
        assert self.lamplit is not None
        return self.lamplit


class Graph(nn.Module):
    """Image formation as a function of tensors alone, with the blurs of one plan."""

    def __init__(self, module: Underwater, plan: BlurPlan) -> None:
        super().__init__()
        self.plan, self.blurs = plan, Blurs(plan)
        medium = module.medium.map(lambda t: t.detach().to("cpu", torch.float32))
        if module.light is not None:
            values = {field.name: getattr(medium, field.name) for field in fields(medium)}
            medium = _InLamplight(**values, lamplit=medium.under_lamp())
        self.medium, self.inputs = medium, tuple(medium.parameters())
        self.development, self.light = module.development, module.light
        self.color_space = module.color_space

    def forward(self, *values: Tensor) -> Tensor:
        """Form a picture from image (Bx3xHxW), distance (Bx1xHxW), noise (Bx3xHxW) if there is a
        sensor, and the tensors of `Medium.parameters` if they are inputs.
        """
        image, distance, *coefficients = values
        medium, normals = self.medium, None
        if self.development.noise is not None:
            normals, *coefficients = coefficients
        if coefficients:
            named: dict[str, Any] = dict(zip(self.inputs, coefficients, strict=True))
            law = {name: named.pop(name) for name in PointSpread.NUMBERS}
            medium = replace(
                medium, **named, point_spread=replace(medium.point_spread, **law), bands=()
            )
        return form(
            image,
            effective_distance(distance, None, torch.float32),
            medium,
            self.development,
            color_space=self.color_space,
            light=self.light,
            plan=self.plan,
            blurs=self.blurs,
            normals=normals,
        )


def _examples(graph: Graph, coefficients: bool) -> dict[str, tuple[Tensor, dict[int, Any]]]:
    """Inputs of a graph by name: an example, and the names of its free sizes by axis."""
    names = ("batch", "height", "width", "rates", "scatter_rates")
    batch, height, width, rates, scatter_rates = (torch.export.Dim(n, min=1) for n in names)
    # torch.export would take a multiple of a period for the rule, and a 1 for fixed
    image = torch.rand(2, 3, 41, 57, dtype=torch.float32)
    free = {0: batch, 2: height, 3: width}
    examples = {"image": (image, free), "distance": (torch.ones_like(image[:, :1]), free)}
    if graph.development.noise is not None:
        examples["noise"] = torch.randn_like(image), free
    for name, row in graph.medium[0].parameters().items() if coefficients else ():
        free, axis = {0: batch}, Medium.TENSORS.get(name, "B")[-1]
        if axis in "KL":
            # two more rates without weight, as an example of one rate would fix that number
            row = pad(row, (0, 2))
            free[row.ndim - 1] = rates if axis == "K" else scatter_rates
        examples[name] = (row.expand(2, *row.shape[1:]).clone(), free)
    return examples


def _model(module: Underwater, coefficients: bool, tell: Callable[[str], None]) -> Any:
    """Trace a module into an ONNX model."""
    plan = plan_of(module)
    graph = Graph(module, plan).eval()
    examples = _examples(graph, coefficients)
    values, sizes = zip(*examples.values(), strict=True)
    with torch.no_grad(), _quiet():
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
    _drop_traces(model.graph)
    model.graph.doc_string = f"{module.medium}; {plan}"
    # names of free sizes; the output has those of the image
    for value in (*model.graph.input, *model.graph.output):
        value.doc_string = _DOC.get(value.name, f"uwaug.Medium.{value.name}")
        dims = value.type.tensor_type.shape.dim
        for axis, size in examples.get(value.name, examples["image"])[1].items():
            dims[axis].dim_param = size.__name__
    for key, text in _metadata(module, plan, coefficients).items():
        model.metadata_props.add(key=key, value=text)
    return model


def _metadata(module: Underwater, plan: BlurPlan, coefficients: bool) -> dict[str, str]:
    """Metadata of a file; "uwaug_module" holds the arguments of `Underwater`."""
    arguments = {
        "medium": module.medium,
        "distance_range": module.distance_range,
        "tolerance": module.tolerance,
        "color_space": module.color_space,
        "sides": module.sides,
        "development": module.development,
        "light": module.light,
    }
    return {
        "uwaug_version": __version__,
        "uwaug_water": "; ".join(module.medium.notes),
        "uwaug_plan": str(plan),
        "uwaug_coefficients": "inputs" if coefficients else "constants",
        "uwaug_module": json.dumps(to_plain(arguments)),
    }


def _drop_assertions(program: torch.export.ExportedProgram) -> None:
    """Drop the trace's assertions that sizes differ where they do in the example. The computation
    holds where they are equal, too.
    """
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


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence two messages of the exporter: a deprecation inside torch, and operators of a
    torchvision that is not used.
    """
    log = logging.getLogger("torch.onnx._internal.exporter._registration")

    def mute(record: logging.LogRecord) -> bool:
        return "torchvision is not installed" not in record.getMessage()

    log.addFilter(mute)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*LeafSpec", category=FutureWarning)
            yield
    finally:
        log.removeFilter(mute)
