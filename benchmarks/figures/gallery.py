"""The galleries of the guides: published systems in two waters, a red tank at five depths, made-up
distances.
"""

import torch
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from skimage import data
from torch import Tensor

from benchmarks.harness import RESULTS, command
from uwaug import Development, Medium, RandomUnderwater, Underwater, published
from uwaug._support.atomic import written_whole
from uwaug.distance import MadeUp
from uwaug.optics.scattering import Scattering
from uwaug.presets.scene import Scene, motorcycle

FIGURES = RESULTS.parent / "figures"
WATERS = {"II": 1.0, "7C": 0.2}
"""What the scene's distances are multiplied by: at 2 to 5 m nothing is seen in 7C."""

OWN = "hou-2020"
"""The system that knows no waters and no distances."""

DEPTHS = (0.0, 5.0, 10.0, 20.0, 30.0)
"""m below the surface, of the red tank in type II; a diver is some .7 to 2 m away from it."""

WIDTH = 188  # px of a picture
LABEL = 22  # px
QUALITY = 70


class Grid:
    """Pictures of one shape in columns, each with a label above."""

    def __init__(self, rows: int, columns: int, shape: tuple[int, int]) -> None:
        self.tall = WIDTH * shape[0] / shape[1]
        self.size = (columns * (WIDTH + 6) - 6, rows * (self.tall + LABEL))
        self.columns = columns
        self.figure = Figure(figsize=(self.size[0] / 100, self.size[1] / 100), dpi=100)

    def show(self, place: int, picture: Tensor, label: str) -> None:
        """The picture (3xHxW, sRGB) at a place, counted row by row."""
        row, column = divmod(place, self.columns)
        wide, high = self.size
        x, y = column * (WIDTH + 6), row * (self.tall + LABEL) + LABEL
        box = (x / wide, 1 - (y + self.tall) / high, WIDTH / wide, self.tall / high)
        axis: Axes = self.figure.add_axes(box)
        axis.imshow(picture.clamp(0, 1).permute(1, 2, 0).numpy(), aspect="auto")
        axis.set_axis_off()
        axis.set_title(label, loc="left", fontsize=8, pad=3)


def systems(scene: Scene) -> Figure:
    """The scene, and each published system in II and in 7C, two systems a row."""
    names = [name for name in published.systems() if name != OWN]
    rows = -(-(len(names) + 1) // 2)
    grid = Grid(rows, 4, (scene.image.shape[-2], scene.image.shape[-1]))
    grid.show(0, scene.image, "no water")
    own = published.picture(OWN, scene.image, scene.distance)
    grid.show(1, own, f"{OWN}, its own water")
    place = 2
    for name in names:
        for water, factor in WATERS.items():
            z = factor * scene.distance
            picture = published.picture(name, scene.image, z, water)
            grid.show(place, picture, f"{name}, {water}")
            place += 1
    return grid.figure


def reds(scene: Scene) -> Figure:
    """A red tank at five depths: above, each channel fades by one number; below, surfaces have
    spectra. The camera's exposure is automatic.
    """
    height, width = scene.image.shape[-2:]
    tank = (..., slice(height // 4, 3 * height // 4), slice(3 * width // 8, 7 * width // 8))
    image, distance = scene.image[tank], scene.distance[tank] / 3
    grid = Grid(2, len(DEPTHS), (image.shape[-2], image.shape[-1]))
    for column, depth in enumerate(DEPTHS):
        for row, surfaces in enumerate(("grey", "spectral")):
            medium = Medium.from_water(
                "II",
                vertical_depth=depth,
                g=Scattering.CALIBRATED.g,
                surfaces=surfaces,
            )
            camera = Development(exposure="auto", gamut=float(surfaces == "spectral"))
            degrade = Underwater(medium, development=camera)
            label = f"{depth:g} m, {'spectra' if row else 'one number a channel'}"
            grid.show(row * len(DEPTHS) + column, degrade(image, distance), label)
    return grid.figure


def made_up() -> Figure:
    """Four pictures of scikit-image, with two made-up maps and what default draws make of each."""
    names, draws = ("coffee", "astronaut", "rocket", "chelsea"), 2
    source = MadeUp()
    augment = RandomUnderwater(distance=source)
    grid = Grid(len(names), 1 + 2 * draws, (2, 3))
    for row, name in enumerate(names):
        image = torch.from_numpy(getattr(data, name)()).permute(2, 0, 1)
        image = image[:, : 2 * image.shape[2] // 3]
        grid.show(row * grid.columns, image / 255, name)
        for draw in range(draws):
            generator = torch.Generator().manual_seed(draws * row + draw)
            record = augment.make_params(image, generator)
            numbers = record["samples"][0]["numbers"]
            z = source.metres(None, image, numbers)[0]
            shade = (z / 0.5).log() / torch.tensor(24.0).log()
            colours = torch.from_numpy(colormaps["viridis_r"](shade.numpy())[..., :3])
            colours[z.isinf()] = 0
            place = row * grid.columns + 1 + 2 * draw
            grid.show(
                place, colours.permute(2, 0, 1), f"{numbers['near']:.1f} to {numbers['far']:.0f} m"
            )
            wet = augment.transform(image, None, record)
            grid.show(place + 1, wet / 255, "")
    return grid.figure


def main(quick: bool = False) -> dict[str, Figure]:
    """Draw and save."""
    scene = motorcycle()
    if quick:
        scene = Scene(scene.image[:, ::8, ::8], scene.distance[:, ::8, ::8], 125.0)
    found = {"systems": systems(scene), "reds": reds(scene), "made-up": made_up()}
    if not quick:
        for name, figure in found.items():
            with written_whole(FIGURES / f"{name}.jpg") as part:
                figure.savefig(part, format="jpg", pil_kwargs={"quality": QUALITY})
            print(FIGURES / f"{name}.jpg")
    return found


if __name__ == "__main__":
    command(main, __doc__)
