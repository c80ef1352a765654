"""`uwaug degrade`."""

import inspect
import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer

from uwaug import checks
from uwaug.commands.clusters import carry_out_in_shards, place_of, require_manner
from uwaug.commands.console import refuse
from uwaug.commands.names import complete_preset, complete_water
from uwaug.commands.runs import Manner, carry_out, rehearse, repeat, require_free
from uwaug.jobs.depth import Depth
from uwaug.jobs.index import INDICES
from uwaug.jobs.model import TERMS
from uwaug.jobs.recipe import Recipe
from uwaug.jobs.rows import Rows
from uwaug.jobs.run import cores
from uwaug.options import contrast_of
from uwaug.picture_files import FORMATS, require_format
from uwaug.transforms import RandomUnderwater

__all__ = ["degrade"]

_FEW = 8
"""Pictures that this process has done before others have begun."""

_NOT_OPTIONS = (
    "distance_kind",
    "distance",
    "unknown",
    "same_on_batch",
    "image_key",
    "distance_key",
)
"""Arguments of `RandomUnderwater` that files have no use for, or that flags say."""

Inputs = Annotated[
    list[Path] | None,
    typer.Argument(
        help="Pictures, folders of them, or lists: CSV or Parquet with a column input and, if they "
        "like, id, distance, output."
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(help="Folder to write to, made if need be; or, of one picture, a file."),
]
Distance = Annotated[
    str | None,
    typer.Option(
        help="Distance of each pixel: a folder of files with the pictures' names, a pattern such "
        "as {stem}_depth.png, one file, or metres."
    ),
]
WaterType = Annotated[
    str | None,
    typer.Option(
        help="Jerlov type: I, IA, IB, II, III, 1C, 3C, 5C, 7C, 9C.", autocompletion=complete_water
    ),
]
PresetName = Annotated[
    str | None,
    typer.Option(help="A preset, or the path of a TOML file.", autocompletion=complete_preset),
]
FitFile = Annotated[Path | None, typer.Option(help="What uwaug fit has written.")]
Random = Annotated[bool, typer.Option("--random", help="A water of its own for each picture.")]
Options = Annotated[
    Path | None, typer.Option(help="TOML file of options of RandomUnderwater, such as waters.")
]
Visibility = Annotated[str | None, typer.Option(help="m, or a range such as 2:10.")]
Contrast = Annotated[
    str | None, typer.Option(help="Left at the median distance, 0…1, or a range such as .2:.6.")
]
Severity = Annotated[int | None, typer.Option(help="1 (mild) to 5: a contrast.")]
VerticalDepth = Annotated[
    str | None, typer.Option("--depth", help="Of the scene below the surface, m, or a range.")
]
Exposure = Annotated[str | None, typer.Option(help="auto, none, or a gain in stops.")]
Kind = Annotated[
    str, typer.Option(help="Of distance files: metric, relative, inverse or disparity.")
]
Unit = Annotated[
    str, typer.Option(help="Of distance files: m, cm, mm, um, or how many metres 1 stands for.")
]
Unknown = Annotated[
    str, typer.Option(help="What 0 and NaN get: error, fill, skip, far, or metres.")
]
Near = Annotated[str | None, typer.Option(help="m, of relative and inverse distances.")]
Far = Annotated[str | None, typer.Option(help="m, of relative and inverse distances.")]
Gamma = Annotated[str | None, typer.Option(help="Exponent, of relative distances.")]
Focal = Annotated[
    float | None, typer.Option(help="Focal length, px: for the blur, planar depth and disparity.")
]
Baseline = Annotated[float | None, typer.Option(help="m, between the cameras of a disparity.")]
Offset = Annotated[float, typer.Option(help="px, of the principal points of a disparity.")]
Planar = Annotated[
    bool, typer.Option("--planar", help="Files hold depth along the optical axis, not the ray.")
]
Network = Annotated[Path | None, typer.Option(help="Depth network (ONNX), in place of --distance.")]
Seed = Annotated[int, typer.Option(help="Of all that is random.")]
Variants = Annotated[int, typer.Option(help="Of each picture.")]
Format = Annotated[
    str | None, typer.Option("--format", help="Of what is written: png, jpg, webp, tif, npy.")
]
Workers = Annotated[int | None, typer.Option(help="Processes; by default one for each core.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on where the same command was stopped.")]
Force = Annotated[bool, typer.Option("--force", help="Write over what is there.")]
LabelFiles = Annotated[
    Path | None,
    typer.Option("--labels", help="COCO file, or folder of YOLO's .txt or of .png masks."),
]
MinContrast = Annotated[
    float | None, typer.Option(help="Labels of what keeps less, 0…1, are marked as ignored.")
]
Void = Annotated[int | None, typer.Option(help='Value of masks that means "ignored" already.')]
Terms = Annotated[
    bool,
    typer.Option("--keep-terms", help="Write the direct, forward and backscattered light too."),
]
DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Say what would be read and written, and how long.")
]
Ray = Annotated[
    str | None,
    typer.Option(
        help="In place of processes: local (Ray is started on this machine), auto (its cluster), "
        "or host:port of a cluster."
    ),
]
InShards = Annotated[
    str | None,
    typer.Option(
        "--shards",
        help="In place of --out, with --ray: Parquet files with the pictures inside, in a folder, "
        "s3://…, gs://… or fsspec+NAME://…",
    ),
]
Sheet = Annotated[bool, typer.Option("--sheet", help="Draw some of the results on one sheet.")]
From = Annotated[
    Path | None, typer.Option("--from", help="A record: make its picture again, the same bytes.")
]


