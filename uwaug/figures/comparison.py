"""Published systems side by side, for one scene in one water."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from uwaug import published
from uwaug.figures.sheet import sheet, show
from uwaug.presets.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_comparison(scene: Scene, water: str, systems: Sequence[str] = ()) -> "Figure":
    """Draw a scene and its picture by each published system, with their mean colours.

    Args:
        scene: picture and distances.
        water: see `uwaug.published.picture`.
        systems: names of `uwaug.published.systems`; all of them by default.

    Raises:
        ValueError: if a system or the water is unknown.
    """
    pictures = {"no water": scene.image}
    for name in systems or published.systems():
        pictures[name] = published.picture(name, scene.image, scene.distance, water)
    heading = f"One scene, {len(pictures) - 1} systems, {water}"
    caption = "Each as its authors computed it; in brackets the means of red, green and blue, 0…1."
    figure, axes = sheet(scene, len(pictures), heading, caption)
    for axis, (name, picture) in zip(axes, pictures.items(), strict=False):
        mean = " ".join(f"{value:.2f}" for value in picture.double().mean((1, 2)).tolist())
        show(axis, picture, f"{name}   ({mean})")
    return figure
