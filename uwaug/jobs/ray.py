"""Data sets of Ray Data under water: `uwaug.jobs.ray.degrade(dataset, recipe)`."""

import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from PIL import Image

from uwaug.io.write import FORMATS, require_format
from uwaug.jobs.cluster import begin_on, require_ray
from uwaug.jobs.index import number_of
from uwaug.jobs.one import Outcome, degrade_file, reason_of
from uwaug.jobs.recipe import Recipe
from uwaug.jobs.record import Source
from uwaug.jobs.row import Row
from uwaug.jobs.run import alone

__all__ = ["ADDED", "added_schema", "degrade"]

_GIVEN = ("id", "variant", "input", "distance", "output", "problem", "name")

ADDED = ("image", "water", "visibility", "contrast", "record", "status", "reason")
"""Columns that `degrade` adds."""

_SHARE = 0.5
"""Of a core, that each actor asks for. It uses a whole one; but if actors asked for all of them,
what reads the pictures would wait for ever."""

_BATCH = 8
"""Pictures that an actor holds at once."""


def degrade(
    dataset: Any,
    recipe: Recipe,
    *,
    workers: int | tuple[int, int] | None = None,
    ending: str | None = None,
) -> Any:
    """Degrade the pictures of a data set of Ray Data.

    The same row and recipe give the same bytes as `uwaug degrade`, in any order, on any machine:
    what is random follows from `id` and `variant`.

    Args:
        dataset: a `ray.data.Dataset` with the columns
            id: names of the pictures, no two alike;
            input: paths; bytes of picture files; or structs of both, {bytes, path}, as Hugging
                Face has them;
            distance, if the recipe has no depth network: the same of files of distances, or metres;
            output, if you like: names, whose ends say the format;
            variant, if you like: which of several of one picture, from 0.
        recipe: what is done to them. Files that it names must be there on every machine.
        workers: actors, or the least and the most of them; None: one for each core that Ray has
            now. Each uses one core.
        ending: of pictures without an output, such as ".png"; None: as of the picture.

    Returns:
        A `ray.data.Dataset` of as many rows, with all columns that were there and
            image: structs {bytes, path} of the picture's file; null where status is "failed";
            water, visibility (m), contrast: its name, and what is left to see;
            record: JSON of what stands beside a picture that is written to a file;
            status: "done" or "failed";
            reason: why it failed. One bad picture does not stop the rest.

    Raises:
        ImportError: if Ray is not installed.
        ValueError: if a column is missing or has the name of one that is added, or the ending is
            unknown.
    """
    require_ray()
    import ray

    if ending is not None:
        require_format(f"picture{ending}")
    _require_columns(dataset.columns() or [])
    total = int(ray.cluster_resources().get("CPU", 1))
    if workers is None:
        workers = max(1, total)
    compute = ray.data.ActorPoolStrategy(size=workers)
    if isinstance(workers, tuple):
        compute = ray.data.ActorPoolStrategy(min_size=workers[0], max_size=workers[1])
    return dataset.map_batches(
        _Worker,
        fn_constructor_args=(recipe, ending, os.getcwd()),
        compute=compute,
        batch_size=_BATCH,
        batch_format="pyarrow",
        num_cpus=_SHARE if total > 1 else 0,
        udf_modifying_row_count=False,
    )


def _require_columns(names: list[str]) -> None:
    for name in ("id", "input"):
        if name not in names:
            raise ValueError(f"dataset: expected columns id and input, got {', '.join(names)}")
    twice = sorted(set(names) & set(ADDED))
    if twice:
        cure = "see ray.data.Dataset.rename_columns"
        raise ValueError(f"dataset has a column {twice[0]}, which would be added: {cure}")


