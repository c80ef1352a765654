"""ONNX: an `Underwater` module as one graph, checked against float64 eager, and a runner for it.

The graph takes any batch, height and width. It cannot raise: NaN stays NaN, a negative distance counts as 0, +inf is
open water; distances outside the planned range keep the nearer end's blur, as in eager mode.
"""

import importlib
import json
import logging
import os
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from uwaug.blur import BlurPlan
from uwaug.colour import linear_to_srgb, srgb_to_linear
from uwaug.formation import BlurDemand, form
from uwaug.graph import PARAMETERS, Graph, parameters_of
from uwaug.medium import FARTHEST, Medium, PointSpread, assemble
from uwaug.module import Underwater

FORMAT = 1  # of the metadata; files of another are refused
SIDES = (32, 1024)  # px: short sides that one file serves, where the width law scales with the image


def export_onnx(
    module: Underwater,
    path: str | os.PathLike[str],
    *,
    parameters: Literal["frozen", "inputs"] = "frozen",
    field: Literal["none", "input"] = "none",
    image: Literal["float32", "uint8"] = "float32",
    sides: tuple[int, int] = SIDES,
    opset: int = 18,
    verify: bool = True,
) -> Path:
    """Write a module as an ONNX file that needs no uwaug to run.

    Inputs: image (Bx3xHxW), distance (Bx1xHxW float32, m), then those asked for below. Output: as the image.

    Args:
        module: with a `distance_range`, which fixes the plan of the blur.
        path: of the file; written whole, after it has passed its check, or not at all.
        parameters: "frozen", or "inputs": rates, weights and width law become inputs of the graph, with a row for each
            image (see `uwaug.graph.parameters_of`), so that one file serves every water whose widths lie in the plan:
            export a module of all of them, `Underwater(Medium.stack(…))`.
        field: "input" adds the medium field, Bx1xHxW, as an input.
        image: "float32" (0…1, not clipped), or "uint8" in and out (0…255, rounded and clipped).
        sides: smallest and largest short side, px, that the plan serves; matters only for a width law with a reference
            size. Images outside get the nearest width of the plan.
        opset: ≥ 18.
        verify: run `check_onnx` before the file is put in place.

    Returns:
        The path.

    Raises:
        ImportError: if the onnx extra is not installed.
        OSError: if the folder is missing or cannot be written to.
        TypeError, ValueError: if an argument is not as above, or the file fails its check.
    """
    path = Path(path)
    if opset < 18:
        raise ValueError(f"opset must be ≥ 18 (scatter with addition), got {opset}")
    onnx, *_ = _require("onnx", "onnxscript", *(["onnxruntime"] if verify else []))
    graph, examples, shapes, names = _example(module, parameters, field, image, sides)
    with _part_of(path) as part:
        with torch.no_grad(), _quiet():
            program = _program(graph, examples, shapes)
            exported = torch.onnx.export(
                program, dynamo=True, input_names=names, output_names=["output"], opset_version=opset, verbose=False
            )
        assert exported is not None
        model = exported.model_proto
        _tidy(model, shapes)
        for key, value in _metadata(module, graph.plan, parameters, field, image, sides).items():
            model.metadata_props.add(key=key, value=value)
        onnx.save(model, part)
        if verify:
            check_onnx(part, module)
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(part, 0o666 & ~mask)
        os.replace(part, path)
    return path


def export_program(
    module: Underwater,
    *,
    parameters: Literal["frozen", "inputs"] = "frozen",
    field: Literal["none", "input"] = "none",
    image: Literal["float32", "uint8"] = "float32",
    sides: tuple[int, int] = SIDES,
) -> torch.export.ExportedProgram:
    """The same graph as a `torch.export` program, for `torch.export.save`; arguments as `export_onnx`."""
    graph, examples, shapes, _ = _example(module, parameters, field, image, sides)
    with torch.no_grad(), _quiet():
        return _program(graph, examples, shapes)


def _program(graph: Graph, examples: tuple[Tensor, ...], shapes: Any) -> torch.export.ExportedProgram:
    # deferred: that whole periods of 16 px cover an image of any size is more than the exporter can prove
    return torch.export.export(graph, examples, dynamic_shapes=shapes, prefer_deferred_runtime_asserts_over_guards=True)


