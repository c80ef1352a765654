"""Presets: settings with a name, read from TOML files whose tables are arguments of the library."""

import os
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import ColorSpace
from uwaug.distance.convert import from_relative
from uwaug.formation.development import Development
from uwaug.formation.field import gaussian_random_field
from uwaug.formation.underwater import Underwater
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.scattering import Scattering
from uwaug.optics.water import Water, load_water
from uwaug.presets.files import preset_path

T = TypeVar("T")

AnyWater = str | os.PathLike[str] | Water
AnyCamera = str | os.PathLike[str] | Camera

_HOMOGENEOUS = (1.0, 1.0)
"""The range of a field that does nothing."""


@dataclass(frozen=True)
class Preset:
    """A medium with the distances, the field and the camera it is meant for; made by `load_preset`.

    Attributes:
        name: of the file, without its ending.
        source: where the figures come from.
        medium: water, camera, depth and width law: a batch of one.
        near, far: range of distances, m.
        gamma: exponent of the distance scaling, z = near + (far − near)·t^gamma.
        field_range: least and largest value of the medium field.
        color_space: "linear" if sRGB values are taken for light, as the paper does; "srgb" if they
            are decoded first.
        development: of the picture, see `uwaug.Development`.
        spectral: the arguments of `uwaug.Medium.from_water`; None where the file has coefficients.
    """

    name: str
    source: str
    medium: Medium
    near: float
    far: float
    gamma: float
    field_range: tuple[float, float]
    color_space: ColorSpace
    development: Development
    spectral: dict[str, Any] | None

    def distance(self, t: Tensor) -> Tensor:
        """Metres from relative distance t in [0, 1], 0 = near; shape (…, H, W). See
        `uwaug.distance.from_relative`.
        """
        return from_relative(t, self.near, self.far, self.gamma)

    def field(self, shape: tuple[int, ...], generator: torch.Generator | None = None) -> Tensor:
        """A random medium field for distances of `shape`, (B, 1, H, W). See
        `uwaug.gaussian_random_field`.
        """
        low, high = self.field_range
        return gaussian_random_field(shape, low=low, high=high, generator=generator)

    def module(self, sides: tuple[int, int] | None = None) -> Underwater:
        """The preset as an `uwaug.Underwater`, planned for its distances times its field.

        Args:
            sides: the smallest and the largest short side, px, see `uwaug.Underwater`.
        """
        low, high = self.field_range
        return Underwater(
            self.medium,
            (self.near * low, self.far * high),
            color_space=self.color_space,
            sides=sides,
            development=self.development,
        )

    def options(self) -> dict[str, Any]:
        """The preset as arguments of `uwaug.RandomUnderwater`; `development` as a dictionary of
        those of `uwaug.RandomDevelopment`.
        """
        # what `Medium.from_water` takes where the file says nothing
        constants = {"vertical_depth": 1.0, "g": Scattering.PAPER.g}
        spectral = {**constants, **self.spectral} if self.spectral else {"water": self.medium}
        of_camera: dict[str, Any] = {"color_space": self.color_space, "color_matrix": None}
        if spectral.get("surfaces") == "spectral":
            of_camera["color_matrix"] = spectral.get("color_matrix", 1.0)
        renamed = {"water", "surfaces", "color_matrix"}
        return {
            "waters": spectral["water"],
            **{key: value for key, value in spectral.items() if key not in renamed},
            "contrast": None,
            "point_spread": self.medium.point_spread,
            "field": None if self.field_range == _HOMOGENEOUS else self.field_range,
            "light": None,
            "development": {**vars(self.development), **of_camera},
        }


