"""Pictures in files under water."""

import warnings
from collections.abc import Iterator, Sequence
from os.path import splitext
from pathlib import Path
from typing import Any

from torch import Tensor

from uwaug._support import codec
from uwaug._support.threads import one_thread
from uwaug.distance.made_up import MadeUp
from uwaug.distance.sources import Inverse, Relative
from uwaug.distance.unknown import of_shares
from uwaug.files.films import Films, frames_of
from uwaug.files.formats import open_labels
from uwaug.files.labels import Labels, judged
from uwaug.files.pictures import ENDINGS, write_picture
from uwaug.files.recipe import Recipe
from uwaug.files.record import digest, read_record, record_path
from uwaug.files.run import Job, Progress, Work, require_apart, run, versions
from uwaug.files.summary import Summary
from uwaug.files.table import Row, require_rows, table_in
from uwaug.formation.contrast import FAINT
from uwaug.optics.curves import FARTHEST
from uwaug.transforms.truth import MAPS, Truth

_CONTRAST_ROWS = 128  # rows of the short side, about, that give the mean contrast of a picture

_Made = tuple[Tensor, Truth | None, bytes]  # picture, maps, and EXIF of its source
_WHITE_OF_12_BITS = 4095 / 65535  # that are stored in 16 as they are


def degrade(
    recipe: Recipe,
    rows: Sequence[Row],
    out: str | Path,
    *,
    workers: int = 1,
    resume: bool = False,
    force: bool = False,
    sheet: bool = False,
    beside: Sequence[Path] = (),
    progress: Progress | None = None,
) -> Summary:
    """Put pictures in files under water.

    Each picture gets a record beside it, from which `replay` makes it again; index.csv lists all,
    and table.csv has the rows. The same recipe and names give the same bytes, whatever the number
    of workers, and interruptions. A picture that fails does not stop the others.

    Args:
        recipe: transform and options.
        rows: pictures, see `read_table` and `propose`.
        out: folder to write to, made if need be.
        workers: number of processes; 1: this one, 0: one for each core.
        resume: go on after a stop, with the same recipe; what was made of the same row is kept.
        force: remove first what an earlier run has written to `out`.
        sheet: draw some of the results on sheet.jpg.
        beside: real photographs to draw there, below them.
        progress: function of the numbers of finished and of all pictures.

    Raises:
        ValueError: if options or labels do not suit, a map is missing, two rows have one name or
            map, or files would be one, or written over.
        FileExistsError: if `out` holds anything but a run to `resume` or to redo by `force`, or
            another run is at work there.
        OSError: if `out` cannot be written.
    """
    out = Path(out)
    if out.suffix.lower() in ENDINGS and not out.is_dir():
        raise ValueError(f"out (--out) must be a folder, got {out}")
    source = recipe.transform.distance
    require_rows(rows, with_maps=source.reads_maps)
    if isinstance(source, MadeUp) and any(row.film for row in rows):
        raise ValueError("distance made up from each frame would flicker: give files, or metres")
    labels = open_labels(rows, recipe.classes)
    if labels is None and {recipe.min_contrast, recipe.classes} != {None}:
        raise ValueError("min_contrast and classes are of labels, of which none are given")
    return run(
        _Underwater(recipe, out),
        list(_jobs(recipe, rows, labels)),
        labels=labels,
        workers=workers,
        resume=resume,
        force=force,
        sheet=sheet,
        beside=beside,
        lists={"table.csv": table_in(out, rows)},
        progress=progress,
    )


def replay(
    record: str | Path,
    output: str | Path,
    *,
    picture: str | Path | None = None,
    distance: str | Path | None = None,
    force: bool = False,
) -> None:
    """Make a picture again from its record, to the byte with the same versions of uwaug, PyTorch
    and numba on the same kind of processor; with others, it warns.

    Args:
        record: file beside a picture that a run has written.
        output: file to write.
        picture, distance: the picture's sources, if they have moved.
        force: write over an existing file.

    Raises:
        ValueError: if the file is no record, or picture or distances have changed.
        FileExistsError: if `output` exists, without `force`.
        OSError: if a file cannot be read or written.
    """
    output = Path(output)
    if output.exists() and not force:
        raise FileExistsError(f"{output} exists: force=True (--force) writes over it")
    entries = read_record(Path(record))
    if "recipe" not in entries:
        raise ValueError(f"{record}: is no record of a picture under water")
    record_versions = {name: entries[name] for name in versions()}
    if record_versions != versions():
        got = " and ".join(f"{name} {version}" for name, version in record_versions.items())
        warnings.warn(f"{record} was written by {got}: last bits may differ", stacklevel=2)
    recipe = codec.from_plain(entries["recipe"], Recipe)
    cells = entries["row"]
    for name, new_path in (("picture", picture), ("distance", distance)):
        cells[name] = cells[name] and Path(new_path or cells[name])
        if cells[name] and digest(cells[name]) not in (None, entries["sha256"][name]):
            raise ValueError(f"{cells[name]} has changed since {record} was written")
    for file, before in entries["options_file"].items():
        if digest(Path(file)) != before:
            raise ValueError(f"{file} is gone, or has changed since {record} was written")
    row = Row(**cells)
    require_apart(Work(output.parent, {}), [Job(row._replace(labels=None), output.name)])
    with one_thread():
        (image, _, exif), z = recipe.read(row)
        degraded = recipe.transform_of(row.picture).transform(image, z, entries["params"])
        recipe.write(output, degraded, row.picture, exif)


