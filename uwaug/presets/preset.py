"""Presets: options of `RandomUnderwater` in TOML files."""

import os
import tomllib
from pathlib import Path
from typing import Any

from uwaug._support.atomic import read_text
from uwaug.formation.setting import Setting
from uwaug.optics.camera import Camera
from uwaug.optics.water import Water
from uwaug.presets.files import preset_path
from uwaug.transforms.random_development import RandomDevelopment
from uwaug.transforms.random_underwater import RandomUnderwater
from uwaug.transforms.random_water import RandomWater


def load_preset(
    name_or_path: str | os.PathLike[str],
    *,
    water: str | os.PathLike[str] | Water | None = None,
    camera: str | os.PathLike[str] | Camera | None = None,
) -> RandomUnderwater:
    """Load a preset, or the medium of a fit.

    Args:
        name_or_path: a name, see `list_presets`; the path of a TOML file, with tables for
            `RandomUnderwater.from_dict`; or of a JSON file that `uwaug fit` has written. CSV files
            that a file names lie beside it.
        water, camera: replace the preset's, see `uwaug.load_water` and `uwaug.load_camera`.

    Raises:
        ValueError: the name is unknown; the file does not suit (names the key); or water or camera
            is given where the preset has coefficients.
        OSError: the file cannot be read.

    Examples:
        >>> preset = load_preset("survey", water="II")
        >>> preset.distance, preset.water.field
        (Relative(near=1.0, far=5.0, gamma=1.0, holes='error'), (0.7, 1.3))
        >>> preset.module().distance_range
        (0.7, 6.5)
    """
    given = {key: value for key, value in (("waters", water), ("camera", camera)) if value}
    if os.fspath(name_or_path).endswith(".json"):
        # fits load scipy.optimize, which a DataLoader worker can do without
        from uwaug.fitting.result import load_fit

        if given:
            raise ValueError(f"{name_or_path} holds coefficients: no water or camera replaces them")
        return _of_setting(load_fit(name_or_path).setting)
    path = preset_path(name_or_path)
    tables = read_tables(path)
    waters = tables["water"].get("waters")
    if given and isinstance(waters, dict) and waters.get("kind") == "Medium":
        raise ValueError(f"{path} holds coefficients: no water or camera replaces them")
    try:
        return RandomUnderwater.from_dict({**tables, "water": {**tables["water"], **given}})
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error


def read_tables(path: Path) -> dict[str, Any]:
    """Read the options of `RandomUnderwater` in a TOML file; those of water become a table."""
    text = read_text(path)
    try:
        tables = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: not a TOML file: {error}") from error
    water = tables.get("water", {})
    if not isinstance(water, dict):
        water = {"waters": water}
    named = {key: _beside(path, water[key]) for key in ("waters", "camera") if key in water}
    return {**tables, "water": {**water, **named}}


def _of_setting(setting: Setting) -> RandomUnderwater:
    """A transform of which nothing is random but the place of snow."""
    numbers = {name: getattr(setting.development, name) for name in RandomDevelopment.PLAIN}
    numbers["metered"] = bool(numbers["metered"])
    development = RandomDevelopment(**numbers, color_space=setting.color_space)
    water = RandomWater(setting.medium, field=None)
    return RandomUnderwater(water, light=setting.light, development=development, view=setting.view)


def _beside(path: Path, value: Any) -> Any:
    if isinstance(value, list):
        return [_beside(path, item) for item in value]
    return path.parent / value if str(value).lower().endswith(".csv") else value