class _Worker:
    """An actor."""

    def __init__(self, recipe: Recipe, ending: str | None, folder: str) -> None:
        import ray

        begin_on(folder)
        self._recipe, self._ending = recipe, ending
        self._job = partial(degrade_file, recipe=recipe)
        # what it died over may come again: from now on, each picture has a process of its own
        self._careful = bool(ray.get_runtime_context().was_current_actor_reconstructed)

    def __call__(self, batch: Any) -> Any:
        import pyarrow as pa

        rows = batch.select([name for name in _GIVEN if name in batch.column_names]).to_pylist()
        results = [self._result(row) for row in rows]
        schema = added_schema()
        added = pa.Table.from_pylist(results, schema)
        for name in ADDED:
            batch = batch.append_column(schema.field(name), added[name])
        return batch

    def _result(self, values: Mapping[str, Any]) -> dict[str, Any]:
        try:
            with tempfile.TemporaryDirectory(prefix="uwaug-") as folder:
                return self._made(values, Path(folder))
        except Exception as error:
            return {"status": "failed", "reason": reason_of(error)}

    def _made(self, values: Mapping[str, Any], folder: Path) -> dict[str, Any]:
        """The added columns of a row, by way of files in a folder that is removed."""
        name = values["id"]
        if not isinstance(name, str) or not name:
            raise ValueError(f"id: expected a name, got {name!r}")
        given, known = _file_of(values["input"], folder / "input")
        if not isinstance(given, Path):
            raise ValueError(f"input: expected a path or bytes, got {given!r}")
        where, where_known = _file_of(values.get("distance"), folder / "distance")
        output = values.get("output") or _named(name, self._ending or _ending_of(given, known))
        row = Row(
            name,
            given,
            where,
            folder / f"output{Path(output).suffix}",
            int(values.get("variant") or 0),
            values.get("problem"),
            values.get("name") or name,
        )
        outcome = alone(self._job, row) if self._careful else self._job(row)
        if outcome.record is None:
            # the folder is gone when this is read
            reason = str(outcome.reason).replace(f"{folder}/", "")
            return {"status": "failed", "reason": reason}
        return _columns(outcome, str(output), known, where_known)


def _columns(
    outcome: Outcome, output: str, known: str | None, where_known: str | None
) -> dict[str, Any]:
    record = outcome.record
    assert record is not None
    record = replace(record, output=Path(output).name)
    if record.labels is not None:
        record = replace(record, labels={**record.labels, "output": output})
    if known is not None:
        record = replace(record, input=replace(record.input, path=known))
    if where_known is not None and isinstance(record.distance, Source):
        record = replace(record, distance=replace(record.distance, path=where_known))
    return {
        "image": {"bytes": outcome.row.output.read_bytes(), "path": output},
        "water": record.water,
        "visibility": record.visibility,
        "contrast": record.contrast,
        "record": json.dumps(asdict(record), ensure_ascii=False),
        "status": "done",
    }


def _file_of(value: Any, path: Path) -> tuple[Path | float | None, str | None]:
    """The file of a value, or its metres; and, of bytes, by what name they are known.

    Bytes are put into a file: what reads files reads them too, by the same rules.
    """
    known = path.name
    if isinstance(value, Mapping):
        known = value.get("path") or known
        value = value.get("path") if value.get("bytes") is None else value["bytes"]
    if isinstance(value, bytes):
        path.write_bytes(value)
        return path, known
    if value is None or value == "":
        return None, None
    metres = number_of(str(value))
    return (Path(value) if metres is None else metres), None


def _named(name: str, ending: str) -> str:
    path = Path(name)
    return str(path.with_suffix(ending)) if path.suffix.lower() in FORMATS else name + ending


def _ending_of(path: Path, known: str | None) -> str:
    """Of the file to write: as of the picture's name, else as of its content."""
    suffix = Path(known or path).suffix.lower()
    if suffix in FORMATS:
        return suffix
    with Image.open(path) as image:
        kind = image.format
    for suffix, format in FORMATS.items():
        if format == kind:
            return suffix
    raise ValueError(f"input: expected a picture that can be written as {kind}: give an ending")


def added_schema() -> Any:
    """The `pyarrow.Schema` of the columns that `degrade` adds."""
    import pyarrow as pa

    kinds = {
        "image": pa.struct({"bytes": pa.binary(), "path": pa.string()}),
        "visibility": pa.float64(),
        "contrast": pa.float64(),
    }
    return pa.schema([(name, kinds.get(name, pa.string())) for name in ADDED])
