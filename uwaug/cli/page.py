"""`uwaug page`: the model in a browser."""

from pathlib import Path
from typing import Annotated, Any

import typer

from uwaug.cli.choices import WATERS, Force, Holes, Unit, complete, number_or_word, read_metres
from uwaug.cli.console import print_written, reported_errors, require_writable


def page(
    out: Annotated[Path, typer.Option(help="HTML file to write.")] = Path("uwaug-page.html"),
    image: Annotated[
        Path | None, typer.Option(help="The scene without water; a motorcycle by default.")
    ] = None,
    distance: Annotated[
        str | None,
        typer.Option(
            help="Distances: .npy, PNG, TIFF, EXR. Or metres. By default made-up.",
            metavar="FILE|METRES",
        ),
    ] = None,
    unit: Unit = "m",
    holes: Holes = "error",
    water: Annotated[
        str | None,
        typer.Option(help="Jerlov type of the first view.", autocompletion=complete(*WATERS)),
    ] = None,
    open_: Annotated[bool, typer.Option("--open", help="Open the page in a browser.")] = False,
    force: Force = False,
) -> None:
    """Write a page that shows what degrade makes: your own pictures, every slider, offline."""
    require_writable(out, force=force, endings=(".html",))
    from uwaug._support import checks
    from uwaug.distance import MadeUp, Metres
    from uwaug.files.pictures import metres_of, read_picture
    from uwaug.page.tables import PIXELS
    from uwaug.page.write import write_page
    from uwaug.presets.scene import motorcycle, own_scene

    with reported_errors():
        if water is not None:
            checks.one_of("water", water, WATERS)
        if image is None and (distance is not None or (unit, holes) != ("m", "error")):
            raise ValueError("--distance, --unit and --holes are of a picture: give --image")
        stem = "motorcycle" if image is None else image.stem
        source: dict[str, Any] = {"picture": f"{stem}-scene.png", "distance": f"{stem}-scene.npy"}
        source |= {"unit": 1.0, "holes": "error", "unsaved": True}
        if image is None:
            scene = motorcycle()
        else:
            picture = read_picture(image)
            if distance is None:
                z = MadeUp().metres(None, picture, {"near": 1.0, "far": 8.0, "scene": 0.5})
                source["guessed"] = True
            else:
                z = read_metres(distance, unit, picture)
                z = Metres(number_or_word(holes)).metres(z, picture, {})
                source = {"picture": str(image), "distance": distance, "holes": holes}
                source |= {"unit": metres_of(number_or_word(unit)), "width": picture.shape[-1]}
            scene = own_scene(picture, z, PIXELS)
        write_page(out, scene, source, water)
    print_written(out)
    if open_:
        typer.launch(str(out.absolute()))
