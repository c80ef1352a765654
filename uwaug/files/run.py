"""Folders of pictures under water: a record beside each picture, and an index of all."""

import csv
import json
import os
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor

from uwaug import __version__
from uwaug._support import checks
from uwaug._support.atomic import remove_left, written_whole
from uwaug.distance.doubts import doubts
from uwaug.distance.made_up import MadeUp
from uwaug.distance.sources import Inverse, Metres, Relative, Source
from uwaug.files.items import OTHERS, Item
from uwaug.files.labels import Judged, Labelled, Labels, judged, open_labels
from uwaug.files.pictures import ENDINGS, metres_of, read_distance, read_picture, write_picture
from uwaug.files.pool import on_processes, one_thread
from uwaug.files.record import COLUMNS, read_record, record_path, write_record
from uwaug.files.sheet import write_sheet
from uwaug.formation.contrast import FAINT
from uwaug.transforms.draws import Record
from uwaug.transforms.like import Nearness, like
from uwaug.transforms.random_underwater import RandomUnderwater
from uwaug.transforms.random_water import Reached
from uwaug.transforms.samples import key_of

_LOOKS = 128
"""Rows, and columns, about, at which the contrast that is left is looked at."""

_TRIED = 9
"""Frames of a film at most on which its draw may be settled."""

_DARK = 0.1
"""Mean value of a frame, of 0…1, that is no measure of a film's exposure: a fade, or the gap of a
cut.
"""


@dataclass(frozen=True)
class Recipe:
    """What is done to every picture of a run. With the name of a picture and the number of a
    variant, all that is random follows from it.

    Attributes:
        transform: options of `RandomUnderwater`, as its `to_dict` gives them.
        unit: of distances in files, see `read_distance`, where the transform takes metres.
        seed: of all that is random.
        variants: of each picture.
        labels: a COCO file, or a folder of YOLO's files or of masks; None for none.
        min_contrast: labels of objects of which less contrast is left, 0…1, are left out; None
            keeps all.
        sequence: whether the pictures of a folder are frames of one film, in the order of their
            names: one draw for all, settled on one of them (see `RandomUnderwater.for_clip`).
        drift: m by which the field of a sequence drifts from frame to frame; .004 is .1 m/s at 25
            frames a second.
        quality: of pictures that are written as JPEG, 1…100.

    Raises:
        ValueError: if a value does not suit.
    """

    transform: dict[str, Any] = field(default_factory=dict)
    unit: str | float = "m"
    seed: int = 0
    variants: int = 1
    labels: str | None = None
    min_contrast: float | None = None
    sequence: bool = False
    drift: float = 0.004
    quality: float = 95

    def __post_init__(self) -> None:
        metres_of(self.unit)
        if self.variants < 1:
            raise ValueError(f"variants must be 1 or more, got {self.variants}")
        if self.min_contrast is not None:
            checks.within("min_contrast", self.min_contrast, 0.0, 1.0)
        checks.within("drift", self.drift)
        checks.within("quality", self.quality, 1, 100)

    def to_dict(self) -> dict[str, Any]:
        """As JSON holds it, and reads it back."""
        plain: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return plain


class Result(NamedTuple):
    """What became of a picture.

    Attributes:
        item, variant: which picture.
        place: of the picture that was written, below the folder of the run.
        status: "written"; "skipped", as the same recipe has made it before; "failed".
        contrast: mean share of contrast that is left; None if it failed.
        objects: of the picture, if there are labels.
        reason: why it failed.
        reached: what it took to reach the contrast asked for, if one was.
    """

    item: Item
    variant: int
    place: str
    status: Literal["written", "skipped", "failed"]
    contrast: float | None = None
    objects: Sequence[Judged] = ()
    reason: str = ""
    reached: Reached | None = None


@dataclass(frozen=True)
class Summary:
    """What became of a run: the `Result` of each picture, in the order of items and variants."""

    results: Sequence[Result]

    def count(self, status: str) -> int:
        """How many pictures have a status of `Result`."""
        return sum(result.status == status for result in self.results)

    @property
    def failures(self) -> list[str]:
        """What went wrong: each begins with a picture's name."""
        return [f"{one.item.name}: {one.reason}" for one in self.results if one.status == "failed"]

    @property
    def blank(self) -> list[str]:
        """Names of pictures in which next to nothing is left to see, less than 3 % of the contrast:
        distances may be in another unit, or the water too turbid.
        """
        left = [(one.item.name, one.contrast) for one in self.results]
        return [name for name, share in left if share is not None and share < FAINT]

    @property
    def odd(self) -> list[str]:
        """Names of pictures whose contrast it took odd distances or contents to reach, or that did
        not reach it, and how, see `RandomUnderwater`: distances may be in another unit.
        """
        named = [(one.item.name, one.reached) for one in self.results]
        return [f"{name} ({reached})" for name, reached in named if reached and reached.odd]

    @property
    def objects(self) -> tuple[int, int]:
        """How many labels there were, and how many of them were kept."""
        kept = [one.kept for result in self.results for one in result.objects]
        return len(kept), sum(kept)


