"""`uwaug demo`."""

from pathlib import Path
from typing import Annotated

import typer

from uwaug.cli.console import require_matplotlib
from uwaug.cli.drawing import draw_into, require_folder

__all__ = ["demo"]


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the pictures; made if need be.")] = Path(
        "uwaug-demo"
    ),
    force: Annotated[
        bool, typer.Option("--force", help="Write even if the folder holds other files.")
    ] = False,
) -> None:
    """Draw a real scene in ten waters, term by term."""
    require_matplotlib("the demo draws")
    from uwaug.figures import demo as plots
    from uwaug.presets import scene

    require_folder(out, plots.PICTURES, force)
    draw_into(out, scene.motorcycle(), plots.PICTURES)
