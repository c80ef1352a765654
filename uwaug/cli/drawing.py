"""Sheets of a scene, drawn into a folder."""

import os
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import Progress

from uwaug._support.atomic import is_part
from uwaug.cli.console import fail, refuse

if TYPE_CHECKING:
    from uwaug.figures.demo import Drawing
    from uwaug.presets.scene import Scene

__all__ = ["draw_into", "require_folder"]


def require_folder(out: Path, names: Iterable[str], force: bool) -> None:
    """Before any work: refuse a folder that holds other files than those of `names`."""
    try:
        found = os.listdir(out)
    except FileNotFoundError:
        found = []
    except OSError as error:
        fail(f"cannot write to {out}: {error.strerror or error}")
    # what a killed process has left does not count
    others = sorted(name for name in found if name not in names and not is_part(name))
    if others and not force:
        cure = "choose an empty folder, or --force to write into it"
        refuse(f"{out} holds other files, such as {others[0]}: {cure}")


def draw_into(
    out: Path, scene: "Scene", pictures: "Mapping[str, Callable[[Scene], Drawing]]"
) -> None:
    """Draw the sheets of a scene and report each; the folder is made if need be."""
    start = time.perf_counter()
    try:
        out.mkdir(parents=True, exist_ok=True)
        report = _draw_all(out, scene, pictures)
    except OSError as error:
        fail(f"cannot write to {out}: {error.strerror or error}")
    took = time.perf_counter() - start
    print("\n".join(report))
    print(f"{len(pictures)} pictures in {out.resolve()}, {took:.1f} s")


def _draw_all(
    out: Path, scene: "Scene", pictures: "Mapping[str, Callable[[Scene], Drawing]]"
) -> list[str]:
    from uwaug._support import sheet as sheets

    errors, report = Console(stderr=True), []
    with Progress(console=errors, transient=True, disable=not errors.is_terminal) as progress:
        for name, draw in progress.track(pictures.items(), description="Drawing"):
            before = time.perf_counter()
            figure, modelled = draw(scene)
            sheets.save(figure, out / name)
            report.append(f"{out / name}  ({time.perf_counter() - before:.1f} s)")
            report += [f"    {line}" for line in modelled]
    return report
