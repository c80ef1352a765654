"""`uwaug demo`."""

from pathlib import Path
from typing import Annotated

import typer

from uwaug.commands.console import require_matplotlib
from uwaug.commands.drawing import draw_into, require_folder

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
    from uwaug import plots, scene

    require_folder(out, plots.PICTURES, force)
    draw_into(out, scene.motorcycle(), plots.PICTURES)
