"""Published systems side by side: one scene in one water, as each of them makes it."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from torch import Tensor

from uwaug import published
from uwaug.figures.sheet import sheet, show
from uwaug.presets.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def compare(scene: Scene, water: str = "II", systems: Sequence[str] = ()) -> dict[str, Tensor]:
    """A scene as each of several published systems makes it.

    Args:
        scene: picture and distances.
        water: what `uwaug.load_water` takes; systems that have figures of few waters keep their own
            where it is none of these.
        systems: names of `uwaug.published.systems`; all of them by default.

    Returns:
        Pictures (3xHxW, sRGB, 0…1) by the name of their system.

    Raises:
        ValueError: if a system or the water is unknown.
    """
    names = systems or published.systems()
    return {n: published.picture(n, scene.image, scene.distance, water) for n in names}


def draw_comparison(scene: Scene, pictures: dict[str, Tensor], water: str) -> "Figure":
    """The scene and what systems make of it, with the mean colour of each."""
    heading = f"One scene, {len(pictures)} systems, {water}"
    figure, axes = sheet(scene, 1 + len(pictures), heading, "Each as its authors computed it.")
    shown = {"no water": scene.image, **pictures}
    for axis, (name, picture) in zip(axes, shown.items(), strict=False):
        mean = " ".join(f"{value:.2f}" for value in picture.double().mean((1, 2)).tolist())
        show(axis, picture, f"{name}   ({mean})")
    return figure
