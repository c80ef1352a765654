"""`uwaug degrade`: pictures and folders under water."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from uwaug.cli.choices import (
    FocalPx,
    Force,
    Holes,
    Options,
    Preset,
    Resume,
    Unit,
    ViewAngle,
    Workers,
    number_or_word,
    view_table,
    with_tables,
)
from uwaug.cli.console import (
    counted,
    end_if_failed,
    print_counts,
    print_written,
    reported_errors,
    status,
)
from uwaug.files.formats import formats

if TYPE_CHECKING:
    from uwaug.files.summary import Summary
    from uwaug.files.table import Row

_RUN_OPTIONS = ("drift", "motion", "quality")  # of --set, but not of the transform
_ROWS_SHOWN = 8  # of a dry run
_GROUPS = {
    "Output": ("out", "variants", "sheet", "maps", "dry_run"),
    "Distance": ("distance", "unit", "holes", "view", "focal_px"),
    "Water": ("water", "contrast", "severity", "like", "preset", "plain", "set_", "options"),
    "Run": ("seed", "workers", "resume", "force", "ray", "help"),
    "Films": ("sequence",),
    "Labels": ("labels", "classes", "min_contrast"),
}


class Grouped(TyperCommand):
    """The command with its flags in groups."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Flags, each with the heading of its group."""
        params = super().get_params(ctx)
        for param in params:
            headings = [group for group, names in _GROUPS.items() if param.name in names]
            vars(param)["rich_help_panel"] = headings[0] if headings else None
        return params


