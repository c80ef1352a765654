"""What an exported file says of itself, and the module that it came from."""

import json
import math
import os
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any, Literal, get_args

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.onnx_session import Session
from uwaug._support.types import ColorSpace, Shape
from uwaug.blur.kernels import PERIOD
from uwaug.blur.plan import NO_BLUR, BlurPlan
from uwaug.formation.demand import SIDES, distance_range_of, sides_of
from uwaug.formation.exposure import Exposure, require_exposure
from uwaug.formation.underwater import Underwater
from uwaug.light.light import Light
from uwaug.light.lit import light_of
from uwaug.optics.inherent import Bands
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread

__all__ = ["FORMAT", "Options", "Stored", "plan_of", "read_metadata", "read_module", "stored_in"]

FORMAT = 2
"""Of the metadata; files of another are refused."""

_NAMES = (
    "version",
    "water",
    "medium",
    "plan",
    "tolerance",
    "color_space",
    "exposure",
    "parameters",
    "field",
    "image",
    "sides_px",
    "distance_range_m",
    "module",
)
"""Of what every file says of itself."""

_MOST = 64
"""Blurs of a plan, and terms of their weights: more than any plan has."""

_WIDEST = 32
"""Shorter sides: no plan asks for a wider blur."""

_UNITS = "image 0…1 (float32) or 0…255 (uint8); distance in metres along the ray, +inf = open water"


@dataclass(frozen=True)
class Options:
    """What a file is exported for; see `uwaug.onnx.export_onnx`."""

    parameters: Literal["frozen", "inputs"] = "frozen"
    field: Literal["none", "input"] = "none"
    image: Literal["float32", "uint8"] = "float32"

    def __post_init__(self) -> None:
        checks.one_of("parameters", self.parameters, ("frozen", "inputs"))
        checks.one_of("field", self.field, ("none", "input"))
        checks.one_of("image", self.image, ("float32", "uint8"))

    @staticmethod
    def of(metadata: dict[str, str]) -> "Options":
        """Those of a file."""
        given = (metadata[f"uwaug_{name}"] for name in ("parameters", "field", "image"))
        return Options(*given)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Stored:
    """What a file holds of the module that it came from."""

    options: Options
    medium: Medium
    plan: BlurPlan
    sides: tuple[int, int]
    distance_range: tuple[float, float]
    tolerance: float
    color_space: ColorSpace
    exposure: Exposure
    light: Light | None = None
    camera: tuple[float | None, tuple[float, float] | None] = (None, None)


def require_light(module: Underwater, options: Options) -> None:
    """Refuse a light that cannot be written with these options."""
    light = module.light
    if light is None:
        return
    if light.rows() > 1:
        raise ValueError(f"module.light is for {light.rows()} pictures, of which one can be frozen")
    if options.parameters != "frozen":
        what = "a light is written with its water"
        raise ValueError(f"parameters must be 'frozen' where module.light is given: {what}")
    if module.exposure == "auto":
        cure = "give a number of stops"
        raise ValueError(f"module.exposure is 'auto', which a file with a light has not: {cure}")


def plan_of(module: Underwater) -> BlurPlan:
    """The plan of a module's file, which is the module's own for pictures of any size."""
    if module.distance_range is None:
        cure = "give Underwater(…, distance_range=(near, far)), which fixes the plan"
        raise ValueError(f"module has no distance_range: {cure}")
    if module.order != "line_of_sight":
        raise ValueError(
            f"module.order must be 'line_of_sight' to be exported, got {module.order!r}"
        )
    if module.sides is None:
        cure = f"give Underwater(…, sides={SIDES}), so that module and file share one plan"
        raise ValueError(f"module has no sides and plans its blur for each picture's size: {cure}")
    # as it would be at the next picture, after parameters have changed
    module.keep_up(module.medium)
    plan = module.plan(module.sides)
    assert plan is not None
    return plan


