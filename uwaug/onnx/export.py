"""From module to file."""

import inspect
import logging
import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from uwaug._support import checks
from uwaug._support.atomic import written_whole
from uwaug._support.extras import require
from uwaug.blur.kernels import PERIOD
from uwaug.formation.underwater import Underwater
from uwaug.onnx.check import check_onnx
from uwaug.onnx.graph import Before, Graph, Strip, parameters_of
from uwaug.onnx.metadata import Options, plan_of, require_light, written
from uwaug.onnx.strips import joined, strips_of

__all__ = ["export_onnx", "export_program"]


def export_onnx(
    module: Underwater,
    path: str | os.PathLike[str],
    *,
    parameters: Literal["frozen", "inputs"] = "frozen",
    field: Literal["none", "input"] = "none",
    image: Literal["float32", "uint8"] = "float32",
    opset: int = 18,
    verify: bool = True,
    progress: Callable[[str], None] | None = None,
) -> Path:
    """Write a module as an ONNX file that needs no uwaug to run.

    Inputs: image (Bx3xHxW), distance (Bx1xHxW float32, m), then those asked for below. Output: as
    the image.

    Args:
        module: with a `distance_range` and `sides`, which fix the plan of the blur; the file has
            the same plan. What is learnable is written as it stands. A light is written as it
            stands too, with frozen parameters and an exposure that is not automatic.
        path: of the file; written whole, after it has passed its check, or not at all. A symbolic
            link stays, and what it points to is replaced.
        parameters: "frozen", or "inputs": rates, weights and width law become inputs of the graph,
            with a row for each image (see `uwaug.Medium.parameters`), so that one file serves every
            water whose widths lie in the plan: export a module of all of them,
            `Underwater(Medium.stack(…))`.
        field: "input" adds the medium field, Bx1xHxW, as an input.
        image: "float32" (0…1, not clipped), or "uint8" in and out (0…255, rounded and clipped).
        opset: ≥ 18, as high as the installed exporter can write.
        verify: run `check_onnx` before the file is put in place.
        progress: is told what is being done, a few words at each step.

    Returns:
        The path.

    Raises:
        ImportError: if the onnx extra is not installed.
        OSError: if the folder is missing or cannot be written to, or `path` is no regular file.
        TypeError, ValueError: if an argument is not as above, or the file fails its check.
    """
    path = Path(path)
    if opset < 18:
        raise ValueError(f"opset must be ≥ 18 (scatter with addition), got {opset}")
    onnx, *_ = require("onnx", "onnx", "onnxscript", *(["onnxruntime"] if verify else []))
    newest = onnx.defs.onnx_opset_version()
    if opset > newest:
        raise ValueError(f"opset must be ≤ {newest}, as onnx {onnx.__version__} is, got {opset}")
    options, tell = Options(parameters, field, image), progress or _silent
    tell("tracing")
    subject = _subject(module, options)
    with written_whole(path) as part:
        model = _translated(subject, opset, tell)
        for key, value in written(module, subject.graph.plan, options).items():
            model.metadata_props.add(key=key, value=value)
        onnx.save(model, part)
        if verify:
            try:
                check_onnx(part, module, progress=tell)
            except ValueError as error:
                # nobody will ever see the part
                raise ValueError(str(error).replace(str(part), str(path))) from error
    return path


def _silent(_: str) -> None:
    pass


def _translated(subject: "_Subject", opset: int, tell: Callable[[str], None]) -> Any:
    """The graph as an ONNX model."""
    if subject.graph.light is not None:  # which is made for the whole picture
        model = _model(subject, opset, tell)
    else:
        before = subject._replace(graph=Before(subject.graph))
        whole = _model(before, opset, tell)
        model = joined(whole, _model(_strip_of(before), opset, _silent))
    _drop_traces(model.graph)
    _name_sizes(model, subject)
    return model


def _strip_of(before: "_Subject") -> "_Subject":
    """A strip, with what `Before` makes as examples."""
    image = before.inputs["image"]
    with torch.no_grad():
        rows, _ = strips_of(len(image), (image.shape[2], image.shape[3]))
        made = before.graph.made(*before.inputs.values())
    assert len(rows) > 1  # torch.export takes a size of 1 for fixed
    frozen, picture = before.graph.parent.frozen, before.free["image"]
    every = torch.export.Dim("every_rate", min=1)
    known = {
        "light": picture,
        "z": picture,
        "brightest": {0: picture[0]},
        "rates": {0: picture[0], 1: every},
        "weights": {0: picture[0]} if frozen else {0: picture[0], 2: every},
    }
    # whole periods of rows
    free = {"rows": {0: PERIOD * torch.export.Dim("periods", min=1)}}
    for name in made:
        if name.startswith("prepared"):
            free[name] = {**picture, 2: torch.export.Dim(name, min=1)}
        else:
            free[name] = known.get(name) or before.free[name]
    strip = Strip(before.graph.parent, list(made))
    return _Subject(strip, {"rows": rows[0], **made}, free)


