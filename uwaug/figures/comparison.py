"""uwaug and published systems side by side, for one scene in one water."""

from collections.abc import Sequence

from PIL import Image

from uwaug import published
from uwaug.figures.demo import SETTING, in_waters, sheet_of
from uwaug.optics.jerlov import JERLOV_TYPES
from uwaug.optics.water import load_water
from uwaug.presets.scene import Scene


def draw_comparison(scene: Scene, water: str, systems: Sequence[str] = ()) -> Image.Image:
    """Draw a scene, its picture by uwaug and by each published system, with their mean colours.

    Args:
        scene: picture and distances.
        water: see `uwaug.load_water`.
        systems: see `uwaug.published.system`; by default all of `uwaug.published.systems` that know
            the water, see `uwaug.published.takes_spectra`. A ValueError if one does not.
    """
    spectra, image, z = load_water(water), scene.image, scene.distance
    if not systems:
        systems = published.systems()
        if spectra.name not in JERLOV_TYPES:
            systems = [*filter(published.takes_spectra, systems)]
    pictures = {"no water": image, "uwaug": in_waters([spectra], scene)(image, z)}
    pictures |= {name: published.picture(name, image, z, spectra) for name in systems}
    cells = []
    for name, picture in pictures.items():
        mean = " ".join(f"{value:.2f}" for value in picture.double().mean((1, 2)).tolist())
        cells.append((picture, f"{name}   ({mean})"))
    heading = f"One scene, uwaug and {len(systems)} systems, {spectra.name}"
    caption = (
        "Each as its authors computed it; in brackets the means of red, green and blue, 0…1.\n"
        f"uwaug: {SETTING[0].lower()}{SETTING[1:]}."
    )
    return sheet_of(scene, cells, heading, caption)
