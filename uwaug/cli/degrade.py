"""`uwaug degrade`: its flags, and the recipe and the pictures that they come to."""

import inspect
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uwaug.cli import distances
from uwaug.cli.choices import PICTURE_FORMATS, Surfaces, complete, preset_option, water_option
from uwaug.cli.console import refuse, reported_errors, require_package

if TYPE_CHECKING:
    from uwaug.jobs.items import Items

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


def _range(text: str) -> float | list[float]:
    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 2):
        raise typer.BadParameter(f"expected a number, or a range such as 2:10, got {text!r}")
    return numbers[0] if len(numbers) == 1 else numbers


def _exposure(text: str) -> str | float | list[float]:
    if text in ("auto", "none"):
        return text
    try:
        return _range(text)
    except typer.BadParameter:
        expected = "auto, none, stops, or a range of them such as -1:1"
        raise typer.BadParameter(f"expected {expected}, got {text!r}") from None


def _panel(name: str) -> Callable[..., Any]:
    """`typer.Option` for a group of flags in the help."""
    return partial(typer.Option, rich_help_panel=name)


_water, _output = _panel("Water"), _panel("Output")
_drawn, _camera = _panel("Drawn for each picture"), _panel("Camera")
_labels, _run = _panel("Labels"), _panel("Run")
_ranged = partial(_drawn, parser=_range, metavar="NUMBER|LOW:HIGH")
_developed = partial(_camera, parser=_range, metavar="NUMBER|LOW:HIGH")
_scaled = partial(distances.flag, parser=_range, metavar="NUMBER|LOW:HIGH")


