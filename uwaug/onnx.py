"""ONNX: an `Underwater` module as one graph, checked against float64 eager, and a runner for it.

The graph takes any batch, height and width. It cannot raise: NaN stays NaN, a negative distance counts as 0, +inf is
open water; distances outside the planned range keep the nearer end's blur, as in eager mode.
"""

import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor, nn

from uwaug.blur import BlurPlan, blurred
from uwaug.colour import linear_to_srgb, srgb_to_linear
from uwaug.formation import combine, form
from uwaug.medium import FARTHEST, Medium, PointSpread, assemble
from uwaug.module import Underwater

FORMAT = 1  # of the metadata; files of another are refused
SIDES = (32, 1024)  # px: short sides that one file serves, where the width law scales with the image
_PARAMETERS = ("beta", "direct_weights", "G", "signal_weights", "veil_weights", "b_mean", "scale", "exponent")


def _require(*packages: str) -> Any:
    import importlib

    try:
        return [importlib.import_module(name) for name in packages]
    except ImportError as error:
        raise ImportError(f'{error.name} is missing: ONNX needs pip install "uwaug[onnx]"') from error


class _Graph(nn.Module):
    """The module as a function of tensors alone, for tracing."""

    def __init__(self, module: Underwater, plan: BlurPlan, frozen: bool, field: bool, quantised: bool) -> None:
        super().__init__()
        self.plan, self.frozen, self.field, self.quantised = plan, frozen, field, quantised
        self.srgb = module.color_space == "srgb"
        medium = module.medium.to(torch.float32)
        self.law = medium.point_spread
        for name, value in parameters_of(medium).items():
            self.register_buffer(name, value)

    def forward(self, image: Tensor, distance: Tensor, *rest: Tensor) -> Tensor:
        inputs = list(rest)
        z = distance.clamp(0.0, FARTHEST)
        if self.field:
            z = z * inputs.pop(0)
        values = [self.get_buffer(name) for name in _PARAMETERS] if self.frozen else inputs
        *tensors, scale, exponent = values
        if self.frozen and not isinstance(self.law.exponent, Tensor):
            law = self.law  # a known exponent makes a simpler graph
        else:
            law = PointSpread(scale, exponent, self.law.shape, self.law.reference_size)
        medium = assemble(tensors, law, ())
        j = image.to(torch.float32) / 255 if self.quantised else image
        j = srgb_to_linear(j) if self.srgb else j
        size = (image.shape[-2], image.shape[-1])
        (result,) = combine(j, z, medium, blurred(j, self.plan), self.plan, size, "line_of_sight", True)
        result = linear_to_srgb(result) if self.srgb else result
        return torch.round(result * 255).clamp(0.0, 255.0).to(torch.uint8) if self.quantised else result


def parameters_of(medium: Medium) -> dict[str, Tensor]:
    """What a file exported with `parameters="inputs"` takes, by name; each with a row for every image of the batch.

    Shapes: beta (B, K), direct_weights (B, 3, K), G (B, L), signal_weights and veil_weights (B, 3, L), b_mean, scale
        and
    exponent (B,).
    """
    law = medium.point_spread
    rows = [torch.as_tensor(v, dtype=medium.beta.dtype).expand(len(medium)).clone() for v in (law.scale, law.exponent)]
    return dict(zip(_PARAMETERS, (*medium.tensors(), *rows)))


def _plan(module: Underwater, sides: tuple[int, int]) -> BlurPlan:
    if module.demand is None:
        raise ValueError(
            "module has no distance_range: give Underwater(distance_range=(near, far)), which fixes the plan"
        )
    if module.order != "line_of_sight":
        raise ValueError(f"module.order must be 'line_of_sight' to be exported, got {module.order!r}")
    return module.demand.plan_sizes(*sides, 4 * sides[1])


