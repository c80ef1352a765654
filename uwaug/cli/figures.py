"""`uwaug demo`, `uwaug plot` and `uwaug compare`: sheets of pictures."""

import os
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uwaug.cli import distances
from uwaug.cli.choices import ForceFile, ForceFolder, preset_option, water_option
from uwaug.cli.console import (
    fail,
    print_written,
    refuse,
    reported_errors,
    require_not_read,
    require_package,
    require_writable,
    status,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from uwaug.io import DistanceFormat
    from uwaug.presets.scene import Scene

Picture = Annotated[
    Path | None, typer.Argument(help="The scene without water.", show_default=False)
]
OlderPicture = Annotated[Path | None, typer.Option("--image", hidden=True)]
OutFolder = Annotated[Path, typer.Option(help="Folder for the pictures; made if need be.")]


def demo(out: OutFolder = Path("uwaug-demo"), force: ForceFolder = False) -> None:
    """Draw a real scene in ten waters, term by term."""
    require_package("plot", "matplotlib")
    from uwaug.figures.demo import PICTURES
    from uwaug.presets import scene

    _require_folder(out, PICTURES, force)
    _draw_into(out, scene.motorcycle(), PICTURES)


def plot(
    distance: distances.Distance,
    picture: Picture = None,
    water: Annotated[
        str | None,
        water_option("For the sheet of terms, or in place of the preset's: 1C if none is given."),
    ] = None,
    preset: Annotated[
        str | None, preset_option("For the sheet of terms; or the path of a TOML file.")
    ] = None,
    distance_kind: distances.Kind = "metric",
    distance_unit: distances.Unit = "m",
    unknown: distances.Unknown = "behind",
    planar: distances.Planar = False,
    focal_px: distances.FocalPx = None,
    baseline: distances.Baseline = None,
    offset_px: distances.OffsetPx = 0.0,
    near: distances.Near = None,
    far: distances.Far = None,
    gamma: distances.Gamma = None,
    out: OutFolder = Path("uwaug-plot"),
    force: ForceFolder = False,
    image: OlderPicture = None,
) -> None:
    """Draw your own scene in ten waters, and term by term."""
    file = _the_picture(picture, image)
    require_package("plot", "matplotlib")
    from uwaug.figures.demo import own_pictures, preset_case
    from uwaug.optics import load_water
    from uwaug.presets import load_preset

    with reported_errors():
        if preset is not None:
            pictures = own_pictures(preset_case(load_preset(preset, water=water)))
        else:
            pictures = own_pictures(load_water(water or "1C"))
    _require_folder(out, pictures, force)
    with reported_errors():
        place = distances.one_place(distance)
        format = distances.format_of(
            distance_kind,
            distance_unit,
            unknown,
            planar=planar,
            focal_px=focal_px,
            baseline=baseline,
            offset_px=offset_px,
        )
    for name in pictures:
        require_not_read("--out", out / name, distances.files(file, place))
    with status() as say:
        say("reading the picture")
        scene = _read_scene(file, place, format, near, far, gamma)
    _draw_into(out, scene, pictures)
    if scene.note:
        print(scene.note)


def compare(
    distance: distances.Distance,
    out: Annotated[Path, typer.Option(help="The sheet to write: .png or .jpg.")],
    picture: Picture = None,
    water: Annotated[
        str, water_option("Systems that have figures of few waters alone keep their own.")
    ] = "II",
    system: Annotated[
        list[str] | None,
        preset_option(
            "A preset, or path of its file; repeat it. All published systems by default."
        ),
    ] = None,
    table: Annotated[Path | None, typer.Option(help="The table too: a .csv or .json file.")] = None,
    distance_kind: distances.Kind = "metric",
    distance_unit: distances.Unit = "m",
    unknown: distances.Unknown = "behind",
    planar: distances.Planar = False,
    focal_px: distances.FocalPx = None,
    baseline: distances.Baseline = None,
    offset_px: distances.OffsetPx = 0.0,
    near: distances.Near = None,
    far: distances.Far = None,
    gamma: distances.Gamma = None,
    force: ForceFile = False,
    image: OlderPicture = None,
) -> None:
    """Your scene as each published system makes it, and how they differ."""
    file = _the_picture(picture, image)
    with reported_errors():
        place = distances.one_place(distance)
        format = distances.format_of(
            distance_kind,
            distance_unit,
            unknown,
            planar=planar,
            focal_px=focal_px,
            baseline=baseline,
            offset_px=offset_px,
        )
    inputs = distances.files(file, place)
    require_writable("--out", out, force=force, endings=(".png", ".jpg"), inputs=inputs)
    if table is not None:
        require_writable("--table", table, force=force, endings=(".csv", ".json"), inputs=inputs)
    require_package("plot", "matplotlib")
    import uwaug
    from uwaug._support.drawing import save

    with status() as say:
        say("reading the picture")
        scene = _read_scene(file, place, format, near, far, gamma)
        say("computing the systems")
        with reported_errors():
            comparison = uwaug.figures.compare(
                scene.image, scene.distance, water, system, scene.focal_px
            )
    try:
        save(comparison.plot(scene.note), out)
        if table is not None:
            comparison.save(table)
    except OSError as error:
        print(comparison.summary())  # what took a while is not lost
        fail(error)
    print(f"{comparison.summary()}\n")
    if scene.note:
        print(scene.note)
    print_written(out, table)


def _the_picture(picture: Path | None, image: Path | None) -> Path:
    """The picture, by either of its spellings."""
    if picture is not None and image is not None:
        refuse(f"--image is an older spelling of the picture: expected one, got {picture} too")
    file = picture or image
    if file is None:
        refuse("expected a picture, such as photo.jpg")
    return file


def _read_scene(
    file: Path,
    place: Path | float,
    format: "DistanceFormat",
    near: float | None,
    far: float | None,
    gamma: float | None,
) -> "Scene":
    """A picture and its distances as a sheet shows them."""
    from uwaug.io import read_picture_file
    from uwaug.presets.scene import own_scene

    with reported_errors():
        original = read_picture_file(file)
        size = (original.image.shape[-2], original.image.shape[-1])
        scaling = {"near": near, "far": far, "gamma": gamma}
        metres, notes = format.metres(place, size, turned=original.turned, **scaling)
        try:
            behind = format.unknown == "behind"
            scene = own_scene(original.image, metres, format.focal_px, behind=behind)
        except ValueError as error:
            # the map first, as most of what does not suit is in it
            names = ": with ".join(map(str, reversed(distances.files(file, place))))
            raise ValueError(f"{names}: {error}") from error
    for note in notes:
        print(f"Note: {place}: {note}")
    return scene


def _require_folder(out: Path, names: Iterable[str], force: bool) -> None:
    """Refuse, before any work, a folder that holds other files than those of `names`."""
    from uwaug._support.atomic import is_part

    try:
        files = os.listdir(out)
    except FileNotFoundError:
        return
    except OSError as error:
        fail(f"cannot write to {out}: {error.strerror or error}")
    # what a killed process has left does not count
    others = sorted(name for name in files if name not in names and not is_part(name))
    if others and not force:
        cure = "choose an empty folder, or --force to write into it"
        refuse(f"{out} holds other files, such as {others[0]}: {cure}")


def _draw_into(
    out: Path, scene: "Scene", pictures: "Mapping[str, Callable[[Scene], Figure]]"
) -> None:
    """Draw the sheets of a scene and name them; the folder is made if need be."""
    from rich.console import Console
    from rich.progress import Progress

    from uwaug._support.drawing import save

    start = time.perf_counter()
    errors = Console(stderr=True)
    try:
        out.mkdir(parents=True, exist_ok=True)
        with Progress(console=errors, transient=True, disable=not errors.is_terminal) as progress:
            for name, draw in progress.track(pictures.items(), description="Drawing"):
                save(draw(scene), out / name)
    except OSError as error:
        fail(f"cannot write to {out}: {error.strerror or error}")
    print_written(*(out / name for name in pictures))
    print(f"{len(pictures)} pictures, {time.perf_counter() - start:.1f} s")