def degrade(
    context: typer.Context,
    inputs: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Pictures, folders of them, or lists: CSV or Parquet with a column input and, if "
            "they like, id, distance, output."
        ),
    ] = None,
    water: Annotated[
        str | None,
        water_option(
            "Jerlov type: I, IA, IB, II, III, 1C, 3C, 5C, 7C, 9C. Or contents, such as "
            "chlorophyll=5,cdom=0.3,minerals=1 (mg/m³, 1/m at 440 nm, g/m³), each a number or a "
            "range, LOW:HIGH. Or a CSV file: wavelength (nm), a, b, K_d (1/m).",
            "Water",
        ),
    ] = None,
    preset: Annotated[
        str | None, preset_option("A preset, or the path of a TOML file.", "Water")
    ] = None,
    fit: Annotated[Path | None, _water(help="What uwaug fit has written.")] = None,
    random: Annotated[
        bool, _water("--random", help="A water of its own for each picture.")
    ] = False,
    hazy: Annotated[
        bool,
        _water(
            "--hazy",
            help="--random as it was up to version 0.1: turbid waters, grey surfaces, a camera "
            "that shows its raw channels.",
        ),
    ] = False,
    options: Annotated[
        Path | None, _water(help="TOML file of options of RandomUnderwater, such as lamps.")
    ] = None,
    distance: Annotated[
        str | None,
        distances.flag(
            help="Distance of each pixel: a folder of files with the pictures' names, a pattern "
            "such as {stem}_depth.png, one file, metres, or a range of metres, LOW:HIGH, of which "
            "each picture gets one.",
            metavar="PLACE|METRES|LOW:HIGH",
        ),
    ] = None,
    distance_kind: distances.Kind = "metric",
    distance_unit: distances.Unit = "m",
    unknown: distances.Unknown = "error",
    planar: distances.Planar = False,
    focal_px: distances.FocalPx = None,
    baseline: distances.Baseline = None,
    offset_px: distances.OffsetPx = 0.0,
    depth_network: Annotated[
        Path | None, distances.flag(help="Depth network (ONNX), in place of --distance.")
    ] = None,
    near: Annotated[Any, _scaled(help="m, of relative and inverse distances.")] = None,
    far: Annotated[Any, _scaled(help="m, of relative and inverse distances.")] = None,
    gamma: Annotated[Any, _scaled(help="Exponent, of relative distances.")] = None,
    visibility: Annotated[Any, _ranged(help="m.")] = None,
    contrast: Annotated[Any, _ranged(help="Left at the median distance, 0…1.")] = None,
    severity: Annotated[
        int | None,
        _drawn(
            min=1,
            max=5,
            help="1 (mild) to 5: a contrast; --random as --hazy.",
            autocompletion=complete(*"12345"),
        ),
    ] = None,
    vertical_depth: Annotated[
        Any, _ranged("--vertical-depth", "--depth", help="Of the scene below the surface, m.")
    ] = None,
    seed: Annotated[int, _drawn(min=0, max=2**64 - 1, help="Of all that is random.")] = 0,
    variants: Annotated[int, _drawn(min=1, help="Of each picture.")] = 1,
    surfaces: Annotated[
        Surfaces | None,
        _camera(
            help="spectral: each colour loses light by its own spectrum, so that reds turn grey "
            "and black; grey: all colours as a grey card does."
        ),
    ] = None,
    color_matrix: Annotated[
        Any, _developed(help="Share of the camera's colour matrix, 0…1; of spectral surfaces.")
    ] = None,
    exposure: Annotated[
        Any,
        _camera(
            help="auto, none, or a gain in stops.",
            parser=_exposure,
            metavar="auto|none|STOPS",
            autocompletion=complete("auto", "none"),
        ),
    ] = None,
    compensation: Annotated[Any, _developed(help="Stops, on top of the exposure.")] = None,
    white_balance: Annotated[
        Any, _developed(help="Share of a grey-world correction, up to 1; 0 and less: none.")
    ] = None,
    saturation: Annotated[Any, _developed(help="0: grey; 1: as it is.")] = None,
    black_point: Annotated[
        Any, _developed(help="Share of the darkest percent's light that becomes black, 0…1.")
    ] = None,
    gamut: Annotated[
        Any, _developed(help="Share of gamut compression, 0…1; 0 clips negative channels.")
    ] = None,
    tone: Annotated[
        Any, _developed(help="Contrast of the tone curve about mid-grey; 1: straight.")
    ] = None,
    out: Annotated[
        Path | None,
        _output(help="Folder to write to, made if need be; or, of one picture, a file."),
    ] = None,
    output_format: Annotated[
        str | None,
        _output(
            "--format",
            help="png, jpg, webp, tif, npy; that of each picture by default.",
            autocompletion=complete(*PICTURE_FORMATS),
        ),
    ] = None,
    keep_terms: Annotated[
        bool,
        _output("--keep-terms", help="The direct, forward and backscattered light too."),
    ] = False,
    sheet: Annotated[bool, _output("--sheet", help="Some of the results on one sheet.")] = False,
    force: Annotated[bool, _output("--force", help="Write over what is there.")] = False,
    labels: Annotated[
        Path | None, _labels(help="COCO file, or folder of YOLO's .txt or of .png masks.")
    ] = None,
    min_contrast: Annotated[
        float | None, _labels(help="Labels of what keeps less, 0…1, are marked as ignored.")
    ] = None,
    ignore_index: Annotated[
        int | None,
        _labels("--ignore-index", "--void", help='Value of masks that means "ignored" already.'),
    ] = None,
    resume: Annotated[
        bool, _run("--resume", help="Go on where the same command was stopped.")
    ] = False,
    dry_run: Annotated[
        bool, _run("--dry-run", help="Say what would be read and written, and how long.")
    ] = False,
    replay: Annotated[
        Path | None,
        _run("--replay", "--from", help="A record: make its picture again, the same bytes."),
    ] = None,
    workers: Annotated[
        int | None, _run(min=1, help="Processes; by default one for each core.")
    ] = None,
    ray: Annotated[
        str | None,
        _run(
            help="In place of processes: local (Ray is started on this machine), auto (its "
            "cluster), or host:port of a cluster.",
            autocompletion=complete("local", "auto"),
        ),
    ] = None,
    shards: Annotated[
        str | None,
        _run(
            help="In place of --out, with --ray: Parquet files with the pictures inside, in a "
            "folder, s3://…, gs://… or fsspec+NAME://…"
        ),
    ] = None,
) -> None:
    """Your pictures, under water: with a record beside each, and an index of all."""
    if (out is None) == (shards is None):
        got = "neither" if out is None else "both"
        refuse(f"expected --out, or --shards in its place, got {got}")
    drawn = {
        "visibility": visibility,
        "contrast": contrast,
        "vertical_depth": vertical_depth,
        "surfaces": surfaces,
        "color_matrix": color_matrix,
        "exposure": exposure,
        "compensation": compensation,
        "white_balance": white_balance,
        "saturation": saturation,
        "black_point": black_point,
        "gamut": gamut,
        "tone": tone,
        "near": near,
        "far": far,
        "gamma": gamma,
    }
    if replay is not None:
        if out is None:
            refuse("--replay writes a file: give --out")
        sources = {name: context.get_parameter_source(name) for name in context.params}
        given = {
            name for name, source in sources.items() if source and source.name == "COMMANDLINE"
        }
        if len(inputs or []) > 1 or given - {"replay", "out", "force", "inputs", "distance"}:
            refuse(
                "--replay takes all from the record: give nothing but --out and files that moved"
            )
        from uwaug.cli.run import repeat

        repeat(replay, out, force, inputs or [], distance)
        return
    if not inputs:
        refuse("expected a picture, a folder of pictures, a list of them, or --replay")
    waters = {"water": water, "preset": preset, "fit": fit, "random": random or hazy}
    chosen = [f"--{name}" for name, value in waters.items() if value]
    if not chosen:
        cure = ""
        named = [name for name, value in drawn.items() if value is not None]
        if named:
            flag = f"--{named[0].replace('_', '-')}"
            cure = f": {flag} names no water: add --random, or one such as --water 3C"
        refuse(f"expected --water, --preset, --fit or --random, got none of them{cure}")
    if len(chosen) > 1 and chosen != ["--water", "--preset"]:
        got = " and ".join(chosen)
        refuse(f"expected one of --water, --preset, --fit and --random, got {got}")
    if depth_network is not None and distance is not None:
        refuse("--depth-network takes the place of --distance: give one of them")
    if shards is not None and ray is None:
        refuse("--shards is written by Ray: give --ray local, or an address")
    if shards is not None and (sheet or keep_terms):
        flag = "--sheet" if sheet else "--keep-terms"
        refuse(f"{flag} is a file of its own, and --shards has none: give --out")
    if ray not in (None, "local") and workers is not None:
        refuse(f"--workers: the cluster at {ray} has its own")
    if sheet:
        require_package("plot", "matplotlib")
    if ray is not None:
        require_package("ray", "ray.data")

    from uwaug.cli.run import Run
    from uwaug.io.write import FORMATS
    from uwaug.jobs import Recipe
    from uwaug.jobs.pool import cores

    place = Path(str(shards)) if out is None else out
    with reported_errors():
        distance_format = distances.format_of(
            distance_kind,
            distance_unit,
            unknown,
            planar=planar,
            focal_px=focal_px,
            baseline=baseline,
            offset_px=offset_px,
            network=depth_network,
        )
        distance_place = None if distance is None else distances.place_of(distance)
        if isinstance(distance_place, (float, tuple)):
            distance_format.require_constant()
        planes = distance_place if isinstance(distance_place, tuple) else None
        as_hazy = hazy or (random and severity is not None)
        drawn_options = _options(options, drawn, severity, hazy=as_hazy)
        if focal_px is not None and preset is None and fit is None:
            drawn_options.setdefault("focal_px", focal_px)
        if planes is not None:
            drawn_options["distance"] = list(planes)
        recipe = Recipe(
            water=water,
            preset=preset,
            fit=None if fit is None else str(fit),
            random=random or hazy,
            options=drawn_options,
            distance=distance_format,
            seed=seed,
            labels=None if labels is None else str(labels),
            min_contrast=min_contrast,
            void=ignore_index,
            keep_terms=keep_terms,
        ).resolved()
        from_files = None if planes is not None else distance
        unmapped = planes is not None or depth_network is not None
        items = _items(inputs, place, from_files, variants, output_format, unmapped, labels)
        if shards is None and items.name is None and out and out.suffix and not out.is_dir():
            expected = f"the file of one picture, which ends in {', '.join(FORMATS)}, or a folder"
            cure = "make the folder first if it is to be called so"
            got = f", got {len(items)} pictures" if out.suffix.lower() in FORMATS else ""
            refuse(f"--out {out}: expected {expected}{got}: {cure}")
        source = recipe.open_labels()
        count = len(items)
    if workers is None:
        # a worker takes three seconds to begin
        workers = 1 if count < _FEW and ray is None else min(cores(), count)
    run = Run(items, recipe, source, workers, resume=resume, force=force, sheet=sheet, ray=ray)
    run.require_free(in_files=shards is None)
    if dry_run:
        run.rehearse()
    elif shards is None:
        run.carry_out()
    else:
        run.carry_out_in_shards(shards)