def _traced(
    module: Underwater, frozen: bool, field: bool, quantised: bool, sides: tuple[int, int]
) -> tuple[_Graph, tuple[Tensor, ...], tuple[Any, ...], list[str]]:
    """Graph module, example inputs, dynamic shapes and input names."""
    graph = _Graph(module, _plan(module, sides), frozen, field, quantised).eval()
    height, width = 48, 56
    image = torch.rand(2, 3, height, width)
    examples = [(image * 255).to(torch.uint8) if quantised else image, torch.rand(2, 1, height, width) + 1]
    if field:
        examples.append(torch.ones(2, 1, height, width))
    names = ["image", "distance", *(["field"] if field else [])]
    batch, rows, columns = (torch.export.Dim(name, min=1) for name in ("batch", "height", "width"))
    rates, scatter = torch.export.Dim("rates", min=1), torch.export.Dim("scatter_rates", min=1)
    pixels: list[Any] = [{0: batch, 2: rows, 3: columns} for _ in examples]
    if not frozen:
        medium = module.medium.to(torch.float32)
        examples += [_widen(v.expand(2, *v.shape[1:]), name) for name, v in parameters_of(medium[0]).items()]
        names += _PARAMETERS
        for name in _PARAMETERS:
            last = {
                "beta": rates,
                "direct_weights": rates,
                "G": scatter,
                "signal_weights": scatter,
                "veil_weights": scatter,
            }
            dims: dict[int, Any] = {0: batch}
            if name in last:
                dims[2 if "weights" in name else 1] = last[name]
            pixels.append(dims)
    shapes = (*pixels[:2], *([tuple(pixels[2:])] if pixels[2:] else []))
    return graph, tuple(e.contiguous() for e in examples), shapes, names


def _widen(value: Tensor, name: str) -> Tensor:
    """Two more rates of no weight: an example that happened to have one rate would fix that number."""
    return value if name in ("b_mean", "scale", "exponent") else torch.nn.functional.pad(value, (0, 2))


def export_program(
    module: Underwater,
    *,
    parameters: Literal["frozen", "inputs"] = "frozen",
    field: Literal["none", "input"] = "none",
    image: Literal["float32", "uint8"] = "float32",
    sides: tuple[int, int] = SIDES,
) -> torch.export.ExportedProgram:
    """The same graph as a `torch.export` program, for `torch.export.save`; arguments as `export_onnx`."""
    frozen, with_field, quantised = _options(parameters, field, image, sides)
    graph, examples, shapes, _ = _traced(module, frozen, with_field, quantised, sides)
    with torch.no_grad():
        return torch.export.export(graph, examples, dynamic_shapes=shapes)