def degrade(
    context: typer.Context,
    pictures: Annotated[
        Path,
        typer.Argument(
            help="Folder of pictures; or a table (.csv) of pictures, maps and labels; or a record "
            "(.json), whose picture is made again."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder to write; of a record, the picture.")],
    distance: Annotated[
        str | None,
        typer.Option(
            help="Folder, file, or pattern such as depth/{stem}.png; or metres, as 3 or 1:5; or "
            "guessed: by depth-anything, a network of 99 MB, or made-up, the default.",
            metavar="PATH|METRES|depth-anything|made-up",
        ),
    ] = None,
    unit: Unit = "m",
    holes: Holes = "error",
    water: Annotated[
        list[str] | None,
        typer.Option(
            help="Jerlov type, contents (chlorophyll=1:20,cdom=.1:1), or CSV file; repeat it to "
            "draw from several. Many waters by default."
        ),
    ] = None,
    contrast: Annotated[
        str | None, typer.Option(help="Contrast left at median distance, .4 or .1:.8.")
    ] = None,
    severity: Annotated[
        str | None, typer.Option(help="Murk, 1 to 5; all: a folder for each.", metavar="1…5|all")
    ] = None,
    like: Annotated[
        list[Path] | None,
        typer.Option(
            help="Underwater photographs to look like: files and folders, one for each --like."
        ),
    ] = None,
    preset: Preset = None,
    view: ViewAngle = None,
    focal_px: FocalPx = None,
    plain: Annotated[
        bool,
        typer.Option(
            "--plain",
            help="Nothing is random but what you name: even water, grey surfaces, depth 0.",
        ),
    ] = False,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Set any option, once or more: water.vertical_depth=0:5, light=none; for films "
            "drift=.004 and motion=[0.02,0,0], m a frame; quality=80 of JPEG.",
            metavar="NAME=VALUE",
        ),
    ] = None,
    options: Options = None,
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.")] = 0,
    variants: Annotated[int, typer.Option(help="Number of variants of each picture.")] = 1,
    workers: Workers = 0,
    sequence: Annotated[
        bool, typer.Option("--sequence", help="Each folder is a film: one draw for its frames.")
    ] = False,
    resume: Resume = False,
    force: Force = False,
    sheet: Annotated[bool, typer.Option("--sheet", help="Also draw a sheet of results.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show rows of the table, and what has none; then end.")
    ] = False,
    maps: Annotated[
        str | None,
        typer.Option(
            help="Also write clean light, m·z, transmission, its direct share, signal and veil, in "
            "linear light.",
            metavar="npy|exr",
        ),
    ] = None,
    labels: Annotated[
        str | None, typer.Option(help=f"Labels, or a pattern of them: {formats()}.")
    ] = None,
    classes: Annotated[
        str | None, typer.Option(help="File with the classes of YOLO's labels, as data.yaml.")
    ] = None,
    min_contrast: Annotated[
        float | None, typer.Option(help="Least contrast left for a label to be kept, 0…1.")
    ] = None,
) -> None:
    """Put pictures under water: a random water for each, or the ones that you name.

    A record beside each picture says what was done; given in place of a picture, it makes the same
    picture again.
    """
    with reported_errors():
        if pictures.suffix == ".json":
            _replay(context, pictures, out, force=force)
            return
        from uwaug.files import Recipe
        from uwaug.files import degrade as run
        from uwaug.files.distances import are_maps, distances_of
        from uwaug.files.films import frames_of
        from uwaug.files.formats import open_labels
        from uwaug.files.prepare import prepare, references_of
        from uwaug.files.table import as_csv, in_words, require_rows
        from uwaug.transforms import RandomUnderwater

        named = set_ or (), water or (), contrast
        is_contrast = "contrast" in _options(None, False, options, *named)["water"]
        if severity is not None and (is_contrast or like):
            raise ValueError("--severity is a contrast: give no contrast and no --like with it")
        values = _options(preset, plain, options, *named, is_told=distance is not None)
        if view_of := view_table(view, focal_px):
            values["view"] = view_of
        run_values = {name: values.pop(name) for name in _RUN_OPTIONS if name in values}
        maps_of = distance if are_maps(distance) else None
        rows = _rows(pictures, maps_of, labels, sequence=sequence, out=out)
        print(in_words(rows), flush=True)
        if dry_run:
            require_rows(rows)
            frames_of(rows)
            open_labels(rows, classes)
            print(as_csv(rows[:_ROWS_SHOWN]), end="")
            return
        has_maps, is_film = any(row.distance for row in rows), any(row.film for row in rows)
        if {"drift", "motion"} & {*run_values} and not is_film:
            raise ValueError(f"--set {next(iter(run_values))} is of films: give --sequence")
        is_placed = distance is not None or has_maps or "distance" in values
        if plain and not (values["water"].get("waters") and is_placed):
            raise ValueError("--plain draws nothing: give both, one --water and --distance")
        of_maps: Any = {"unit": number_or_word(unit), "holes": number_or_word(holes)}
        of_table = {"has_maps": has_maps, "is_film": is_film}
        stated = values.pop("distance", None)
        values["distance"], note = distances_of(distance, stated, **of_maps, **of_table)
        augment = RandomUnderwater.from_dict(values)
        if plain and not augment.distance.has_size:
            ends = "--set distance.near=1 --set distance.far=5"
            raise ValueError(f"--plain draws nothing, but this scene has no size: give {ends}")
        # a network of the hub that cannot be fetched ends the run before its first picture
        getattr(augment.distance, "file", None)
        recipe = Recipe(
            augment,
            unit=of_maps["unit"],
            seed=seed,
            variants=variants,
            min_contrast=min_contrast,
            classes=classes,
            maps=maps,
            **run_values,
        )
        references = references_of(like or ())
        with status() as say:
            if references:
                say("looking for waters like the photographs")
            recipe, sentences = prepare(recipe, rows, references)
        for sentence in filter(None, (note, *sentences)):
            print(sentence, flush=True)
        how: Any = {"workers": workers, "resume": resume, "force": force, "sheet": sheet}
        summaries = []
        for folder, left in _grades(severity).items():
            graded = recipe if left is None else recipe.at_contrast(left)
            with counted() as progress:
                how |= {"beside": references, "progress": progress}
                summaries.append(run(graded, rows, out / folder, **how))
            _print_summary(summaries[-1], out / folder)
    end_if_failed([failure for summary in summaries for failure in summary.failures])


