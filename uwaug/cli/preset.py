"""`uwaug preset …`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from uwaug._support.atomic import written_whole
from uwaug.cli.console import fail, refuse, require_room
from uwaug.cli.names import complete_preset
from uwaug.presets.files import bundled_preset, list_presets, preset_path
from uwaug.presets.preset import load_preset

__all__ = ["preset"]

_WIDE = 250
"""Columns: more than any row has."""

preset = typer.Typer(
    help="List presets, show one, or copy one to edit it.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@preset.command("list")
def list_() -> None:
    """List the presets and where their figures come from."""
    table = Table("name", "distance (m)", "γ", "field", "source", box=None, pad_edge=False)
    for name in list_presets():
        p = load_preset(name)
        low, high = p.field_range
        table.add_row(name, f"{p.near:g}–{p.far:g}", f"{p.gamma:g}", f"{low:g}–{high:g}", p.source)
    # a line for each, that a script can read, however narrow the terminal
    Console(width=_WIDE).print(table)


@preset.command()
def show(
    name: Annotated[
        str,
        typer.Argument(
            help="A preset, or the path of a .toml file.", autocompletion=complete_preset
        ),
    ],
) -> None:
    """Print a preset's file, and the medium that it comes to."""
    try:
        path = preset_path(name)
    except ValueError as error:
        refuse(error)
    try:
        text = path.read_text(encoding="utf-8")
        medium = load_preset(path).medium
    except (OSError, ValueError) as error:
        fail(error)
    # as a comment: what is printed is a preset's file too
    print(f"{text.rstrip()}\n\n# It comes to {medium}")


@preset.command()
def copy(
    name: Annotated[
        str, typer.Argument(help="A preset, see uwaug preset list.", autocompletion=complete_preset)
    ],
    file: Annotated[Path, typer.Argument(help="The .toml file to write.")],
    force: Annotated[bool, typer.Option("--force", help="Write over an existing file.")] = False,
) -> None:
    """Copy a preset into a file of your own, to edit it."""
    try:
        source = bundled_preset(name)
    except ValueError as error:
        refuse(error)
    if file.suffix != ".toml":
        refuse(f"{file}: expected a name that ends in .toml, as --preset asks for one")
    require_room(file, force)
    try:
        with written_whole(file) as part:
            part.write_bytes(source.read_bytes())
    except OSError as error:
        fail(error)
    print(f"{file}  (a copy of {name}: edit it, then use it with --preset {file})")