def _options(
    path: Path | None, drawn: dict[str, Any], severity: int | None, *, hazy: bool
) -> dict[str, Any]:
    """Options of `RandomUnderwater`, from a file and from flags; of its `hazy` those too that
    neither names.
    """
    from uwaug import RandomUnderwater
    from uwaug._support.parse import from_toml
    from uwaug.transforms.codec import encode_options
    from uwaug.transforms.random_underwater import SEVERITIES, hazy_options

    options: dict[str, Any] = {}
    if path is not None:
        try:
            options = from_toml(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise ValueError(f"{path}: is no TOML: {error}") from None
        names = [n for n in inspect.signature(RandomUnderwater).parameters if n not in _NOT_OPTIONS]
        for name in options:
            if name not in names:
                raise ValueError(f"{path}: unknown key {name}; there are {', '.join(names)}")
    options |= {name: value for name, value in drawn.items() if value is not None}
    if severity is not None:
        if "contrast" in options:
            refuse("--severity and --contrast: give one of them")
        options["contrast"] = SEVERITIES[severity]
    return encode_options(hazy_options(options)) if hazy else options


def _items(
    inputs: list[Path],
    out: Path,
    distance: str | None,
    variants: int,
    output_format: str | None,
    unmapped: bool,
    labels: Path | None,
) -> "Items":
    from uwaug.io.write import FORMATS, format_of
    from uwaug.jobs.items import Items, is_manifest

    ending = None
    if output_format is not None:
        ending = f".{output_format.lower().removeprefix('.')}"
        format_of(f"picture{ending}")
    alone = len(inputs) == 1 and not inputs[0].is_dir() and not is_manifest(inputs[0])
    if alone and variants == 1 and out.suffix.lower() in FORMATS and not out.is_dir():
        return Items(inputs, distance, out.parent, unmapped=unmapped, name=out.name)
    return Items(
        inputs, distance, out, variants=variants, ending=ending, unmapped=unmapped, labels=labels
    )
