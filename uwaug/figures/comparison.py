"""Systems side by side: one scene in one water, as each of several presets makes it."""

import csv
import io
import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.atomic import written_whole
from uwaug._support.drawing import GREY, INK
from uwaug._support.extras import require
from uwaug._support.types import Array
from uwaug.figures import sheet as paper
from uwaug.formation.colour import LUMINANCE, linear_to_srgb, to_light
from uwaug.formation.contrast import contrast
from uwaug.formation.inputs import validate
from uwaug.formation.underwater import Underwater
from uwaug.light.geometry import focal_of
from uwaug.optics.jerlov import JERLOV_TYPES
from uwaug.optics.water import Water, load_water
from uwaug.presets.files import published_systems
from uwaug.presets.preset import Preset, load_preset

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FULLEST = "ismiroglou-2025"
"""The system that the others' colours are compared with: direct light, forward scatter and veil
from spectra.
"""

METRES = (2.0, 5.0)
"""At which contrast and blur are told."""

_TABLES = (".csv", ".json")

_PIXELS = 100_000
"""Of a picture, whose colours are compared; all of them move the mean by .01."""


HEADINGS = (
    "system",
    "mean sRGB",
    "contrast 2 m",
    "5 m",
    "blur 2 m",
    "5 m",
    "ΔE",
    "PC difference",
)


