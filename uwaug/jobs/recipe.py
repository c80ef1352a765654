"""What is done to every picture of a run: a value that workers and records can hold."""

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from uwaug._support import checks
from uwaug._support.atomic import require_regular
from uwaug.distance.sample import Scaling
from uwaug.fitting.result import Fit
from uwaug.jobs.depth import Depth
from uwaug.jobs.model import Model, OneMedium, RandomWater
from uwaug.labels import LabelSource, open_labels
from uwaug.light.light import Light
from uwaug.optics.point_spread import PointSpread
from uwaug.presets.preset import Preset, load_preset
from uwaug.transforms.random_underwater import RandomUnderwater

__all__ = ["Recipe"]

_RANGES = ("near", "far", "gamma")
"""Options that scale maps, which known media take too, as numbers."""

_FIXED: dict[str, Any] = {
    "contrast": None,
    "vertical_depth": 1.0,
    "field_probability": 0.0,
}
"""Options of one water, as it is in nature, instead of a random one."""


@dataclass(frozen=True)
class Recipe:
    """What is done to every picture. One of `water`, `preset`, `fit` and `random` says which water.

    Attributes:
        water: a Jerlov type, as it is in nature; beside a preset, in place of the preset's.
        preset: name, or path of a TOML file.
        fit: path of what `uwaug fit` has written.
        random: waters as `RandomUnderwater` draws them.
        options: of `RandomUnderwater`, as JSON and TOML have them: ranges as lists, a point spread
            as a table. Of a fit, and of a preset without spectra, near, far and gamma alone.
        depth: what distance files hold.
        seed: of all that is random.
        labels: COCO file, or folder of YOLO's files or of masks, see `uwaug.labels`.
        min_contrast: labels with less are marked as ignored; None for none.
        void: value of masks that means "ignored" already.
        keep_terms: whether direct, forward-scattered and backscattered light are written too.
        content: by path, the SHA-256 of each file that the recipe names.
    """

    water: str | None = None
    preset: str | None = None
    fit: str | None = None
    random: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)
    depth: Depth = field(default_factory=Depth)
    seed: int = 0
    labels: str | None = None
    min_contrast: float | None = None
    void: int | None = None
    keep_terms: bool = False
    content: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        given = {"water": self.water, "preset": self.preset, "fit": self.fit}
        chosen = [name for name, value in given.items() if value is not None]
        chosen += ["random"] if self.random else []
        if len(chosen) != 1 and chosen != ["water", "preset"]:
            got = " and ".join(chosen) or "none"
            raise ValueError(f"expected one of water, preset, fit and random, got {got}")
        if self.min_contrast is not None:
            checks.within("min_contrast", self.min_contrast, 0.0, 1.0)
        if self.labels is None and (self.min_contrast, self.void) != (None, None):
            raise ValueError("min_contrast and void would do nothing: there are no labels")

    def sealed(self) -> "Recipe":
        """The recipe with whole paths and the content of its files, so that a record holds from any
        folder, and knows when they change.

        Raises:
            TypeError, ValueError, OSError: if no picture could be degraded with it.
        """
        options = dict(self.options)
        if "cameras" in options:
            given = options["cameras"]
            names = [given] if isinstance(given, str) else list(given)
            options["cameras"] = [_whole(name, ".csv") for name in names]
        whole = replace(
            self,
            preset=_whole(self.preset, ".toml"),
            fit=_whole(self.fit),
            labels=_whole(self.labels),
            options=options,
            depth=replace(self.depth, network=_whole(self.depth.network)),
        )
        whole.model()
        whole.label_source()
        named = [whole.preset, whole.fit, whole.labels, whole.depth.network]
        content = {}
        for path in (*named, *options.get("cameras", ())):
            if path is not None and os.path.isabs(path) and not os.path.isdir(path):
                content[path] = sha256_of(path)
        return replace(whole, content=content)

    def require_content(self) -> None:
        """Refuse a recipe whose files have changed.

        Raises:
            ValueError: names the file.
        """
        for path, known in self.content.items():
            if sha256_of(path) != known:
                raise ValueError(f"{path} has changed since the record was written")

    def to_json(self) -> dict[str, Any]:
        """As what JSON holds."""
        return asdict(self)

    @staticmethod
    def from_json(values: Mapping[str, Any]) -> "Recipe":
        """The inverse of `to_json`.

        Raises:
            ValueError, TypeError: if they are those of no recipe.
        """
        known = [one.name for one in fields(Recipe)]
        odd = sorted(set(values) ^ set(known))
        if odd:
            raise ValueError(
                f"recipe: expected {', '.join(known)}, they differ in {', '.join(odd)}"
            )
        return Recipe(**{**values, "depth": Depth(**values["depth"])})

    def label_source(self) -> LabelSource | None:
        """Where labels come from: opened once in a process.

        Raises:
            ValueError, OSError: as `uwaug.labels.open_labels`.
        """
        return None if self.labels is None else _labels(self.labels, self.void)

    def model(self) -> Model:
        """What degrades pictures: made once in a process.

        Raises:
            TypeError, ValueError, OSError: as the transform, the preset or the fit.
        """
        # files were looked at when it was sealed
        return _made(json.dumps({**self.to_json(), "content": {}}, sort_keys=True))


