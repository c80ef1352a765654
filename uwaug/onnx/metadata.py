"""The metadata of an exported file, and the module that it came from."""

import json
import os
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

from uwaug._support.onnx_session import Session
from uwaug.blur.plan import BlurPlan
from uwaug.formation.demand import distance_range_of, sides_of
from uwaug.formation.setup import Setup
from uwaug.formation.underwater import Underwater
from uwaug.onnx.graph import Options

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
"""Metadata that every file has."""

_UNITS = "image 0…1 (float32) or 0…255 (uint8); distance in metres along the ray, +inf = open water"


@dataclass(frozen=True)
class Stored:
    """The module of a file, and what the file takes."""

    options: Options
    setup: Setup
    plan: BlurPlan
    sides: tuple[int, int]
    distance_range: tuple[float, float]


def written(module: Underwater, plan: BlurPlan, options: Options) -> dict[str, str]:
    """The metadata of a module's file."""
    medium = module.medium
    rebuild = {**module.setup.to_dict(), "plan": asdict(plan)}
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
    """The metadata that `export_onnx` wrote into a file.

    Raises:
        ImportError: if onnxruntime is not installed.
        OSError: if the file cannot be read.
        ValueError: if it is not from uwaug, or of another format, or lacks what every file has.
    """
    session = Session(path, 1, optimise=False).opened
    metadata: dict[str, str] = session.get_modelmeta().custom_metadata_map
    if "uwaug_format" not in metadata:
        raise ValueError(
            f"{path}: not a file of uwaug.onnx.export_onnx, as it has no metadata of it"
        )
    if metadata["uwaug_format"] != str(FORMAT):
        origin = f"{metadata['uwaug_format']} from uwaug {metadata.get('uwaug_version', '?')}"
        raise ValueError(
            f"{path}: format {origin}, but this version reads format {FORMAT}: export it again"
        )
    missing = [name for name in _NAMES if f"uwaug_{name}" not in metadata]
    if missing:
        raise ValueError(f"{path}: its metadata lack uwaug_{missing[0]}: export it again")
    return metadata


def stored_in(path: str | os.PathLike[str], metadata: dict[str, str]) -> Stored:
    """The module of the file at `path`, by its metadata.

    Raises:
        ValueError: if they are not what `export_onnx` wrote.
    """
    try:
        return _stored(metadata)
    except Exception as error:  # whatever a wrong figure, kind or depth of nesting leads to
        raise ValueError(
            f"{path}: its metadata are damaged ({type(error).__name__}: {error!s:.200}): "
            "export it again"
        ) from error


def _stored(metadata: dict[str, str]) -> Stored:
    module = json.loads(metadata["uwaug_module"], parse_constant=_refuse_constant)
    # files of older versions say these three here only
    exposure = json.loads(metadata["uwaug_exposure"])
    color_space, tolerance = metadata["uwaug_color_space"], float(metadata["uwaug_tolerance"])
    here = {"exposure": exposure, "color_space": color_space, "tolerance": tolerance}
    choices = (metadata[f"uwaug_{name}"] for name in ("parameters", "field", "image"))
    return Stored(
        options=Options(*choices),  # type: ignore[arg-type]
        setup=Setup.from_dict(module | here),
        plan=BlurPlan(**{name: _tuples(value) for name, value in module["plan"].items()}),
        sides=sides_of(json.loads(metadata["uwaug_sides_px"])),
        distance_range=distance_range_of(json.loads(metadata["uwaug_distance_range_m"])),
    )


def _refuse_constant(name: str) -> None:
    raise ValueError(f"expected finite numbers, got {name}")


def _tuples(value: Any) -> Any:
    """JSON's lists as tuples."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def read_module(path: str | os.PathLike[str]) -> Underwater:
    """The module that a file was exported from, rebuilt from its metadata, with the very plan that
    the file has: for pictures of any size it computes what the file does. Errors as
    `read_metadata`.

    What was learned is there; the module itself learns nothing.
    """
    stored = stored_in(path, read_metadata(path))
    setup = stored.setup
    return Underwater(
        setup.medium,
        stored.distance_range,
        setup.tolerance,
        setup.color_space,
        exposure=setup.exposure,
        sides=stored.sides,
        light=setup.light,
        focal_px=setup.focal_px,
        centre=setup.centre,
        plan=stored.plan,
        development=setup.development,
    )
