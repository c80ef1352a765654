"""`uwaug fit` and `uwaug fit-patches`: the water of pictures, or of charts in them."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from uwaug.cli.choices import Distance, Force, Unit, number_or_word, read_metres, view_table
from uwaug.cli.console import print_written, reported_errors, require_writable

if TYPE_CHECKING:
    from uwaug.fitting import Fit

Out = Annotated[Path, typer.Option(help="JSON file to write.")]
Figure = Annotated[Path | None, typer.Option(help="PNG file of the fit to write.")]


def fit(
    observed: Annotated[Path, typer.Option(help="Picture of the scene in the water.")],
    distance: Distance,
    out: Out,
    clean: Annotated[
        Path | None,
        typer.Option(help="Picture of it without water; else the veil alone is estimated."),
    ] = None,
    unit: Unit = "m",
    holes: Annotated[
        str, typer.Option(help="Pixels of 0 or NaN: none drops them, far is open water; or error.")
    ] = "error",
    model: Annotated[
        Literal["auto", "haze", "veil", "gaussian", "exponential", "waters"],
        typer.Option(help="Model of the water; waters finds its Jerlov type, contents and depth."),
    ] = "auto",
    surfaces: Annotated[
        Literal["auto", "grey", "spectral"] | None,
        typer.Option(help="Of --model waters: grey, with spectra, or else what fits better."),
    ] = None,
    camera: Annotated[
        str | None, typer.Option(help="Of --model waters: a camera's name, or a CSV file.")
    ] = None,
    g: Annotated[
        float | None, typer.Option(help="Of --model waters: share scattered away; else .05.")
    ] = None,
    mu: Annotated[
        float | None, typer.Option(help="Of --model waters: share scattered back; else 1.5·g.")
    ] = None,
    view: Annotated[
        float | None, typer.Option(help="Of --model waters: angle of view, degrees; else 60.")
    ] = None,
    focal_px: Annotated[
        float | None, typer.Option(help="In place of --view: focal length, px of the pictures.")
    ] = None,
    balance: Annotated[
        Literal["known", "free"] | None,
        typer.Option(help="Of --model waters: white as in --clean, or a gain for each colour."),
    ] = None,
    darkest: Annotated[
        float | None, typer.Option(help="Without --clean: what is darkest reflects; else .05.")
    ] = None,
    gain: Annotated[
        Literal["free", "fixed"], typer.Option(help="Exposure and daylight above the scene.")
    ] = "free",
    color_space: Annotated[
        Literal["srgb", "linear"],
        typer.Option(help="Values of the pictures; linear: as they are, of light or of a haze."),
    ] = "srgb",
    figure: Figure = None,
    force: Force = False,
) -> None:
    """Recover a water from pictures without it and in it; or its veil from the latter alone."""
    _require_files(out, figure, force=force)
    import torch

    import uwaug
    from uwaug.distance import Metres
    from uwaug.distance.unknown import of_metres
    from uwaug.files.pictures import jpeg_quality, read_picture
    from uwaug.fitting import fit_veil, fit_water

    with reported_errors():
        if gain == "fixed" and (model == "waters" or clean is None):
            raise ValueError("--gain fixed needs --clean, and another model than waters")
        optics: dict[str, Any] = {
            "surfaces": surfaces,
            "camera": camera,
            "g": g,
            "mu": mu,
            "balance": balance,
        }
        optics = {name: value for name, value in optics.items() if value is not None}
        if table := view_table(view, focal_px):
            optics["view"] = uwaug.View(**table)
        if optics and model != "waters":
            raise ValueError(f"--{next(iter(optics))} is of --model waters, got --model {model}")
        if clean is None and model not in ("auto", "veil"):
            raise ValueError(f"--model {model} needs --clean")
        if clean is not None and darkest is not None:
            raise ValueError("--darkest is of fits without --clean: leave one of them out")
        wet = read_picture(observed)
        z = read_metres(distance, unit, wet)
        if holes in ("error", "none"):
            z = z.masked_fill(of_metres(z), torch.nan)
        else:
            z = Metres(number_or_word(holes)).metres(z, wet, {})
        if holes == "error" and (unknown := int((~(z > 0)).sum())):
            cure = "--holes none leaves them out, far is open water"
            raise ValueError(f"{distance}: unknown at {unknown} of {z.numel()} pixels: {cure}")
        options: dict[str, Any] = {"color_space": color_space}
        if clean is None:
            if darkest is not None:
                options["darkest"] = darkest
            result = fit_veil(wet, z, **options)
        else:
            dry, options["jpeg"] = read_picture(clean), jpeg_quality(observed)
            if model == "waters":
                result = fit_water(dry, wet, z, **options, **optics)
            else:
                result = uwaug.fit(dry, wet, z, model=model, gain=gain, **options)
        _write(result, out, figure)


def fit_patches(
    table: Annotated[Path, typer.Argument(help="CSV table: a patch of a chart in each line.")],
    out: Out,
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
    figure: Figure = None,
    force: Force = False,
) -> None:
    """Recover a water from patches of colour charts at known distances."""
    _require_files(out, figure, force=force)
    from uwaug import fitting

    with reported_errors():
        result = fitting.fit_patches(
            fitting.read_patches(table),
            color_space=color_space,
            model=model,
            uneven=uneven,
            distance_error=distance_error,
        )
        _write(result, out, figure)


def _require_files(out: Path, figure: Path | None, *, force: bool) -> None:
    """Refuse files that cannot be written, before anything is fitted."""
    require_writable(out, force=force, endings=(".json",))
    if figure is not None:
        require_writable(figure, force=force, endings=(".png",))
        from uwaug._support.extras import require

        with reported_errors():
            require("plot", "matplotlib")


def _write(result: "Fit", out: Path, figure: Path | None) -> None:
    result.save(out)
    print(result.summary())
    print_written(out)
    if figure is not None:
        result.plot().savefig(figure)
        print_written(figure)
