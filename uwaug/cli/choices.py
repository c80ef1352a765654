"""Flags that several commands take.

The library is not loaded for these, so that help and completion do not wait for it.
"""

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


def complete(*words: str) -> Callable[[str], list[str]]:
    """A function that tells a shell which of the words begin as one that is being typed."""
    return lambda incomplete: [w for w in words if w.lower().startswith(incomplete.lower())]


Picture = Annotated[Path, typer.Argument(help="The scene without water.")]
Distance = Annotated[
    str, typer.Option(help="Distances: .npy, PNG, TIFF, EXR. Or metres.", metavar="FILE|METRES")
]
Unit = Annotated[
    str,
    typer.Option(
        help="Of distance files: m, cm, mm, or how many metres 1 stands for.",
        autocompletion=complete("m", "cm", "mm"),
    ),
]
Holes = Annotated[
    str,
    typer.Option(
        help="What 0 and NaN get: behind (as depth cameras want it), fill, far (open water), or "
        "metres; error.",
        metavar="WORD|METRES",
        autocompletion=complete("error", "fill", "behind", "far"),
    ),
]
Water = Annotated[
    str | None,
    typer.Option(
        help="A Jerlov type, contents (chlorophyll=5,cdom=0.3) or a CSV file.",
        autocompletion=complete(*WATERS),
    ),
]
Preset = Annotated[
    str | None,
    typer.Option(
        help="A preset, its TOML file, or what uwaug fit has written.",
        autocompletion=complete(*list_presets()),
    ),
]
Workers = Annotated[int, typer.Option(help="Processes; 0: one for each core.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on after a stop.")]
Force = Annotated[bool, typer.Option("--force", help="Write over what is there.")]


def number_or_word(text: str) -> Any:
    """A number where it is one."""
    try:
        return float(text)
    except ValueError:
        return text


def read_metres(distance: str, unit: str, image: "Tensor") -> "Tensor":
    """The distances (1xHxW, m) of a picture (3xHxW): of a file, or everywhere the same."""
    import torch

    from uwaug.distance.sizes import brought_to, require_aspect
    from uwaug.files.pictures import read_distance

    metres = number_or_word(distance)
    if isinstance(metres, float):
        return torch.full((1, *image.shape[-2:]), metres)
    z = read_distance(distance, number_or_word(unit))
    require_aspect(distance, z, image)
    return brought_to((image.shape[-2], image.shape[-1]), z)


def read_scene(picture: Path, distance: str, unit: str, holes: str) -> "Scene":
    """A picture and its distances as a sheet shows them."""
    from uwaug.distance import Metres
    from uwaug.files.pictures import read_picture
    from uwaug.presets.scene import own_scene

    image = read_picture(picture)
    z = read_metres(distance, unit, image)
    unknown = float((~(z > 0)).double().mean())
    scene = own_scene(image, Metres(number_or_word(holes)).metres(z, image, {}))
    filled = f" {unknown:.2%} of the distances were unknown, and got: {holes}." if unknown else ""
    return replace(scene, note=(scene.note + filled).strip())
