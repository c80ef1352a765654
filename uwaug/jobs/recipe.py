"""What is done to every picture of a run: a value that workers and sidecars can hold."""

import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from uwaug._support import checks
from uwaug._support.hashing import FileHash
from uwaug.distance.sample import Scaling, as_unknown
from uwaug.fitting import Fit, load_fit
from uwaug.formation.exposure import require_exposure
from uwaug.formation.setup import Setup
from uwaug.io.distances import DistanceFormat
from uwaug.jobs.waters import DrawnWaters, KnownWater, Waters
from uwaug.labels import LabelSource, open_labels
from uwaug.light.light import Light
from uwaug.optics.scattering import Scattering
from uwaug.presets.preset import load_preset, preset_files
from uwaug.transforms.codec import decode_options
from uwaug.transforms.params import DEVELOPED, QUANTITIES
from uwaug.transforms.random_underwater import RandomUnderwater

_FIXED: dict[str, Any] = {
    **dict.fromkeys(("color_matrix", *DEVELOPED)),
    "contrast": None,
    "vertical_depth": 1.0,
    "field_probability": 0.0,
    "mu": Scattering.CALIBRATED.mu,
}
"""Options of one water, as it is in nature, instead of a random one."""


_SPECTRA = ("waters", "cameras")
"""Options that may name CSV files."""


