"""What other runtimes and copies make of an exported file: the largest difference from PyTorch, in
four photographs of 240×320 px on tilted planes, by daylight and by a lamp.
"""

from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from onnxruntime.quantization import CalibrationDataReader, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process
from onnxruntime.tools.symbolic_shape_infer import SymbolicShapeInference
from onnxruntime.transformers.float16 import DEFAULT_OP_BLOCK_LIST, convert_float_to_float16
from skimage import data
from skimage.transform import resize

import uwaug
from benchmarks.harness import command, save
from uwaug.onnx import export_onnx

SIZE = (240, 320)  # px
PHOTOGRAPHS = ("astronaut", "chelsea", "coffee", "rocket")
Feeds = list[dict[str, np.ndarray[Any, Any]]]


def feeds_of(count: int) -> Feeds:
    """Inputs of the first photographs, .7 to 5.9 m away."""
    rows = np.linspace(5.0, 0.7, SIZE[0], dtype=np.float32)
    feeds = []
    for number, name in enumerate(PHOTOGRAPHS[:count]):
        picture = resize(getattr(data, name)(), SIZE, anti_aliasing=True).astype(np.float32)
        distance = np.repeat(rows[:, None], SIZE[1], 1) + np.float32(0.3 * number)
        feeds.append({"image": picture.transpose(2, 0, 1)[None], "distance": distance[None, None]})
    return feeds


def modules() -> dict[str, uwaug.Underwater]:
    """Preset `calibrated` in 7C, by daylight and by a lamp beside the camera."""
    module = uwaug.load_preset("calibrated", water="7C").module(sides=(96, 480))
    lamp = uwaug.Lamp((0.3, -0.2, 0.0), power=40.0, cone=60.0)
    lit = uwaug.Underwater(
        module.medium, module.distance_range, sides=(96, 480), light=uwaug.Light([lamp])
    )
    return {"daylight": module, "a lamp": lit}


class Photographs(CalibrationDataReader):  # type: ignore[misc]
    """The same pictures, by which ranges of 8 bits are chosen."""

    def __init__(self, feeds: Feeds) -> None:
        self.feeds: Iterator[Any] = iter(feeds)

    def get_next(self) -> Any:
        """The next inputs, or None."""
        return next(self.feeds, None)


def copies(path: Path, feeds: Feeds) -> Iterator[tuple[str, Path]]:
    """The file, and what ONNX Runtime's tools make of it."""
    model = onnx.load(path)
    inferred, prepared, small = (path.with_name(f"{name}.onnx") for name in ("shapes", "pre", "8"))
    yield "as it is", path
    onnx.save(SymbolicShapeInference.infer_shapes(model, auto_merge=True), inferred)
    yield "symbolic_shape_infer", inferred
    quant_pre_process(path, prepared)
    yield "quant_pre_process", prepared
    for name, kinds in (("quantize_static", None), ("quantize_static, Conv alone", ["Conv"])):
        quantize_static(prepared, small, Photographs(feeds), op_types_to_quantize=kinds)
        yield name, small
    kept = [*DEFAULT_OP_BLOCK_LIST, "ScatterElements"]
    onnx.save(convert_float_to_float16(model, keep_io_types=True, op_block_list=kept), small)
    yield "convert_float_to_float16", small


def by_onnxruntime(path: Path) -> Callable[[Any], Any]:
    """A file in ONNX Runtime."""
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    return lambda feed: session.run(None, feed)[0]


def by_openvino(path: Path) -> Callable[[Any], Any]:
    """A file in OpenVINO, in single precision."""
    hint = {"INFERENCE_PRECISION_HINT": "f32"}
    model = import_module("openvino").Core().compile_model(path, "CPU", hint)
    return lambda feed: model([*feed.values()])[0]


def main(quick: bool = False) -> None:
    """Export, run, compare, print and save."""
    feeds, rows = feeds_of(1 if quick else len(PHOTOGRAPHS)), []
    for light, module in modules().items():
        exact = [module(*map(torch.from_numpy, feed.values())).numpy() for feed in feeds]
        with TemporaryDirectory() as folder:
            path = export_onnx(module, Path(folder) / "file.onnx")
            runs = ((name, by_onnxruntime(copy)) for name, copy in copies(path, feeds))
            for name, run in (*runs, *_openvino(path)):
                off = _difference(run, feeds, exact)
                print(f"{light}, {name}: {off if off is None else f'{off:.2g}'}", flush=True)
                rows.append({"light": light, "run": name, "off": off})
        if quick:
            return
    save("runtimes", {"rows": rows})


def _difference(run: Callable[[Any], Any], feeds: Feeds, exact: list[Any]) -> float | None:
    """The largest of all pictures; None where the copy stops."""
    try:
        pairs = zip(map(run, feeds), exact, strict=True)
        return max(float(np.abs(result - x).max()) for result, x in pairs)
    except onnxruntime.capi.onnxruntime_pybind11_state.Fail as error:
        print(f"stops: {error}")
        return None


def _openvino(path: Path) -> list[tuple[str, Callable[[Any], Any]]]:
    try:
        return [(f"OpenVINO {import_module('openvino').__version__}", by_openvino(path))]
    except ModuleNotFoundError:
        print("OpenVINO is not installed")
        return []


if __name__ == "__main__":
    command(main, __doc__)
