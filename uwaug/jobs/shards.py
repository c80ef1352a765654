"""Many pictures into Parquet files with the pictures inside, on any file system, by Ray Data.

Beside the folder of these shards, in one of its name with `.run` behind it, stands the recipe. What
is done stands in the shards alone: one that has no end was being written when the run was killed,
and does not count.
"""

import json
import logging
import os
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np

from uwaug.jobs.cluster import require_ray
from uwaug.jobs.one import named
from uwaug.jobs.recipe import Recipe
from uwaug.jobs.rows import Rows, hash_of

__all__ = ["SIZE", "Shards", "Tally"]

SIZE = 256
"""Rows of a shard: of pictures of half a megabyte, what one reads at once."""

_COLUMNS = {
    "key": "int64",
    "id": "string",
    "variant": "int64",
    "input": "string",
    "distance": "string",
    "output": "string",
    "problem": "string",
    "name": "string",
}
"""Of the rows of a run."""

_INNER = ("problem", "name")
"""Those of them that shards do not have."""

_BLOCK = 16
"""Rows that are handed to an actor at once, at most, and that a reader of shards gets at once."""


@dataclass
class Tally:
    """What the shards of a run hold.

    Attributes:
        rows, failed: how many; failed ones are rows without a picture.
        reasons: why they failed, of the first few.
    """

    rows: int = 0
    failed: int = 0
    reasons: list[str] = field(default_factory=list)


