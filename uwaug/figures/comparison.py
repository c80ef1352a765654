"""uwaug and published systems side by side, for one scene in one water."""

from collections.abc import Sequence
from dataclasses import replace

from PIL import Image

from uwaug import published
from uwaug._support import checks
from uwaug.figures.demo import SETTING, in_waters, sheet_of
from uwaug.optics.jerlov import JERLOV_TYPES
from uwaug.optics.water import load_water
from uwaug.presets.scene import Scene


def draw_comparison(
    scene: Scene, water: str, systems: Sequence[str] = (), *, stretch: float = 1.0
) -> Image.Image:
    """Draw a scene, its picture by uwaug and by each published system, with their mean colours.

    Args:
        scene: picture and distances.
        water: see `uwaug.load_water`.
        systems: see `uwaug.published.system`; by default all of `uwaug.published.systems` that know
            the water, see `uwaug.published.takes_spectra`. A ValueError if one does not.
        stretch: factor > 0 of all distances; below 1 it brings the scene nearer, where murky water
            would leave nothing of it.
    """
    checks.positive("stretch", stretch)
    spectra = load_water(water)
    names, strangers = systems or published.systems(), []
    if spectra.name not in JERLOV_TYPES:
        strangers = [name for name in names if not published.takes_spectra(name)]
    if systems and strangers:
        got = f"{', '.join(strangers)} with {water!r}"
        raise ValueError(f"a system without spectra knows the ten Jerlov types alone, got {got}")
    if stretch != 1:
        note = f"Distances times {stretch:g}. {scene.note}".rstrip()
        scene = replace(scene, distance=stretch * scene.distance, note=note)
    image, z = scene.image, scene.distance
    pictures = {"no water": image, "uwaug": in_waters([spectra], scene)(image, z)}
    for name in names:
        if name not in strangers:
            pictures[name] = published.picture(name, image, z, spectra)
    cells = []
    for name, picture in pictures.items():
        mean = " ".join(f"{value:.2f}" for value in picture.double().mean((1, 2)).tolist())
        cells.append((picture, f"{name}   ({mean})"))
    heading = f"One scene, uwaug and {len(pictures) - 2} systems, {spectra.name}"
    caption = (
        "Each as its authors computed it; in brackets the means of red, green and blue, 0…1.\n"
        f"uwaug: {SETTING[0].lower()}{SETTING[1:]}."
    )
    if strangers:
        caption += f" Left out, as they know Jerlov types alone: {', '.join(strangers)}."
    return sheet_of(scene, cells, heading, caption)
