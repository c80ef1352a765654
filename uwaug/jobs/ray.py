"""Many pictures on Ray: on the cores of this machine, or of a cluster. Ray Data maps the `Degrader`
over the items of a run, into files or into Parquet shards with the pictures inside; or over a data
set of Ray Data: `uwaug.jobs.ray.degrade(dataset, recipe)`.

Beside a folder of shards, in one of its name with `.run` behind it, stands the recipe. What is done
stands in the shards alone: one that has no end was being written when the run was killed, and does
not count.
"""

import io
import json
import logging
import os
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

from PIL import Image

from uwaug._support import checks
from uwaug._support.atomic import held, remove_left
from uwaug._support.extras import require
from uwaug._support.parse import from_json
from uwaug.io.read import name_of, opened
from uwaug.io.write import FORMATS
from uwaug.jobs.items import Item, Items, labelled, metres_in
from uwaug.jobs.picture import Degrader, Result, names_together, reason_of
from uwaug.jobs.pool import alone, cores, use_one_thread
from uwaug.jobs.recipe import Recipe
from uwaug.jobs.remarks import Remarks
from uwaug.jobs.sidecar import NOTES_APART
from uwaug.labels import LabelSource

LOCAL = "local"
"""In place of an address: Ray is started on this machine, and ended with the run."""

ADDED = ("image", "water", "visibility", "contrast", "record", "status", "reason", "notes")
"""Columns that `degrade` adds."""

SIZE = 256
"""Rows of a shard: of pictures of half a megabyte, what one reads at once."""

_BLOCK = 16
"""Pictures that are handed to an actor at once, at most, and that a reader of shards gets at once.
"""

_BATCH = 8
"""Pictures of a data set that an actor holds at once."""

_PART = ".parquet.part"
"""End of the name of a shard that is being written anew, without the rows that failed."""

_SHARE = 0.5
"""Of a core, that each actor asks for. It uses a whole one; but if actors asked for all of them,
what reads the pictures would wait for ever."""

_SETTINGS = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # else a picture for which memory does not suffice is begun again for ever
    "RAY_task_oom_retries": "3",
}


def require_ray() -> None:
    """Refuse what needs Ray where it is not installed.

    Raises:
        ImportError: names the extra.
    """
    require("ray", "ray.data")


@contextmanager
def connected(address: str, workers: int | None = None) -> Iterator[int]:
    """Ray, for as long as it is needed; gives the number of its cores.

    Args:
        address: "local" starts it on this machine; "auto" finds a cluster that this machine is
            part of; or host:port. Where Ray has been started in this process, that is taken.
        workers: cores, of "local"; None: all that this process may use.

    Raises:
        ImportError: if Ray is not installed.
        OSError: if nothing answers there.
    """
    require_ray()
    import ray

    mine = not ray.is_initialized()
    if mine:
        for name, value in _SETTINGS.items():
            os.environ.setdefault(name, value)
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": "error"}
        if address == LOCAL:
            options |= {"num_cpus": workers or cores(), "include_dashboard": False}
        try:
            ray.init(address, **options)
        except (OSError, RuntimeError, ValueError) as error:
            cure = f"is Ray running there? {LOCAL} starts it on this machine"
            raise ConnectionError(f"no Ray at {address}: {error}: {cure}") from None
    try:
        yield _total()
    finally:
        if mine:
            ray.shutdown()


