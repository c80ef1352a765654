"""What a preset's file may hold, and what is said of one that holds something else."""

import difflib
import json
import math
import tomllib
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from uwaug._support import checks
from uwaug._support.atomic import require_regular
from uwaug._support.checks import DOMAIN
from uwaug._support.types import Array, ColorSpace, Shape
from uwaug.formation.development import Development
from uwaug.formation.exposure import require_exposure
from uwaug.light.light import Light
from uwaug.optics.bands import Forward
from uwaug.optics.jerlov import JERLOV_TYPES
from uwaug.optics.reduction import USUAL, Dims, Downwelling, VeilRate
from uwaug.optics.surfaces import Surfaces
from uwaug.optics.water import load_water

_ROUNDING = 0.005  # 1/m: half of the last digit that the paper prints

# Pydantic checks types and keys, `DOMAIN` the range of what it knows by name, and each
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
    """A water and a camera; of each, a file that ends in .csv lies beside the preset's."""

    type: str
    camera: str

    def __post_init__(self) -> None:
        if "=" in self.type:
            try:
                load_water(self.type)
            except ValueError as error:
                raise ValueError(f"type: {error}") from None
        elif not is_table(self.type):
            checks.one_of("type", self.type, (*JERLOV_TYPES, "contents", "the name of a CSV file"))


@dataclass(frozen=True)
class _Coefficients(_Table):
    a_per_m: _RGB
    b_per_m: _RGB
    G_per_m: _RGB
    kd_per_m: _RGB

    def __post_init__(self) -> None:
        for key, values in vars(self).items():
            _require_not_negative(key, values)
        if min(self.G_per_m) == 0:
            raise ValueError(f"G_per_m must be > 0, got {self.G_per_m}")


@dataclass(frozen=True)
class _Channels(_Table):
    """One rate for each channel, which picture and veil share: of water types, or `left`, a
    transmission that is the same at any distance.
    """

    type: str = ""
    beta_per_m: dict[str, _RGB] | None = None
    left_per_m: dict[str, _RGB] | None = None
    left: _RGB | None = None
    surface_light: float = 1.0

    def __post_init__(self) -> None:
        checks.within("surface_light", self.surface_light, 0.0)
        tables = (self.beta_per_m, self.left_per_m, self.left)
        if sum(table is not None for table in tables) != 1:
            raise ValueError("beta_per_m, left_per_m, left: give one of these three")
        if self.left is not None:
            _require_shares("left", self.left)
            if self.type or self.surface_light != 1:
                raise ValueError("left is all: type and surface_light would do nothing")
            return
        checks.one_of("type", self.type, self.beta_per_m or self.left_per_m or ())
        for name, beta in (self.beta_per_m or {}).items():
            _require_not_negative(f"beta_per_m.{name}", beta)
        for name, left in (self.left_per_m or {}).items():
            _require_shares(f"left_per_m.{name}", left)

    def rates(self) -> dict[str, Array]:
        """β of each water type, 1/m."""
        if self.beta_per_m is not None:
            return {name: np.array(beta) for name, beta in self.beta_per_m.items()}
        return {name: -np.log(np.array(left)) for name, left in (self.left_per_m or {}).items()}


@dataclass(frozen=True)
class _Veil(_Table):
    """V(0) between two ends, before it is dimmed; it comes in as the picture goes."""

    low: _RGB
    high: _RGB

    def __post_init__(self) -> None:
        _require_not_negative("low", self.low)
        _require_not_negative("high", self.high)
        if any(low > high for low, high in zip(self.low, self.high, strict=True)):
            raise ValueError(f"high must be ≥ low = {self.low}, got {self.high}")


@dataclass(frozen=True)
class _Medium(_Table):
    vertical_depth_m: float
    g: float
    mu: float
    depth_range_m: tuple[float, float] | None = None
    downwelling: Downwelling = "kd"
    dims: Dims = "both"
    veil_rate: VeilRate = "G"
    forward: Forward = "image"
    surfaces: Surfaces = "grey"
    color_matrix: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.has_spectra and self.color_matrix != 1:
            raise ValueError("color_matrix would do nothing: surfaces are grey")
        if self.depth_range_m is not None:
            low, high = self.depth_range_m
            checks.within("depth_range_m", low, 0.0)
            if not low <= self.vertical_depth_m <= high < math.inf:
                expected = f"hold vertical_depth_m = {self.vertical_depth_m}"
                raise ValueError(f"depth_range_m must {expected}, got {self.depth_range_m}")

    @property
    def has_spectra(self) -> bool:
        """Whether surfaces have them."""
        return self.surfaces == "spectral"


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
class _Development(_Table, Development):
    """As `Development`, whose numbers it has."""


