"""`uwaug fit`: the water of a picture."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from uwaug.cli.choices import Distance, Force, Unit, number_or_word, read_metres
from uwaug.cli.console import print_written, reported_errors, require_writable


def fit(
    clean: Annotated[Path, typer.Option(help="Picture of the scene without water.")],
    observed: Annotated[Path, typer.Option(help="Picture of the scene in the water.")],
    distance: Distance,
    out: Annotated[Path, typer.Option(help="JSON file to write.")],
    unit: Unit = "m",
    holes: Annotated[
        str, typer.Option(help="Pixels of 0 or NaN: none drops them, far is open water; or error.")
    ] = "error",
    model: Annotated[
        Literal["auto", "haze", "veil", "gaussian", "exponential", "waters"],
        typer.Option(help="Model of the water; waters finds its Jerlov type, contents and depth."),
    ] = "auto",
    gain: Annotated[
        Literal["free", "fixed"], typer.Option(help="Exposure and daylight above the scene.")
    ] = "free",
    color_space: Annotated[
        Literal["srgb", "linear"],
        typer.Option(help="Values of the pictures; linear: as they are, of light or of a haze."),
    ] = "srgb",
    figure: Annotated[Path | None, typer.Option(help="PNG file of the fit to write.")] = None,
    force: Force = False,
) -> None:
    """Recover a water from a picture without it and a picture in it."""
    require_writable(out, force=force, endings=(".json",))
    if figure is not None:
        require_writable(figure, force=force, endings=(".png",))
    import torch

    import uwaug
    from uwaug._support.extras import require
    from uwaug.distance import Metres
    from uwaug.distance.unknown import of_metres
    from uwaug.files.pictures import read_picture
    from uwaug.fitting import fit_water

    with reported_errors():
        if figure is not None:
            require("plot", "matplotlib")
        if model == "waters" and gain == "fixed":
            raise ValueError("--model waters fits the gain: leave out --gain fixed")
        pictures = read_picture(clean), read_picture(observed)
        z = read_metres(distance, unit, pictures[0])
        if holes in ("error", "none"):
            z = z.masked_fill(of_metres(z), torch.nan)
        else:
            z = Metres(number_or_word(holes)).metres(z, pictures[0], {})
        if holes == "error" and (unknown := int((~(z > 0)).sum())):
            cure = "--holes none leaves them out, and far takes them for open water"
            raise ValueError(f"{distance}: unknown at {unknown} of {z.numel()} pixels: {cure}")
        if model == "waters":
            result = fit_water(*pictures, z, color_space=color_space)
        else:
            result = uwaug.fit(*pictures, z, model=model, gain=gain, color_space=color_space)
        result.save(out)
        print(result.summary())
        print_written(out)
        if figure is not None:
            result.plot().savefig(figure)
            print_written(figure)
