"""The sidecar of a picture that a run has written: what it was made of, and how to make it again.

It is put in place before its picture is. A picture without a sidecar is therefore none of a run's,
and a sidecar whose picture is missing is of a run that was stopped there.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from uwaug._support.atomic import require_regular, written_whole
from uwaug._support.hashing import FileHash
from uwaug._support.parse import from_json
from uwaug.transforms.codec import encode_options
from uwaug.transforms.random_underwater import UNDEVELOPED, hazy_options

TERMS = ("direct", "forward", "backscatter")
"""Of the light, as files beside a picture are called."""

NOTES_APART = " | "
"""Between notes in a cell of a table."""

_FORMAT = 2

_NUMBER = float | int | None

_KINDS = {
    "uwaug": str,
    "torch": str,
    "id": str,
    "variant": int,
    "input": FileHash,
    "distance": FileHash | _NUMBER,
    "recipe": Mapping,
    "drawn": Mapping,
    "water": str,
    "visibility": _NUMBER,
    "contrast": _NUMBER,
    "notes": list,
    "labels": Mapping | None,
    "label_file": FileHash | None,
    "beside": Mapping,
}
"""Of the values of a sidecar."""


@dataclass(frozen=True)
class Sidecar:
    """What is written beside a picture, as JSON.

    Attributes:
        uwaug, torch: versions.
        id, variant: of the item.
        input: the picture's file.
        distance: its file; metres; or None, of a depth network or drawn.
        output: the name of the picture that was written.
        sha256, bytes: of its file.
        recipe: as JSON has it, see `Recipe.to_json`.
        drawn: all that is random, and what it came to: of `RandomUnderwater`, its record.
        water, visibility, contrast: name; m; mean share of contrast that is left. None if unknown.
        notes: what is worth knowing.
        labels: what `uwaug.labels.with_contrast` returns, with "output"; None if there are none.
        label_file: that they are from.
        beside: SHA-256 of the files of labels and of terms that were written with it, by their
            names. Earlier versions do not tell.
    """

    uwaug: str
    torch: str
    id: str
    variant: int
    input: FileHash
    distance: FileHash | float | None
    output: str
    sha256: str
    bytes: int
    recipe: dict[str, Any]
    drawn: dict[str, Any]
    water: str
    visibility: float | None
    contrast: float | None
    notes: list[str]
    labels: Any = None
    label_file: FileHash | None = None
    beside: dict[str, str] = field(default_factory=dict)

    @property
    def noted(self) -> str:
        """The notes in one cell of a table."""
        return NOTES_APART.join(self.notes)

    def to_json(self) -> dict[str, Any]:
        """As what JSON holds."""
        return {"format": _FORMAT, **asdict(self)}

    def write(self, path: Path) -> None:
        """Write it, whole or not at all.

        Raises:
            OSError: if it cannot be written.
        """
        text = json.dumps(self.to_json(), indent=1, ensure_ascii=False) + "\n"
        with written_whole(path) as part:
            part.write_text(text, encoding="utf-8")

    @staticmethod
    def read(path: Path) -> "Sidecar":
        """Read one.

        Raises:
            ValueError: if the file is none; names it.
            OSError: if it cannot be read.
        """
        require_regular(path)
        try:
            values = from_json(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise ValueError(f"{path}: is no record of a picture: {error}") from None
        names = {attribute.name for attribute in fields(Sidecar)}
        foreign = f"{path}: is no record of a picture that uwaug has written"
        if not isinstance(values, Mapping):
            raise ValueError(foreign)
        values = {"beside": {}, **values}
        if set(values) != names | {"format"}:
            raise ValueError(foreign)
        if values["format"] not in (1, _FORMAT):
            got = values["format"]
            raise ValueError(f"{path}: expected a record of format {_FORMAT}, got {got}")
        attributes = {name: values[name] for name in names}
        if values["format"] == 1:
            attributes["recipe"] = _recipe_of_1(attributes["recipe"])
        try:
            for name in ("input", "distance", "label_file"):
                if isinstance(attributes[name], Mapping):
                    attributes[name] = FileHash(**attributes[name])
        except TypeError:
            raise ValueError(foreign) from None
        if not all(isinstance(attributes[name], kind) for name, kind in _KINDS.items()):
            raise ValueError(foreign)
        content = attributes["recipe"].get("content", {})
        if not isinstance(content, Mapping) or not _are_labels(attributes["labels"]):
            raise ValueError(foreign)
        output = attributes["output"]
        is_name = isinstance(output, str) and Path(output).name == output not in ("", "..")
        if not is_name:
            # records are handed on: none may say where on this machine is written
            raise ValueError(f"{path}: output must be a name without folders, got {output!r}")
        return Sidecar(**attributes)


def _are_labels(labels: Any) -> bool:
    """Whether a value is that of a sidecar's labels."""
    if labels is None:
        return True
    objects = labels.get("objects")
    named = all(isinstance(labels.get(name), str) for name in ("picture", "output"))
    return named and isinstance(objects, list) and all(map(_is_object, objects))


def _is_object(entry: Any) -> bool:
    kinds = {"key": int | str, "contrast": float | int, "ignored": bool}
    return isinstance(entry, Mapping) and all(
        isinstance(entry.get(name), kind) for name, kind in kinds.items()
    )


def _recipe_of_1(recipe: Any) -> Any:
    """A recipe of format 1, with those options that have other defaults since."""
    if not isinstance(recipe, Mapping) or recipe.get("preset") or recipe.get("fit"):
        return recipe  # presets and fits have all options of their own
    options = recipe.get("options") or {}
    named = hazy_options(options) if recipe.get("random") else {**UNDEVELOPED, **options}
    return {**recipe, "options": encode_options(named)}


def versions() -> tuple[str, str]:
    """Of uwaug and torch."""
    return version("uwaug"), str(torch.__version__)


def sidecar_of(picture: Path) -> Sidecar | None:
    """The sidecar of a picture; None if no run has written it."""
    beside = sidecar_path(picture)
    try:
        return Sidecar.read(beside) if beside.is_file() else None
    except (OSError, ValueError):
        return None


def sidecar_path(output: Path) -> Path:
    """The sidecar of a picture that is written to `output`."""
    return output.with_name(output.name + ".json")


def terms_path(output: Path, term: str) -> Path:
    """The file of one of a picture's terms."""
    return output.with_name(f"{output.stem}_{term}{output.suffix}")
