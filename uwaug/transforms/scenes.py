"""Pictures in the water that they have drawn, and what a camera and a person see of them."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwaug._support.once import Once
from uwaug._support.types import ColorSpace
from uwaug.formation.colour import decoded
from uwaug.formation.contrast import FAINT, contrast_left
from uwaug.formation.development import Development
from uwaug.formation.each import form_each
from uwaug.light import Light
from uwaug.optics.medium import Medium
from uwaug.transforms.random_water import InWater, Reached
from uwaug.transforms.samples import typed

_blank = Once(looks=16)
"""Whether anything is left to see: what is wrong with all pictures shows in the first."""


class Scenes(NamedTuple):
    """Pictures in the water that they have drawn, before an image is formed of them.

    Attributes:
        image (3xHxW or Bx3xHxW tensor): as it came.
        pictures (Bx3xHxW tensor): all of it, plain.
        color_space: of the pictures.
        chosen: the indices of those that have a water; what follows is of these N alone.
        z, metres (Nx1xHxW tensors): effective distances, and those without the field, m.
        waters: media, and what it took to reach a contrast.
        developments: of the camera.
        lights: with lamps; None for daylight.
        spans: the nearest, the median and the farthest effective distance of each, m.
        alike: whether all have one law of widths, and are metered or none is.
    """

    image: Tensor
    pictures: Tensor
    color_space: ColorSpace
    chosen: Sequence[int] = ()
    z: Tensor = torch.zeros(0, 1, 1, 1)
    metres: Tensor = torch.zeros(0, 1, 1, 1)
    waters: Sequence[InWater] = ()
    developments: Sequence[Development] = ()
    lights: Sequence[Light | None] = ()
    spans: Sequence[tuple[float, float, float]] = ()
    alike: bool = True

    def formed(self) -> Tensor:
        """The image under water, of the type of the one that came."""
        if not self.chosen:
            return self.image
        pictures, index = self.pictures, None
        if len(self.chosen) < len(pictures):
            index = torch.tensor(self.chosen).to(pictures.device)
        for water, light, span in zip(self.waters, self.lights, self.spans, strict=True):
            _warn_if_blank(span[1], water.medium, light)
        with torch.autocast(pictures.device.type, enabled=False):
            result = form_each(
                pictures if index is None else pictures[index],
                self.z,
                [water.medium for water in self.waters],
                self.developments,
                color_space=self.color_space,
                spans=self.spans,
                alike=self.alike,
                lights=self.lights,
                metres=self.metres,
            )
        if index is not None:
            result = pictures.index_copy(0, index, result)
        return typed(result[0] if self.image.ndim == 3 else result, type(self.image))

    def contrast_map(self, step: int = 1) -> Tensor:
        """The share of contrast that is left, see `uwaug.contrast_left`, in every so many rows and
        columns: 1xhxw of a picture, Bx1xhxw of a batch; 1 where there is no water.
        """
        shares = list(torch.ones_like(self.pictures[:, :1, ::step, ::step], dtype=torch.float32))
        each = zip(self.chosen, self.z, self.metres, self.waters, self.lights, strict=True)
        for i, z, metres, water, light in each:
            far, near = z[..., ::step, ::step], metres[..., ::step, ::step]
            shares[i] = contrast_left(far, water.medium, light=light, metres=near)
        return shares[0] if self.image.ndim == 3 else torch.stack(shares)

    def reached(self, picture: int) -> Reached | None:
        """What it took to reach the contrast that a picture asked for, if it did."""
        waters = dict(zip(self.chosen, self.waters, strict=True))
        return waters[picture].reached if picture in waters else None

    def settled(self) -> dict[str, Any]:
        """What this one picture settles for all frames of a film, see `Measured.of_film`."""
        medium = self.waters[0].medium.to(self.z)
        J = decoded(self.pictures, self.color_space).to(self.z.dtype)
        (light,) = self.lights
        T = None if light is None else light.curves(medium, self.z, self.metres)
        development = self.developments[0].settled(J, self.z, medium, T)
        balance = development.white_balance
        return {
            "median": self.spans[0][1] / self.waters[0].scale,
            "exposure": development.exposure,
            "white_balance": balance if isinstance(balance, tuple) else None,
        }


def _warn_if_blank(median: float, medium: Medium, light: Light | None) -> None:
    """Warn, once in a process, if next to nothing is left to see at the median distance, m; the far
    end of a scene is hidden in many a good draw.
    """
    if not math.isfinite(median) or not _blank.due():
        return
    z = medium.beta.new_full((1, 1, 1), median)
    if float(contrast_left(z, medium, light=light)) < FAINT:
        got = f"less than {100 * FAINT:g} % of the contrast is left on half of a picture or more"
        cure = "are distances metres? If so, take clearer water by contrast"
        _blank.warn(f"{got}, of median distance {median:.3g} m: {cure}")