def _replay(context: typer.Context, record: Path, out: Path, *, force: bool) -> None:
    from uwaug.files import replay

    flags = []
    for name in sorted(context.params.keys() - {"pictures", "out", "force"}):
        source = context.get_parameter_source(name)
        if source is not None and source.name != "DEFAULT":
            flags.append(f"--{name.rstrip('_').replace('_', '-')}")
    if flags:
        raise ValueError(f"{record} is a record, which says all but --out: not {', '.join(flags)}")
    replay(record, out, force=force)
    print_written(out)


def _rows(
    pictures: Path, maps: str | None, labels: str | None, *, sequence: bool, out: Path
) -> list["Row"]:
    """Rows of a table, or those that are proposed for a folder."""
    from uwaug.files import propose, read_table
    from uwaug.files.search import left_out

    if pictures.suffix.lower() == ".csv":
        stated = {"--distance": maps, "--labels": labels, "--sequence": sequence}
        if flags := [flag for flag, value in stated.items() if value]:
            raise ValueError(f"{pictures} is a table, which says it: leave out {flags[0]}")
        return read_table(pictures)
    rows = propose(pictures, maps, labels, sequence=sequence, exclude=[out])
    if unread := left_out(pictures, [out, maps, labels]):
        print(f"left out, as such files are not read: {unread}")
    return rows


def _grades(severity: str | None) -> dict[str, float | None]:
    """Folders below that of the run, "" for itself, and the contrast that is left in each."""
    from uwaug.transforms.random_underwater import SEVERITIES

    if severity is None:
        return {"": None}
    if severity == "all":
        return {str(level): left for level, left in SEVERITIES.items()}
    if severity not in map(str, SEVERITIES):
        raise ValueError(f"--severity must be 1 (mild) to 5 (severe), or all, got {severity!r}")
    return {"": SEVERITIES[int(severity)]}


def _print_summary(summary: "Summary", out: Path) -> None:
    print_counts(summary, "pictures", out)
    if any(result.row.labels for result in summary.results):
        count, kept = summary.objects
        print(f"{kept} of {count} labels kept")
    for sentence in (*summary.notes, *summary.asked):
        print(sentence)


def _options(
    preset: str | None,
    plain: bool,
    file: Path | None,
    settings: Sequence[str],
    waters: Sequence[str],
    contrast: str | None,
    *,
    is_told: bool = False,
) -> dict[str, Any]:
    """Options of `RandomUnderwater` as plain values; later arguments replace earlier ones, and
    distances that the run is told those of a preset.
    """
    from uwaug.presets.preset import load_preset
    from uwaug.transforms import RandomDevelopment, RandomWater

    if plain and preset is not None:
        raise ValueError("--plain and --preset exclude each other: presets have figures of theirs")
    options: dict[str, Any] = {"water": {}}
    if plain:
        nouns = {"water": RandomWater.PLAIN, "development": RandomDevelopment.PLAIN}
        options = {**{name: dict(values) for name, values in nouns.items()}, "light": None}
    if preset is not None:
        changes = {"water": waters[0]} if waters else {}
        transform = load_preset(preset, **changes)
        options |= transform.to_dict()
        if is_told or transform.distance.reads_maps:  # which are of the preset's own pictures
            options.pop("distance", None)
    options = with_tables(options, file)
    if waters:
        options["water"]["waters"] = list(waters)
    if contrast is not None:
        options["water"]["contrast"] = _value(contrast)
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise ValueError(f"--set expects NAME=VALUE, got {setting!r}")
        value = _value(text)
        name = "water.waters" if name == "water" and not isinstance(value, dict) else name
        *tables, key = name.strip().split(".")
        target = options
        for table in tables:
            if target.get(table) in (None, "none"):
                target[table] = {}
            target = target[table]
            if not isinstance(target, dict):
                raise ValueError(f"--set {setting}: {table} is {target!r}, no table")
        target[key] = value
    return options


def _value(text: str) -> Any:
    """The value of a text: as TOML has it, a range such as .2:.5, none, or a word."""
    from uwaug._support.ranges import read_range

    if text.lower() == "none":
        return None
    if (ends := read_range(text)) is not None:
        return ends
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
