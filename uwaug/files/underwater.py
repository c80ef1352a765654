"""Pictures in files under water."""

import os
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from os.path import splitext
from pathlib import Path
from typing import Any

from torch import Tensor

from uwaug._support import codec
from uwaug._support.threads import one_thread
from uwaug.distance.made_up import MadeUp
from uwaug.distance.sources import Inverse, Relative, Source
from uwaug.distance.unknown import of_shares
from uwaug.files.films import Films, frames_of
from uwaug.files.folder import NOT_OURS, require_same
from uwaug.files.formats import open_labels
from uwaug.files.items import Item, cure_of
from uwaug.files.labels import Labels, judged
from uwaug.files.pictures import ENDINGS, Picture, write_picture
from uwaug.files.recipe import Recipe
from uwaug.files.record import digest, read_record, record_of, record_path
from uwaug.files.run import Job, Progress, Work, require_apart, run, versions
from uwaug.files.summary import Summary
from uwaug.formation.contrast import FAINT
from uwaug.optics.curves import FARTHEST
from uwaug.transforms.truth import MAPS, Truth

_CONTRAST_ROWS = 128  # rows of the short side, about, that give the mean contrast of a picture
_DARK_LIGHT = 1 / 8  # share of white that no value of a picture of 12 bits in 16 reaches


def degrade(
    recipe: Recipe,
    items: Sequence[Item],
    out: str | Path,
    *,
    workers: int = 1,
    resume: bool = False,
    force: bool = False,
    sheet: bool = False,
    beside: Sequence[Path] = (),
    ray: str | None = None,
    progress: Progress | None = None,
) -> Summary:
    """Put pictures in files under water.

    Each picture gets a record beside it, from which `replay` makes it again; index.csv lists all.
    The same recipe and name give the same bytes, whatever the number of workers, and interruptions.
    A picture that fails does not stop the others.

    Args:
        recipe: transform and options.
        items: pictures, see `find_items`.
        out: folder to write to, made if need be; or, for one picture, the file to write.
        workers: number of processes; 1: this one, 0: one for each core.
        resume: go on after a stop, with the same recipe; what was made of the same files is kept.
        force: remove first what an earlier run has written to `out`.
        sheet: draw some of the results on sheet.jpg.
        beside: real photographs to draw there, below them.
        ray: address of a Ray cluster in place of processes: "local", "auto", or host:port.
        progress: function of the numbers of finished and of all pictures.

    Raises:
        ValueError: if options or labels do not suit, or files would be one, or written over.
        FileExistsError: if `out` holds anything but a run to `resume` or to redo by `force`, or
            another run is at work there.
        OSError: if `out` cannot be written.
    """
    out, labels = Path(out), None
    single = out.suffix.lower() in ENDINGS and not out.is_dir()
    if cure_of(out.suffix) and not out.is_dir():
        raise ValueError(f"{out}: pictures are written as {', '.join(ENDINGS)}")
    if single and (len(items) * recipe.variants != 1 or recipe.labels or recipe.maps or sheet):
        raise ValueError(f"{out} is a file, which is for one picture and nothing else")
    if recipe.labels is not None:
        labels = open_labels(recipe.labels, items)
        masks = {entry for entry in labels.of.values() if isinstance(entry, Path)}
        items = [item for item in items if item.picture not in masks]
    _require_distances(recipe, items)
    if single:
        return _one(_Underwater(recipe, out.parent), Job(items[0], out.name), resume, force)
    summary = run(
        _Underwater(recipe, out),
        list(_jobs(recipe, items, labels)),
        labels=labels,
        workers=workers,
        resume=resume,
        force=force,
        ray=ray,
        sheet=sheet,
        beside=beside,
        progress=progress,
    )
    if labels is None:
        return summary
    unlabelled = [item.name for item in items if item.name not in labels.of]
    got = f"belong to {len(items) - len(unlabelled)} of {len(items)} pictures"
    rest = f", not to {unlabelled[0]}" if unlabelled else ""
    return replace(summary, notes=[f"labels, {labels.reads}, {got}{rest}", *summary.notes])


def _one(work: Work, job: Job, resume: bool, force: bool) -> Summary:
    """A picture into a file, which may be that of an earlier run."""
    require_apart(work, [job])
    path = work.out / job.place
    if os.path.lexists(path):
        before = record_of(path)
        if before is None:
            raise FileExistsError(f"{path} {NOT_OURS}")
        if force:
            path.unlink()
        elif resume:
            require_same(path, before, work.made_with)
        else:
            cure = "resume=True (--resume) keeps it, force=True (--force) writes over it"
            raise FileExistsError(f"{path} exists: {cure}")
    with one_thread():
        return Summary([work(job)])


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
        cure = "defaults and last bits may differ"
        warnings.warn(f"{record} was written by {got}: {cure}", stacklevel=2)
    recipe = codec.from_plain(entries["recipe"], Recipe)
    files = []
    for source, new_path in ((entries["picture"], picture), (entries["distance"], distance)):
        file = source and Path(new_path or source["path"])
        if file and digest(file) not in (None, source["sha256"]):
            raise ValueError(f"{file} has changed since {record} was written")
        files.append(file)
    for file, before in entries["options_file"].items():
        if digest(Path(file)) != before:
            raise ValueError(f"{file} is gone, or has changed since {record} was written")
    item = Item(entries["name"], *files)
    require_apart(Work(output.parent, {}), [Job(item, output.name)])
    with one_thread():
        (image, *_), z = recipe.read(item)
        degraded = recipe.transform_of(item.picture).transform(image, z, entries["params"])
        recipe.write(output, degraded, item.picture)


