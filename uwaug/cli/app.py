"""The command line, `uwaug …`. Exit codes: 0 done; 1 a file or a package failed; 2 used wrongly.

Help, completion and the version load neither torch nor numpy: commands import what they need.
"""

import io
import signal
import sys
import warnings
from typing import Annotated

import typer

from uwaug import __version__
from uwaug.cli.degrade import Grouped, degrade
from uwaug.cli.depth import depth
from uwaug.cli.export import check, export
from uwaug.cli.figures import compare, demo, plot
from uwaug.cli.fit import fit, fit_patches
from uwaug.cli.page import page
from uwaug.cli.preset import preset, waters
from uwaug.cli.warm_up import warm_up

app = typer.Typer(
    help="A differentiable, batched, spectrally honest model of how water degrades an image.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="To begin: uwaug demo; then uwaug degrade photo.jpg --distance 3 --out wet/",
)

_COMMANDS = (
    ("Pictures", degrade, "photos/ --distance depth/ --unit mm --holes behind --out wet/ --sheet"),
    ("Pictures", plot, "photo.jpg --distance depth.npy --water 7C --out sheets/"),
    ("Pictures", compare, "photo.jpg --distance depth.npy --water II --out sheet.png"),
    ("Pictures", depth, "photos/ --out depth/"),
    ("Pictures", page, "--image photo.jpg --distance depth.png --unit mm --holes behind --open"),
    ("Pictures", demo, ""),
    ("Waters", fit, "--clean air.png --observed wet.png --distance depth.npy --out fit.json"),
    ("Waters", fit_patches, "charts.csv --color-space linear --out water.json"),
    ("Waters", waters, "site.csv"),
    ("ONNX files", export, "--preset survey --water 7C --out 7C.onnx"),
    ("ONNX files", check, "7C.onnx"),
    ("This machine", warm_up, ""),
)
"""Commands, each with its heading in the help and the example below its flags."""

for panel, command, example in _COMMANDS:
    epilog = f"Example: uwaug {command.__name__.replace('_', '-')} {example}" if example else None
    cls = Grouped if command is degrade else None
    app.command(cls=cls, rich_help_panel=panel, epilog=epilog)(command)
app.add_typer(preset, name="preset", rich_help_panel="Waters")


def main() -> None:
    """Run the command line."""
    warnings.formatwarning = lambda message, *_: f"{message}\n"
    # a signal would end Python without removing the file that it is writing
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # a console of another encoding than UTF-8 shows ? for β
            stream.reconfigure(errors="replace")
    # shells ask for completion through a variable that is named after the program
    app(prog_name="uwaug")


def _print_version(flag: bool) -> None:
    if flag:
        print(f"uwaug {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print it.")
    ] = False,
) -> None:
    pass