def degrade(
    inputs: Inputs = None,
    out: Out = None,
    distance: Distance = None,
    water: WaterType = None,
    preset: PresetName = None,
    fit: FitFile = None,
    random: Random = False,
    options: Options = None,
    visibility: Visibility = None,
    contrast: Contrast = None,
    severity: Severity = None,
    depth: VerticalDepth = None,
    exposure: Exposure = None,
    distance_kind: Kind = "metric",
    distance_unit: Unit = "m",
    unknown: Unknown = "error",
    near: Near = None,
    far: Far = None,
    gamma: Gamma = None,
    focal_px: Focal = None,
    baseline: Baseline = None,
    offset_px: Offset = 0.0,
    planar: Planar = False,
    depth_network: Network = None,
    seed: Seed = 0,
    variants: Variants = 1,
    output_format: Format = None,
    workers: Workers = None,
    ray: Ray = None,
    shards: InShards = None,
    resume: Resume = False,
    force: Force = False,
    labels: LabelFiles = None,
    min_contrast: MinContrast = None,
    void: Void = None,
    keep_terms: Terms = False,
    sheet: Sheet = False,
    dry_run: DryRun = False,
    again: From = None,
) -> None:
    """Your pictures, under water."""
    """Your pictures, under water: with a record beside each, and an index of all."""
    depth_options = {
        "kind": distance_kind,
        "unit": _number(distance_unit),
        "focal_px": focal_px,
        "baseline_m": baseline,
        "offset_px": offset_px,
        "planar": planar,
        "unknown": _number(unknown),
        "network": None if depth_network is None else str(depth_network),
    }
    flags = {
        "visibility": visibility,
        "contrast": contrast,
        "vertical_depth": depth,
        "exposure": exposure,
        "near": near,
        "far": far,
        "gamma": gamma,
    }
    place = place_of(out, shards, alone=again is not None)
    if again is not None:
        if inputs:
            refuse(f"--from makes the picture of a record: expected no other, got {inputs[0]}")
        repeat(again, place, force)
        return
    if not inputs:
        refuse("expected a picture, a folder of pictures, a list of them, or --from")
    try:
        drawn = _options(options, flags, severity)
        if focal_px is not None and preset is None and fit is None:
            drawn.setdefault("focal_px", focal_px)
        recipe = Recipe(
            water=water,
            preset=preset,
            fit=None if fit is None else str(fit),
            random=random,
            options=drawn,
            depth=Depth(**_inverse_of_network(depth_options)),
            seed=seed,
            labels=None if labels is None else str(labels),
            min_contrast=min_contrast,
            void=void,
            keep_terms=keep_terms,
        ).sealed()
        rows = _rows(inputs, place, distance, variants, output_format, depth_network is not None)
        count = rows.check(TERMS if keep_terms else ())
    except (TypeError, ValueError, OSError, ImportError) as error:
        refuse(error)
    manner = Manner(_workers(workers, count, ray), resume, force, sheet, ray)
    require_manner(manner, shards, workers, keep_terms=keep_terms)
    if shards is None:
        require_free(rows, recipe, manner)
    if dry_run:
        rehearse(rows, recipe, count, manner)
        return
    if shards is None:
        carry_out(rows, recipe, count, manner)
    else:
        carry_out_in_shards(rows, recipe, count, manner, shards)


def _options(path: Path | None, flags: dict[str, str | None], severity: int | None) -> Any:
    """Options of `RandomUnderwater`, from a file and from flags."""
    found: dict[str, Any] = {}
    if path is not None:
        try:
            found = tomllib.loads(path.read_text(encoding="utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"{path}: is no TOML: {error}") from None
        known = inspect.signature(RandomUnderwater).parameters
        for name in found:
            if name not in known or name in _NOT_OPTIONS:
                wanted = ", ".join(name for name in known if name not in _NOT_OPTIONS)
                raise ValueError(f"{path}: unknown key {name}; there are {wanted}")
    for name, text in flags.items():
        if text is not None:
            found[name] = text if text in ("auto", "none") else _range(name, text)
    if severity is not None:
        if "contrast" in found:
            raise ValueError("severity and contrast: give one of them")
        checks.within("severity", severity, 1, 5)
        found["contrast"] = contrast_of(severity)
    return found


def _range(name: str, text: str) -> float | list[float]:
    """A number, or two with a colon between them."""
    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 2):
        raise ValueError(f"{name} must be a number, or a range such as 2:10, got {text!r}")
    return numbers[0] if len(numbers) == 1 else numbers


def _number(text: str) -> str | float:
    """A number where there is one."""
    try:
        return float(text)
    except ValueError:
        return text


def _inverse_of_network(options: dict[str, Any]) -> dict[str, Any]:
    """Depth networks give inverse depth, whatever the default is."""
    if options["network"] is not None and options["kind"] == "metric":
        options = {**options, "kind": "inverse"}
    return options


def _rows(
    inputs: list[Path],
    out: Path,
    distance: str | None,
    variants: int,
    output_format: str | None,
    network: bool,
) -> Rows:
    checks.within("variants", variants, 1)
    if network and distance is not None:
        raise ValueError("--depth-network takes the place of --distance: give one of them")
    ending = None
    if output_format is not None:
        ending = f".{output_format.lower().removeprefix('.')}"
        require_format(f"picture{ending}")
    alone = len(inputs) == 1 and not inputs[0].is_dir() and inputs[0].suffix not in INDICES
    if alone and variants == 1 and out.suffix.lower() in FORMATS and not out.is_dir():
        return Rows(inputs, distance, out.parent, network=network, name=out.name)
    return Rows(inputs, distance, out, variants, ending, network)


def _workers(wanted: int | None, count: int, ray: str | None) -> int:
    if wanted is not None:
        if wanted < 1:
            refuse(f"--workers must be at least 1, got {wanted}")
        return wanted
    # a worker takes three seconds to begin
    return 1 if count < _FEW and ray is None else min(cores(), count)