class _Underwater(Work):
    def __init__(self, recipe: Recipe, out: Path) -> None:
        plain = codec.to_plain(recipe)
        files = {str(file): digest(file) for file in _files_of(plain["transform"])}
        super().__init__(out, {"recipe": plain, "options_file": files})
        self.recipe, self._films = recipe, Films(recipe)

    def made_of(self, job: Job) -> dict[str, Any]:
        sources = super().made_of(job)
        if job.frame is not None:
            number, moment, candidates = job.frame
            sources["frame"] = [number, moment, *(row.name for row in candidates)]
        return sources

    def make(self, job: Job) -> tuple[_Made, dict[str, Any]]:
        row, labels = job.row, job.labels
        (image, turn, exif), z = self.recipe.read(row)
        transform = self.recipe.transform_of(row.picture)
        if job.frame is None:
            params = self.recipe.drawn(row.name, job.variant)
        else:
            params = self._films.draw(job.frame, job.variant)
        # some pixels are enough for the mean: all of them take a third of the picture's time
        step = max(1, min(image.shape[1:]) // _CONTRAST_ROWS) if labels is None else 1
        scenes = transform.scenes(image, z, params)
        degraded, contrast = scenes.formed(), scenes.contrast_map(step)
        solid = scenes.metres[:, 0, ::step, ::step] < FARTHEST  # open water hides nothing
        # a picture that is left alone has no metres
        faint = (contrast < FAINT)[solid] if len(solid) else contrast[:0]
        lost = float(faint.sum()) / max(faint.numel(), 1)
        clarity = scenes.clarity(0)
        truth = None if self.recipe.maps is None else scenes.truth()
        objects = []
        if labels is not None:
            objects = judged(labels, row.name, contrast, self.recipe.min_contrast)
        source = transform.distance
        may_have_holes = isinstance(source, (Relative, Inverse)) and source.holes == "error"
        is_coded = image.is_floating_point() and row.picture.suffix.lower() != ".exr"
        applies = {
            "blank": lost > 0.5,
            "dark": is_coded and 0 < float(image.max()) <= _WHITE_OF_12_BITS,
            "turned": turn > 1 and (z is not None or labels is not None),
            "alone": may_have_holes and z is not None and bool(of_shares(z).any()),
        }
        return (degraded, truth, exif), {
            "params": params,
            "color_space": transform.development.color_space,
            "contrast": round(float(contrast.double().mean()), 4),
            "lost": round(lost, 4),
            "clarity": clarity and clarity.record(),
            "odd": clarity.odd if clarity else "",
            "truth": truth and truth.record(),
            "objects": [label._asdict() for label in objects],
            "asked": [question for question, is_so in applies.items() if is_so],
        }

    def write(self, path: Path, result: _Made, row: Row) -> None:
        degraded, truth, exif = result
        if truth is not None:
            place = path.relative_to(self.out).as_posix()
            for name, file in zip(MAPS, self._maps(place), strict=True):
                file.parent.mkdir(parents=True, exist_ok=True)
                write_picture(file, getattr(truth, name).float(), color_space="linear")
        self.recipe.write(path, degraded, row.picture, exif)

    def files(self, job: Job) -> list[Path]:
        return [*super().files(job), *([] if self.recipe.maps is None else self._maps(job.place))]

    def _maps(self, place: str) -> list[Path]:
        stem = (self.out / "maps" / place).with_suffix("")
        return [stem.with_name(f"{stem.name}_{name}.{self.recipe.maps}") for name in MAPS]

    def caption(self, path: Path) -> str:
        """Median distance and mean contrast of a picture; its water."""
        record = read_record(record_path(path))
        (sample,) = record["params"]["samples"]
        if not sample["applied"]:
            return "left alone"
        distance = f"{record['clarity']['metres']:.2g} m, "
        waters = [
            water if isinstance(water, str) else ",".join(f"{x}={y:.2g}" for x, y in water.items())
            for water in sample["water"]["waters"]
        ]
        return f"{distance}contrast {record['contrast']:.2f}\n{' + '.join(waters)}"


def _files_of(value: Any) -> Iterator[Path]:
    if isinstance(value, (dict, list, tuple)):
        for part in value.values() if isinstance(value, dict) else value:
            yield from _files_of(part)
    elif isinstance(value, str) and Path(value).suffix and Path(value).is_file():
        yield Path(value)


def _jobs(recipe: Recipe, rows: Sequence[Row], labels: Labels | None) -> Iterator[Job]:
    frames = frames_of(rows)
    for row in rows:
        place = row.name if labels is None else labels.place(row.name)
        labels_of_row = None if labels is None else labels.only(row.name)
        stem, end = splitext(place)
        for variant in range(recipe.variants):
            number = f"_{variant + 1}" if recipe.variants > 1 else ""
            yield Job(row, f"{stem}{number}{end}", variant, labels_of_row, frames.get(row.name))
