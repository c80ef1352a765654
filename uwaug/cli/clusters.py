"""`uwaug degrade --ray`: what only Ray can do."""

import sys
import time
from pathlib import Path

import typer
from rich.console import Console

from uwaug.cli.console import fail, refuse, require_matplotlib
from uwaug.cli.runs import INTERRUPTED, LISTED, Manner, failures
from uwaug.jobs.items import Items
from uwaug.jobs.ray import LOCAL, Shards, connected, require_ray
from uwaug.jobs.recipe import Recipe
from uwaug.labels import LabelSource

__all__ = ["carry_out_in_shards", "place_of", "require_manner"]


def place_of(out: Path | None, shards: str | None, *, alone: bool) -> Path:
    """Where a run writes to: files, or shards; `alone`: it writes one file."""
    if (out is None) == (shards is None):
        got = "neither" if out is None else "both"
        refuse(f"expected --out, or --shards in its place, got {got}")
    if out is None and alone:
        refuse("--from writes a file: give --out")
    return Path(str(shards)) if out is None else out


def require_manner(
    manner: Manner, shards: str | None, workers: int | None, *, keep_terms: bool
) -> None:
    """Refuse options that do not go together, or need what is not there, before the run."""
    if manner.sheet:
        require_matplotlib("the sheet is drawn")
    if manner.ray is None:
        if shards is not None:
            refuse(f"--shards is written by Ray: give --ray {LOCAL}, or an address")
        return
    if workers is not None and manner.ray != LOCAL:
        refuse(f"--workers: the cluster at {manner.ray} has its own")
    if shards is not None and (manner.sheet or keep_terms):
        odd = "--sheet" if manner.sheet else "--keep-terms"
        refuse(f"{odd} is a file of its own, and --shards has none: give --out")
    try:
        require_ray()
    except ImportError as error:
        fail(error)


def carry_out_in_shards(
    items: Items, recipe: Recipe, manner: Manner, source: LabelSource | None, place: str
) -> None:
    """Degrade all pictures into shards; end with 1 if any failed."""
    start = time.perf_counter()
    try:
        shards = Shards(place)
        shards.prepare(recipe, resume=manner.resume, force=manner.force)
    except FileExistsError as error:
        refuse(f"{error}: --resume to go on, --force to remove them, or another place")
    except (ValueError, ImportError) as error:
        refuse(error)
    except OSError as error:
        fail(error)
    assert manner.ray is not None
    try:
        with connected(manner.ray, manner.workers):
            shown = Console(stderr=True).is_terminal
            shards.write(items, recipe, labels=source, progress=shown)
        tally = shards.tally(LISTED)
    except KeyboardInterrupt:
        print("Stopped; --resume goes on.", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    except (OSError, ValueError) as error:
        fail(error)
    took = time.perf_counter() - start
    print(f"{tally.rows - tally.failed} of {len(items)} pictures in {place}, {took:.1f} s")
    if tally.failed:
        failed, rest = (tally.failed, tally.rows, tally.reasons), ": rows whose status is failed"
        fail(failures(*failed, rest))
