"""The sidecar of a picture that a run has written: what it was made of, and how to make it again.

It is put in place before its picture is. A picture without a sidecar is therefore none of a run's,
and a sidecar whose picture is missing is of a run that was stopped there.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from uwaug._support.atomic import require_regular, written_whole
from uwaug._support.hashing import FileHash

TERMS = ("direct", "forward", "backscatter")
"""Of the light, as files beside a picture are called."""

_FORMAT = 2

_DEFAULTS_OF_1: dict[str, Any] = {
    "waters": ["II", "III", "1C", "3C", "5C", "7C", "9C"],
    "contrast": [0.1, 0.6],
    "vertical_depth": [0.0, 10.0],
    "mu": 0.075,
    "surfaces": "grey",
    **dict.fromkeys(("color_matrix", "compensation", "white_balance", "gamut")),
}
"""Options of `RandomUnderwater` as they were by default where format 1 was written."""


@dataclass(frozen=True)
class Sidecar:
    """What is written beside a picture, as JSON.

    Attributes:
        uwaug, torch: versions.
        id, variant: of the item.
        input: the picture's file.
        distance: its file; metres; or None, of a depth network.
        output: the name of the picture that was written.
        sha256, bytes: of its file.
        recipe: as JSON has it, see `Recipe.to_json`.
        drawn: all that is random, and what it came to: of `RandomUnderwater`, its record.
        water, visibility, contrast: name; m; mean share of contrast that is left. None if unknown.
        notes: what is worth knowing.
        labels: what `uwaug.labels.with_contrast` returns, with "output"; None if there are none.
        label_file: that they are from.
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
            values = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise ValueError(f"{path}: is no record of a picture: {error}") from None
        names = {field.name for field in fields(Sidecar)}
        if not isinstance(values, Mapping) or set(values) != names | {"format"}:
            raise ValueError(f"{path}: is no record of a picture that uwaug has written")
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
            raise ValueError(f"{path}: is no record of a picture that uwaug has written") from None
        return Sidecar(**attributes)


def _recipe_of_1(recipe: Any) -> Any:
    """A recipe of format 1 with the options that were meant where they are not named."""
    if not isinstance(recipe, Mapping) or not (recipe.get("random") or recipe.get("water")):
        return recipe
    if recipe.get("preset"):  # has options of its own
        return recipe
    options = recipe.get("options") or {}
    meant = dict(_DEFAULTS_OF_1)
    if recipe.get("water"):
        del meant["waters"], meant["contrast"], meant["vertical_depth"]
    if "visibility" in options:
        meant.pop("contrast", None)
    return {**recipe, "options": {**meant, **options}}


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
