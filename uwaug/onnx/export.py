"""From module to file."""

import logging
import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from uwaug._support.atomic import written_whole
from uwaug._support.extras import require
from uwaug.blur.kernels import PERIOD
from uwaug.formation.underwater import Underwater
from uwaug.onnx.check import check_onnx
from uwaug.onnx.graph import Graph, Options, parameters_of
from uwaug.onnx.metadata import written
from uwaug.onnx.scan import STRIP, join


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
        progress: is told what is being done, a few words at each step; such as `print`, as a file
            takes about a minute.

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
    tell = progress or (lambda _: None)
    tell("tracing")
    graph = Graph(module, Options(parameters, field, image)).eval()
    with written_whole(path) as part:
        model = _model(graph, opset, tell)
        for key, value in written(module, graph.plan, graph.options).items():
            model.metadata_props.add(key=key, value=value)
        onnx.save(model, part)
        if verify:
            try:
                check_onnx(part, module, progress=tell)
            except ValueError as error:
                # nobody will ever see the part
                raise ValueError(str(error).replace(str(part), str(path))) from error
    return path


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
    graph = Graph(module, Options(parameters, field, image)).eval()
    return _program(graph, _examples(graph, _Sizes()))


class _Example(NamedTuple):
    """An input for a trace, and the names of its free sizes, by axis."""

    value: Tensor
    free: dict[int, Any]


class _Sizes:
    """The free sizes of a trace."""

    def __init__(self, prefix: str = "") -> None:
        def size(name: str) -> Any:
            return torch.export.Dim(prefix + name, min=1)

        self.batch, self.height, self.width = size("batch"), size("height"), size("width")
        # in periods, of a whole picture and of a strip
        self.down, self.across, self.periods = size("down"), size("across"), size("periods")
        self.rates, self.scatter_rates = size("rates"), size("scatter_rates")
        self.all_rates = size("all_rates")
        self.picture = {0: self.batch, 2: self.height, 3: self.width}


def _examples(graph: Graph, sizes: _Sizes) -> dict[str, _Example]:
    """What a graph takes, by name."""
    # no multiple of a period, which torch.export would take for the rule; nor is a 1 free
    image = torch.rand(2, 3, 41, 57, dtype=torch.float32)
    metres = torch.ones_like(image[:, :1])
    if graph.options.image == "uint8":
        image = (image * 255).to(torch.uint8)
    pictures = {name: metres for name in ("distance", "field") if name in graph.inputs}
    pictures = {"image": image, **pictures}
    examples = {name: _Example(x, sizes.picture) for name, x in pictures.items()}
    for name, row in parameters_of(graph.medium[0]).items() if not graph.frozen else ():
        # two more rates of no weight, as an example of one rate would fix that number
        row, free = pad(row, (0, 2)) if row.ndim > 1 else row, {0: sizes.batch}
        if row.ndim > 1:
            direct = name in ("beta", "direct_weights")
            free[row.ndim - 1] = sizes.rates if direct else sizes.scatter_rates
        examples[name] = _Example(row.expand(2, *row.shape[1:]).contiguous(), free)
    return examples


class _Parts(nn.Module):
    """Both parts of a graph side by side, for a single trace."""

    def __init__(self, graph: Graph, names: list[str]) -> None:
        super().__init__()
        self.parent, self.names = graph, names

    def forward(self, *values: Tensor) -> tuple[Tensor, ...]:
        by_name = dict(zip(self.names, values, strict=True))
        own = {name.removeprefix(STRIP): x for name, x in by_name.items() if name.startswith(STRIP)}
        before = self.parent.before(by_name, by_name["down"], by_name["across"])
        return (*before.values(), self.parent.strip(own, own["rows"], own["across"]))


def _parts(graph: Graph) -> tuple[dict[str, _Example], list[str]]:
    """What both parts of a graph take, each of sizes of its own; names of what the first gives."""
    sizes = _Sizes()
    examples = _examples(graph, sizes)
    down, across = torch.arange(3 * PERIOD), torch.arange(4 * PERIOD)
    examples["down"] = _Example(down, {0: PERIOD * sizes.down})
    examples["across"] = _Example(across, {0: PERIOD * sizes.across})
    with torch.no_grad():
        prepared = graph.before({name: x.value for name, x in examples.items()}, down, across)
    sizes = _Sizes(STRIP)
    strip = {name: x for name, x in _examples(graph, sizes).items() if name in graph.parameters_in}
    strip["rows"] = _Example(down[: 2 * PERIOD], {0: PERIOD * sizes.periods})
    strip["across"] = _Example(across, {0: PERIOD * sizes.across})
    free: dict[str, dict[int, Any]] = {
        "light": sizes.picture,
        "z": sizes.picture,
        "columns": {0: sizes.width + len(prepared["columns"]) - 57},
        "brightest": {0: sizes.batch},
        "black": {0: sizes.batch},
        "rates": {0: sizes.batch, 1: sizes.all_rates},
        "weights": {0: sizes.batch} if graph.frozen else {0: sizes.batch, 2: sizes.all_rates},
    }
    for name, value in prepared.items():
        if name not in free:
            height = graph.blurs.height(name, sizes.height, sizes.down)
            free[name] = {**sizes.picture, 2: height}
        strip[name] = _Example(value, free[name])
    examples |= {STRIP + name: example for name, example in strip.items()}
    return examples, list(prepared)


def _program(graph: nn.Module, examples: dict[str, _Example]) -> torch.export.ExportedProgram:
    with torch.no_grad(), _quiet():
        program = torch.export.export(
            graph,
            # to torch.export, one tensor given twice is one input
            tuple(example.value.clone() for example in examples.values()),
            dynamic_shapes=(tuple(example.free for example in examples.values()),),
            strict=False,
            # that whole periods of 16 px cover an image of any size is more than the exporter can
            # prove
            prefer_deferred_runtime_asserts_over_guards=True,
        )
    # It asserts that sizes are apart where they are in the example, such as width and whole
    # periods, or 1 and the number of these. What is computed holds where they are equal, too. The
    # ONNX exporter drops assertions as well, but only after it has traced their arithmetic again.
    for node in list(program.graph.nodes):
        if node.target is torch.ops.aten._assert_scalar.default:
            program.graph.erase_node(node)
    program.graph.eliminate_dead_code()
    program.graph_module.recompile()
    return program


def _model(graph: Graph, opset: int, tell: Callable[[str], None]) -> Any:
    """A graph as an ONNX model."""
    examples, prepared = _parts(graph) if graph.in_strips else (_examples(graph, _Sizes()), [])
    program = _program(_Parts(graph, list(examples)) if prepared else graph, examples)
    tell("translating and optimising")
    with torch.no_grad(), _quiet():
        exported = torch.onnx.export(
            program,
            dynamo=True,
            input_names=list(examples),
            output_names=[*prepared, "output"],
            opset_version=opset,
            verbose=False,
        )
    assert exported is not None
    model = exported.model_proto
    written = {entry.domain: entry.version for entry in model.opset_import}[""]
    if written != opset:
        # it says so in its log alone
        raise ValueError(f"opset {opset}: the installed exporter can write up to {written} here")
    if prepared:
        join(model, prepared)
    _drop_traces(model.graph)
    # free sizes have names; the output has those of the image
    for value in (*model.graph.input, *model.graph.output):
        dims = value.type.tensor_type.shape.dim
        for axis, size in examples["image" if value.name == "output" else value.name].free.items():
            dims[axis].dim_param = size.__name__
    return model


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
