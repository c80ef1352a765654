"""Presets: settings with a name, read from TOML files and checked before anything is computed."""

import difflib
import json
import os
import tomllib
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args

import numpy as np
import torch
from torch import Tensor

from uwaug import checks
from uwaug.checks import DOMAIN
from uwaug.colour import ColorSpace
from uwaug.distance import from_relative
from uwaug.exposure import Exposure, require_exposure
from uwaug.field import gaussian_random_field
from uwaug.files import require_regular
from uwaug.module import Underwater
from uwaug.optics.bands import band_coefficients
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread, Shape
from uwaug.optics.water import JERLOV_TYPES, Water

__all__ = ["Preset", "list_presets", "load_preset"]

_ROUNDING = 0.005  # 1/m: half of the last digit that the paper prints


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

    def options(self, distance_kind: str = "metric") -> dict[str, Any]:
        """The preset as options of `RandomUnderwater`, see `RandomUnderwater.from_preset`."""
        if self.spectral is None:
            cure = "use load_preset(…).module()"
            raise ValueError(f"preset {self.name!r} has coefficients but no spectra: {cure}")
        options = {
            **self.spectral,
            "contrast": None,
            "vertical_depth": self.vertical_depth,
            "exposure": self.exposure,
            "point_spread": self.medium.point_spread,
            "field_range": self.field_range,
            "color_space": self.color_space,
        }
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

    def module(self, sides: tuple[int, int] | None = None) -> Underwater:
        """The preset as an `uwaug.Underwater`, planned for its distances times its field; `sides`
        as there.
        """
        low, high = self.field_range
        distances = (self.near * low, self.far * high)
        options: dict[str, Any] = {"color_space": self.color_space, "exposure": self.exposure}
        return Underwater(self.medium, distances, sides=sides, **options)


def list_presets() -> list[str]:
    """Names of the presets that come with the package, sorted."""
    return sorted(path.stem for path in _folder().glob("*.toml"))


def load_preset(
    name_or_path: str | os.PathLike[str],
    *,
    water: str | Water | None = None,
    camera: str | os.PathLike[str] | Camera | None = None,
) -> Preset:
    """Load a preset.

    Args:
        name_or_path: a name, see `list_presets`; or the path of a TOML file (a string that ends in
            ``.toml``, or any path object). Copy a file of the package's ``configs`` folder to make
            your own.
        water: a Jerlov type ("I" … "9C") or a `Water` that takes the place of the preset's.
        camera: a camera that takes the place of the preset's, see `load_camera`.

    Raises:
        ValueError: the name is unknown (lists the known); the file is no TOML, or a key is unknown,
            missing, of the wrong type or out of range (names file and key); or water or camera is
            given where the preset has coefficients.
        OSError: the file cannot be read.

    Examples:
        >>> preset = load_preset("survey", water="II")
        >>> preset.near, preset.far, preset.field_range
        (1.0, 5.0, (0.7, 1.3))
        >>> preset.distance(torch.tensor([[0.0, 0.5, 1.0]]))
        tensor([[1., 3., 5.]])
    """
    path = _find(name_or_path)
    config = _read(path)
    try:
        spectral = _spectral(config, path.parent, water, camera)
        medium = _medium(config, spectral)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    z = config.distance
    return Preset(
        name=path.stem,
        source=config.source,
        medium=medium,
        vertical_depth=config.medium.vertical_depth_m,
        near=z.near_m,
        far=z.far_m,
        gamma=z.gamma,
        field_range=(config.field.low, config.field.high),
        color_space=config.color_space,
        exposure=config.exposure,
        spectral=spectral,
    )


# The schema. Pydantic checks types and keys, `DOMAIN` the range of what it knows by name, and each
# table what is left.


class _Table:
    __pydantic_config__: ClassVar[dict[str, Any]] = {"strict": True, "extra": "forbid"}

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            quantity = key.removesuffix("_px").removesuffix("_m")
            if quantity in DOMAIN:
                checks.within(key, value, *DOMAIN[quantity])


_RGB = tuple[float, float, float]


@dataclass(frozen=True)
class _Spectral(_Table):
    type: str
    camera: str

    def __post_init__(self) -> None:
        checks.one_of("type", self.type, JERLOV_TYPES)


@dataclass(frozen=True)
class _Coefficients(_Table):
    a_per_m: _RGB
    b_per_m: _RGB
    G_per_m: _RGB
    kd_per_m: _RGB

    def __post_init__(self) -> None:
        for key, values in vars(self).items():
            for value in values:
                checks.within(key, value, 0.0)
        if min(self.G_per_m) == 0:
            raise ValueError(f"G_per_m must be > 0, got {self.G_per_m}")


@dataclass(frozen=True)
class _Medium(_Table):
    vertical_depth_m: float
    g: float
    mu: float


@dataclass(frozen=True)
class _PointSpread(_Table):
    scale_px: float
    exponent: float
    short_side_px: float
    shape: Shape = "gaussian"

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.positive("short_side_px", self.short_side_px)


@dataclass(frozen=True)
class _Distance(_Table):
    near_m: float
    far_m: float
    gamma: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.near_m < self.far_m:
            raise ValueError(f"far_m must be > near_m = {self.near_m}, got {self.far_m}")