def load_preset(
    name_or_path: str | os.PathLike[str],
    *,
    water: AnyWater | None = None,
    camera: AnyCamera | None = None,
) -> Preset:
    """Load a preset.

    Args:
        name_or_path: a name, see `list_presets`; or the path of a TOML file (a string that ends in
            ``.toml``, or any path object). `uwaug preset show` prints one to make your own.
        water: takes the place of the preset's, see `uwaug.load_water`.
        camera: a camera that takes the place of the preset's, see `uwaug.load_camera`.

    Raises:
        ValueError: the name is unknown (lists the known); the file is no TOML, or a key is unknown,
            missing, of the wrong type or out of range (names file and key); or water or camera is
            given where the preset has coefficients, which none replaces.
        OSError: the file cannot be read.

    Examples:
        >>> preset = load_preset("survey", water="II")
        >>> preset.near, preset.far, preset.field_range
        (1.0, 5.0, (0.7, 1.3))
        >>> preset.distance(torch.tensor([[0.0, 0.5, 1.0]]))
        tensor([[1., 3., 5.]])
    """
    path = preset_path(name_or_path)
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not a TOML file: {error}") from error
    given = {"water": water, "camera": camera}
    given = {key: value for key, value in given.items() if value is not None}
    if given and "water" not in tables:
        raise ValueError(f"{path} holds coefficients, which no {' or '.join(given)} replaces")
    try:
        return _preset(path, given, **tables)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {_unnamed(error)}") from error


def _preset(
    path: Path,
    given: Mapping[str, Any],
    *,
    source: str,
    distance: Mapping[str, Any],
    water: Mapping[str, Any] | None = None,
    coefficients: Mapping[str, Any] | None = None,
    point_spread: Mapping[str, Any] | None = None,
    field: Mapping[str, Any] | None = None,
    development: Mapping[str, Any] | None = None,
    color_space: ColorSpace = "srgb",
) -> Preset:
    """A preset from the tables of its file.

    given: water and camera in place of the file's.
    """
    if (water is None) == (coefficients is None):
        raise ValueError("give one of the tables water and coefficients")
    checks.one_of("color_space", color_space, get_args(ColorSpace))
    law = {}
    if point_spread is not None:
        law["point_spread"] = _made("point_spread", PointSpread, point_spread)
    spectral = None
    if water is not None:
        named = {key: _beside(path, key, value) for key, value in water.items()}
        spectral = _made("water", _loaded, {**named, **given})
        medium = _made("water", Medium.from_water, {**spectral, **law})
    else:
        assert coefficients is not None
        medium = _made("coefficients", Medium.from_coefficients, {**coefficients, **law})
    near, far, gamma = _made("distance", _distance, distance)
    return Preset(
        name=path.stem,
        source=source,
        medium=medium,
        near=near,
        far=far,
        gamma=gamma,
        field_range=_made("field", _field, field or {}),
        color_space=color_space,
        development=_made("development", Development, development or {}),
        spectral=spectral,
    )


def _made(table: str, function: Callable[..., T], arguments: Mapping[str, Any]) -> T:
    """What a function makes of a table; its refusals name the table."""
    try:
        return function(**arguments)
    except (TypeError, ValueError) as error:
        raise ValueError(f"[{table}] {_unnamed(error)}") from error


def _unnamed(error: Exception) -> str:
    """What is refused, without the name of a function whose arguments the file holds."""
    return re.sub(r"^[\w.]+\(\) ", "", str(error))


def _loaded(
    water: AnyWater, camera: AnyCamera = "Nikon 5100 (NPL)", **constants: Any
) -> dict[str, Any]:
    """The arguments of `Medium.from_water`, with water and camera loaded."""
    return {"water": load_water(water), "camera": load_camera(camera), **constants}


def _beside(path: Path, key: str, value: Any) -> Any:
    """A value of a file; a water or a camera that is a CSV file lies beside it."""
    is_table = key in ("water", "camera") and str(value).lower().endswith(".csv")
    return path.parent / value if is_table else value


def _distance(near: float, far: float, gamma: float = 1.0) -> tuple[float, float, float]:
    checks.within("near", near, 0.0)
    checks.within("far", far, 0.0)
    checks.positive("gamma", gamma)
    if not near < far:
        raise ValueError(f"far must be > near = {near}, got {far}")
    return near, far, gamma


def _field(low: float = 1.0, high: float = 1.0) -> tuple[float, float]:
    checks.positive("low", low)
    checks.positive("high", high)
    if not low <= high:
        raise ValueError(f"high must be ≥ low = {low}, got {high}")
    return low, high
