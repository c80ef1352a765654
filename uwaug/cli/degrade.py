"""`uwaug degrade`: pictures and folders under water."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from uwaug.cli.choices import Force, Holes, Preset, Resume, Unit, Workers, number_or_word
from uwaug.cli.console import counted, end_if_failed, print_counts, print_written, reported_errors
from uwaug.files.formats import formats


def degrade(
    context: typer.Context,
    pictures: Annotated[
        Path, typer.Argument(help="A picture, a folder; or a record, to make it again.")
    ],
    out: Annotated[Path, typer.Option(help="The file or folder to write.")],
    distance: Annotated[
        str | None,
        typer.Option(
            help="A file, a folder, or a pattern such as {stem}_depth.png; metres, or 1:5. By "
            "default made-up, from each picture alone.",
            metavar="PATH|METRES|made-up",
        ),
    ] = None,
    unit: Unit = "m",
    holes: Holes = "error",
    water: Annotated[
        list[str] | None,
        typer.Option(
            help="A Jerlov type, contents, also in ranges (chlorophyll=1:20,cdom=.1:1), or a CSV "
            "file; repeat it to draw. Many waters by default."
        ),
    ] = None,
    contrast: Annotated[
        str | None,
        typer.Option(help="Left at the median distance: .4, or .1:.8; none: the water as it is."),
    ] = None,
    like: Annotated[
        list[Path] | None,
        typer.Option(
            help="A photograph taken under water that pictures shall look like: of all draws, its "
            "nearest; repeat it."
        ),
    ] = None,
    preset: Preset = None,
    plain: Annotated[
        bool,
        typer.Option(
            "--plain",
            help="Nothing random but what you name: even water as it is in nature, at the surface, "
            "a camera that changes nothing.",
        ),
    ] = False,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Any option: water.vertical_depth=0:5, development.saturation=1, light=none; "
            "drift=.004, m a frame, of a sequence; quality=80, of JPEG; repeat it.",
            metavar="NAME=VALUE",
        ),
    ] = None,
    options: Annotated[
        Path | None, typer.Option(help="The same in a TOML file, such as a preset's.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of all that is random.")] = 0,
    variants: Annotated[int, typer.Option(help="Of each picture.")] = 1,
    workers: Workers = 0,
    sequence: Annotated[
        bool, typer.Option("--sequence", help="Each folder is a film: one draw for its frames.")
    ] = False,
    resume: Resume = False,
    force: Force = False,
    sheet: Annotated[bool, typer.Option("--sheet", help="Draw some results on a sheet.")] = False,
    ray: Annotated[str | None, typer.Option(help="A Ray cluster: auto, host:port; local.")] = None,
    labels: Annotated[str | None, typer.Option(help=f"Of the pictures: {formats()}.")] = None,
    min_contrast: Annotated[
        float | None, typer.Option(help="Leaves out labels of which less contrast is left.")
    ] = None,
) -> None:
    """Put pictures under water: a random water for each, or the ones that you name.

    A record beside each picture says what was done; given in place of a picture, it makes the same
    picture again.
    """
    with reported_errors():
        if pictures.suffix == ".json":
            from uwaug.files import replay

            sources = {name: context.get_parameter_source(name) for name in context.params}
            given = {
                name for name, source in sources.items() if source and source.name != "DEFAULT"
            }
            if said_too := sorted(given - {"pictures", "out", "force"}):
                flags = ", ".join(f"--{name.rstrip('_').replace('_', '-')}" for name in said_too)
                raise ValueError(f"{pictures} is a record, which says all but --out: not {flags}")
            replay(pictures, out, force=force)
            print_written(out)
            return
        from uwaug.files import Recipe, find_items
        from uwaug.files import degrade as run
        from uwaug.files.distances import distances_of
        from uwaug.files.items import left_out
        from uwaug.files.prepare import prepare
        from uwaug.transforms import RandomUnderwater

        chosen = _options(preset, plain, options, set_ or (), water or (), contrast)
        of_run = {name: chosen.pop(name) for name in ("drift", "quality") if name in chosen}
        if "drift" in of_run and not sequence:
            raise ValueError("--set drift is of films, whose frames --sequence makes of a folder")
        if plain and not (chosen["water"].get("waters") and (distance or "distance" in chosen)):
            raise ValueError("--plain draws nothing: give both, one --water and --distance")
        of_maps: Any = {"unit": number_or_word(unit), "holes": number_or_word(holes)}
        said = distances_of(distance, chosen.pop("distance", None), sequence=sequence, **of_maps)
        if said.source is not None:
            chosen["distance"] = said.source
        recipe = Recipe(
            RandomUnderwater.from_dict(chosen),
            unit=of_maps["unit"],
            seed=seed,
            variants=variants,
            labels=labels,
            min_contrast=min_contrast,
            sequence=sequence,
            **of_run,
        )
        items = find_items(pictures, said.maps, exclude=[out, labels])
        if others := left_out(pictures, said.maps, exclude=[out, labels]):
            print(f"left out, as such files are not read: {others}")
        recipe, sentences = prepare(recipe, items, like or ())
        for sentence in filter(None, (said.note, *sentences)):
            print(sentence, flush=True)
        with counted() as progress:
            summary = run(
                recipe,
                items,
                out,
                workers=workers,
                resume=resume,
                force=force,
                sheet=sheet,
                ray=ray,
                progress=progress,
            )
    print_counts(summary, "pictures", out)
    if labels is not None:
        count, kept = summary.objects
        print(f"{kept} of {count} labels kept", *summary.notes, sep="\n")
    if summary.blank:
        some = f"{len(summary.blank)} of them, such as {summary.blank[0]}"
        cure = "are distances in another unit? If not, take clearer water by --contrast"
        print(f"next to nothing is left to see of {some}: {cure}")
    if summary.odd:
        print(f"odd scenes: {len(summary.odd)}, such as {summary.odd[0]}")
    for question in summary.asked:
        print(question)
    end_if_failed(summary.failures)


def _options(
    preset: str | None,
    plain: bool,
    file: Path | None,
    settings: Sequence[str],
    waters: Sequence[str],
    contrast: str | None,
) -> dict[str, Any]:
    """Options of `RandomUnderwater` as plain values; the later of these take the place of the
    earlier.
    """
    from uwaug.presets.preset import load_preset, read_tables
    from uwaug.transforms import RandomDevelopment, RandomWater

    if plain and preset is not None:
        raise ValueError("--plain and --preset exclude each other: presets have figures of theirs")
    options: dict[str, Any] = {"water": {}}
    if plain:
        nouns = {"water": RandomWater.PLAIN, "development": RandomDevelopment.PLAIN}
        options = {**{name: dict(values) for name, values in nouns.items()}, "light": None}
    if preset is not None:
        replaced = {"water": waters[0]} if waters else {}
        options |= load_preset(preset, **replaced).to_dict()
        options.pop("distance", None)  # of a preset's own maps
    if file is not None:
        for name, value in read_tables(file).items():
            both = isinstance(value, dict) and isinstance(options.get(name), dict)
            options[name] = options[name] | value if both else value
    if waters:
        options["water"]["waters"] = list(waters)
    if contrast is not None:
        options["water"]["contrast"] = _value(contrast)
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise ValueError(f"--set expects NAME=VALUE, got {setting!r}")
        *places, last = name.strip().split(".")
        target = options
        for place in places:
            if target.get(place) in (None, "none"):
                target[place] = {}
            target = target[place]
            if not isinstance(target, dict):
                raise ValueError(f"--set {setting}: {place} is {target!r}, no table")
        target[last] = _value(text)
    return options


def _value(text: str) -> Any:
    """A value as TOML writes it, a range such as .2:.5, none, or a word."""
    from uwaug._support.ranges import read_range

    if text.lower() == "none":
        return None
    if (ends := read_range(text)) is not None:
        return ends
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
