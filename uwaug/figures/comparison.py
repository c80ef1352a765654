"""Published systems side by side: one scene in one water, as each of them makes it."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from uwaug import published
from uwaug.figures.sheet import sheet, show
from uwaug.presets.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_comparison(scene: Scene, water: str, systems: Sequence[str] = ()) -> "Figure":
    """A scene and what published systems make of it, with the mean colour of each.

    Args:
        scene: picture and distances.
        water: what `uwaug.load_water` takes; systems that have figures of few waters keep their own
            where it is none of these.
        systems: names of `uwaug.published.systems`; all of them by default.

    Raises:
        ValueError: if a system or the water is unknown.
    """
    shown = {"no water": scene.image}
    for name in systems or published.systems():
        shown[name] = published.picture(name, scene.image, scene.distance, water)
    heading = f"One scene, {len(shown) - 1} systems, {water}"
    caption = "Each as its authors computed it; in brackets the means of red, green and blue, 0…1."
    figure, axes = sheet(scene, len(shown), heading, caption)
    for axis, (name, picture) in zip(axes, shown.items(), strict=False):
        mean = " ".join(f"{value:.2f}" for value in picture.double().mean((1, 2)).tolist())
        show(axis, picture, f"{name}   ({mean})")
    return figure