@dataclass(frozen=True)
class SystemRow:
    """What a system makes of the scene.

    Attributes:
        system: name of its preset.
        red, green, blue: mean of the picture, sRGB, 0…1.
        contrast_2m, contrast_5m: share of the contrast of a grey object's detail that is left at
            these distances in the middle of the view, see `uwaug.contrast`.
        blur_2m, blur_5m: width σ of the forward scatter at these distances, px of this picture; 0
            where a system has none.
        delta_e: mean colour difference to the fullest system, CIEDE2000.
        phase_congruency: difference of it to the scene, see `phase_congruency_difference`.
    """

    system: str
    red: float
    green: float
    blue: float
    contrast_2m: float
    contrast_5m: float
    blur_2m: float
    blur_5m: float
    delta_e: float
    phase_congruency: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """Systems on one scene; made by `uwaug.figures.compare`.

    Attributes:
        water: its name; that of a Jerlov type, or of one's own.
        rows: one for each system.
        pictures: of each system (3xHxW, sRGB, 0…1), by name.
        image (3xHxW tensor): the scene without water, sRGB.
        fixed: names of the systems that know no waters, and have their own.
    """

    water: str
    rows: tuple[SystemRow, ...]
    pictures: dict[str, Tensor]
    image: Tensor
    fixed: tuple[str, ...]

    def summary(self) -> str:
        """The table as text."""
        lines = [HEADINGS, *(_cells(row) for row in self.rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        text = []
        for system, *numbers in lines:
            columns = zip(numbers, widths[1:], strict=True)
            aligned = [cell.rjust(width) for cell, width in columns]
            text.append("  ".join([system.ljust(widths[0]), *aligned]))
        return "\n".join(text)

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"Comparison({len(self.rows)} systems, {self.water})"

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the table: CSV, or JSON with the water; by the ending of `path`.

        Raises:
            ValueError: if `path` ends in neither.
            OSError: if it cannot be written.
        """
        checks.one_of("path's ending", Path(path).suffix, _TABLES)
        rows = [asdict(row) for row in self.rows]
        if Path(path).suffix == ".json":
            table: dict[str, Any] = {"water": self.water, "fullest": FULLEST, "systems": rows}
            text = json.dumps(table, indent=1) + "\n"
        else:
            file = io.StringIO(newline="")
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
            text = file.getvalue()
        with written_whole(path) as part:
            part.write_text(text, encoding="utf-8", newline="")

    def plot(self, note: str = "") -> "Figure":
        """The pictures side by side, with the table below. Needs matplotlib.

        Args:
            note: a line of the caption, such as what was done to the distances.
        """
        from matplotlib.transforms import Bbox

        shape = (self.image.shape[-2], self.image.shape[-1])
        columns = paper.columns_for(shape)
        caption = "Each as its authors computed it, with one water, one exposure, no noise."
        if self.fixed:
            caption += f" With a water of its own: {', '.join(self.fixed)}."
        caption += f"\n{note}" if note else ""
        water = f"Jerlov {self.water}" if self.water in JERLOV_TYPES else self.water
        line = 24  # px
        below = line * (len(self.rows) + 3)
        figure, axes = paper.sheet(
            math.ceil((1 + len(self.pictures)) / columns),
            columns,
            shape,
            f"One scene, {len(self.rows)} systems, {water}",
            caption,
            below=below,
        )
        pictures = {"No water": self.image, **self.pictures}
        for axis, (name, picture) in zip(axes, pictures.items(), strict=False):
            paper.show(axis, picture, name)
        width, height = figure.get_size_inches() * figure.dpi
        left = paper.MARGIN / width
        box = (left, 1.5 * paper.MARGIN / height, 0.86, line * (len(self.rows) + 1) / height)
        axis = figure.add_axes(box)
        axis.set_axis_off()
        table = axis.table(
            [_cells(row) for row in self.rows],
            colLabels=HEADINGS,
            colWidths=[0.26, 0.16, 0.1, 0.08, 0.1, 0.1, 0.07, 0.13],
            bbox=Bbox.unit(),
            edges="",
        )
        table.auto_set_font_size(False)
        for (row, column), cell in table.get_celld().items():
            cell.PAD = 0.0
            cell.set_text_props(
                fontsize=11,
                color=GREY if row == 0 else INK,
                ha="left" if column < 2 else "right",
                parse_math=False,
            )
        note = (
            "Contrast: of fine detail on grey, left at that distance. "
            f"ΔE: mean CIEDE2000 to {FULLEST}. "
            "PC difference: of phase congruency, 0 = all structure is left."
        )
        figure.text(left, paper.MARGIN / height, note, fontsize=10, color=GREY, va="center")
        return figure


def compare(
    image: Tensor,
    distance: Tensor,
    water: str | os.PathLike[str] | Water = "II",
    systems: Sequence[str] | None = None,
    focal_px: float | None = None,
) -> Comparison:
    """One scene in one water, as each of several systems makes it.

    Args:
        image (3xHxW tensor): the scene without water, sRGB; uint8, or floating point.
        distance (1xHxW tensor): metres along the ray; +inf is open water.
        water: what `uwaug.load_water` takes. A system that has coefficients of its own keeps them;
            so does one that has figures of Jerlov types, where the water is none of these.
        systems: names of presets or paths of their files; None for all of
            `uwaug.presets.published_systems`. Where a preset has a range, its middle is
            taken; water is homogeneous.
        focal_px: focal length, px of the image, for lamps; by default the view is 60° wide.

    Raises:
        ImportError: if the package phasecongruency is missing.
        TypeError, ValueError, OSError: if image, distance or water do not suit, or as
            `uwaug.load_preset`.

    Examples:
        >>> import torch, uwaug
        >>> image, distance = torch.rand(3, 40, 60), torch.linspace(1, 5, 2400).reshape(1, 40, 60)
        >>> systems = ["jaffe-1990", "ismiroglou-2025"]
        >>> comparison = uwaug.figures.compare(image, distance, "7C", systems)
        >>> [row.system for row in comparison.rows]
        ['jaffe-1990', 'ismiroglou-2025']
        >>> comparison.rows[1].delta_e
        0.0
    """
    loaded = load_water(water)
    is_type = loaded.name in JERLOV_TYPES and loaded == Water.jerlov(loaded.name)
    validate(image, distance, None, None, also_bytes=True)
    if image.ndim == 4:
        raise ValueError(f"image must be one picture, (3, H, W), got {tuple(image.shape)}")
    if isinstance(systems, str):
        raise TypeError(f"systems must be names, such as [{systems!r}], got a string")
    names = published_systems() if systems is None else list(systems)
    if not names or len(set(names)) < len(names):
        raise ValueError(f"systems: expected at least one, each once, got {names}")
    _phase_congruency()  # before any work
    scene = linear_to_srgb(to_light(image, "srgb")).detach()
    fullest = _lab(seen_by(load_preset(FULLEST, water=loaded), scene, distance, focal_px))
    structure = _congruency(scene)
    size = (scene.shape[-2], scene.shape[-1])
    # a plate in the middle of the view, which faces the camera
    z = torch.tensor(METRES, dtype=torch.float64).reshape(-1, 1, 1, 1)
    rows, pictures, fixed = [], {}, []
    for name in names:
        preset = load_preset(name)
        if preset.spectral is not None:
            preset = load_preset(name, water=loaded)
        elif is_type and loaded.name in preset.waters:
            preset = load_preset(name, water=loaded.name)
        else:
            fixed.append(name)
        picture = seen_by(preset, scene, distance, focal_px)
        focal = focal_of(focal_px, size[1])
        shares = contrast(preset.medium, z, light=preset.light, focal_px=focal).flatten()
        widths = preset.medium.width(z, size).flatten()
        red, green, blue = picture.double().mean((1, 2)).tolist()
        rows.append(
            SystemRow(
                system=name,
                red=red,
                green=green,
                blue=blue,
                contrast_2m=float(shares[0]),
                contrast_5m=float(shares[1]),
                blur_2m=float(widths[0]),
                blur_5m=float(widths[1]),
                delta_e=_colour_difference(_lab(picture), fullest),
                phase_congruency=_lost(structure, _congruency(picture)),
            )
        )
        pictures[name] = picture
    return Comparison(loaded.name, tuple(rows), pictures, scene, tuple(fixed))


_STRUCTURE = 1e-4
"""Mean phase congruency of a picture with edges. Photographs have .02 and more, noise 1e-6."""


def phase_congruency_difference(before: Tensor, after: Tensor) -> float:
    """How much of a picture's structure is lost: mean absolute difference of the phase congruency
    of both pictures, as a share of the mean of the first.

    Phase congruency finds edges whatever their contrast; arXiv:2606.26295 found that its
    difference follows the quality of segmentation in turbid water. Their formula was not at hand;
    this is ours, of luminance in 8 bits, as files hold it.

    Args:
        before, after (3xHxW tensors): sRGB, 0…1.

    Returns:
        0 if nothing is lost, 1 if everything is; more where rounding to 8 bits shows edges that
        are none; NaN if there was no structure to lose, as in noise.

    Raises:
        ImportError: if the package phasecongruency is missing.

    Source: "Beyond Aesthetics: Quantifying Information Loss in Turbid Scenes", arXiv:2606.26295;
    P. Kovesi, *Image features from phase congruency*, Videre 1, 1999.
    """
    return _lost(_congruency(before), _congruency(after))


def _lost(before: Array, after: Array) -> float:
    difference, structure = float(np.abs(before - after).mean()), float(before.mean())
    if difference == 0:
        return 0.0
    return difference / structure if structure > _STRUCTURE else math.nan


def _congruency(picture: Tensor) -> Array:
    weights = torch.tensor(LUMINANCE, dtype=torch.float64)
    grey = torch.einsum("c,chw->hw", weights, picture.double().clamp(0, 1))
    levels = (255 * grey).round()
    if levels.min() == levels.max():
        return np.zeros(tuple(levels.shape))
    return np.asarray(_phase_congruency()(levels.numpy())[0])


def _phase_congruency() -> Any:
    (package,) = require("compare", "phasecongruency")
    return package.phasecongmono


def seen_by(
    preset: Preset, scene: Tensor, distance: Tensor, focal_px: float | None = None
) -> Tensor:
    """The scene (3xHxW, sRGB, 0…1) as a preset makes it, in a view 60° wide without `focal_px`."""
    options: dict[str, Any] = {"color_space": preset.color_space, "exposure": preset.exposure}
    options |= {"light": preset.light, "focal_px": focal_of(focal_px, scene.shape[-1])}
    with torch.no_grad():
        return Underwater(preset.medium, **options)(scene, distance).clamp(0, 1)


def _lab(picture: Tensor) -> Array:
    """CIE Lab (Nx3) of a picture (3xHxW, sRGB)."""
    colour = _colour_science()
    step = math.ceil(math.sqrt(picture[0].numel() / _PIXELS))
    pixels = picture[:, ::step, ::step].double().flatten(1).T.numpy()
    return np.asarray(colour.XYZ_to_Lab(colour.sRGB_to_XYZ(pixels)))


def _colour_difference(lab: Array, other: Array) -> float:
    """Mean CIEDE2000."""
    return float(_colour_science().delta_E(lab, other, method="CIE 2000").mean())


def _colour_science() -> Any:
    # it sets NumPy's print options for the whole process
    with np.printoptions():
        (colour,) = require("compare", "colour")
    return colour


def _cells(row: SystemRow) -> tuple[str, ...]:
    """A row in words, under the headings of the table."""
    mean = f"{row.red:.2f} {row.green:.2f} {row.blue:.2f}"
    contrasts = f"{row.contrast_2m:.3f}", f"{row.contrast_5m:.3f}"
    blurs = f"{row.blur_2m:.2f} px", f"{row.blur_5m:.2f} px"
    return row.system, mean, *contrasts, *blurs, f"{row.delta_e:.1f}", f"{row.phase_congruency:.2f}"
