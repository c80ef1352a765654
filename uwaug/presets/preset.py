"""Presets: settings with a name, read from TOML files and checked before anything is computed."""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug._support.types import ColorSpace
from uwaug.distance.convert import from_relative
from uwaug.formation.development import NEUTRAL, Development
from uwaug.formation.exposure import Exposure
from uwaug.formation.field import gaussian_random_field
from uwaug.formation.setup import Setup
from uwaug.formation.underwater import Underwater
from uwaug.light import Light
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.reduction import attenuations, light_and_veil
from uwaug.optics.water import Water, load_water
from uwaug.presets.files import preset_path
from uwaug.presets.schema import Config, is_table, read_config

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
        spectral: water, camera, g, mu, surfaces and color_matrix; None where the file has
            coefficients of three channels.
        waters: names of the types that `load_preset` takes in place of the file's; none where the
            file's coefficients are those of one water.
        equation: what it computes, in one line; may be empty.
        choices: how its medium differs from what `uwaug.RandomUnderwater` draws.
        light: what shines; None for daylight as the medium has it.
        development: of the picture, see `uwaug.Development`.
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
    waters: tuple[str, ...]
    equation: str
    choices: Mapping[str, str]
    light: Light | None
    development: Development

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
            choices = ", ".join(f"{key} = {value}" for key, value in self.choices.items())
            raise ValueError(
                f"preset {self.name!r} has {choices}, which RandomUnderwater does not draw: {cure}"
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
        if self.development != NEUTRAL:
            options |= asdict(self.development)
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

    def setup(self, focal_px: float | None = None) -> Setup:
        """What a picture of the preset is taken with; `focal_px` as for `module`."""
        return Setup(
            self.medium,
            self.light,
            self.exposure,
            self.color_space,
            focal_px,
            development=self.development,
        )

    def module(
        self, sides: tuple[int, int] | None = None, focal_px: float | None = None
    ) -> Underwater:
        """The preset as an `uwaug.Underwater`, planned for its distances times its field.

        Args:
            sides: the smallest and the largest short side, px, see `uwaug.Underwater`.
            focal_px: focal length, px of the image; a preset with a lamp or a sun needs it.
        """
        low, high = self.field_range
        return Underwater(
            self.medium,
            (self.near * low, self.far * high),
            color_space=self.color_space,
            sides=sides,
            exposure=self.exposure,
            light=self.light,
            focal_px=focal_px,
            development=self.development,
        )


def load_preset(
    name_or_path: str | os.PathLike[str],
    *,
    water: str | os.PathLike[str] | Water | None = None,
    camera: str | os.PathLike[str] | Camera | None = None,
    tolerance: float = 0.002,
    generator: torch.Generator | None = None,
) -> Preset:
    """Load a preset.

    Args:
        name_or_path: a name, see `list_presets`; or the path of a TOML file (a string that ends in
            ``.toml``, or any path object). `uwaug preset copy` copies one to make your own.
        water: takes the place of the preset's, see `load_water`. Where there are no spectra, one of
            the types that the file has figures for.
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
    depth = config.medium.vertical_depth_m
    if generator is not None and config.medium.depth_range_m is not None:
        low, high = config.medium.depth_range_m
        depth = low + (high - low) * _uniform(1, generator)[0]
    try:
        spectral = _spectra(config, path.parent, water, camera)
        veil = _veil(config, generator)
        if spectral is not None:
            medium = _spectral_medium(config, spectral, depth, veil, tolerance)
        elif config.channels is not None:
            medium = _channel_medium(config, water, depth, veil)
        else:
            medium = _coefficient_medium(config, depth)
    except ValueError as error:
        # of the arguments, as the file has been checked
        raise ValueError(f"preset {path.stem}: {error}") from error
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
        waters=config.waters(),
        equation=config.equation,
        choices=config.choices(),
        light=None if config.light is None else Light.from_list(config.light),
        development=Development(**vars(config.development)),
    )


def preset_files(name_or_path: str | os.PathLike[str]) -> list[Path]:
    """The files that a preset names, of a water or a camera of one's own.

    Raises:
        ValueError, OSError: as of `load_preset`.
    """
    path = preset_path(name_or_path)
    named = read_config(path).water
    names = () if named is None else (named.type, named.camera)
    return [path.parent / name for name in names if is_table(name)]


def _spectra(
    config: Config,
    folder: Path,
    water: str | os.PathLike[str] | Water | None,
    camera: str | os.PathLike[str] | Camera | None,
) -> dict[str, Any] | None:
    """What makes the medium, as `RandomUnderwater` names it; None if there are no spectra."""
    if config.water is None:
        if camera is not None or (water is not None and config.channels is None):
            raise ValueError(
                "holds coefficients for red, green and blue, which no water or camera replaces"
            )
        return None
    if water is None:
        water = _named(config.water.type, folder)
    if camera is None:
        camera = _named(config.water.camera, folder)
    return {
        "waters": load_water(water),
        "cameras": load_camera(camera),
        "g": config.medium.g,
        "mu": config.medium.mu,
        "surfaces": config.medium.surfaces,
        "color_matrix": config.medium.color_matrix if config.medium.has_spectra else None,
    }


def _named(name: str, folder: Path) -> str | Path:
    """What a preset names: a file beside its own, or what has a name."""
    return folder / name if is_table(name) else name


def _spectral_medium(
    config: Config,
    spectral: Mapping[str, Any],
    depth: float,
    veil: list[float] | None,
    tolerance: float,
) -> Medium:
    medium = Medium.from_water(
        spectral["waters"],
        spectral["cameras"],
        vertical_depth=depth,
        g=spectral["g"],
        mu=spectral["mu"],
        point_spread=_width_law(config),
        tolerance=tolerance,
        downwelling=config.medium.downwelling,
        dims=config.medium.dims,
        veil_rate=config.medium.veil_rate,
        forward=config.medium.forward,
        surfaces=config.medium.surfaces,
        color_matrix=config.medium.color_matrix,
    )
    if veil is None:
        return medium
    at_infinity = torch.tensor(veil, dtype=torch.float64)
    if config.medium.dims != "direct":
        # dimmed as the picture is, each wavelength by its own
        at_infinity = at_infinity * medium.ambient()
    return medium.with_veil(at_infinity, curve="signal")


def _channel_medium(
    config: Config,
    water: str | os.PathLike[str] | Water | None,
    depth: float,
    veil: list[float] | None,
) -> Medium:
    channels = config.channels
    assert channels is not None
    assert veil is not None
    if channels.left is not None:
        if water is not None:
            raise ValueError("holds one transmission, which no water replaces")
        return Medium.from_transmission(channels.left, veil)
    rates = channels.rates()
    kind = channels.type if water is None else water
    if kind not in rates:
        raise ValueError(f"has no spectra: water must be one of {', '.join(rates)}, got {water!r}")
    beta = rates[str(kind)]
    left = np.exp(-beta * depth) if config.medium.downwelling == "beam" else np.ones(3)
    left = left * channels.surface_light
    light = np.ones(3) if config.medium.dims == "veil" else left
    ambient = np.ones(3) if config.medium.dims == "direct" else left
    return Medium.from_coefficients(
        beta.tolist(), beta.tolist(), (np.array(veil) * ambient).tolist(), light=light.tolist()
    )


def _coefficient_medium(config: Config, depth: float) -> Medium:
    a, b, printed_G, kd = (np.array(values) for values in vars(config.coefficients).values())
    # the g of each channel that gives G as printed, which is rounded
    g = np.divide(printed_G - a, b, out=np.zeros(3), where=b > 0)
    beta, G = attenuations(a, b, g)
    light, veil, _ = light_and_veil(beta, G, b, kd, vertical_depth=depth, mu=config.medium.mu)
    return Medium.from_coefficients(
        beta.tolist(),
        G.tolist(),
        veil.tolist(),
        b_mean=float(b.mean()),
        point_spread=_width_law(config),
        light=light.tolist(),
    )


def _width_law(config: Config) -> PointSpread:
    law = config.point_spread
    return PointSpread(law.scale_px, law.exponent, law.shape, law.short_side_px)


def _veil(config: Config, generator: torch.Generator | None) -> list[float] | None:
    """V(0) before it is dimmed: the middle of its range, or drawn; None if the water makes it."""
    if config.veil is None:
        return None
    shares = [0.5] * 3 if generator is None else _uniform(3, generator)
    ends = zip(config.veil.low, config.veil.high, shares, strict=True)
    return [low + (high - low) * share for low, high, share in ends]


def _uniform(count: int, generator: torch.Generator) -> list[float]:
    """Random numbers in 0…1."""
    return torch.rand(count, generator=generator, dtype=torch.float64).tolist()