def written(module: Underwater, plan: BlurPlan, options: Options) -> dict[str, str]:
    """The metadata of a module's file."""
    medium, law = module.medium, module.medium.point_spread
    tensors: dict[str, Any] = {
        name: value.detach().tolist() for name, value in medium.parameters().items()
    }
    for name, value in law.numbers().items():
        if not isinstance(value, Tensor):
            tensors[name] = value
    rebuild: dict[str, Any] = {
        "medium": tensors,
        "law": {"shape": law.shape, "reference_size": law.reference_size},
        "notes": medium.notes,
        "plan": asdict(plan),
    }
    if module.light is not None:
        rebuild["light"] = module.light.to_list()
        rebuild["camera"] = module.camera
        if medium.bands is not None:
            bands = [tensor.detach().double().tolist() for tensor in medium.bands.tensors()]
            rebuild["unlit"] = [*bands, medium.bands.tolerance]
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
        "uwaug_sides_px": json.dumps(module.sides),
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
        ValueError: if it is not from uwaug, or of another format, or lacks what every file has.
    """
    found: dict[str, str] = (
        Session(path, 1, optimise=False).opened.get_modelmeta().custom_metadata_map
    )
    if "uwaug_format" not in found:
        raise ValueError(
            f"{path}: not a file of uwaug.onnx.export_onnx, as it has no metadata of it"
        )
    if found["uwaug_format"] != str(FORMAT):
        raise ValueError(
            f"{path}: format {found['uwaug_format']} from uwaug {found.get('uwaug_version', '?')}, "
            f"but this version reads format {FORMAT}: export it again"
        )
    missing = [name for name in _NAMES if f"uwaug_{name}" not in found]
    if missing:
        raise ValueError(f"{path}: its metadata lack uwaug_{missing[0]}: export it again")
    return found


def stored_in(path: str | os.PathLike[str], metadata: dict[str, str]) -> Stored:
    """What the metadata of the file at `path` say of its module.

    Raises:
        ValueError: if they have been altered into what `export_onnx` cannot have written.
    """
    try:
        return _stored(metadata)
    except Exception as error:  # whatever a wrong figure, kind or depth of nesting leads to
        raise ValueError(
            f"{path}: its metadata are damaged ({type(error).__name__}: {error!s:.200}): "
            "export it again"
        ) from error


def _stored(metadata: dict[str, str]) -> Stored:
    rebuild = json.loads(metadata["uwaug_module"])
    medium, sides = _medium(rebuild), sides_of(json.loads(metadata["uwaug_sides_px"]))
    plan = _plan(rebuild["plan"], sides)
    if plan != NO_BLUR:
        checks.one_of("plan.shape", plan.shape, (medium.point_spread.shape,))
    checks.one_of("color_space", metadata["uwaug_color_space"], get_args(ColorSpace))
    exposure = json.loads(metadata["uwaug_exposure"])
    require_exposure(exposure)
    tolerance = float(metadata["uwaug_tolerance"])
    checks.tolerance(tolerance)
    light, camera = _light(rebuild)
    return Stored(
        options=Options.of(metadata),
        medium=medium,
        plan=plan,
        sides=sides,
        distance_range=distance_range_of(json.loads(metadata["uwaug_distance_range_m"])),
        tolerance=tolerance,
        color_space=metadata["uwaug_color_space"],  # type: ignore[arg-type]
        exposure=exposure,
        light=light,
        camera=camera,
    )


def _light(rebuild: dict[str, Any]) -> tuple[Light | None, Any]:
    """The light of a file, and focal length and centre of its camera."""
    if "light" not in rebuild:
        return None, (None, None)
    focal_px, centre = rebuild["camera"]
    centre = None if centre is None else tuple(centre)
    return light_of(Light.from_list(rebuild["light"]), focal_px, centre), (focal_px, centre)


def _medium(rebuild: dict[str, Any]) -> Medium:
    values: dict[str, Any] = {}
    for name, value in rebuild["medium"].items():
        tensor = torch.tensor(value, dtype=torch.float64)
        # forward scatter from the direct light is a difference of curves
        least, bound = (-math.inf, "") if name == "signal_weights" else (0.0, " ≥ 0")
        if not tensor.numel() or not (tensor.isfinite() & (tensor >= least)).all():
            raise ValueError(f"{name} must hold finite numbers{bound}")
        values[name] = float(tensor) if tensor.ndim == 0 else tensor
    numbers = {name: values.pop(name) for name in PointSpread.NUMBERS}
    law = rebuild["law"]
    if law["reference_size"] is not None:
        checks.positive("reference_size", law["reference_size"], "px")
    notes = tuple(map(str, rebuild["notes"]))
    spread = PointSpread(**numbers, shape=law["shape"], reference_size=law["reference_size"])
    bands = None
    if "unlit" in rebuild:
        *tensors, tolerance = rebuild["unlit"]
        doubles = [torch.tensor(t, dtype=torch.float64) for t in tensors]
        bands = Bands.of_tensors(doubles, tolerance)
    medium = Medium(**values, point_spread=spread, notes=notes, bands=bands)
    medium.parameters()  # has a row of each number for every medium, or raises
    return medium


def _plan(stored: dict[str, Any], sides: tuple[int, int]) -> BlurPlan:
    """A plan that `plan_blur` may have made: one of other figures could ask for endless kernels."""
    values = {**stored, "coefficients": tuple(map(tuple, stored["coefficients"]))}
    plan = BlurPlan(
        **{**values, "sigmas": tuple(stored["sigmas"]), "cells": tuple(stored["cells"])}
    )
    checks.one_of("plan.shape", plan.shape, get_args(Shape))
    widest, degree = float(_WIDEST * sides[1]), len(plan.coefficients[0])
    for name in ("sigma_min", "sigma_max", "error"):
        checks.within(f"plan.{name}", getattr(plan, name), 0.0, widest)
    checks.within("plan.sigma_max", plan.sigma_max, plan.sigma_min)
    checks.within("plan.reach", plan.reach, 0.0, 8.0)
    checks.within("plan.degree", degree, 1, _MOST)
    checks.within("plan.sigmas", len(plan.sigmas), 1, _MOST)
    for sigma, cell, row in zip(plan.sigmas, plan.cells, plan.coefficients, strict=True):
        checks.within("plan.sigmas", sigma, 0.0, widest)
        # a cell is never wider than σ, and σ at most a few cells
        checks.within("plan.cells", cell, max(1.0, sigma / 8), max(1.0, sigma))
        ratio = PERIOD / cell if cell < PERIOD else cell / PERIOD
        checks.within("plan.cells", abs(ratio - round(ratio)), 0.0, 1e-9)
        for weight in row:
            checks.within("plan.coefficients", weight)
        checks.within("plan.coefficients", len(row), degree, degree)
    return plan


def read_module(path: str | os.PathLike[str]) -> Underwater:
    """The module that a file was exported from, rebuilt from its metadata, with the very plan that
    the file has: for pictures of any size it computes what the file does. Errors as
    `read_metadata`.

    What was learned is there; the module itself learns nothing.
    """
    metadata = read_metadata(path)
    stored = stored_in(path, metadata)
    try:
        return Underwater(
            stored.medium,
            stored.distance_range,
            stored.tolerance,
            stored.color_space,
            exposure=stored.exposure,
            sides=stored.sides,
            light=stored.light,
            focal_px=stored.camera[0],
            centre=stored.camera[1],
            plan=stored.plan,
        )
    except (ArithmeticError, RuntimeError, RuntimeWarning) as error:
        # finite figures, but beyond what can be computed with
        raise ValueError(f"{path}: its metadata are damaged ({error}): export it again") from error