def _model(subject: "_Subject", opset: int, tell: Callable[[str], None]) -> Any:
    """A graph, or one of its parts, as an ONNX model."""
    with torch.no_grad(), _quiet():
        program = _program(subject)
        _drop_asserts(program)
        tell("translating and optimising")
        exported = torch.onnx.export(
            program,
            dynamo=True,
            input_names=list(subject.inputs),
            opset_version=opset,
            verbose=False,
        )
    assert exported is not None
    model = exported.model_proto
    got = {entry.domain: entry.version for entry in model.opset_import}
    if got.get("") != opset:
        # it says so in its log alone
        raise ValueError(
            f"opset {opset}: the installed exporter can write up to {got.get('')} here"
        )
    return model


def _drop_asserts(program: torch.export.ExportedProgram) -> None:
    """Drop what it asserts of free sizes. The exporter does so too, but only after it has traced
    their arithmetic again.
    """
    for node in list(program.graph.nodes):
        if node.target is torch.ops.aten._assert_scalar.default:
            program.graph.erase_node(node)
    program.graph.eliminate_dead_code()
    program.graph_module.recompile()


def export_program(
    module: Underwater,
    *,
    parameters: Literal["frozen", "inputs"] = "frozen",
    field: Literal["none", "input"] = "none",
    image: Literal["float32", "uint8"] = "float32",
) -> torch.export.ExportedProgram:
    """The same function as a `torch.export` program, for `torch.export.save`: one graph without
    strips, which is slower on large pictures. Arguments as for `export_onnx`.
    """
    with torch.no_grad(), _quiet():
        return _program(_subject(module, Options(parameters, field, image)))


class _Subject(NamedTuple):
    """What torch.export wants: the graph, or a part of it; an example of each input, by name, and
    its free sizes, by axis.
    """

    graph: Any
    inputs: dict[str, Tensor]
    free: dict[str, dict[int, Any]]


def _subject(module: Underwater, options: Options) -> _Subject:
    checks.instance("module", module, Underwater)
    frozen, field, quantised = (
        options.parameters == "frozen",
        options.field == "input",
        options.image == "uint8",
    )
    if frozen and len(module.medium) != 1:
        held = f"{len(module.medium)} media, of which only one can be frozen"
        raise ValueError(f"module holds {held}: use parameters='inputs'")
    require_light(module, options)
    plan = plan_of(module)
    names = ("batch", "height", "width", "rates", "scatter_rates")
    batch, height, width, rates, scatter_rates = (torch.export.Dim(name, min=1) for name in names)
    # five strips of three periods
    picture = torch.rand(2, 3, 240, 560, dtype=torch.float32)
    inputs = {
        "image": (picture * 255).to(torch.uint8) if quantised else picture,
        "distance": torch.ones_like(picture[:, :1]),
    }
    if field:
        inputs["field"] = torch.ones_like(picture[:, :1])
    free = {name: {0: batch, 2: height, 3: width} for name in inputs}
    for name, row in parameters_of(module.medium[0]).items() if not frozen else ():
        # two more rates of no weight, as an example of one rate would fix that number
        example = pad(row, (0, 2)) if row.ndim > 1 else row
        inputs[name] = example.expand(2, *example.shape[1:]).contiguous()
        free[name] = {0: batch}
        if row.ndim > 1:
            free[name][row.ndim - 1] = (
                rates if name in ("beta", "direct_weights") else scatter_rates
            )
    graph = Graph(module, plan, frozen=frozen, field=field, quantised=quantised).eval()
    return _Subject(graph, inputs, free)


def _program(subject: _Subject) -> torch.export.ExportedProgram:
    parameters = inspect.signature(subject.graph.forward).parameters.values()
    named = sum(one.kind is not one.VAR_POSITIONAL for one in parameters)
    free = list(subject.free.values())
    shapes: tuple[Any, ...] = tuple(free[:named])
    if len(free) > named:
        shapes = (*shapes, tuple(free[named:]))
    return torch.export.export(
        subject.graph,
        tuple(subject.inputs.values()),
        dynamic_shapes=shapes,
        strict=False,
        # that whole periods of 16 px cover an image of any size is more than the exporter can prove
        prefer_deferred_runtime_asserts_over_guards=True,
    )


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence two messages of the exporter that do not concern the user: a deprecation inside
    torch, and operators of a torchvision that is not used.
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


def _drop_traces(graph: Any) -> None:
    """Drop stack traces, which name files of this machine."""
    for part in (*graph.node, *graph.input, *graph.output, *graph.initializer):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")
    del graph.value_info[:]
    graph.ClearField("metadata_props")
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.HasField("g"):  # the body of a loop
                _drop_traces(attribute.g)


def _name_sizes(model: Any, subject: _Subject) -> None:
    """Give the free sizes of inputs and output their names; the output has those of the image."""
    free = (*subject.free.values(), subject.free["image"])
    for value, dims in zip((*model.graph.input, *model.graph.output), free, strict=True):
        for axis, dim in dims.items():
            value.type.tensor_type.shape.dim[axis].dim_param = dim.__name__