@dataclass(frozen=True)
class _Field(_Table):
    low: float
    high: float

    def __post_init__(self) -> None:
        checks.positive("low", self.low)
        checks.within("high", self.high, 0.0)
        if not self.low <= self.high:
            raise ValueError(f"high must be ≥ low = {self.low}, got {self.high}")


@dataclass(frozen=True)
class _Config(_Table):
    source: str
    color_space: ColorSpace
    medium: _Medium
    point_spread: _PointSpread
    distance: _Distance
    field: _Field
    water: _Spectral | None = None
    coefficients: _Coefficients | None = None
    exposure: Literal["none", "auto"] | float = "none"

    def __post_init__(self) -> None:
        require_exposure(self.exposure)
        if (self.water is None) == (self.coefficients is None):
            raise ValueError("water, coefficients: give one of these two tables")
        if self.coefficients is not None:
            _require_printed(self.coefficients, self.medium.g)


def _require_printed(c: _Coefficients, g: float) -> None:
    """Refuse a G that is not a + g·b; each of the three is rounded in print."""
    colours = ("red", "green", "blue")
    for colour, a, b, printed in zip(colours, c.a_per_m, c.b_per_m, c.G_per_m, strict=True):
        G = a + g * b
        if abs(G - printed) > _ROUNDING * (2 + g) + 1e-9:
            raise ValueError(
                f"coefficients.G_per_m is {printed} in {colour}, but a + g·b = {a} + {g}·{b} = "
                f"{G:.4g}: more than rounding to two decimals explains"
            )


def _folder() -> Path:
    here = Path(__file__).parent
    installed = here / "configs"
    return installed if installed.is_dir() else here.parent / "configs"


def _find(name_or_path: str | os.PathLike[str]) -> Path:
    if not isinstance(name_or_path, str) or name_or_path.endswith(".toml"):
        return Path(name_or_path)
    names = list_presets()
    if name_or_path not in names:
        known = f"there are {', '.join(names)}; or give the path of a .toml file"
        raise ValueError(f"no preset is called {name_or_path!r}; {known}")
    return _folder() / f"{name_or_path}.toml"


def _read(path: Path) -> _Config:
    from pydantic import TypeAdapter, ValidationError

    require_regular(path)
    try:
        # as JSON, because there strict types allow an array for a tuple
        table = json.dumps(tomllib.loads(path.read_text(encoding="utf-8")), default=str)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not a TOML file: {error}") from error
    except RecursionError:
        raise ValueError(f"{path}: not a preset: its brackets or keys nest too deeply") from None
    try:
        return TypeAdapter(_Config).validate_json(table)
    except ValidationError as error:
        found = "; ".join(_explain(dict(one)) for one in error.errors())
        raise ValueError(f"{path}: {found}") from None


def _explain(error: dict[str, Any]) -> str:
    where = [str(part) for part in error["loc"]]
    key = ".".join(where)
    if error["type"] == "value_error":  # our own, which begins with the key
        return ".".join([*where, str(error["ctx"]["error"])])
    if error["type"] == "missing":
        return f"{key} is missing"
    if error["type"] == "unexpected_keyword_argument":
        known = _keys(where[:-1])
        close = difflib.get_close_matches(where[-1], known, n=1)
        hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(known)}"
        return f"{key} is no key; {hint}"
    return f"{key}: {error['msg']}, got {error['input']!r}"


def _keys(tables: list[str]) -> list[str]:
    """The keys of a table, given the way to it."""
    table: Any = _Config
    for name in tables:
        kind = next(field.type for field in fields(table) if field.name == name)
        table = next(t for t in (kind, *get_args(kind)) if is_dataclass(t))
    return [field.name for field in fields(table)]


def _spectral(
    config: _Config,
    folder: Path,
    water: str | Water | None,
    camera: str | os.PathLike[str] | Camera | None,
) -> dict[str, Any] | None:
    """Water, camera, g and mu, as `RandomUnderwater` names them; None if there are no spectra."""
    if config.water is None:
        if water is not None or camera is not None:
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


def _medium(config: _Config, spectral: dict[str, Any] | None) -> Medium:
    psf = config.point_spread
    law = PointSpread(psf.scale_px, psf.exponent, psf.shape, psf.short_side_px)
    if spectral is None:
        return _medium_from_coefficients(config, law)
    return Medium.from_water(
        spectral["waters"],
        spectral["cameras"],
        vertical_depth=config.medium.vertical_depth_m,
        g=spectral["g"],
        mu=spectral["mu"],
        point_spread=law,
    )


def _medium_from_coefficients(config: _Config, law: PointSpread) -> Medium:
    a, b, printed, kd = (np.array(values) for values in vars(config.coefficients).values())
    # the g of each channel that gives G as printed, which is rounded
    g = np.divide(printed - a, b, out=np.zeros(3), where=b > 0)
    depth, mu = config.medium.vertical_depth_m, config.medium.mu
    beta, G, light, veil = band_coefficients(a, b, kd, vertical_depth=depth, g=g, mu=mu)
    return Medium.from_coefficients(
        beta.tolist(),
        G.tolist(),
        veil.tolist(),
        b_mean=float(b.mean()),
        point_spread=law,
        light=light.tolist(),
    )
