"""`uwaug degrade`: pictures and folders under water."""

import os
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from uwaug.cli.choices import Force, Holes, Preset, Unit, number_or_word
from uwaug.cli.console import counted, end, print_written, reported_errors


def degrade(
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
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Any argument of RandomUnderwater: vertical_depth=0:5, development.saturation=1, "
            "mixing=0:1; drift=.004, m a frame, of a sequence; quality=80, of JPEG; repeat it.",
            metavar="NAME=VALUE",
        ),
    ] = None,
    options: Annotated[Path | None, typer.Option(help="The same in a TOML file.")] = None,
    seed: Annotated[int, typer.Option(help="Of all that is random.")] = 0,
    variants: Annotated[int, typer.Option(help="Of each picture.")] = 1,
    workers: Annotated[int, typer.Option(help="Processes; 0: one for each core.")] = 0,
    sequence: Annotated[
        bool, typer.Option("--sequence", help="Each folder is a film: one draw for its frames.")
    ] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on after a stop.")] = False,
    force: Force = False,
    sheet: Annotated[bool, typer.Option("--sheet", help="Draw some results on a sheet.")] = False,
    ray: Annotated[str | None, typer.Option(help="A Ray cluster: auto, host:port; local.")] = None,
    labels: Annotated[
        str | None, typer.Option(help="A COCO file, a folder of YOLO's, or one of masks.")
    ] = None,
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
            from uwaug.files.run import replay

            replay(pictures, out, force=force)
            print_written(out)
            return
        from uwaug.files.items import find_items, left_out
        from uwaug.files.run import Recipe, doubts_of, like_of
        from uwaug.files.run import degrade as run
        from uwaug.transforms import RandomUnderwater

        chosen = _transform_options(preset, options, set_ or (), water or (), contrast)
        of_run = {name: chosen.pop(name) for name in ("drift", "quality") if name in chosen}
        plane = None if distance is None else _value(distance)
        # whoever speaks of units or holes has maps
        untold = distance is None and "distance" not in chosen and (unit, holes) == ("m", "error")
        if untold and sequence:
            chosen["distance"] = [1.0, 5.0]
        elif distance == "made-up" or untold:
            given = chosen.get("distance")
            chosen["distance"] = {**(given if isinstance(given, dict) else {}), "kind": "MadeUp"}
            distance = None
        elif isinstance(plane, (float, list)):
            chosen["distance"], distance = plane, None
        elif holes != "error" and isinstance(chosen.get("distance", {}), dict):
            source = {"kind": "Metres", **chosen.get("distance", {})}
            chosen["distance"] = {**source, "holes": number_or_word(holes)}
        recipe = Recipe(
            transform=RandomUnderwater.from_dict(chosen).to_dict(),
            unit=number_or_word(unit),
            seed=seed,
            variants=variants,
            labels=labels,
            min_contrast=min_contrast,
            sequence=sequence,
            **of_run,
        )
        apart = [str(out)] if labels is None else [str(out), labels]
        items = find_items(pictures, distance, apart=apart)
        if pictures.is_dir() and (others := left_out(pictures, [*apart, distance])):
            print(f"left out, as they are neither PNG, JPEG nor TIFF: {others}")
        if untold and sequence:
            print(
                "Without --distance, all of a film is a plane, 1 to 5 m away, as distances made up "
                "from each frame would flicker."
            )
        elif untold:
            print(
                "Without --distance, distances are made up from each picture: an invented cue, "
                "good for robustness, not for restoration."
            )
        for doubt in doubts_of(recipe, items):
            print(doubt, flush=True)
        if like:
            recipe, nearness = like_of(recipe, items, like)
            print(f"like {', '.join(map(str, like))}: {nearness}", flush=True)
            if nearness.doubt:
                print(nearness.doubt, flush=True)
        with counted() as progress:
            summary = run(
                recipe,
                items,
                out,
                workers=min(workers or os.cpu_count() or 1, len(items) * variants),
                resume=resume,
                force=force,
                sheet=sheet,
                ray=ray,
                progress=progress,
            )
    written, skipped = summary.count("written"), summary.count("skipped")
    already = f", {skipped} were there" if skipped else ""
    print(f"{written} of {len(summary.results)} pictures written to {out}{already}")
    if labels is not None:
        count, kept = summary.objects
        print(f"{kept} of {count} labels kept")
    if summary.blank:
        some = f"{len(summary.blank)} of them, such as {summary.blank[0]}"
        cure = "are distances in another unit? If not, take clearer water by --contrast"
        print(f"next to nothing is left to see of {some}: {cure}")
    if summary.odd:
        cure = "are distances metres? --contrast none leaves them and the water as they are"
        print(f"odd scenes: {len(summary.odd)}, such as {summary.odd[0]}: {cure}")
    if summary.failures:
        more = f"\nand {len(summary.failures) - 5} more" if len(summary.failures) > 5 else ""
        end(1, "\n".join(summary.failures[:5]) + more)


def _transform_options(
    preset: str | None,
    file: Path | None,
    settings: Sequence[str],
    waters: Sequence[str],
    contrast: str | None,
) -> dict[str, Any]:
    """Options of `RandomUnderwater` as plain values; the later of these take the place of the
    earlier.
    """
    from uwaug.transforms import RandomUnderwater

    options: dict[str, Any] = {}
    if preset is not None:
        replaced = {"water": waters[0]} if waters else {}
        options = RandomUnderwater.from_preset(preset, **replaced).to_dict()
    if waters:
        options["waters"] = list(waters)
    if file is not None:
        try:
            options |= tomllib.loads(file.read_text(encoding="utf-8"))
        except tomllib.TOMLDecodeError as error:
            raise ValueError(f"{file}: {error}") from None
    if contrast is not None:
        options["contrast"] = _value(contrast)
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise ValueError(f"--set expects NAME=VALUE, got {setting!r}")
        *tables, last = name.strip().split(".")
        target = options
        for table in tables:
            target = target.setdefault(table, {})
        target[last] = _value(text)
    return options


def _value(text: str) -> Any:
    """A value as TOML writes it, a range such as .2:.5, none, or a word."""
    if text == "none":
        return None
    try:
        ends = [float(part) for part in text.split(":")]
        return ends[0] if len(ends) == 1 else ends
    except ValueError:
        pass
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