@dataclass(frozen=True)
class Recipe:
    """What is done to every picture. One of `water`, `preset`, `fit` and `random` says which water.

    Attributes:
        water: what `uwaug.load_water` takes, as it is in nature, or the text of `Constituents`;
            beside a preset, in place of the preset's.
        preset: name, or path of a TOML file.
        fit: path of what `uwaug fit` has written.
        random: waters as `RandomUnderwater` draws them.
        options: of `RandomUnderwater`, as JSON and TOML have them: ranges as lists, a point spread
            as a table. Of a fit, and of a preset without spectra, only what says how it is seen:
            near, far, gamma, exposure, light, and numbers of `uwaug.Development`.
        distance: what distance files hold; "depth" in JSON.
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
    distance: DistanceFormat = field(default_factory=DistanceFormat)
    seed: int = 0
    labels: str | None = None
    min_contrast: float | None = None
    void: int | None = None
    keep_terms: bool = False
    content: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        named = {"water": self.water, "preset": self.preset, "fit": self.fit}
        chosen = [name for name, value in named.items() if value is not None]
        chosen += ["random"] if self.random else []
        if len(chosen) != 1 and chosen != ["water", "preset"]:
            got = " and ".join(chosen) or "none"
            raise ValueError(f"expected one of water, preset, fit and random, got {got}")
        if self.min_contrast is not None:
            checks.within("min_contrast", self.min_contrast, 0.0, 1.0)
        if self.labels is None and (self.min_contrast, self.void) != (None, None):
            raise ValueError("min_contrast and void would do nothing: there are no labels")

    def resolved(self) -> "Recipe":
        """The recipe with absolute paths and the content of its files, so that a sidecar holds from
        any folder, and knows when they change.

        Raises:
            TypeError, ValueError, OSError: if no picture could be degraded with it.
        """
        options = dict(self.options)
        spectra = {name: _absolute_spectra(options[name]) for name in _SPECTRA if name in options}
        options |= spectra
        recipe = replace(
            self,
            water=_absolute(self.water, ".csv"),
            preset=_absolute(self.preset, ".toml"),
            fit=_absolute(self.fit),
            labels=_absolute(self.labels),
            options=options,
            distance=replace(self.distance, network=_absolute(self.distance.network)),
        )
        for name, value in options.items():
            # replays go on with what earlier versions have taken
            if name in QUANTITIES and self.distance.map_kind not in QUANTITIES[name].maps:
                kind = f"distance_kind is {self.distance.kind!r}"
                raise ValueError(f"{name} would do nothing: {kind}, got {value!r}")
        recipe.open()
        paths = [recipe.water, recipe.preset, recipe.fit, recipe.labels, recipe.distance.network]
        paths += [name for names in spectra.values() for name in names]
        if recipe.preset is not None:
            paths += [os.path.abspath(path) for path in preset_files(recipe.preset)]
        weights = f"{recipe.distance.network}.data"  # where ONNX has those of large networks
        paths += [weights] if os.path.exists(weights) else []
        content = {}
        for path in paths:
            if isinstance(path, str) and os.path.isabs(path) and not os.path.isdir(path):
                content[path] = FileHash.of(path).sha256
        return replace(recipe, content=content)

    def require_content(self) -> None:
        """Refuse a recipe whose files have changed.

        Raises:
            ValueError: names the file.
        """
        for path, sha256 in self.content.items():
            if FileHash.of(path).sha256 != sha256:
                raise ValueError(f"{path} has changed since the record was written")

    def to_json(self) -> dict[str, Any]:
        """As what JSON holds."""
        values = asdict(self)
        names = ["depth" if name == "distance" else name for name in values]
        return dict(zip(names, values.values(), strict=True))

    @staticmethod
    def from_json(values: Mapping[str, Any]) -> "Recipe":
        """The inverse of `to_json`.

        Raises:
            ValueError, TypeError: if they are those of no recipe.
        """
        names = [option.name for option in fields(Recipe)]
        names[names.index("distance")] = "depth"
        odd = sorted(set(values) ^ set(names))
        if odd:
            expected = ", ".join(names)
            raise ValueError(f"recipe: expected {expected}, they differ in {', '.join(odd)}")
        others = {name: value for name, value in values.items() if name != "depth"}
        return Recipe(**others, distance=DistanceFormat(**values["depth"]))

    def open_labels(self) -> LabelSource | None:
        """Where labels come from; None if none are asked for. One process of a run opens it.

        Raises:
            ValueError, OSError: as `uwaug.labels.open_labels`.
        """
        return None if self.labels is None else open_labels(self.labels, void=self.void)

    def open(self) -> Waters:
        """Where pictures get their water.

        Raises:
            TypeError, ValueError, OSError: as the transform, the preset or the fit.
        """
        options = decode_options(self.options)
        if self.fit is not None:
            fit = load_fit(self.fit)
            name = f"fit {fit.model if isinstance(fit, Fit) else fit.type}"
            setup = Setup(fit.medium, focal_px=self.distance.focal_px)
            return self._known(name, setup, None, Scaling(1.0, 5.0, 1.0), options)
        if self.preset is not None:
            preset = load_preset(self.preset, water=self.water)
            if not preset.drawable:
                setup = preset.setup(self.distance.focal_px)
                scaling = Scaling(preset.near, preset.far, preset.gamma)
                return self._known(preset.name, setup, preset.uneven, scaling, options)
        options |= {"distance_kind": self.distance.map_kind, "unknown": self.distance.unknown}
        if self.preset is not None:
            from_preset = RandomUnderwater.from_preset
            return DrawnWaters(from_preset(self.preset, water=self.water, **options))
        if self.water is not None:
            fixed = {**_FIXED, "waters": [self.water]}
            if {"contrast", "visibility"} & set(options):
                del fixed["contrast"]
            options = {**fixed, **options}
        return DrawnWaters(RandomUnderwater(**options))

    def _known(
        self,
        name: str,
        setup: Setup,
        field_range: tuple[float, float] | None,
        scaling: Scaling,
        options: Mapping[str, Any],
    ) -> KnownWater:
        """A known medium, and those of the options that say how it is seen."""
        for option, value in options.items():
            is_number = isinstance(value, (int, float))
            if option in Scaling._fields and is_number:
                scaling = scaling._replace(**{option: value})
            elif option in DEVELOPED and is_number:
                development = replace(setup.development, **{option: value})
                setup = replace(setup, development=development)
            elif option == "exposure":
                require_exposure(value)
                setup = replace(setup, exposure=value)
            elif option == "light" and isinstance(value, Light):
                setup = replace(setup, light=value.require_one())
            else:
                got = f"{name} is one known medium, and nothing is drawn"
                raise ValueError(f"{option}={value!r} would do nothing: {got}")
        kind, unknown = self.distance.map_kind, as_unknown(self.distance.unknown)
        return KnownWater(name, setup, field_range, kind, unknown, scaling)


def changes(recipe: Mapping[str, Any], before: Mapping[str, Any]) -> list[str]:
    """What of a recipe would make another picture than an earlier one has, in words; but for the
    content of files.

    Args:
        recipe, before: as JSON has them.
    """
    return [
        line for name in recipe if name != "content" for line in _changes_of(name, recipe, before)
    ]


def _changes_of(name: str, recipe: Mapping[str, Any], before: Mapping[str, Any]) -> Iterator[str]:
    """The changes of an option; of a table, what in it."""
    now, then = recipe.get(name), before.get(name)
    if isinstance(now, Mapping) and isinstance(then, Mapping):
        for key in {**now, **then}:
            yield from _changes_of(key, now, then)
    elif now != then and not (name == "unknown" and _same_unknown(now, then)):
        yield f"{name}={now!s:.40}, was {then!s:.40}"


def _same_unknown(now: Any, then: Any) -> bool:
    """Whether a picture that is there would be the same: made although unknown pixels are an error,
    it has none; and where they were filled, it would not be skipped.
    """
    return bool(then == "error" or (then == "fill" and now == "skip"))


def _absolute_spectra(names: Any) -> Any:
    """Waters or cameras, with absolute paths of files: a list, or a mapping to weights."""
    if isinstance(names, Mapping):
        return {_absolute(name, ".csv"): weight for name, weight in names.items()}
    listed = names if isinstance(names, list | tuple) else [names]
    return [_absolute(name, ".csv") for name in listed]


def _absolute(path: Any, ending: str = "") -> Any:
    """The absolute path of a file; what has another end is a name."""
    named = isinstance(path, str) and path.lower().endswith(ending)
    return os.path.abspath(path) if named else path