class Shards:
    """A folder of shards.

    Args:
        place: path of a folder; or s3://…, gs://…, hdfs://…, or fsspec+NAME://… of whatever else
            fsspec knows.

    Raises:
        ImportError: if Ray, or what serves the place, is not installed.
        ValueError: if nothing serves such a place.
    """

    def __init__(self, place: str) -> None:
        require_ray()
        import pyarrow.fs as fs

        where = place if "://" in place else os.path.abspath(place)
        try:
            self._files, path = fs.FileSystem.from_uri(where)
        except (OSError, ValueError) as error:
            raise ValueError(f"shards: no place {place}: {error}") from None
        self.place, self._path = place, path.rstrip("/")
        self._run = f"{self._path}.run"

    def prepare(self, recipe: Recipe, *, resume: bool = False, force: bool = False) -> None:
        """Make room before anything is done: Ray would add to what is there.

        Args:
            recipe: of the run.
            resume: go on where the same run was stopped.
            force: remove shards of an earlier run.

        Raises:
            ValueError: if there are files and neither is asked for; if the run that is to go on
                was another; or if no run is known that has written what is there.
            OSError: if the place cannot be read or written.
        """
        from pyarrow.fs import FileType

        found, known = self._found(), self._known()
        if found and not (resume or force):
            cure = "--resume to go on, --force to remove them, or another place"
            raise ValueError(f"{self.place} holds files, such as {found[0]}: {cure}")
        # --force must not remove what is somebody else's
        odd = [path for path in found if known is None or not path.endswith(".parquet")]
        if odd:
            cure = "choose another place, or move it"
            raise ValueError(f"{odd[0]} is no shard of a run that {self._run} knows: {cure}")
        if resume and known is not None:
            if known != json.loads(json.dumps(recipe.to_json())):
                cure = "give the same, or --force without --resume"
                raise ValueError(f"--resume: {self._run}/recipe.json is another recipe: {cure}")
            return
        for folder in (self._run, self._path):
            if self._files.get_file_info(folder).type != FileType.NotFound:
                self._files.delete_dir(folder)
            self._files.create_dir(folder, recursive=True)
        with self._files.open_output_stream(f"{self._run}/recipe.json") as file:
            file.write(json.dumps(recipe.to_json(), indent=1).encode())

    def _found(self) -> list[str]:
        """The files that are there."""
        from pyarrow.fs import FileSelector, FileType

        inside = FileSelector(self._path, recursive=True, allow_not_found=True)
        listed = self._files.get_file_info(inside)
        return [one.path for one in listed if one.type == FileType.File]

    def _known(self) -> Any:
        """The recipe of the run that has written here; None if there was none."""
        try:
            with self._files.open_input_stream(f"{self._run}/recipe.json") as file:
                return json.loads(file.read())
        except (FileNotFoundError, ValueError):
            return None

    def write(
        self, rows: Rows, recipe: Recipe, count: int, *, size: int = SIZE, progress: bool = False
    ) -> None:
        """Degrade the rows that are not in the shards, and write them into some more.

        Args:
            rows: which pictures.
            recipe: what is done to them.
            count: how many rows there are.
            size: rows of a shard, at least, but of the last.
            progress: whether Ray draws how far it is.

        Raises:
            OSError: if Ray fails, or the place cannot be written.
        """
        import pyarrow as pa
        import ray

        from uwaug.jobs.ray import degrade

        logging.getLogger("ray.data").setLevel(logging.ERROR)
        total = max(1, int(ray.cluster_resources().get("CPU", 1)))
        schema, done = pa.schema(list(_COLUMNS.items())), self._done()
        # 8 for each actor, so that none of them works alone at the end
        block = max(1, min(_BLOCK, size, count // (8 * total)))
        lines = (line for line in _lines(rows) if not _among(done, line["key"]))
        blocks = []
        while group := list(islice(lines, block)):
            blocks.append(pa.Table.from_pylist(group, schema))
        if not blocks:
            return
        made = degrade(ray.data.from_arrow(blocks), recipe).drop_columns(list(_INNER))
        made.context.enable_progress_bars = progress
        try:
            made.write_parquet(
                self._path,
                filesystem=self._files,
                min_rows_per_file=size,
                # else writing would wait for a core that the actors hold
                ray_remote_args={"num_cpus": 0},
                row_group_size=_BLOCK,
                schema=_schema(),
            )
        except ray.exceptions.RayError as error:
            raise OSError(f"Ray: {error}") from None

    def _done(self) -> Any:
        """The keys of the rows in the shards, in order; removes shards that have no end."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        keys = array("q")
        for path in self._found():
            try:
                column = pq.read_table(path, columns=["key"], filesystem=self._files)["key"]
            except pa.ArrowInvalid:
                self._files.delete_file(path)
            else:
                keys.extend(column.to_pylist())
        return np.sort(np.frombuffer(keys, dtype=np.int64))

    def tally(self, most: int) -> Tally:
        """Count what is in the shards; with at most so many reasons.

        Raises:
            OSError: if they cannot be read.
        """
        from pyarrow.dataset import dataset

        found = Tally()
        shards = dataset(self._path, filesystem=self._files, format="parquet")
        for batch in shards.to_batches(columns=["input", "status", "reason"]):
            found.rows += len(batch)
            for row in batch.to_pylist():
                if row["status"] == "failed":
                    found.failed += 1
                    if len(found.reasons) < most:
                        found.reasons.append(named(row["input"], row["reason"]))
        return found


def _among(keys: Any, key: int) -> bool:
    place = int(np.searchsorted(keys, key))
    return place < len(keys) and int(keys[place]) == key


def _lines(rows: Rows) -> Iterator[dict[str, Any]]:
    for row in rows:
        yield {
            "key": hash_of(row.key),
            "id": row.id,
            "variant": row.variant,
            "input": str(row.input),
            "distance": None if row.distance is None else str(row.distance),
            "output": row.place.as_posix(),
            "problem": row.problem,
            "name": row.name,
        }


def _schema() -> Any:
    """Of shards, with what Hugging Face's `datasets` need to show pictures."""
    import pyarrow as pa

    from uwaug.jobs.ray import added_schema

    known: dict[str, Any] = {}
    schema = pa.schema([*pa.schema(list(_COLUMNS.items())), *added_schema()])
    for name in _INNER:
        schema = schema.remove(schema.get_field_index(name))
    for column in schema:
        kind = "float64" if column.type == pa.float64() else str(column.type)
        known[column.name] = {"dtype": kind, "_type": "Value"}
    known["image"] = {"_type": "Image"}
    return schema.with_metadata({"huggingface": json.dumps({"info": {"features": known}})})
