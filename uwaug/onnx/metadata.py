"""What an exported file says of itself, and the module that it came from."""

import json
import os
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any, Literal

import torch
from torch import Tensor

from uwaug import checks
from uwaug.blur.demand import BlurDemand
from uwaug.blur.plan import BlurPlan
from uwaug.module import Underwater
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.session import Session

__all__ = ["FORMAT", "Options", "plan_of", "read_metadata", "read_module"]

FORMAT = 2
"""Of the metadata; files of another are refused."""

SIDES = (32, 1024)
"""px: short sides that one file serves, where the width law scales with the image."""


_UNITS = "image 0…1 (float32) or 0…255 (uint8); distance in metres along the ray, +inf = open water"


@dataclass(frozen=True)
class Options:
    """What a file is exported for; see `uwaug.export_onnx`."""

    parameters: Literal["frozen", "inputs"] = "frozen"
    field: Literal["none", "input"] = "none"
    image: Literal["float32", "uint8"] = "float32"
    sides: tuple[int, int] = SIDES

    def __post_init__(self) -> None:
        checks.one_of("parameters", self.parameters, ("frozen", "inputs"))
        checks.one_of("field", self.field, ("none", "input"))
        checks.one_of("image", self.image, ("float32", "uint8"))
        if not 1 <= self.sides[0] <= self.sides[1]:
            raise ValueError(
                f"sides must be 1 ≤ smallest ≤ largest short side in px, got {self.sides}"
            )

    @staticmethod
    def of(metadata: dict[str, str]) -> "Options":
        """Those of a file."""
        smallest, largest = json.loads(metadata["uwaug_sides_px"])
        parameters, field, image = (
            metadata[f"uwaug_{name}"] for name in ("parameters", "field", "image")
        )
        return Options(parameters, field, image, (smallest, largest))  # type: ignore[arg-type]


def plan_of(module: Underwater, options: Options) -> BlurPlan:
    """The plan of a module's file: one for all sizes."""
    if module.demand is None:
        cure = "give Underwater(…, distance_range=(near, far)), which fixes the plan"
        raise ValueError(f"module has no distance_range: {cure}")
    if module.order != "line_of_sight":
        raise ValueError(
            f"module.order must be 'line_of_sight' to be exported, got {module.order!r}"
        )
    return module.demand.plan_all(options.sides)


def written(module: Underwater, plan: BlurPlan, options: Options) -> dict[str, str]:
    """The metadata of a module's file."""
    medium, law, demand = module.medium, module.medium.point_spread, module.demand
    assert demand is not None
    tensors: dict[str, Any] = {
        name: value.detach().tolist() for name, value in medium.parameters().items()
    }
    for name, value in law.numbers().items():
        if not isinstance(value, Tensor):
            tensors[name] = value
    rebuild = {
        "medium": tensors,
        "law": {"shape": law.shape, "reference_size": law.reference_size},
        "notes": medium.notes,
        "demand": asdict(demand),
        "plan": asdict(plan),
    }
    return {
        "uwaug_format": str(FORMAT),
        "uwaug_version": version("uwaug"),
        "uwaug_water": "; ".join(medium.notes),
        "uwaug_medium": repr(medium),
        "uwaug_plan": str(plan),
        "uwaug_tolerance": repr(module.tolerance),
        "uwaug_color_space": module.color_space,
        "uwaug_exposure": json.dumps(module.exposure),
        "uwaug_parameters": options.parameters,
        "uwaug_field": options.field,
        "uwaug_image": options.image,
        "uwaug_sides_px": json.dumps(options.sides),
        "uwaug_distance_range_m": json.dumps(module.distance_range),
        "uwaug_units": _UNITS,
        "uwaug_minimum_size": "1x1",
        "uwaug_module": json.dumps(rebuild),
    }


def read_metadata(path: str | os.PathLike[str]) -> dict[str, str]:
    """What `export_onnx` wrote into a file.

    Raises:
        ImportError: if onnxruntime is not installed.
        OSError: if the file cannot be read.
        ValueError: if it is not from uwaug, or of another format.
    """
    found: dict[str, str] = (
        Session(path, 1, optimise=False).opened.get_modelmeta().custom_metadata_map
    )
    if "uwaug_format" not in found:
        raise ValueError(f"{path}: not a file of uwaug.export_onnx, as it has no metadata of it")
    if found["uwaug_format"] != str(FORMAT):
        raise ValueError(
            f"{path}: format {found['uwaug_format']} from uwaug {found.get('uwaug_version', '?')}, "
            f"but this version reads format {FORMAT}: export it again"
        )
    return found


def read_module(path: str | os.PathLike[str]) -> Underwater:
    """The module that a file was exported from, rebuilt from its metadata; errors as
    `read_metadata`.
    """
    metadata = read_metadata(path)
    stored = json.loads(metadata["uwaug_module"])
    values: dict[str, Any] = {
        name: value if isinstance(value, float) else torch.tensor(value, dtype=torch.float64)
        for name, value in stored["medium"].items()
    }
    numbers = {name: values.pop(name) for name in PointSpread.NUMBERS}
    law = PointSpread(**numbers, **stored["law"])
    near, far = json.loads(metadata["uwaug_distance_range_m"])
    return Underwater(
        Medium(**values, point_spread=law, notes=tuple(stored["notes"])),
        (near, far),
        float(metadata["uwaug_tolerance"]),
        metadata["uwaug_color_space"],  # type: ignore[arg-type]
        exposure=json.loads(metadata["uwaug_exposure"]),
        demand=BlurDemand(**stored["demand"]),
    )