def run_on_ray(
    items: Iterable[Item],
    recipe: Recipe,
    *,
    resume: bool = False,
    force: bool = False,
    labels: LabelSource | None = None,
) -> Iterator[Result]:
    """Degrade pictures in files, and say in the order of `items` what became of each.

    The same files as of `uwaug.jobs.run`. Pictures whose process or machine dies are begun
    again on another.

    Args:
        items: which pictures.
        recipe: what is done to them. Files that it names must be there on every machine.
        resume, force, labels: as for `uwaug.jobs.run`.

    Raises:
        OSError: if Ray itself fails.
    """
    import ray

    source = recipe.open_labels() if labels is None else labels
    listed = list(labelled(items, source))
    dataset = _blocks(listed, _BLOCK)
    if dataset is None:
        return
    dataset.context.execution_options.preserve_order = True
    dataset.context.enable_progress_bars = False
    # what is begun again may have been written by then, but not reported
    options = {"resume": resume or not force, "force": force}
    mapped = _mapped(dataset, _IntoFiles, (recipe, os.getcwd(), options), batch_size=1)
    try:
        for row in mapped.iter_rows():
            for result in pickle.loads(row["results"]):
                kept = result.status == "kept" and not resume
                yield replace(result, status="done") if kept else result
    except ray.exceptions.RayError as error:
        raise OSError(f"Ray: {error}") from None
    finally:
        # what tasks that were killed have left
        for folder in {item.output.parent for item in listed}:
            remove_left(folder)


