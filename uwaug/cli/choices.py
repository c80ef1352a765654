"""Flags of several commands, and how they are read, without loading the library for help."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uwaug.presets.files import list_presets

if TYPE_CHECKING:
    from torch import Tensor

    from uwaug.presets.scene import Scene

WATERS = ("I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C")
PLACES = ("reef", "harbour", "lake", "fjord")


def view_table(degrees: float | None, focal_px: float | None) -> dict[str, Any]:
    """A view as a table of options, empty if none is given."""
    numbers = {"degrees": degrees, "focal_px": focal_px}
    return {name: number for name, number in numbers.items() if number is not None}


def complete(*words: str) -> Callable[[str], list[str]]:
    """Shell completion of a few words."""
    # typer knows the argument by its name
    return lambda incomplete: [w for w in words if w.lower().startswith(incomplete.lower())]


Picture = Annotated[Path, typer.Argument(help="The scene without water.")]
Distance = Annotated[
    str, typer.Option(help="Distances: .npy, PNG, TIFF, EXR. Or metres.", metavar="FILE|METRES")
]
Unit = Annotated[
    str,
    typer.Option(
        help="Unit of distance files: m, cm, mm, or how many metres 1 stands for.",
        autocompletion=complete("m", "cm", "mm"),
    ),
]
Holes = Annotated[
    str,
    typer.Option(
        help="Of pixels that hold 0 or NaN: behind (depth cameras), fill, far (open water), metres;"
        " error refuses them.",
        metavar="WORD|METRES",
        autocompletion=complete("error", "fill", "behind", "far"),
    ),
]
ViewAngle = Annotated[
    float | None, typer.Option("--view", help="Horizontal angle of the camera's view, degrees.")
]
FocalPx = Annotated[
    float | None, typer.Option(help="In place of --view: focal length, px of the pictures.")
]
Water = Annotated[
    str | None,
    typer.Option(
        help="Jerlov type, place (harbour), contents (chlorophyll=5,cdom=0.3), or CSV file.",
        autocompletion=complete(*WATERS, *PLACES),
    ),
]
Preset = Annotated[
    str | None,
    typer.Option(
        help="Preset, its TOML file, or a file that uwaug fit has written.",
        autocompletion=complete(*list_presets()),
    ),
]
Options = Annotated[
    Path | None, typer.Option(help="TOML file of options, with tables as in a preset.")
]
Workers = Annotated[int, typer.Option(help="Number of processes; 0: one for each core.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on after a stop.")]
Force = Annotated[
    bool, typer.Option("--force", help="Write over existing files, or begin a folder anew.")
]


def number_or_word(text: str) -> Any:
    """The number that a text is, else the text."""
    try:
        return float(text)
    except ValueError:
        return text


def with_tables(options: dict[str, Any], file: Path | None) -> dict[str, Any]:
    """Options of `RandomUnderwater` with those of a TOML file, if any, in their place."""
    from uwaug.presets.preset import read_tables

    merged = dict(options)
    for name, value in read_tables(file).items() if file is not None else ():
        before = merged.get(name)
        if not isinstance(value, dict) or not isinstance(before, dict):
            merged[name] = value
        else:  # options of one kind are none of another
            is_other = "kind" in value and value["kind"] != before.get("kind")
            merged[name] = value if is_other else before | value
    return merged


def read_metres(distance: str, unit: str, image: "Tensor") -> "Tensor":
    """Distances (1xHxW, m) of a picture (3xHxW): from a file, or the same everywhere."""
    import torch

    from uwaug.distance.sizes import brought_to, require_aspect
    from uwaug.files.pictures import read_distance

    number = number_or_word(distance)
    if isinstance(number, float):
        return torch.full((1, *image.shape[-2:]), number)
    z = read_distance(distance, number_or_word(unit))
    require_aspect(distance, z, image)
    return brought_to((image.shape[-2], image.shape[-1]), z)


def read_scene(picture: Path, distance: str, unit: str, holes: str) -> "Scene":
    """A picture with its distances, for a sheet."""
    from uwaug.distance import Metres
    from uwaug.files.pictures import read_picture
    from uwaug.presets.scene import own_scene

    image = read_picture(picture)
    z = read_metres(distance, unit, image)
    scene = own_scene(image, Metres(number_or_word(holes)).metres(z, image, {}))
    if unknown := float((~(z > 0)).double().mean()):
        note = f"{scene.note} {unknown:.2%} of the distances were unknown, and got: {holes}."
        scene = replace(scene, note=note.strip())
    return scene
