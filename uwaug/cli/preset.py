"""`uwaug preset …` and `uwaug waters`."""

import json
from contextlib import suppress
from typing import Annotated

import typer

from uwaug.cli.choices import PLACES, WATERS, Preset, complete
from uwaug.cli.console import reported_errors
from uwaug.presets.files import list_presets, preset_path

_TABLE_COLUMNS = 250  # more letters than any row has

preset = typer.Typer(help="List presets, or show one.", no_args_is_help=True)


@preset.command("list")
def list_() -> None:
    """List the presets and where their figures come from."""
    from rich.console import Console
    from rich.table import Table

    from uwaug.distance import Relative
    from uwaug.presets import load_preset

    table = Table("name", "distance (m)", "γ", "field", "what", box=None, pad_edge=False)
    for name in list_presets():
        preset = load_preset(name)
        low, high = preset.water.field or (1.0, 1.0)
        source, ends, gamma = preset.distance, "of maps", ""
        if isinstance(source, Relative):
            ends, gamma = f"{source.near:g}–{source.far:g}", f"{source.gamma:g}"
        title = preset_path(name).read_text(encoding="utf-8").partition("\n")[0].lstrip("# ")
        table.add_row(name, ends, gamma, f"{low:g}–{high:g}", title)
    # a line for each, that a script can read, however narrow the terminal
    Console(width=_TABLE_COLUMNS).print(table)


@preset.command()
def show(
    name: Annotated[
        str, typer.Argument(help="Or a .toml file.", autocompletion=complete(*list_presets()))
    ],
) -> None:
    """Print the file of a preset, and its medium."""
    from uwaug.presets import load_preset

    with reported_errors():
        path = preset_path(name)
        text, preset = path.read_text(encoding="utf-8"), load_preset(path)
    print(text.rstrip())
    with suppress(ValueError):  # where something is random, there is no one medium
        # as a comment: what is printed is a preset's file too
        print(f"\n# It comes to {preset.module().medium}")


def waters(
    own: Annotated[
        list[str] | None,
        typer.Argument(metavar="[WATER]...", help="Waters of your own: contents, or CSV files."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print inputs for uwaug export --coefficients.")
    ] = False,
    preset: Preset = "survey",
) -> None:
    """List the waters: visibility, attenuation, doubts. Or, as JSON, their numbers in a preset."""
    names = (*(own or ()), *WATERS, *PLACES)
    if as_json:
        from uwaug.onnx import input_rows
        from uwaug.presets import load_preset

        with reported_errors():
            modules = {name: load_preset(preset or "", water=name).module() for name in names}
        media = {name: module.medium for name, module in modules.items()}
        rows = {"preset": preset, **input_rows(media, modules[WATERS[0]].light)}
        print(json.dumps(rows, ensure_ascii=False))
        return
    from rich.console import Console
    from rich.table import Table

    from uwaug import Constituents, load_camera, load_water
    from uwaug.optics.constituents import PLACES as CONTENTS
    from uwaug.optics.jerlov import IN_WORDS
    from uwaug.optics.reduction import default_bands

    camera = load_camera("Nikon 5100 (NPL)")
    means = f"view: visibility; β, K_d: red, green, blue of the {camera.name}"
    table = Table(caption=means, caption_justify="left")
    table.add_column("water", no_wrap=True)
    for heading in ("view (m)", "β (1/m)", "K_d (1/m)"):
        table.add_column(heading, justify="right", no_wrap=True)
    with reported_errors():
        waters = [load_water(name) for name in names]
    for water in waters:
        bands = water.at(default_bands(water))
        weights = camera.weights(bands.wavelengths)
        means_of = [" ".join(f"{x:.3f}" for x in rate @ weights) for rate in (bands.beta, bands.kd)]
        words = IN_WORDS.get(water.name, "see below" if water.name in PLACES else "yours")
        table.add_row(f"{water.name}, {words}", f"{water.visibility():.1f}", *means_of)
    Console().print(table)
    print("\nPlaces, by their contents (mg/m³, 1/m, g/m³):")
    for name in PLACES:
        print(f"  {name}: {Constituents(**CONTENTS[name]).name}")
    print("\nNot as printed in Solonenko & Mobley 2015, or doubtful:")
    for water in waters:
        for note in water.provenance:
            # values taken from the table as a whole have a citation without wavelengths
            if " nm: " in note:
                print(f"  {note}")