def _options(parameters: str, field: str, image: str, sides: tuple[int, int]) -> tuple[bool, bool, bool]:
    for name, value, allowed in (
        ("parameters", parameters, ("frozen", "inputs")),
        ("field", field, ("none", "input")),
        ("image", image, ("float32", "uint8")),
    ):
        if value not in allowed:
            raise ValueError(f"{name} must be one of {allowed}, got {value!r}")
    if not 1 <= sides[0] <= sides[1]:
        raise ValueError(f"sides must be 1 ≤ smallest ≤ largest short side in px, got {sides}")
    return parameters == "frozen", field == "input", image == "uint8"


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

    Args:
        module: with a `distance_range`, which fixes the plan of the blur.
        path: of the file; written whole, after it has passed its check, or not at all.
        parameters: "frozen", or "inputs": rates, weights and width law become inputs of the graph (see
            `parameters_of`), so that one file serves every water whose widths lie in the plan.
        field: "input" adds the medium field as an input.
        image: "float32" (0…1, not clipped), or "uint8" in and out (0…255, rounded and clipped).
        sides: smallest and largest short side, px, that the plan serves; matters only for a width law with a reference
            size.
        opset: ≥ 18.
        verify: run `check_onnx` before the file is put in place.

    Returns:
        The path.

    Raises:
        ImportError: if the onnx extra is not installed.
        ValueError: if the module has no distance range, or the file fails its check.
    """
    frozen, with_field, quantised = _options(parameters, field, image, sides)
    if opset < 18:
        raise ValueError(f"opset must be ≥ 18 (scatter with addition), got {opset}")
    (onnx,) = _require("onnx", "onnxscript")[:1]
    graph, examples, shapes, names = _traced(module, frozen, with_field, quantised, sides)
    with torch.no_grad():
        program = torch.onnx.export(
            graph,
            examples,
            dynamo=True,
            dynamic_shapes=shapes,
            input_names=names,
            output_names=["output"],
            opset_version=opset,
            custom_translation_table=_translations(),
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    for key, value in _metadata(module, graph.plan, parameters, field, image, sides).items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    path = Path(path)
    handle, part = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    os.close(handle)
    try:
        onnx.save(model, part)
        if verify:
            check_onnx(part, module)
        os.chmod(part, 0o666 & ~_umask())
        os.replace(part, path)
    finally:
        Path(part).unlink(missing_ok=True)
    return path


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _translations() -> dict[Any, Any]:
    """ONNX has no exp2: e^(x·ln 2) instead of a power, which is twenty times as slow in ONNX Runtime."""
    from onnxscript import opset18 as op

    def exp2(self: Any) -> Any:
        return op.Exp(op.Mul(self, op.CastLike(op.Constant(value_float=0.6931471805599453), self)))

    return {torch.ops.aten.exp2.default: exp2}


def _metadata(
    module: Underwater, plan: BlurPlan, parameters: str, field: str, image: str, sides: tuple[int, int]
) -> dict[str, str]:
    from uwaug import __version__

    assert module.distance_range is not None
    near, far = module.distance_range
    return {
        "uwaug_format": str(FORMAT),
        "uwaug_version": __version__,
        "uwaug_medium": repr(module.medium),
        "uwaug_plan": str(plan),
        "uwaug_tolerance": repr(module.tolerance),
        "uwaug_color_space": module.color_space,
        "uwaug_parameters": parameters,
        "uwaug_field": field,
        "uwaug_image": image,
        "uwaug_sides_px": json.dumps(sides),
        "uwaug_distance_range_m": json.dumps([near, far]),
        "uwaug_units": "image 0…1 (float32) or 0…255 (uint8); distance in metres along the ray, +inf = open water",
        "uwaug_minimum_size": "1x1",
    }


def _session(path: str | os.PathLike[str], threads: int = 0, optimise: bool = True) -> Any:
    (ort,) = _require("onnxruntime")
    options = ort.SessionOptions()
    options.log_severity_level = 3
    options.intra_op_num_threads = threads
    level = ort.GraphOptimizationLevel
    options.graph_optimization_level = level.ORT_ENABLE_ALL if optimise else level.ORT_DISABLE_ALL
    return ort.InferenceSession(os.fspath(path), options, providers=["CPUExecutionProvider"])


def read_metadata(path: str | os.PathLike[str]) -> dict[str, str]:
    """What `export_onnx` wrote into a file.

    Raises:
        ValueError: if the file is not from uwaug, or of another format.
    """
    (onnx,) = _require("onnx")
    model = onnx.load(os.fspath(path), load_external_data=False)
    found = {p.key: p.value for p in model.metadata_props}
    if "uwaug_format" not in found:
        raise ValueError(f"{path}: not a file of uwaug.export_onnx (no metadata)")
    if found["uwaug_format"] != str(FORMAT):
        raise ValueError(
            f"{path}: format {found['uwaug_format']} from uwaug {found.get('uwaug_version', '?')}, "
            f"but this version reads format {FORMAT}: export it again"
        )
    return found


class OnnxUnderwater:
    """Run an exported file like the module that it came from.

    The session is opened at the first call and not pickled, so that the object can live in DataLoader workers.

    Args:
        path: of the file.
        threads: of ONNX Runtime; 0 lets it choose.

    Examples: see the README.
    """

    def __init__(self, path: str | os.PathLike[str], threads: int = 0) -> None:
        self.path = Path(path)
        self.threads = threads
        self.metadata = read_metadata(path)
        self._opened: Any = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_opened": None}

    def __call__(
        self, image: Tensor, distance: Tensor, field: Tensor | None = None, medium: Medium | None = None
    ) -> Tensor:
        """Degrade an image; shapes as `uwaug.Underwater`, and a medium where the file takes parameters as inputs."""
        wants_field, wants_medium = (
            self.metadata["uwaug_field"] == "input",
            self.metadata["uwaug_parameters"] == "inputs",
        )
        if (field is not None) != wants_field:
            raise ValueError(f"field: the file was exported {'with' if wants_field else 'without'} one")
        if (medium is not None) != wants_medium:
            raise ValueError(f"medium: the file was exported with parameters='{self.metadata['uwaug_parameters']}'")
        wanted = torch.uint8 if self.metadata["uwaug_image"] == "uint8" else torch.float32
        if image.dtype != wanted:
            raise TypeError(f"image must be {wanted} for this file, got {image.dtype}")
        if image.ndim not in (3, 4) or distance.shape[-2:] != image.shape[-2:]:
            raise ValueError(f"image {tuple(image.shape)} and distance {tuple(distance.shape)} do not fit together")
        batched = [t if t.ndim == 4 else t[None] for t in (image, distance, *([field] if field is not None else []))]
        b = max(len(t) for t in batched)
        feed = {name: _array(t, b) for name, t in zip(("image", "distance", "field"), batched)}
        if medium is not None:
            feed |= {name: _array(value, b) for name, value in parameters_of(medium).items()}
        if self._opened is None:
            self._opened = _session(self.path, self.threads)
        (out,) = self._opened.run(None, feed)
        result = torch.from_numpy(out)
        return result[0] if image.ndim == 3 else result


def _array(value: Tensor, batch: int) -> np.ndarray:
    dtype = value.dtype if value.dtype == torch.uint8 else torch.float32
    array: np.ndarray = value.detach().to("cpu", dtype).expand(batch, *value.shape[1:]).contiguous().numpy()
    return array


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


def _cases(sides: tuple[int, int], distance_range: tuple[float, float]) -> Iterator[tuple[str, Tensor, Tensor, Tensor]]:
    """(description, image, distance, field): batches, sizes and distances on which a file is checked."""
    rng = torch.Generator().manual_seed(0)
    near, far = distance_range
    far = min(far, 100.0)
    for batch, (h, w) in (
        (1, (1, 1)),
        (2, (1, 9)),
        (5, (7, 5)),
        (1, (32, 48)),
        (2, (65, 33)),
        (1, (128, 129)),
        (5, (40, 40)),
    ):
        image = torch.rand(batch, 3, h, w, generator=rng)
        ramp = torch.linspace(0, 1, w).expand(batch, 1, h, w)
        kinds = {
            "constant": torch.full((batch, 1, h, w), 0.3),
            "ramp": ramp,
            "step": (ramp > 0.5).float(),
            "random": torch.rand(batch, 1, h, w, generator=rng),
        }
        distances = {name: near + (far - near) * t for name, t in kinds.items()}
        distances |= {"z = 0": torch.zeros(batch, 1, h, w), "beyond": torch.full((batch, 1, h, w), 3 * far)}
        distances["open water"] = torch.full((batch, 1, h, w), torch.inf)
        for name, distance in distances.items():
            field = 0.7 + 0.6 * torch.rand(batch, 1, h, w, generator=rng)
            yield f"{name}, {batch}×{h}×{w}", image, distance, field
    del sides


def check_onnx(path: str | os.PathLike[str], module: Underwater, *, tolerance: float = 1e-5) -> Mapping[str, Any]:
    """Check an exported file against the module it came from.

    `onnx.checker`, then ONNX Runtime with optimisations off and on against float64 eager with the same plan, over
    batches 1, 2, 5, odd, even, non-square and smallest sizes, and constant, ramp, step, random, zero, far and infinite
    distances.

    Args:
        path: the file.
        module: what it was exported from.
        tolerance: largest difference of a float image (0…1); uint8 images may differ by one level.

    Returns:
        {"cases": number, "worst": largest difference, "case": where}.

    Raises:
        ValueError: naming the worst case, if it exceeds the tolerance, or if the graph returns its input.
    """
    (onnx,) = _require("onnx", "onnxruntime")[:1]
    metadata = read_metadata(path)
    onnx.checker.check_model(onnx.load(os.fspath(path)), full_check=True)
    sides = tuple(json.loads(metadata["uwaug_sides_px"]))
    plan = _plan(module, (sides[0], sides[1]))
    quantised = metadata["uwaug_image"] == "uint8"
    medium = module.medium
    near, far = json.loads(metadata["uwaug_distance_range_m"])
    limit = 1.0 if quantised else tolerance
    worst, where, count, moved = -1.0, "", 0, 0.0
    for optimise in (False, True):
        session = _session(path, 1, optimise)
        for case, picture, distance, field in _cases((sides[0], sides[1]), (near, far)):
            image = (picture * 255).round().to(torch.uint8) if quantised else picture
            b = len(image)
            used = field if metadata["uwaug_field"] == "input" else None
            feed = {"image": _array(image, b), "distance": _array(distance, b)}
            if used is not None:
                feed["field"] = _array(used, b)
            if metadata["uwaug_parameters"] == "inputs":
                feed |= {name: _array(value, b) for name, value in parameters_of(medium[0]).items()}
            (out,) = session.run(None, feed)
            exact = _eager(module, plan, image, distance, used, medium, quantised)
            error = float((torch.from_numpy(out).double() - exact).abs().max())
            moved = max(moved, float((exact - image.double()).abs().max()))
            if not error <= worst:
                worst, where = error, f"{case}, optimisations {'on' if optimise else 'off'}"
            count += 1
            if np.isnan(error):
                raise ValueError(f"{path}: the graph returns NaN at {where}")
    if not worst <= limit:
        raise ValueError(f"{path}: differs from float64 eager by {worst:.3g} (limit {limit:g}) at {where}")
    if moved == 0:
        raise ValueError(f"{path}: the module returns every image unchanged: nothing to check")
    return {"cases": count, "worst": worst, "case": where}