class _Underwater(Work):
    def __init__(self, recipe: Recipe, out: Path) -> None:
        plain = codec.to_plain(recipe)
        files = {str(file): digest(file) for file in _files_of(plain["transform"])}
        super().__init__(out, {"recipe": plain, "options_file": files})
        self.recipe, self._films = recipe, Films(recipe)

    def made_of(self, job: Job) -> dict[str, Any]:
        space = self.recipe.transform_of(job.item.picture).development.color_space
        sources = {**super().made_of(job), "color_space": space}
        if job.labels is not None:
            sources["labels"] = job.labels.digest(job.item.name)
        if job.frame is not None:
            _, settled_on = self._films.settled(job.frame, job.variant)
            number, moment, candidates = job.frame
            sources["frame"] = [candidates[0].name, number, moment, settled_on]
        return sources

    def make(self, job: Job) -> tuple[tuple[Tensor, Truth | None], dict[str, Any]]:
        item, labels = job.item, job.labels
        picture, z = self.recipe.read(item)
        image = picture.image
        transform = self.recipe.transform_of(item.picture)
        if job.frame is None:
            params = self.recipe.drawn(item.name, job.variant)
        else:
            params = self._films.draw(job.frame, job.variant)
        # some pixels are enough for the mean: all of them take a third of the picture's time
        step = max(1, min(image.shape[1:]) // _CONTRAST_ROWS) if labels is None else 1
        scenes = transform.scenes(image, z, params)
        degraded, contrast = scenes.formed(), scenes.contrast_map(step)
        solid = scenes.metres[:, 0, ::step, ::step] < FARTHEST  # open water hides nothing
        faint = (contrast < FAINT)[: len(solid)][solid]  # none of a picture that is left alone
        clarity = scenes.clarity(0)
        truth = None if self.recipe.maps is None else scenes.truth()
        objects = []
        if labels is not None:
            objects = judged(labels, item.name, contrast, self.recipe.min_contrast)
        return (degraded, truth), {
            "params": params,
            "contrast": round(float(contrast.double().mean()), 4),
            "lost": round(float(faint.sum()) / max(faint.numel(), 1), 4),
            "clarity": clarity and clarity.record(),
            "odd": clarity.odd if clarity else "",
            "truth": truth and truth.record(),
            "objects": [label._asdict() for label in objects],
            "asked": _questions(job, transform.distance, picture, z),
        }

    def write(self, path: Path, result: tuple[Tensor, Truth | None], item: Item) -> None:
        degraded, truth = result
        if truth is not None:
            place = path.relative_to(self.out).as_posix()
            for name, file in zip(MAPS, self._maps(place), strict=True):
                file.parent.mkdir(parents=True, exist_ok=True)
                write_picture(file, getattr(truth, name).float(), color_space="linear")
        self.recipe.write(path, degraded, item.picture)

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
        water = " + ".join(_short_name(water) for water in sample["water"]["waters"])
        return f"{distance}contrast {record['contrast']:.2f}\n{water}"


def _files_of(value: Any) -> Iterator[Path]:
    if isinstance(value, (dict, list, tuple)):
        for part in value.values() if isinstance(value, dict) else value:
            yield from _files_of(part)
    elif isinstance(value, str) and Path(value).suffix and Path(value).is_file():
        yield Path(value)


def _short_name(water: str | dict[str, float]) -> str:
    """Name of a water, or its contents to two digits, so that a label holds them."""
    if isinstance(water, str):
        return water
    return ",".join(f"{content}={amount:.2g}" for content, amount in water.items() if amount)


def _questions(job: Job, source: Source, picture: Picture, z: Tensor | None) -> list[str]:
    image = picture.image
    may_be_12_bits = job.item.picture.suffix.lower() in (".png", ".tif", ".tiff")
    may_have_holes = isinstance(source, (Relative, Inverse)) and source.holes == "error"
    doubts = {
        "turned": (z is not None or job.labels is not None) and picture.orientation > 1,
        "dark": may_be_12_bits and image.is_floating_point() and float(image.max()) < _DARK_LIGHT,
        "profile": bool(picture.profile),
        "alone": may_have_holes and z is not None and bool(of_shares(z).any()),
    }
    return [key for key, applies in doubts.items() if applies]


def _require_distances(recipe: Recipe, items: Sequence[Item]) -> None:
    source = recipe.transform.distance
    missing = next((item.name for item in items if item.distance is None), None)
    if missing and source.reads_maps:
        cure = "give --distance: files, metres, or made-up (MadeUp())"
        raise ValueError(f"distance is missing: {missing} has no file of it: {cure}")
    if recipe.sequence and isinstance(source, MadeUp):
        raise ValueError("distance made up from each frame would flicker: give files, or metres")


def _jobs(recipe: Recipe, items: Sequence[Item], labels: Labels | None) -> Iterator[Job]:
    frames = frames_of(items, recipe.rig) if recipe.sequence else {}
    for item in items:
        place = item.name if labels is None else labels.place(item.name)
        labels_of_item = None if labels is None else labels.only(item.name)
        stem, end = splitext(place)
        for variant in range(recipe.variants):
            number = f"_{variant + 1}" if recipe.variants > 1 else ""
            yield Job(item, f"{stem}{number}{end}", variant, labels_of_item, frames.get(item))
