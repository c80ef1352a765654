"""`uwaug depth`: distance maps by a depth network."""

from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from uwaug.cli.choices import Force, Resume, Workers, complete
from uwaug.cli.console import counted, end_if_failed, print_counts, reported_errors, require_folder

_HOLDS = ("inverse", "relative", "metres")
_Colour = tuple[float, float, float]


def depth(
    pictures: Annotated[Path, typer.Argument(help="Picture or folder of pictures.")],
    out: Annotated[Path, typer.Option(help="Folder to write the maps to.")],
    network: Annotated[
        str,
        typer.Option(
            help="ONNX file of a network; or one of the Hugging Face hub, fetched once: "
            "owner/name:file, or depth-anything-v2-small, of 99 MB.",
            metavar="PATH|NAME",
        ),
    ] = "depth-anything-v2-small",
    holds: Annotated[
        str,
        typer.Option(
            help="Output of the network: inverse depth, large = near (MiDaS, Depth Anything); "
            "relative, 0 near … 1 far; or metres.",
            metavar="|".join(_HOLDS),
            autocompletion=complete(*_HOLDS),
        ),
    ] = "inverse",
    short_side: Annotated[int, typer.Option(help="Short side of the input, px, if free.")] = 518,
    multiple: Annotated[int, typer.Option(help="Side of the patches, px; 32 for MiDaS.")] = 14,
    mean: Annotated[_Colour, typer.Option(help="Means of channels.")] = (0.485, 0.456, 0.406),
    std: Annotated[_Colour, typer.Option(help="Deviations of them.")] = (0.229, 0.224, 0.225),
    workers: Workers = 0,
    resume: Resume = False,
    force: Force = False,
) -> None:
    """Make distance maps of pictures by a depth network, once, for runs of degrade."""
    require_folder(out)
    with reported_errors():
        from uwaug._support import checks
        from uwaug.distance import Inverse, Metres, Network, Relative
        from uwaug.files.depth import write_maps
        from uwaug.files.search import left_out
        from uwaug.files.table import propose

        checks.one_of("holds", holds, _HOLDS)
        kind = {"inverse": Inverse, "relative": Relative, "metres": Metres}[holds]
        model = Network(
            network,
            holds=kind(),
            short_side=short_side,
            multiple=multiple,
            mean=mean,
            std=std,
        )
        rows = propose(pictures, exclude=[out])
        if unread := left_out(pictures, [out]):
            print(f"left out, as such files are not read: {unread}")
        with counted() as progress:
            summary = write_maps(
                model, rows, out, workers=workers, resume=resume, force=force, progress=progress
            )
    print_counts(summary, "maps", out)
    end_if_failed(summary.failures)
    flags = f"--set distance.kind={kind.__name__} --set distance.near=1 --set distance.far=5"
    if holds == "metres":
        flags = "--unit mm --holes far"
    files = f"{quote(str(pictures))} --distance {quote(str(out))}"
    print(f"go on: uwaug degrade {files} {flags} --out underwater")