class Job(NamedTuple):
    """A picture to write; `place` is from the folder of the run. Of a sequence, the frames on which
    its draw may be settled, the middle one first, and the number of this one.
    """

    item: Item
    variant: int
    place: str
    labels: Labels | None = None
    film: tuple[Item, ...] = ()
    frame: int = 0


def degrade(
    recipe: Recipe,
    items: Sequence[Item],
    out: str | Path,
    *,
    workers: int = 1,
    resume: bool = False,
    force: bool = False,
    sheet: bool = False,
    ray: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Summary:
    """Put pictures in files under water.

    Each picture gets a record beside it, from which `replay` makes it again; index.csv tells of
    all. The same recipe and name give the same bytes, whatever the number of workers, their order,
    and interruptions. A picture that fails does not stop the others.

    Args:
        recipe: what is done to each picture.
        items: which pictures, see `find_items`.
        out: a folder, made if need be; or, for one picture, the file to write.
        workers: processes; 1: this one.
        resume: go on where a run was stopped: what the same recipe has made is left as it is.
        force: write over what is there.
        sheet: draw some of the results on sheet.jpg.
        ray: address of a Ray cluster that takes the place of processes: "local", "auto", or
            host:port. All its machines must see the same folders.
        progress: is told after each picture how many are done, and of how many.

    Raises:
        ValueError: if an option does not suit, two pictures would be one file, or a file would be
            written over that is read.
        FileExistsError: if there is something in `out`, without `resume` and `force`.
        OSError: if `out` cannot be written.
    """
    out, labels = Path(out), None
    single = out.suffix.lower() in ENDINGS and not out.is_dir()
    if out.suffix.lower() in OTHERS and not out.is_dir():
        raise ValueError(f"{out}: pictures are written as {', '.join(ENDINGS)}")
    if single:
        if len(items) * recipe.variants != 1 or recipe.labels is not None or sheet:
            cure = "more pictures, labels and sheets need a folder"
            raise ValueError(f"{out} is a file, which is for one picture: {cure}")
        if out.exists() and not (resume or force):
            raise FileExistsError(f"{out} exists: resume to go on, force to write over it")
        jobs = [Job(items[0], 0, out.name)]
        out = out.parent
    else:
        labels = open_labels(recipe.labels) if recipe.labels is not None else None
        if not (resume or force) and out.is_dir() and set(os.listdir(out)) - {"index.csv"}:
            cure = "another folder, resume to go on, or force to write over it"
            raise FileExistsError(f"{out} is not empty: {cure}")
        out.mkdir(parents=True, exist_ok=True)
        jobs = list(_jobs(recipe, items, labels))
    work = _Worker(recipe, out, resume=resume, force=force)
    source = work.transform.distance
    missing = next((item.name for item in items if item.distance is None), None)
    if missing and isinstance(source, Source) and source.reads_maps:
        cure = "give files of distances, a distance in metres, or MadeUp"
        raise ValueError(f"distance is missing: {missing} has no file of it: {cure}")
    if recipe.sequence and isinstance(source, MadeUp):
        cure = "give files of distances, or metres, such as 1:5"
        raise ValueError(f"distance: made up from each frame, a film would flicker: {cure}")
    _require_apart(jobs, out)
    if resume:
        for folder in {(out / job.place).parent for job in jobs}:
            remove_left(folder)  # what a killed run was writing
    if ray is not None:
        from uwaug.files.ray import on_ray

        found = on_ray(work, jobs, ray, workers)
    else:
        found = on_processes(work, jobs, workers)
    results = []
    for result in found:
        results.append(result)
        if progress is not None:
            progress(len(results), len(jobs))
    summary = Summary(results)
    if not single:
        _write_index(results, out)
        done = [result for result in results if result.status != "failed"]
        if labels is not None:
            labels.finish([Labelled(one.item.name, one.place, one.objects) for one in done], out)
        if sheet and done:
            made: dict[Path, list[Path]] = {}
            for one in done:
                made.setdefault(one.item.picture, []).append(out / one.place)
            write_sheet(out / "sheet.jpg", list(made.items()))
    return summary


def doubts_of(recipe: Recipe, items: Sequence[Item]) -> list[str]:
    """What speaks against the maps of a run, see `uwaug.distance.doubts`: of eight, from the first
    to the last. Single files that cannot be read are left to the run, which names them.

    Raises:
        ValueError: if most of these maps are refused, with what is said of the first.
    """
    transform = RandomUnderwater.from_dict(recipe.transform)
    source = transform.distance
    assert isinstance(source, Source)
    if isinstance(source, (Metres, Relative, Inverse)) and source.holes != "error":
        source = replace(source, holes="far")  # filling takes seconds, and refuses little
    images, maps, refused, asked = [], [], [], 0
    for item in items[:: -(-len(items) // 8) or 1]:
        if item.distance is None or not item.distance.is_file():
            continue
        with suppress(Exception), warnings.catch_warnings():  # decoders raise whatever they like
            warnings.simplefilter("ignore")
            image = read_picture(item.picture)
            asked += 1
            try:
                z = _read_map(item.distance, recipe, transform)
                images.append(image)
                maps.append(z)
                (sample,) = transform.make_params(image, torch.Generator())["samples"]
                source.metres(z, image, sample["numbers"])
            except ValueError as error:
                named = str(error).startswith(str(item.distance))
                refused.append(str(error) if named else f"{item.distance}: {error}")
    if 2 * len(refused) > asked:
        raise ValueError(refused[0])
    if isinstance(source, Metres):
        return doubts(maps, images)
    if 2 * sum(map(_like_mm, maps)) <= len(maps):
        return []
    return [
        "relative or inverse maps hold whole numbers of less than a tenth of what 16 bits do, as "
        "those in mm: leave out distance.kind and give --unit mm (Metres(), divide by 1000)"
    ]


def _like_mm(shares: Tensor) -> bool:
    """Whether a map that was read without unit spans next to nothing of 0…1, in whole numbers."""
    known = 65535 * shares[shares > 0]
    some = known[:: max(1, known.numel() // 4096)].sort().values
    few, whole = some.numel() // 100, some.round()
    narrow = some.numel() >= 64 and float(some[-1 - few] - some[few]) < 6554
    return narrow and len(set(whole.tolist())) > 16 and torch.allclose(some, whole, 0, 0.01)


def like_of(
    recipe: Recipe, items: Sequence[Item], references: Sequence[Path]
) -> tuple[Recipe, Nearness]:
    """A recipe that makes the pictures of a run look like photographs in files, as eight of them
    do, see `uwaug.like`; and how near it comes.
    """
    photographs = [read_picture(path) for path in references]
    transform = RandomUnderwater.from_dict(recipe.transform)
    found = _some(recipe, items, transform)
    images, maps = [image for image, _ in found], [z for _, z in found if z is not None]
    with one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # all that there is to say is in what is returned
        augment = like(photographs, images, maps or None, augment=transform, seed=recipe.seed)
    assert augment.nearness is not None
    return replace(recipe, transform=augment.to_dict()), augment.nearness


def _some(
    recipe: Recipe, items: Sequence[Item], transform: RandomUnderwater
) -> list[tuple[Tensor, Tensor | None]]:
    """Eight pictures of a run and their maps, from the first to the last, but for those that cannot
    be read.
    """
    found = []
    for item in items[:: -(-len(items) // 8) or 1]:
        with suppress(Exception):  # decoders raise whatever they like
            found.append(_read(item, recipe, transform))
    return found


class _Worker:
    """A recipe in a process: it degrades one picture at a call, and raises nothing over a file."""

    def __init__(self, recipe: Recipe, out: Path, *, resume: bool, force: bool) -> None:
        self.recipe, self.out, self.resume, self.force = recipe, out, resume, force
        self._plain = recipe.to_dict()
        self.transform = RandomUnderwater.from_dict(recipe.transform)
        self._clips: dict[tuple[str, int], Record] = {}

    def __call__(self, job: Job) -> Result:
        try:
            with warnings.catch_warnings():
                # each process would warn of blank pictures once: the summary tells of all
                warnings.simplefilter("ignore")
                return self._written(job)
        except Exception as error:  # decoders raise whatever they like over a damaged file
            return self._failed(job, _reason(error))

    def died(self, job: Job) -> Result:
        return self._failed(job, "the process died over it: out of memory, or a damaged file")

    def _failed(self, job: Job, reason: str) -> Result:
        return Result(job.item, job.variant, job.place, "failed", reason=reason)

    def _written(self, job: Job) -> Result:
        item, output = job.item, self.out / job.place
        made_of = {
            "uwaug": __version__,
            "torch": str(torch.__version__),
            "name": item.name,
            "variant": job.variant,
            "picture": os.path.abspath(item.picture),
            "distance": item.distance and os.path.abspath(item.distance),
            "recipe": self._plain,
            "frame": [job.film[0].name, job.frame] if job.film else None,
        }
        named = item, job.variant, job.place
        if self.resume and output.exists():
            record = read_record(record_path(output))
            other = [name for name, value in made_of.items() if record.get(name) != value]
            if not other:
                objects = [Judged(**entry) for entry in record["objects"]]
                reached = record.get("reached") and Reached(**record["reached"])
                return Result(*named, "skipped", record["contrast"], objects, reached=reached)
            if not self.force:
                got = f"{output} was made with another {' and '.join(other)}"
                raise FileExistsError(f"{got}: choose another folder, or force to write over it")
        image, z = _read(item, self.recipe, self.transform)
        params = self._drawn(job, image)
        maps = None if z is None else z[None]
        scenes = self.transform.scenes(image[None], maps, params["samples"])
        degraded = self.transform.degraded(image, scenes)
        reached = scenes[0].reached
        # for the mean alone some pixels do: all of them take a third of the picture's time
        step = max(1, min(image.shape[1:]) // _LOOKS) if job.labels is None else 1
        left = self.transform.left(image, scenes, step)
        contrast = round(float(left.double().mean()), 4)
        objects = []
        if job.labels is not None:
            objects = judged(job.labels, item.name, left, self.recipe.min_contrast)
        output.parent.mkdir(parents=True, exist_ok=True)
        # the picture comes last: where it is, all that belongs to it is
        output.unlink(missing_ok=True)
        if job.labels is not None:
            dropped = {one.key for one in objects if not one.kept}
            job.labels.write(item.name, job.place, dropped, self.out)
        found = {
            "contrast": contrast,
            "reached": reached and reached._asdict(),
            "objects": [one._asdict() for one in objects],
        }
        write_record(record_path(output), {**made_of, "params": params, **found})
        write_picture(output, degraded, self.recipe.quality)
        return Result(*named, "written", contrast, objects, reached=reached)

    def _drawn(self, job: Job, image: Tensor) -> Record:
        """All that is random about a picture; of a frame, about its film."""
        named = job.film[0].name if job.film else job.item.name
        generator = torch.Generator().manual_seed(key_of(self.recipe.seed, job.variant, named))
        params = self.transform.make_params(image, generator)
        if not job.film:
            return params
        key = named, job.variant
        if key not in self._clips:
            # those of one film at a time
            self._clips = {key: clip for key, clip in self._clips.items() if key[0] == named}
            self._clips[key] = self._settled(params, job.film)
        record = self._clips[key]
        (sample,) = record["samples"]
        if "clip" not in sample:
            return record
        of_frame = {"moved": self.recipe.drift * job.frame}
        if "noise_seed" in sample["numbers"]:
            of_frame["noise_seed"] = sample["numbers"]["noise_seed"] + job.frame
        return {"samples": [{**sample, "clip": {**sample["clip"], **of_frame}}]}

    def _settled(self, params: Record, film: Sequence[Item]) -> Record:
        """The record of a film, as of its first frame that can be read, is not dark, and shows more
        than open water; if there is none, as of the first that can be read.
        """
        poor, reasons = [], []  # records, and what is wrong with others
        for frame in film:
            try:
                image, z = _read(frame, self.recipe, self.transform)
                record = self.transform.for_clip(params, image, z)
            except Exception as error:  # as over the picture itself
                reasons.append(f"{frame.name}: {_reason(error)}")
                continue
            metres = record["samples"][0].get("clip", {}).get("metres", 0.0)
            light = float(image.float().mean()) / (1 if image.is_floating_point() else 255)
            if light >= _DARK and metres < checks.OPEN:
                return record
            poor.append(record)
        if not poor:
            raise ValueError(f"no frame serves to settle the film's draw: {reasons[0]}")
        return poor[0]


def replay(
    record: str | Path,
    output: str | Path,
    *,
    picture: str | Path | None = None,
    distance: str | Path | None = None,
    force: bool = False,
) -> None:
    """Make a picture again from its record: the same bytes, by the same versions of uwaug and
    PyTorch, on the same kind of processor.

    Args:
        record: file beside a picture that a run has written.
        output: the file to write.
        picture, distance: files that it was made of, if they have moved.
        force: write over what is there.

    Raises:
        ValueError: if the file is no record, or pictures and distances do not suit.
        FileExistsError: if `output` exists, without `force`.
        OSError: if a file cannot be read or written.
    """
    output = Path(output)
    if output.exists() and not force:
        raise FileExistsError(f"{output} exists: force writes over it")
    plain = read_record(Path(record))
    recipe = Recipe(**plain["recipe"])
    where = distance or plain["distance"]
    item = Item(plain["name"], Path(picture or plain["picture"]), where and Path(where))
    _require_apart([Job(item, 0, output.name)], output.parent)
    with one_thread():
        transform = RandomUnderwater.from_dict(recipe.transform)
        image, z = _read(item, recipe, transform)
        degraded = transform.transform(image, z, plain["params"])
        write_picture(output, degraded, recipe.quality)


def _read(item: Item, recipe: Recipe, transform: RandomUnderwater) -> tuple[Tensor, Tensor | None]:
    """The picture and the map of an item."""
    image = read_picture(item.picture)
    if item.distance is None:
        return image, None
    return image, _read_map(item.distance, recipe, transform)


def _read_map(path: Path, recipe: Recipe, transform: RandomUnderwater) -> Tensor:
    unit = recipe.unit if isinstance(transform.distance, Metres) else None
    return read_distance(path, unit)


def _jobs(recipe: Recipe, items: Sequence[Item], labels: Labels | None) -> Iterator[Job]:
    films: dict[str, list[Item]] = {}
    for item in sorted(items, key=_counting):
        films.setdefault(os.path.dirname(item.name), []).append(item)
    frames: dict[Item, tuple[tuple[Item, ...], int]] = {}
    for film in films.values():
        tried = _spread(film)
        frames |= {item: (tried, number) for number, item in enumerate(film)}
    for item in items:
        settling, frame = frames[item] if recipe.sequence else ((), 0)
        place = item.name if labels is None else labels.place(item.name)
        stem, end = os.path.splitext(place)
        for variant in range(recipe.variants):
            number = f"_{variant + 1}" if recipe.variants > 1 else ""
            own = None if labels is None else labels.only(item.name)
            yield Job(item, variant, f"{stem}{number}{end}", own, settling, frame)


def _spread(film: Sequence[Item]) -> tuple[Item, ...]:
    """Some frames from all over a film, the middle one first."""
    n = len(film)
    return tuple(dict.fromkeys(film[(n // 2 + k * n // _TRIED) % n] for k in range(_TRIED)))


def _counting(item: Item) -> list[Any]:
    """A key that sorts names as one counts: 2.png before 10.png."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", item.name)]


def _require_apart(jobs: Sequence[Job], out: Path) -> None:
    """Refuse two pictures in one file, and to write over what is read."""
    read = {os.path.realpath(job.item.picture) for job in jobs}
    read |= {os.path.realpath(job.item.distance) for job in jobs if job.item.distance is not None}
    written: dict[str, Path] = {}
    for job in jobs:
        output = os.path.realpath(out / job.place)
        if output in read:
            raise ValueError(f"{output} is read, and would be written over: another folder?")
        # files of labels are found by a picture's name without its end
        key = output if job.labels is None else os.path.splitext(output)[0]
        if key in written:
            both = f"{written[key]} and {job.item.picture}"
            raise ValueError(f"{both} would both be written to {key}: rename one")
        written[key] = job.item.picture


def _write_index(results: Sequence[Result], out: Path) -> None:
    with (
        written_whole(out / "index.csv") as part,
        part.open("w", encoding="utf-8", newline="") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for item, variant, place, status, contrast, _, reason, _ in results:
            where = [item.name, variant, item.picture, item.distance, place]
            writer.writerow([*where, contrast, status, reason])


def _reason(error: Exception) -> str:
    """An error in words, with its kind if none of our checks has raised it."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, (ValueError, OSError, ImportError)) and str(error):
        return str(error)
    return f"{type(error).__name__}: {error}"
