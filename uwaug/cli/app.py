"""The command line, `uwaug …`. Exit codes: 0 done, 1 failed (a file that cannot be read or written,
or that fails its check; a package that is missing), 2 used wrongly.
"""

import io
import os
import signal
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from uwaug import __version__
from uwaug.cli.compare import compare
from uwaug.cli.console import fail as _fail
from uwaug.cli.console import said as _said
from uwaug.cli.degrade import degrade
from uwaug.cli.demo import demo
from uwaug.cli.export import export
from uwaug.cli.fit import fit
from uwaug.cli.plot import plot
from uwaug.cli.preset import preset
from uwaug.optics.bands import WAVELENGTHS
from uwaug.optics.camera import load_camera
from uwaug.optics.water import JERLOV_TYPES, Water

app = typer.Typer(
    help="A differentiable, batched, spectrally honest model of how water degrades an image.",
    no_args_is_help=True,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command line."""
    # ended by a signal, Python would not remove the file that it is writing
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # a console of another encoding than UTF-8 shows ? for β
            stream.reconfigure(errors="replace")
    try:
        try:
            # the name of the variable through which shells ask is made of it
            app(prog_name="uwaug")
        finally:
            sys.stdout.flush()
    except OSError as error:
        # of the console alone, as commands report those of their files: else Python would try to
        # write again when it ends, and fail again
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(f"Error: cannot write to the console: {error.strerror or error}", file=sys.stderr)
        sys.exit(1)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"uwaug {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


app.command()(demo)
app.command()(plot)
app.command()(compare)


@app.command()
def waters() -> None:
    """List the water types: visibility, attenuation, doubts."""
    camera = load_camera("Nikon 5100 (NPL)")
    weights = camera.weights(WAVELENGTHS)
    means = f"β, K_d: means over the {camera.name}'s red, green, blue"
    table = Table(caption=means, caption_justify="left")
    table.add_column("type", no_wrap=True)
    for heading in ("visibility (m)", "β (1/m)", "K_d (1/m)"):
        table.add_column(heading, justify="right", no_wrap=True)
    types = [Water.jerlov(name) for name in JERLOV_TYPES]
    for water in types:
        bands, cells = water.at(WAVELENGTHS), []
        for values in (bands.beta, bands.kd):
            cells.append("  ".join(f"{mean:.3f}" for mean in values @ weights))
        table.add_row(water.name, f"{water.visibility():.1f}", *cells)
    Console().print(table)
    print("\nNot as printed in Solonenko & Mobley 2015, or doubtful:")
    for water in types:
        for note in water.provenance:
            # what is taken whole from the table has a citation without wavelengths
            if " nm: " in note:
                print(f"  {note}")


app.add_typer(preset, name="preset")
app.command()(degrade)
app.command()(fit)
app.command()(export)


@app.command()
def check(path: Annotated[Path, typer.Argument(help="A file that uwaug has exported.")]) -> None:
    """Check an ONNX file against the module it came from."""
    from uwaug.onnx import check_onnx, read_metadata, read_module

    try:
        with _said() as say:
            report = check_onnx(path, read_module(path), progress=say)
        unit = " of 255" if read_metadata(path)["uwaug_image"] == "uint8" else ""
    except (ImportError, OSError, ValueError) as error:
        _fail(error)
    worst = f"largest difference {report.worst:.2g}{unit}"
    print(f"{path}: {report.cases} cases, {worst} ({report.where})")
