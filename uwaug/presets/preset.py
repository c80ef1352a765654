"""Presets: settings with a name, read from TOML files and checked before anything is computed."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from uwaug._support.types import ColorSpace
from uwaug.distance.convert import from_relative
from uwaug.formation.exposure import Exposure
from uwaug.formation.field import gaussian_random_field
from uwaug.formation.underwater import Underwater
from uwaug.light import Light
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.medium import Medium
from uwaug.optics.water import Water
from uwaug.presets.media import medium_of
from uwaug.presets.schema import Config, read_config

__all__ = [
    "Preset",
    "bundled_preset",
    "list_presets",
    "load_preset",
    "preset_path",
    "published_systems",
]

_HOMOGENEOUS = (1.0, 1.0)
"""The range of a field that does nothing."""


@dataclass(frozen=True)
class Preset:
    """A medium with the distances, the field and the colour space it is meant for; made by
    `load_preset`.

    Attributes:
        name: of the file, without its ending.
        source: where the figures come from.
        medium: water, camera, depth and width law: a batch of one.
        vertical_depth: depth of the scene below the surface, m; the medium has it in it already.
        near, far: range of distances, m.
        gamma: exponent of the distance scaling, z = near + (far − near)·t^gamma.
        field_range: least and largest value of the medium field.
        color_space: "linear" if sRGB values are taken for light, as the paper does; "srgb" if they
            are decoded first.
        exposure: "none", "auto", or a gain in stops, see `uwaug.Underwater`.
        spectral: water, camera, g and mu; None where the file has coefficients of three channels.
        equation: what it computes, in one line; may be empty.
        choices: how its medium differs from what `uwaug.RandomUnderwater` draws.
        light: what shines; None for daylight as the medium has it.
    """

    name: str
    source: str
    medium: Medium
    vertical_depth: float
    near: float
    far: float
    gamma: float
    field_range: tuple[float, float]
    color_space: ColorSpace
    exposure: Exposure
    spectral: dict[str, Any] | None
    equation: str
    choices: Mapping[str, str]
    light: Light | None

    @property
    def drawable(self) -> bool:
        """Whether `uwaug.RandomUnderwater` can draw from it: it knows spectra, and no choices."""
        return self.spectral is not None and not self.choices

    @property
    def uneven(self) -> tuple[float, float] | None:
        """The range of the field; None where the water is homogeneous."""
        return None if self.field_range == _HOMOGENEOUS else self.field_range

    def options(self, distance_kind: str = "metric") -> dict[str, Any]:
        """The preset as options of `RandomUnderwater`, see `RandomUnderwater.from_preset`."""
        cure = "use load_preset(…).module()"
        if self.spectral is None:
            raise ValueError(f"preset {self.name!r} has coefficients but no spectra: {cure}")
        if self.choices:
            made = ", ".join(f"{key} = {value}" for key, value in self.choices.items())
            raise ValueError(
                f"preset {self.name!r} has {made}, which RandomUnderwater does not draw: {cure}"
            )
        options = {
            **self.spectral,
            "contrast": None,
            "vertical_depth": self.vertical_depth,
            "exposure": self.exposure,
            "point_spread": self.medium.point_spread,
            "field_range": self.field_range,
            "color_space": self.color_space,
        }
        if self.uneven is None:
            options["field_probability"] = 0.0
        if self.light is not None:
            options["light"] = self.light
        if distance_kind != "metric":
            options |= {"near": self.near, "far": self.far}
        if distance_kind == "relative":
            options["gamma"] = self.gamma
        return options

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

    def module(
        self, sides: tuple[int, int] | None = None, focal_px: float | None = None
    ) -> Underwater:
        """The preset as an `uwaug.Underwater`, planned for its distances times its field; `sides`
        as there.

        focal_px: focal length, px of the image; wanted where the preset has a lamp or a sun.
        """
        low, high = self.field_range
        distances = (self.near * low, self.far * high)
        options: dict[str, Any] = {"color_space": self.color_space, "exposure": self.exposure}
        options |= {"light": self.light, "focal_px": focal_px}
        return Underwater(self.medium, distances, sides=sides, **options)


def list_presets() -> list[str]:
    """Names of the presets that come with the package, sorted: the paper's, the library's own, and
    the `published_systems`.
    """
    return sorted(_files())


def published_systems() -> list[str]:
    """Names of the presets that compute what others have published, oldest first."""
    named = [name for name, path in _files().items() if path.parent.name == "published"]
    # each ends with its year
    return sorted(named, key=lambda name: (name.rpartition("-")[2], name))


def bundled_preset(name: str) -> Path:
    """The file of a preset that comes with the package.

    Raises:
        ValueError: the name is unknown; lists the known.
    """
    files = _files()
    if name not in files:
        known = ", ".join(sorted(files))
        raise ValueError(f"no preset is called {name!r}; there are {known}")
    return files[name]


def preset_path(name_or_path: str | os.PathLike[str]) -> Path:
    """The file of a preset, from what `load_preset` takes.

    Raises:
        ValueError: it is a name, and unknown; lists the known.
    """
    if not isinstance(name_or_path, str) or name_or_path.endswith(".toml"):
        return Path(name_or_path)
    try:
        return bundled_preset(name_or_path)
    except ValueError as error:
        raise ValueError(f"{error}; or give the path of a .toml file") from None


def load_preset(
    name_or_path: str | os.PathLike[str],
    *,
    water: str | Water | None = None,
    camera: str | os.PathLike[str] | Camera | None = None,
    tolerance: float = 0.002,
    generator: torch.Generator | None = None,
) -> Preset:
    """Load a preset.

    Args:
        name_or_path: a name, see `list_presets`; or the path of a TOML file (a string that ends in
            ``.toml``, or any path object). `uwaug preset copy` copies one to make your own.
        water: a Jerlov type ("I" … "9C") or a `Water` that takes the place of the preset's. Where
            there are no spectra, one of the types that the file has figures for.
        camera: a camera that takes the place of the preset's, see `load_camera`.
        tolerance: largest error of a curve that was a spectrum; 0 keeps every band.
        generator: draws what the file holds as a range, a veil or a depth; None takes the middle.

    Raises:
        ValueError: the name is unknown (lists the known); the file is no TOML, or a key is unknown,
            missing, of the wrong type or out of range (names file and key); or water or camera is
            given where the preset has coefficients that none replaces.
        OSError: the file cannot be read.

    Examples:
        >>> preset = load_preset("survey", water="II")
        >>> preset.near, preset.far, preset.field_range
        (1.0, 5.0, (0.7, 1.3))
        >>> preset.distance(torch.tensor([[0.0, 0.5, 1.0]]))
        tensor([[1., 3., 5.]])
    """
    path = preset_path(name_or_path)
    config = read_config(path)
    try:
        spectral = _spectral(config, path.parent, water, camera)
        kind = _type_of_channels(config, water)
        medium, depth = medium_of(config, spectral, kind, tolerance, generator)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    z = config.distance
    return Preset(
        name=path.stem,
        source=config.source,
        medium=medium,
        vertical_depth=depth,
        near=z.near_m,
        far=z.far_m,
        gamma=z.gamma,
        field_range=(config.field.low, config.field.high),
        color_space=config.color_space,
        exposure=config.exposure,
        spectral=spectral,
        equation=config.equation,
        choices=config.choices(),
        light=None if config.light is None else Light.from_list(config.light),
    )


def _files() -> dict[str, Path]:
    """The file of each preset that comes with the package."""
    folder = _folder()
    paths = [*folder.glob("*.toml"), *folder.glob("published/*.toml")]
    return {path.stem: path for path in paths}


def _folder() -> Path:
    here = Path(__file__).parent.parent
    installed = here / "configs"
    return installed if installed.is_dir() else here.parent / "configs"


def _spectral(
    config: Config,
    folder: Path,
    water: str | Water | None,
    camera: str | os.PathLike[str] | Camera | None,
) -> dict[str, Any] | None:
    """Water, camera, g and mu, as `RandomUnderwater` names them; None if there are no spectra."""
    if config.water is None:
        if camera is not None or (water is not None and config.channels is None):
            raise ValueError(
                "holds coefficients for red, green and blue, which no water or camera replaces"
            )
        return None
    water = config.water.type if water is None else water
    if camera is None:
        name = config.water.camera
        camera = folder / name if name.lower().endswith(".csv") else name
    return {
        "waters": water if isinstance(water, Water) else Water.jerlov(water),
        "cameras": load_camera(camera),
        "g": config.medium.g,
        "mu": config.medium.mu,
    }


def _type_of_channels(config: Config, water: str | Water | None) -> str | None:
    """The water among those that a file has rates of three channels for; None for its own."""
    if config.channels is None or water is None:
        return None
    table = config.channels.beta_per_m or config.channels.left_per_m
    if table is None:
        raise ValueError("holds one transmission, which no water replaces")
    if water not in table:
        known = ", ".join(table)
        raise ValueError(f"has no spectra: water must be one of {known}, got {water!r}")
    return str(water)
