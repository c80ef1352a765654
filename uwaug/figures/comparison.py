"""uwaug and published systems side by side, for one scene in one water."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from uwaug import published
from uwaug._support import checks
from uwaug.figures.demo import SETTING, in_waters
from uwaug.figures.sheet import sheet, show
from uwaug.optics.water import load_water
from uwaug.presets.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_comparison(
    scene: Scene, water: str, systems: Sequence[str] = (), *, stretch: float = 1.0
) -> "Figure":
    """Draw a scene, its picture by uwaug and by each published system (all by default), with their
    mean colours; `stretch` is a factor of all distances.
    """
    checks.positive("stretch", stretch)
    if stretch != 1:
        note = f"Distances times {stretch:g}. {scene.note}".rstrip()
        scene = replace(scene, distance=stretch * scene.distance, note=note)
    own = in_waters([load_water(water)], scene)(scene.image, scene.distance)
    pictures = {"no water": scene.image, "uwaug": own}
    for name in systems or published.systems():
        pictures[name] = published.picture(name, scene.image, scene.distance, water)
    heading = f"One scene, uwaug and {len(pictures) - 2} systems, {water}"
    caption = (
        "Each as its authors computed it; in brackets the means of red, green and blue, 0…1.\n"
        f"uwaug: {SETTING[0].lower()}{SETTING[1:]}."
    )
    figure, axes = sheet(scene, len(pictures), heading, caption)
    for axis, (name, picture) in zip(axes, pictures.items(), strict=False):
        mean = " ".join(f"{value:.2f}" for value in picture.double().mean((1, 2)).tolist())
        show(axis, picture, f"{name}   ({mean})")
    return figure
