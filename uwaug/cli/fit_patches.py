"""`uwaug fit-patches`: the water of charts at known distances."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from uwaug.cli.choices import Force
from uwaug.cli.console import print_written, reported_errors, require_writable


def fit_patches(
    table: Annotated[Path, typer.Argument(help="CSV table: a patch of a chart in each line.")],
    out: Annotated[Path, typer.Option(help="JSON file to write.")],
    color_space: Annotated[
        Literal["linear", "srgb"],
        typer.Option(help="Values of the table: of light (raw), or of a JPEG, to be decoded."),
    ],
    model: Annotated[
        Literal["haze", "veil"], typer.Option(help="haze: one rate a colour; veil: two.")
    ] = "haze",
    uneven: Annotated[
        float, typer.Option(help="Standard deviation of the light on charts, as a share.")
    ] = 0.3,
    distance_error: Annotated[
        float, typer.Option(help="Standard deviation of distances, as a share.")
    ] = 0.0,
    figure: Annotated[Path | None, typer.Option(help="PNG file of the fit to write.")] = None,
    force: Force = False,
) -> None:
    """Recover a water from patches of colour charts at known distances."""
    require_writable(out, force=force, endings=(".json",))
    if figure is not None:
        require_writable(figure, force=force, endings=(".png",))
    from uwaug import fitting
    from uwaug._support.extras import require

    with reported_errors():
        if figure is not None:
            require("plot", "matplotlib")
        result = fitting.fit_patches(
            fitting.read_patches(table),
            color_space=color_space,
            model=model,
            uneven=uneven,
            distance_error=distance_error,
        )
        result.save(out)
        print(result.summary())
        print_written(out)
        if figure is not None:
            result.plot().savefig(figure)
            print_written(figure)
