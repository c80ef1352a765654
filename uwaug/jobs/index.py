"""index.csv of a run: a line for each picture. And what labels have one file of for all of them."""

import csv
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from uwaug._support.atomic import require_regular, written_whole
from uwaug.io.read import name_of
from uwaug.jobs.items import Item, Items, is_index, labels_file
from uwaug.jobs.picture import Result
from uwaug.jobs.recipe import Recipe
from uwaug.jobs.sidecar import sidecar_of
from uwaug.labels import LabelSource
from uwaug.labels.layout import DESCRIPTION

COLUMNS = (
    "id",
    "variant",
    "input",
    "distance",
    "output",
    "water",
    "visibility",
    "contrast",
    "seconds",
    "status",
    "reason",
    "notes",
)
"""Of an index: visibility in m, contrast as the mean share that is left."""


class Index:
    """Takes down what became of pictures, as lines of a CSV file that is being written."""

    def __init__(self, out: Path, file: Any) -> None:
        self._out = out
        # an earlier version's index may have other columns
        self._writer = csv.DictWriter(file, COLUMNS, extrasaction="ignore", lineterminator="\n")
        self._writer.writeheader()
        self._outputs: set[str] = set()

    def add(self, result: Result) -> None:
        """Take down one."""
        item, sidecar = result.item, result.sidecar
        line: dict[str, Any] = {
            "id": item.id,
            "variant": item.variant,
            "input": self._path(item.input),
            "distance": self._path(item.distance),
            "output": item.place.as_posix(),
            "seconds": f"{result.seconds:.3f}",
            "status": result.status,
            "reason": result.reason,
        }
        if sidecar is not None:
            line["water"] = sidecar.water
            line["notes"] = sidecar.noted
            for name in ("visibility", "contrast"):
                value = getattr(sidecar, name)
                line[name] = None if value is None else f"{value:.4g}"
        self._outputs.add(line["output"])
        self._writer.writerow(line)

    def leave_out(self, items: Iterable[Item]) -> None:
        """Take over no lines of these from an earlier index."""
        self._outputs.update(item.place.as_posix() for item in items)

    def keep_others(self, path: Path) -> None:
        """Take over the lines of an earlier index, of pictures that were not in this run."""
        for line in _lines_in(path):
            gone = line["status"] != "failed" and not (self._out / line["output"]).exists()
            if line["output"] not in self._outputs and not gone:
                self._writer.writerow(line)

    def _path(self, where: Any) -> Any:
        """From the folder of the index, as manifests are read."""
        if where is None or isinstance(where, (int, float)):
            return where
        try:
            return os.path.relpath(name_of(where), self._out)
        except ValueError:  # of another drive
            return os.path.abspath(name_of(where))


@contextmanager
def index_of(out: Path, written_over: Iterable[Item] | None = None) -> Iterator[Index]:
    """index.csv in a folder, which is there once all went well. Pictures of earlier runs stay in
    it.

    Args:
        out: the folder.
        written_over: pictures that are made anew where others are. Their lines go at once: if the
            run is killed, they would tell of what is there no more.

    Raises:
        ValueError: if index.csv is there and is none.
        OSError: if it cannot be written.
    """
    path = out / "index.csv"
    if path.exists():
        require_regular(path)
        if not is_index(path):
            raise ValueError(f"{path} is no index of uwaug: choose another folder, or move it")
        if written_over is not None:
            with _lines_of(out, path) as index:
                index.leave_out(written_over)
    with _lines_of(out, path) as index:
        yield index


@contextmanager
def _lines_of(out: Path, path: Path) -> Iterator[Index]:
    """An index in place of the one at `path`, whose other lines it takes over in the end."""
    with (
        written_whole(path) as part,
        part.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file,
    ):
        index = Index(out, file)
        yield index
        index.keep_others(path)


def require_alike(items: Items, recipe: Recipe) -> None:
    """Refuse, before anything is done, a run whose labels cannot stand beside those of other
    pictures in its folder. The sidecars of these are read.

    Raises:
        ValueError: if labels that have one file for all are those of another folder, or have
            changed; or if those of the other pictures are ignored below another contrast.
    """
    others = set(_outputs_in(items.out)).difference(item.output for item in items)
    for _ in _labels_in(items, recipe, sorted(others)):
        pass


def write_labels(items: Items, recipe: Recipe, source: LabelSource) -> None:
    """Write what labels have one file of for all pictures in the folder of a run: this run's, and
    those of earlier ones with the same labels. Their sidecars are read.

    Raises:
        ValueError: as `require_alike`.
        ValueError, OSError: as `LabelSource.write_run`.
    """
    outputs = list(_outputs_in(items.out))
    if items.name is not None and items.out / items.name not in outputs:
        outputs.append(items.out / items.name)
    records = list(_labels_in(items, recipe, outputs))
    if records:
        source.write_run(records, items.out)


def _labels_in(items: Items, recipe: Recipe, outputs: list[Path]) -> Iterator[Any]:
    """What sidecars of pictures hold of labels of a recipe; refuses what cannot stand together."""
    now = None if recipe.labels is None else recipe.content.get(recipe.labels)
    cure = "make all with --force, or choose another folder"
    for output in outputs:
        sidecar = sidecar_of(output)
        if sidecar is None or sidecar.labels is None or not output.exists():
            continue
        if sidecar.recipe.get("labels") != recipe.labels:
            description = items.out / DESCRIPTION
            if labels_file(items, recipe) == description and description.exists():
                got = f"{output} has labels of {sidecar.recipe.get('labels')}"
                raise ValueError(f"{got}: one data.yaml cannot tell of both, choose another folder")
            continue
        if sidecar.recipe.get("content", {}).get(recipe.labels) != now:
            got = f"{recipe.labels} has changed since {output} was made"
            raise ValueError(f"{got}: put it back, {cure}")
        least = sidecar.recipe.get("min_contrast")
        if least != recipe.min_contrast:
            got = f"{output} has labels with min_contrast={least}"
            here = f"this run has min_contrast={recipe.min_contrast}"
            raise ValueError(f"{got}, and {here}: give the same, {cure}")
        yield sidecar.labels


def _outputs_in(out: Path) -> Iterator[Path]:
    """The pictures that the index of a folder knows of, if it has one."""
    for line in _lines_in(out / "index.csv"):
        if line["status"] != "failed":
            yield out / line["output"]


def _lines_in(path: Path) -> Iterator[dict[str, str]]:
    """The lines of an index, if there is one; but for those that are cut off, as a copy that was
    stopped has them.

    Raises:
        ValueError: if it is damaged otherwise; names it.
    """
    if not path.exists():
        return
    with path.open(encoding="utf-8", newline="") as file:
        try:
            for line in csv.DictReader(file):
                if line.get("output") and line.get("status"):
                    yield line
        except (csv.Error, UnicodeDecodeError) as error:
            raise ValueError(f"{path}: is damaged: {error}: move it") from None