def _require(*packages: str) -> list[Any]:
    try:
        return [importlib.import_module(name) for name in packages]
    except ImportError as error:
        raise ImportError(f'{error.name} is missing: ONNX needs pip install "uwaug[onnx]"') from error


@contextmanager
def _part_of(path: Path) -> Iterator[str]:
    """A file beside `path`, to be moved there when it is whole."""
    if path.is_dir():
        raise IsADirectoryError(f"path must be a file, but {path} is a folder")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"path: there is no folder {path.parent}")
    try:
        handle, part = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise type(error)(f"path: cannot write to the folder {path.parent}: {error.strerror}") from error
    os.close(handle)
    try:
        yield part
    finally:
        Path(part).unlink(missing_ok=True)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without what the exporter says of itself: a deprecation inside torch, and operators of a torchvision not used."""
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


def _plan(module: Underwater, sides: tuple[int, int]) -> BlurPlan:
    if module.demand is None:
        raise ValueError(
            "module has no distance_range: give Underwater(…, distance_range=(near, far)), which fixes the plan"
        )
    if module.order != "line_of_sight":
        raise ValueError(f"module.order must be 'line_of_sight' to be exported, got {module.order!r}")
    return module.demand.plan_sizes(*sides, 4 * sides[1])


def _example(
    module: Underwater, parameters: str, field: str, image: str, sides: tuple[int, int]
) -> tuple[Graph, tuple[Tensor, ...], Any, list[str]]:
    """What torch.export wants: graph module, example inputs, dynamic shapes; and the names of the inputs."""
    if not isinstance(module, Underwater):
        raise TypeError(f"module must be a uwaug.Underwater, got {type(module).__name__}")
    for name, value, allowed in (
        ("parameters", parameters, ("frozen", "inputs")),
        ("field", field, ("none", "input")),
        ("image", image, ("float32", "uint8")),
    ):
        if value not in allowed:
            raise ValueError(f"{name} must be one of {allowed}, got {value!r}")
    if not 1 <= sides[0] <= sides[1]:
        raise ValueError(f"sides must be 1 ≤ smallest ≤ largest short side in px, got {sides}")
    if parameters == "frozen" and len(module.medium) != 1:
        raise ValueError(
            f"module holds {len(module.medium)} media, of which only one can be frozen: use parameters='inputs'"
        )
    plan = _plan(module, sides)
    frozen, with_field, quantised = parameters == "frozen", field == "input", image == "uint8"
    graph = Graph(module, plan, frozen=frozen, field=with_field, quantised=quantised).eval()
    batch, height, width, rates, scatter = (
        torch.export.Dim(name, min=1) for name in ("batch", "height", "width", "rates", "scatter_rates")
    )
    pixels = {0: batch, 2: height, 3: width}
    picture = torch.rand(2, 3, 48, 56, dtype=torch.float32)
    ones = torch.ones(2, 1, 48, 56, dtype=torch.float32)
    inputs: dict[str, tuple[Tensor, Any]] = {
        "image": ((picture * 255).to(torch.uint8) if quantised else picture, pixels),
        "distance": (ones, pixels),
    }
    if with_field:
        inputs["field"] = (ones.clone(), pixels)
    if not frozen:
        for name, row in parameters_of(module.medium[0]).items():
            last = {"beta": rates, "direct_weights": rates}.get(name, scatter)
            dims = {0: batch, row.ndim - 1: last} if row.ndim > 1 else {0: batch}
            # two more rates of no weight, as an example of one rate would fix that number
            wide = pad(row, (0, 2)) if row.ndim > 1 else row
            inputs[name] = (wide.expand(2, *wide.shape[1:]).contiguous(), dims)
    examples, dynamic = (tuple(column) for column in zip(*inputs.values()))
    shapes = (*dynamic[:2], *([dynamic[2:]] if len(dynamic) > 2 else []))
    return graph, examples, shapes, list(inputs)


def _tidy(model: Any, shapes: Any) -> None:
    """Drop stack traces, which name files of this machine, and give the free sizes their names."""
    for part in (*model.graph.node, *model.graph.input, *model.graph.output, *model.graph.initializer):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")
    del model.graph.value_info[:]
    model.graph.ClearField("metadata_props")
    dynamic = (*shapes[:2], *(shapes[2] if len(shapes) > 2 else ()))
    for value, dims in zip((*model.graph.input, *model.graph.output), (*dynamic, shapes[0])):
        for axis, dim in dims.items():
            value.type.tensor_type.shape.dim[axis].dim_param = dim.__name__


def _metadata(
    module: Underwater, plan: BlurPlan, parameters: str, field: str, image: str, sides: tuple[int, int]
) -> dict[str, str]:
    from uwaug import __version__

    medium, law, demand = module.medium, module.medium.point_spread, module.demand
    assert demand is not None
    tensors = {name: t.detach().tolist() for name, t in zip(PARAMETERS, medium.tensors())}
    scale, exponent = (v.detach().tolist() if isinstance(v, Tensor) else v for v in (law.scale, law.exponent))
    rebuild = {
        "medium": tensors,
        "law": {"scale": scale, "exponent": exponent, "shape": law.shape, "reference_size": law.reference_size},
        "notes": medium.notes,
        "demand": asdict(demand),
    }
    return {
        "uwaug_format": str(FORMAT),
        "uwaug_version": __version__,
        "uwaug_water": "; ".join(medium.notes),
        "uwaug_medium": repr(medium),
        "uwaug_plan": str(plan),
        "uwaug_tolerance": repr(module.tolerance),
        "uwaug_color_space": module.color_space,
        "uwaug_parameters": parameters,
        "uwaug_field": field,
        "uwaug_image": image,
        "uwaug_sides_px": json.dumps(sides),
        "uwaug_distance_range_m": json.dumps(module.distance_range),
        "uwaug_units": "image 0…1 (float32) or 0…255 (uint8); distance in metres along the ray, +inf = open water",
        "uwaug_minimum_size": "1x1",
        "uwaug_module": json.dumps(rebuild),
    }


def read_metadata(path: str | os.PathLike[str]) -> dict[str, str]:
    """What `export_onnx` wrote into a file.

    Raises:
        OSError: if it cannot be read.
        ValueError: if the file is not from uwaug, or of another format.
    """
    found: dict[str, str] = _session(path, 1, optimise=False).get_modelmeta().custom_metadata_map
    if "uwaug_format" not in found:
        raise ValueError(f"{path}: not a file of uwaug.export_onnx, as it has no metadata of it")
    if found["uwaug_format"] != str(FORMAT):
        raise ValueError(
            f"{path}: format {found['uwaug_format']} from uwaug {found.get('uwaug_version', '?')}, "
            f"but this version reads format {FORMAT}: export it again"
        )
    return found


def read_module(path: str | os.PathLike[str]) -> Underwater:
    """The module that a file was exported from, rebuilt from its metadata; errors as `read_metadata`."""
    metadata = read_metadata(path)
    stored = json.loads(metadata["uwaug_module"])
    scale, exponent = (
        torch.tensor(v, dtype=torch.float64) if isinstance(v, list) else v
        for v in (stored["law"].pop("scale"), stored["law"].pop("exponent"))
    )
    tensors = [torch.tensor(stored["medium"][name], dtype=torch.float64) for name in PARAMETERS[:6]]
    near, far = json.loads(metadata["uwaug_distance_range_m"])
    module = Underwater(
        assemble(tensors, PointSpread(scale, exponent, **stored["law"]), tuple(stored["notes"])),
        (near, far),
        float(metadata["uwaug_tolerance"]),
        "srgb" if metadata["uwaug_color_space"] == "srgb" else "linear",
    )
    module.demand = BlurDemand(**stored["demand"])
    return module


def _session(path: str | os.PathLike[str], threads: int = 0, *, optimise: bool = True) -> Any:
    (ort,) = _require("onnxruntime")
    Path(path).open("rb").close()  # for Python's own error if there is none
    options = ort.SessionOptions()
    options.log_severity_level = 3
    options.intra_op_num_threads = threads
    level = ort.GraphOptimizationLevel
    options.graph_optimization_level = level.ORT_ENABLE_ALL if optimise else level.ORT_DISABLE_ALL
    try:
        return ort.InferenceSession(os.fspath(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its exceptions have no common base, and no place in the public interface
        raise ValueError(f"{path}: ONNX Runtime cannot load it: {str(error).splitlines()[0]}") from error


class OnnxUnderwater:
    """Run an exported file like the module that it came from.

    The session is opened at the first call and not pickled, so that the object can live in DataLoader workers.

    Args:
        path: of the file.
        threads: of ONNX Runtime; 0 lets it choose. In DataLoader workers, 1.

    Attributes:
        metadata: what the file says of itself, see `read_metadata`.

    Raises:
        ImportError, OSError, ValueError: as `read_metadata`; and if onnxruntime is not installed.
    """

    def __init__(self, path: str | os.PathLike[str], threads: int = 0) -> None:
        self.path = Path(path)
        self.threads = threads
        self.metadata = read_metadata(path)
        self._opened: Any = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_opened": None}

    def __repr__(self) -> str:
        return f"OnnxUnderwater({str(self.path)!r}: {self.metadata['uwaug_medium']})"

    def __call__(
        self, image: Tensor, distance: Tensor, field: Tensor | None = None, medium: Medium | None = None
    ) -> Tensor:
        """Degrade an image.

        Args:
            image (Bx3xHxW or 3xHxW tensor): float32 or uint8, as the file was exported.
            distance (Bx1xHxW or 1xHxW tensor): metres, ≥ 0; +inf is open water.
            field (as distance): if the file has it as an input.
            medium: if the file has its parameters as inputs; one, or one for each image.

        Raises:
            TypeError, ValueError: if an argument is not as above, lacking, or more than the file takes.
        """
        for name, value, key, wanted in (
            ("field", field, "uwaug_field", "input"),
            ("medium", medium, "uwaug_parameters", "inputs"),
        ):
            if (value is not None) != (self.metadata[key] == wanted):
                verb = "needs one" if value is None else "takes none"
                raise ValueError(f"{name}: the file {verb}, as it was exported with {key[6:]}={self.metadata[key]!r}")
        dtype = torch.uint8 if self.metadata["uwaug_image"] == "uint8" else torch.float32
        if image.dtype != dtype:
            raise TypeError(f"image must be {dtype} for this file, got {image.dtype}")
        given = {"image": image, "distance": distance, **({} if field is None else {"field": field})}
        for name, value in given.items():
            channels = 3 if name == "image" else 1
            if value.ndim not in (3, 4) or value.shape[-3] != channels or value.shape[-2:] != image.shape[-2:]:
                raise ValueError(
                    f"{name} must be (B, {channels}, H, W) or ({channels}, H, W) of one size, got "
                    f"{tuple(value.shape)} beside an image {tuple(image.shape)}"
                )
        if medium is not None:
            law = medium.point_spread
            stored = json.loads(self.metadata["uwaug_module"])["law"]
            if (law.shape, law.reference_size) != (stored["shape"], stored["reference_size"]):
                raise ValueError(
                    f"medium: its point spread is {law}, but the file is for shape {stored['shape']!r} and "
                    f"reference_size {stored['reference_size']}"
                )
        if not bool((distance >= 0).all()):
            raise ValueError("distance is NaN or negative somewhere: expected metres ≥ 0 (+inf for open water)")
        rows = {name: value if value.ndim == 4 else value[None] for name, value in given.items()}
        rows |= {} if medium is None else parameters_of(medium)
        sizes = {name: len(value) for name, value in rows.items()}
        batch = next((n for n in sizes.values() if n != 1), 1)
        if not set(sizes.values()) <= {1, batch}:
            raise ValueError(f"batch sizes must agree or be 1, got {sizes}")
        if self._opened is None:
            self._opened = _session(self.path, self.threads)
        if image.numel() == 0 or batch == 0:
            return image.new_zeros(batch, 3, *image.shape[-2:])
        # one by one: what a batch holds between two operations leaves the cache, and takes up to 1.5 times as long
        each = [{name: value[i if len(value) > 1 else 0][None] for name, value in rows.items()} for i in range(batch)]
        result = torch.cat([torch.from_numpy(_run(self._opened, row, 1)) for row in each])
        return result[0] if image.ndim == 3 and batch == 1 else result


def _run(session: Any, rows: dict[str, Tensor], batch: int) -> np.ndarray:
    feed = {
        name: value.detach().to("cpu", value.dtype if value.dtype == torch.uint8 else torch.float32)
        for name, value in rows.items()
    }
    (out,) = session.run(None, {n: v.expand(batch, *v.shape[1:]).contiguous().numpy() for n, v in feed.items()})
    result: np.ndarray = out
    return result


@dataclass(frozen=True)
class Report:
    """What `check_onnx` found: cases run, the largest difference, and where it was."""

    cases: int
    worst: float
    where: str


def check_onnx(path: str | os.PathLike[str], module: Underwater, *, tolerance: float = 1e-5) -> Report:
    """Check an exported file against the module it came from.

    `onnx.checker`, then ONNX Runtime with optimisations off and on against float64 eager with the same plan, over
    batches 1, 2, 5, odd, even, non-square, smallest and largest sizes, and constant, ramp, step, random, zero, far and
    infinite distances. A file that takes its parameters as inputs is given media of other numbers of rates, and one per
    image.

    Args:
        path: the file.
        module: what it was exported from.
        tolerance: largest difference of a float image (0…1); uint8 images may differ by one level.

    Raises:
        ImportError: if the onnx extra is not installed.
        OSError: if the file cannot be read.
        ValueError: naming the worst case, if it exceeds the tolerance; or if the module itself hardly changes a
            picture, so that a graph that returns its input would pass.
    """
    (onnx,) = _require("onnx")
    metadata = read_metadata(path)
    try:
        onnx.checker.check_model(os.fspath(path), full_check=True)
    except onnx.checker.ValidationError as error:
        raise ValueError(f"{path}: onnx.checker refuses it: {str(error).splitlines()[0]}") from error
    smallest, largest = json.loads(metadata["uwaug_sides_px"])
    plan = _plan(module, (smallest, largest))
    if metadata["uwaug_plan"] != str(plan):
        raise ValueError(
            f"{path}: made for {metadata['uwaug_plan']}, but module asks for {plan} here: it is from another module or "
            "version; export it again"
        )
    quantised, with_field = metadata["uwaug_image"] == "uint8", metadata["uwaug_field"] == "input"
    media = [module.medium[i] for i in range(len(module.medium))]
    if metadata["uwaug_parameters"] == "inputs":
        media += _strangers(module.medium)
    near, far = json.loads(metadata["uwaug_distance_range_m"])
    cases = [
        (name, (image * 255).round().to(torch.uint8) if quantised else image, distance, field if with_field else None)
        for name, image, distance, field in _cases((smallest, largest), (near, min(far, 100.0)))
    ]
    runs = [(*case, _for_batch(media, n, len(case[1]))) for n, case in enumerate(cases)]
    exact = [_eager(module, plan, *run[1:], quantised) for run in runs]
    limit = 1.0 if quantised else tolerance
    found: list[tuple[float, str]] = []
    for optimise in (False, True):
        session = _session(path, 1, optimise=optimise)
        for (name, image, distance, field, medium), wanted in zip(runs, exact):
            rows = {"image": image, "distance": distance, **({} if field is None else {"field": field})}
            rows |= parameters_of(medium) if len(media) > 1 else {}
            where = f"{name}, optimisations {'on' if optimise else 'off'}"
            try:
                out = torch.from_numpy(_run(session, rows, len(image)))
            except Exception as error:  # of ONNX Runtime, see _session
                raise ValueError(f"{path}: fails at {where}: {str(error).splitlines()[0]}") from error
            if out.shape != wanted.shape:
                raise ValueError(f"{path}: gives {tuple(out.shape)}, not {tuple(wanted.shape)}, at {where}")
            apart = float((out.double() - wanted).abs().max())
            found.append((np.inf if np.isnan(apart) else apart, where))
    worst, where = max(found)
    if worst > limit:
        raise ValueError(f"{path}: differs from float64 eager by {worst:.3g} (limit {limit:g}) at {where}")
    moved = max(float((wanted - run[1].double()).abs().max()) for run, wanted in zip(runs, exact))
    if moved <= 2 * limit:
        raise ValueError(f"module changes a picture by {moved:.2g} at most: a graph that returns its input would pass")
    return Report(len(found), worst, where)


def _cases(sides: tuple[int, int], distance_range: tuple[float, float]) -> Iterator[tuple[str, Tensor, Tensor, Tensor]]:
    """(name, image, distance, field): batches, sizes and distances on which a file is checked."""
    rng = torch.Generator().manual_seed(0)
    near, far = distance_range
    # the ends of what the plan serves, as far as they are quickly run
    small, large = (min(max(side, 8), 144) for side in sides)
    sizes = (
        (1, 1, 1),
        (2, 1, 9),
        (5, 7, 5),
        (1, small, small + 16),
        (5, small + 1, small),
        (2, 65, 33),
        (1, large, large + 1),
    )
    for batch, h, w in sizes:
        shape = (batch, 1, h, w)
        image = (1.2 * torch.rand(batch, 3, h, w, generator=rng, dtype=torch.float32) - 0.1).clamp(0, 1)
        field = 0.7 + 0.6 * torch.rand(shape, generator=rng, dtype=torch.float32)
        ramp = torch.linspace(0, 1, w, dtype=torch.float32).expand(shape)
        within = {
            "constant": torch.full_like(field, 0.3),
            "ramp": ramp,
            "step": torch.where(ramp > 0.5, 1.0, 0.0),
            "random": torch.rand(shape, generator=rng, dtype=torch.float32),
        }
        distances = {name: near + (far - near) * t for name, t in within.items()}
        distances["at the lens"] = torch.zeros_like(field)
        distances["beyond the range"] = torch.full_like(field, 3 * far)
        distances["open water behind"] = torch.where(ramp > 0.5, torch.inf, distances["ramp"])
        for name, distance in distances.items():
            yield f"{name}, {batch}×{h}×{w}", image, distance, field
    if sides[1] > large:  # the widest blurs show in the largest pictures alone: one of them, if not too large to run
        h = w = min(sides[1], 1024)
        image, t = (
            torch.rand(1, 3, h, w, generator=rng, dtype=torch.float32),
            torch.linspace(0, 1, w, dtype=torch.float32),
        )
        yield (
            f"ramp, 1×{h}×{w}",
            image,
            (near + (far - near) * t).expand(1, 1, h, w),
            torch.ones(1, 1, h, w, dtype=torch.float32),
        )


def _strangers(medium: Medium) -> list[Medium]:
    """Media of one and of five rates, with other width laws, all of the kind that a file with `medium` takes."""
    law = medium.point_spread

    def stranger(k: int, scale: float, exponent: float) -> Medium:
        rates = torch.linspace(0.1, 1.0, k, dtype=torch.float64)[None]
        weights = torch.linspace(0.6, 1.0, 3, dtype=torch.float64)[None, :, None].expand(1, 3, k) / k
        tensors = (rates, weights, 0.4 * rates, weights, 0.3 * weights, rates.new_tensor([0.7]))
        return assemble(tensors, PointSpread(scale, exponent, law.shape, law.reference_size), ("check",))

    return [stranger(1, 1.5, 1.0), stranger(5, 2.5, 0.6)]


def _for_batch(media: list[Medium], number: int, batch: int) -> Medium:
    """The medium of a case: all media in turn, one for each image of a batch."""
    if len(media) == 1:
        return media[0]
    return Medium.stack([media[(number + i) % len(media)] for i in range(batch)])


def _eager(
    module: Underwater,
    plan: BlurPlan,
    image: Tensor,
    distance: Tensor,
    field: Tensor | None,
    medium: Medium,
    quantised: bool,
) -> Tensor:
    """The reference: float64 eager with the plan of the file."""
    j = image.double() / 255 if quantised else image.double()
    z = distance.double().clamp(0, FARTHEST)
    z = z if field is None else z * field.double()
    srgb = module.color_space == "srgb"
    with torch.no_grad():
        (result,) = form(
            srgb_to_linear(j) if srgb else j,
            z,
            medium.to(torch.float64),
            "line_of_sight",
            module.tolerance,
            plan,
            total=True,
        )
        result = linear_to_srgb(result) if srgb else result
    return (result * 255).round().clamp(0, 255) if quantised else result