def degrade(
    dataset: Any,
    recipe: Recipe,
    *,
    workers: int | None = None,
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
        recipe: what is done to them. Files that it names must be there on every machine; but for
            its labels, which are read here.
        workers: actors; None: one for each core that Ray has now. Each uses one core.

    Returns:
        A `ray.data.Dataset` of as many rows, with all columns that were there and
            image: structs {bytes, path} of the picture's file; null where status is "failed";
            water, visibility (m), contrast: its name, and what is left to see;
            record: JSON of the sidecar of a picture that is written to a file;
            status: "done" or "failed";
            reason: why it failed. One bad picture does not stop the rest;
            notes: what is worth knowing.

    Raises:
        ImportError: if Ray is not installed.
        ValueError: if a column is missing or has the name of one that is added.
    """
    require_ray()
    names = dataset.columns() or []
    for name in ("id", "input"):
        if name not in names:
            raise ValueError(f"dataset: expected columns id and input, got {', '.join(names)}")
    twice = sorted(set(names) & set(ADDED))
    if twice:
        cure = "see ray.data.Dataset.rename_columns"
        raise ValueError(f"dataset has a column {twice[0]}, which would be added: {cure}")
    arguments = (recipe, os.getcwd(), {"in_memory": True}, recipe.open_labels())
    return _mapped(dataset, _OverRows, arguments, batch_size=_BATCH, workers=workers)


def _total() -> int:
    import ray

    return max(1, int(ray.cluster_resources().get("CPU", 1)))


def _mapped(
    dataset: Any,
    worker: type,
    arguments: tuple[Any, ...],
    *,
    batch_size: int,
    workers: int | None = None,
) -> Any:
    """A data set with a worker mapped over it, by as many actors as there are cores."""
    import ray

    total = _total()
    return dataset.map_batches(
        worker,
        fn_constructor_args=arguments,
        compute=ray.data.ActorPoolStrategy(size=workers or total),
        batch_size=batch_size,
        batch_format="pyarrow",
        num_cpus=_SHARE if total > 1 else 0,
    )


def _blocks(items: list[Item], size: int) -> Any:
    """A data set of items, some in each row; None if there are none."""
    import pyarrow as pa
    import ray

    # 8 for each actor, so that none of them works alone at the end
    size = max(1, min(_BLOCK, size, len(items) // (8 * _total())))
    remaining, blocks = iter(items), []
    while group := list(islice(remaining, size)):
        blocks.append(pa.table({"items": pa.array([pickle.dumps(group)], pa.large_binary())}))
    return ray.data.from_arrow(blocks) if blocks else None


class _Worker:
    """An actor: a `Degrader` in the folder of the run."""

    def __init__(self, recipe: Recipe, folder: str, options: dict[str, bool]) -> None:
        import ray

        use_one_thread()
        # paths are from there
        with suppress(OSError):
            os.chdir(folder)
        self._recipe, self._options = recipe, options
        self._degrader = Degrader(recipe, **options)
        # what it died over may come again: from now on, each picture has a process of its own
        self._careful = bool(ray.get_runtime_context().was_current_actor_reconstructed)

    def result(self, item: Item) -> Result:
        """What becomes of an item."""
        if self._careful:
            return alone(item, self._recipe, **self._options)
        return self._degrader(item)


class _IntoFiles(_Worker):
    def __call__(self, batch: Any) -> Any:
        import pyarrow as pa

        results = []
        for row in batch["items"].to_pylist():
            results.append(pickle.dumps([self.result(item) for item in pickle.loads(row)]))
        return pa.table({"results": pa.array(results, pa.large_binary())})


class _IntoShards(_Worker):
    def __call__(self, batch: Any) -> Any:
        import pyarrow as pa

        rows = []
        for row in batch["items"].to_pylist():
            for item in pickle.loads(row):
                result = self.result(item)
                distance = None if item.distance is None else str(item.distance)
                rows.append(
                    {
                        "id": item.id,
                        "variant": item.variant,
                        "input": str(item.input),
                        "distance": distance,
                        "output": item.place.as_posix(),
                        **_columns(result, item.place.as_posix()),
                    }
                )
        return pa.Table.from_pylist(rows, shard_schema())


class _OverRows(_Worker):
    """The rows of a data set, which keeps its columns."""

    def __init__(
        self,
        recipe: Recipe,
        folder: str,
        options: dict[str, bool],
        source: LabelSource | None,
    ) -> None:
        super().__init__(recipe, folder, options)
        self._source = source

    def __call__(self, batch: Any) -> Any:
        import pyarrow as pa

        names = ("id", "variant", "input", "distance", "output")
        rows = batch.select([name for name in names if name in batch.column_names]).to_pylist()
        schema = _added_schema()
        added = pa.Table.from_pylist([self._added(row) for row in rows], schema)
        for name in ADDED:
            batch = batch.append_column(schema.field(name), added[name])
        return batch

    def _added(self, row: Mapping[str, Any]) -> dict[str, Any]:
        try:
            item = self._item(row)
        except Exception as error:
            return {"status": "failed", "reason": reason_of(error)}
        return _columns(self.result(item), item.output.as_posix())

    def _item(self, row: Mapping[str, Any]) -> Item:
        id = row["id"]
        if not isinstance(id, str) or not id:
            raise ValueError(f"id: expected a name, got {id!r}")
        file, distance = _file_of(row["input"], "input"), _file_of(row.get("distance"), "distance")
        if file is None or isinstance(file, float):
            raise ValueError(f"input: expected a path or bytes, got {file!r}")
        output = row.get("output")
        if not output:
            ending, path = _ending_of(file), Path(id)
            output = path.with_suffix(ending) if path.suffix.lower() in FORMATS else id + ending
        variant = int(row.get("variant") or 0)
        # from no folder: its whole name is its place
        item = Item(id, file, distance, Path(output), variant, name=id, out=Path())
        (item,) = labelled([item], self._source)
        return item


def _columns(result: Result, output: str) -> dict[str, Any]:
    """The added columns of a row."""
    sidecar = result.sidecar
    if sidecar is None:
        return {"status": "failed", "reason": result.reason}
    return {
        "image": {"bytes": result.content, "path": output},
        "water": sidecar.water,
        "visibility": sidecar.visibility,
        "contrast": sidecar.contrast,
        "record": json.dumps(sidecar.to_json(), ensure_ascii=False),
        "status": "done",
        "notes": sidecar.noted,
    }


def _file_of(value: Any, name: str) -> Any:
    """A path, metres, or an open file of bytes, with the name by which they are known."""
    if isinstance(value, Mapping):
        name = value.get("path") or name
        value = value.get("path") if value.get("bytes") is None else value["bytes"]
    if isinstance(value, bytes):
        file = io.BytesIO(value)
        file.name = name
        return file
    if value is None or value == "":
        return None
    if isinstance(value, (int, float)):
        checks.positive("distance", value, "m")
        return float(value)
    metres = metres_in(value)
    return Path(value) if metres is None else metres


def _ending_of(file: Any) -> str:
    """Of the file to write: as of the picture's name, else as of its content."""
    suffix = Path(name_of(file)).suffix.lower()
    if suffix in FORMATS:
        return suffix
    with opened(file) as stream, Image.open(stream) as image:
        format = image.format
    for suffix, writable in FORMATS.items():
        if writable == format:
            return suffix
    raise ValueError(f"input: {format} cannot be written: give an output, such as 1.png")


def _added_schema() -> Any:
    """The `pyarrow.Schema` of the columns that `degrade` adds."""
    import pyarrow as pa

    kinds = {
        "image": pa.struct({"bytes": pa.binary(), "path": pa.string()}),
        "visibility": pa.float64(),
        "contrast": pa.float64(),
    }
    return pa.schema([(name, kinds.get(name, pa.string())) for name in ADDED])


def shard_schema() -> Any:
    """Of shards, with what Hugging Face's `datasets` need to show pictures."""
    import pyarrow as pa

    columns = [(name, pa.string()) for name in ("id", "input", "distance", "output")]
    columns.insert(1, ("variant", pa.int64()))
    schema = pa.schema([*pa.schema(columns), *_added_schema()])
    features: dict[str, Any] = {}
    for column in schema:
        kind = "float64" if column.type == pa.float64() else str(column.type)
        features[column.name] = {"dtype": kind, "_type": "Value"}
    features["image"] = {"_type": "Image"}
    return schema.with_metadata({"huggingface": json.dumps({"info": {"features": features}})})


@dataclass
class Tally:
    """What the shards of a run hold.

    Attributes:
        rows, failed: how many; failed ones are rows without a picture.
        reasons: why they failed.
        notes: what is worth knowing of the others.
    """

    reasons: Remarks
    notes: Remarks
    rows: int = 0
    failed: int = 0


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

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold the place against other runs, where it is a folder; elsewhere there are no locks.

        Raises:
            BlockingIOError: if another run holds it.
            OSError: if it cannot be made.
        """
        from pyarrow.fs import LocalFileSystem

        if not isinstance(self._files, LocalFileSystem):
            yield
            return
        run = Path(self._run)
        run.mkdir(parents=True, exist_ok=True)
        with held(run):
            yield

    def prepare(self, recipe: Recipe, *, resume: bool = False, force: bool = False) -> None:
        """Make room before anything is done: Ray would add to what is there.

        Args:
            recipe: of the run.
            resume: go on where the same run was stopped.
            force: remove shards of an earlier run.

        Raises:
            FileExistsError: if there are files and neither is asked for.
            ValueError: if the run that is to go on was another; or if there is what no run of
                uwaug has written, in the place or in that of the recipe.
            OSError: if the place cannot be read or written.
        """
        paths, before = self._paths(), self._recipe()
        if paths and not (resume or force):
            raise FileExistsError(f"{self.place} holds files, such as {paths[0]}")
        # what is somebody else's must not be removed
        cure = "choose another place, or move it"
        for path in self._paths(self._run):
            if before is None or path != f"{self._run}/recipe.json":
                raise ValueError(f"{path} is no recipe of a run of uwaug: {cure}")
        for path in paths:
            if before is None or not self._is_shard(path):
                raise ValueError(f"{path} is no shard of a run that {self._run} knows: {cure}")
        mine = json.dumps(recipe.to_json(), indent=1)
        if resume and before is not None:
            if before != json.loads(mine):
                raise ValueError(f"{self._run}/recipe.json is another recipe: give the same")
            return
        for path in paths:
            self._files.delete_file(path)
        for folder in (self._run, self._path):
            self._files.create_dir(folder, recursive=True)
        with self._files.open_output_stream(f"{self._run}/recipe.json") as file:
            file.write(mine.encode())

    def write(
        self,
        items: Items,
        recipe: Recipe,
        *,
        labels: LabelSource | None = None,
        size: int = SIZE,
        progress: bool = False,
    ) -> None:
        """Degrade the items that are not in the shards, and write them into some more.

        Args:
            items: which pictures.
            recipe: what is done to them.
            labels: as for `uwaug.jobs.run`.
            size: rows of a shard, at least, but of the last.
            progress: whether Ray draws how far it is.

        Raises:
            OSError: if Ray fails, or the place cannot be written.
        """
        import ray

        logging.getLogger("ray.data").setLevel(logging.ERROR)
        done = self._done()
        left = (item for item in items if (item.id, item.variant) not in done)
        source = recipe.open_labels() if labels is None else labels
        dataset = _blocks(list(labelled(left, source)), size)
        if dataset is None:
            return
        arguments = (recipe, os.getcwd(), {"in_memory": True})
        mapped = _mapped(dataset, _IntoShards, arguments, batch_size=1)
        mapped.context.enable_progress_bars = progress
        try:
            mapped.write_parquet(
                self._path,
                filesystem=self._files,
                min_rows_per_file=size,
                # else writing would wait for a core that the actors hold
                ray_remote_args={"num_cpus": 0},
                row_group_size=_BLOCK,
                schema=shard_schema(),
            )
        except ray.exceptions.RayError as error:
            raise OSError(f"Ray: {error}") from None

    def tally(self, most: int, reword: Callable[[str], str] = str) -> Tally:
        """Count what is in the shards; with at most so many different reasons and notes, reworded.

        Raises:
            OSError: if they cannot be read.
        """
        from pyarrow.dataset import dataset

        tally = Tally(Remarks(most, reword), Remarks(most, reword))
        shards = dataset(self._path, shard_schema(), "parquet", self._files)
        columns = ["input", "distance", "status", "reason", "notes"]
        for batch in shards.to_batches(columns=columns):
            tally.rows += len(batch)
            for row in batch.to_pylist():
                names = names_together(row["input"], row["distance"])
                if row["status"] == "failed":
                    tally.failed += 1
                    tally.reasons.add(row["reason"], names)
                for note in filter(None, (row["notes"] or "").split(NOTES_APART)):
                    tally.notes.add(note, names)
        return tally

    def _paths(self, folder: str | None = None) -> list[str]:
        """The files that are there, or in a folder."""
        from pyarrow.fs import FileSelector, FileType

        inside = FileSelector(folder or self._path, recursive=True, allow_not_found=True)
        listed = self._files.get_file_info(inside)
        return [info.path for info in listed if info.type == FileType.File]

    def _is_shard(self, path: str) -> bool:
        """Whether a file may be of a run: it has the columns, or no end, as one that was being
        written.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        if not path.endswith((".parquet", _PART)):
            return False
        try:
            schema = pq.read_schema(path, filesystem=self._files)
        except pa.ArrowInvalid:
            return True
        return set(shard_schema().names) <= set(schema.names)

    def _recipe(self) -> Any:
        """The recipe of the run that has written here; None if there was none."""
        try:
            with self._files.open_input_stream(f"{self._run}/recipe.json") as file:
                recipe = from_json(file.read().decode())
        except (FileNotFoundError, ValueError):
            return None
        return recipe if isinstance(recipe, dict) and {"depth", "seed"} <= set(recipe) else None

    def _done(self) -> set[tuple[str, int]]:
        """Id and variant of the pictures in the shards; removes rows of pictures that failed, which
        get another try, and shards that have no end.
        """
        import pyarrow as pa
        import pyarrow.compute as pc
        import pyarrow.parquet as pq

        done: set[tuple[str, int]] = set()
        paths = self._paths()
        left = [path for path in paths if path.endswith(_PART)]
        for path in left:
            self._files.delete_file(path)
        for path in set(paths).difference(left):
            try:
                columns = ["id", "variant", "status"]
                shard = pq.read_table(path, columns=columns, filesystem=self._files)
            except pa.ArrowInvalid:
                self._files.delete_file(path)
            else:
                if "failed" in shard["status"].to_pylist():
                    shard = pq.read_table(path, filesystem=self._files)
                    shard = shard.filter(pc.not_equal(shard["status"], "failed"))
                    part = path.removesuffix(".parquet") + _PART
                    pq.write_table(shard, part, filesystem=self._files, row_group_size=_BLOCK)
                    self._files.move(part, path)
                done.update(zip(shard["id"].to_pylist(), shard["variant"].to_pylist(), strict=True))
        return done