@dataclass(frozen=True)
class Config(_Table):
    """All of a preset's file; the tables are named as there."""

    source: str
    color_space: ColorSpace
    medium: _Medium
    point_spread: _PointSpread
    distance: _Distance
    field: _Field
    water: _Spectral | None = None
    coefficients: _Coefficients | None = None
    exposure: Literal["none", "auto"] | float = "none"
    channels: _Channels | None = None
    veil: _Veil | None = None
    equation: str = ""
    light: list[dict[str, Any]] | None = None
    development: _Development = _Development()

    def __post_init__(self) -> None:
        require_exposure(self.exposure)
        if self.light is not None:
            Light.from_list(self.light).require_one()
        tables = (self.water, self.coefficients, self.channels)
        if sum(table is not None for table in tables) != 1:
            raise ValueError("water, coefficients, channels: give one of these three tables")
        if self.channels is not None:
            self._require_channels()
        if self.water is None and self.medium.has_spectra:
            raise ValueError("medium.surfaces must be grey where the table water is missing")
        if self.coefficients is not None and self.choices():
            raise ValueError(f"medium: {', '.join(self.choices())} is for the table water alone")
        if self.water is not None and self.veil is not None and self.medium.dims == "veil":
            raise ValueError("medium.dims must be both or direct where a veil is given, got 'veil'")
        if self.coefficients is not None:
            _require_printed(self.coefficients, self.medium.g)

    def _require_channels(self) -> None:
        """Refuse what one rate for each channel leaves without meaning."""
        if self.veil is None:
            raise ValueError("veil is missing: channels have no scattering that it would come from")
        assert self.channels is not None
        down = ("beam", "none") if self.channels.left is None else ("none",)
        allowed = {"downwelling": down, "veil_rate": ("G",), "forward": ("image",)}
        for key, values in allowed.items():
            if getattr(self.medium, key) not in values:
                got = f"{getattr(self.medium, key)!r}"
                raise ValueError(f"medium.{key} must be {' or '.join(values)} here, got {got}")

    def choices(self) -> dict[str, str]:
        """How the medium differs from what `RandomUnderwater` draws."""
        values = {key: getattr(self.medium, key) for key in USUAL}
        choices = {key: value for key, value in values.items() if value != USUAL[key]}
        return choices if self.veil is None else {**choices, "veil": "given"}

    def waters(self) -> tuple[str, ...]:
        """Names of the water types that the file holds, or its spectra are known of."""
        if self.channels is not None:
            return tuple(self.channels.rates())
        return () if self.water is None else JERLOV_TYPES


def is_table(name: str) -> bool:
    """Whether a water or a camera is named by a CSV file."""
    return name.lower().endswith(".csv")


def _require_not_negative(key: str, values: _RGB) -> None:
    for value in values:
        checks.within(key, value, 0.0)


def _require_shares(key: str, values: _RGB) -> None:
    """Refuse what is no share of the light that is left."""
    for value in values:
        if not 0 < value <= 1:
            raise ValueError(f"{key} must be in (0, 1], got {value}")


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


def read_config(path: Path) -> Config:
    """What a preset's file holds.

    Raises:
        ValueError: if it is no TOML, or a key is unknown, missing, of the wrong type or out of
            range; names file and key.
        OSError: if the file cannot be read, or is none.
    """
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
        return TypeAdapter(Config).validate_json(table)
    except ValidationError as error:
        faults = "; ".join(_explain(dict(fault)) for fault in error.errors())
        raise ValueError(f"{path}: {faults}") from None


def _explain(error: dict[str, Any]) -> str:
    where = [str(part) for part in error["loc"]]
    key = ".".join(where)
    if error["type"] == "value_error":  # our own, which begins with the key
        return ".".join([*where, str(error["ctx"]["error"])])
    if error["type"] == "missing":
        return f"{key} is missing"
    if error["type"] == "unexpected_keyword_argument":
        keys = _keys(where[:-1])
        close = difflib.get_close_matches(where[-1], keys, n=1)
        hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(keys)}"
        return f"{key} is no key; {hint}"
    return f"{key}: {error['msg']}, got {error['input']!r}"


def _keys(tables: list[str]) -> list[str]:
    """The keys of the table at a path of tables."""
    table: Any = Config
    for name in tables:
        kind = next(field.type for field in fields(table) if field.name == name)
        table = next(t for t in (kind, *get_args(kind)) if is_dataclass(t))
    return [field.name for field in fields(table)]