@lru_cache(maxsize=1)
def _labels(path: str, void: int | None) -> LabelSource:
    return open_labels(path, void=void)


@lru_cache(maxsize=4)
def _made(text: str) -> Model:
    recipe = Recipe.from_json(json.loads(text))
    options = {name: _from_json(name, value) for name, value in recipe.options.items()}
    options |= {"distance_kind": recipe.depth.map_kind, "unknown": recipe.depth.unknown}
    if recipe.fit is not None:
        found = Fit.load(recipe.fit)
        medium = found.medium
        return OneMedium(
            f"fit {found.model}", medium, "srgb", "none", None, **_of_maps("a fit", options, None)
        )
    if recipe.preset is not None:
        preset = load_preset(recipe.preset, water=recipe.water)
        if not preset.drawable:
            return OneMedium(
                preset.name,
                preset.medium,
                preset.color_space,
                preset.exposure,
                preset.uneven,
                **_of_maps(f"preset {preset.name}", options, preset),
                light=preset.light,
                focal_px=recipe.depth.focal_px,
            )
        made = RandomUnderwater.from_preset(recipe.preset, water=recipe.water, **options)
        return RandomWater(made)
    if recipe.water is not None:
        fixed = {**_FIXED, "waters": [recipe.water]}
        if {"contrast", "visibility"} & set(options):
            del fixed["contrast"]
        return RandomWater(RandomUnderwater(**{**fixed, **options}))
    return RandomWater(RandomUnderwater(**options))


def _of_maps(what: str, options: Mapping[str, Any], preset: Preset | None) -> dict[str, Any]:
    """What a known medium takes of the options."""
    numbers = {"near": 1.0, "far": 5.0, "gamma": 1.0}
    if preset is not None:
        numbers = {"near": preset.near, "far": preset.far, "gamma": preset.gamma}
    kind, unknown = options["distance_kind"], options["unknown"]
    for name, value in options.items():
        if name in ("distance_kind", "unknown"):
            continue
        if name not in _RANGES or not isinstance(value, (int, float)):
            raise ValueError(f"{name}={value!r} would do nothing: {what} is one known medium")
        numbers[name] = value
    return {"kind": kind, "unknown": unknown, "scaling": Scaling(**numbers)}


def _from_json(name: str, value: Any) -> Any:
    """An option of `RandomUnderwater`: JSON and TOML know neither tuples nor width laws."""
    if name == "point_spread":
        return PointSpread(**value)
    if name == "light":
        return Light.from_list(value)
    numbers = isinstance(value, (list, tuple)) and len(value) == 2
    if numbers and all(isinstance(one, (int, float)) for one in value):
        return tuple(value)
    return value


def _whole(path: Any, ending: str = "") -> Any:
    """The whole path of a file; what has another end is a name."""
    named = isinstance(path, str) and path.lower().endswith(ending)
    return os.path.abspath(path) if named else path


def sha256_of(path: str | os.PathLike[str]) -> str:
    """Of a file's content.

    Raises:
        OSError: if it cannot be read.
    """
    require_regular(path)
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
