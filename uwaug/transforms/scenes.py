"""Pictures in the water that they have drawn, and what a camera and a person see of them."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwaug import fast
from uwaug._support import checks
from uwaug._support.once import Once
from uwaug._support.types import ColorSpace
from uwaug.distance.doubts import first_maps
from uwaug.distance.sizes import brought_to
from uwaug.distance.sources import Metres, Source
from uwaug.distance.unknown import FARTHEST_SEEN
from uwaug.formation.colour import decoded, linear_to_srgb, require_values
from uwaug.formation.contrast import FAINT, contrast_left
from uwaug.formation.development import Development
from uwaug.formation.each import form_each
from uwaug.light import Light
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium
from uwaug.transforms.draws import Draw
from uwaug.transforms.measured import Measured, measured
from uwaug.transforms.random_water import RandomWater, Reached
from uwaug.transforms.samples import maps_for, naming, typed

_AS_THEY_COME = Metres()
"""Maps of metres without holes."""

_blank = Once(looks=16)
"""Whether anything is left to see: what is wrong with all pictures shows in the first."""


class Setting(NamedTuple):
    """In what a picture is taken.

    Attributes:
        medium, light, development: of one row; None for daylight; of the camera.
        scale: by which every distance is multiplied.
        reached: what it took to reach a contrast, if one was asked for.
        span: the nearest, the median and the farthest effective distance, m.
    """

    medium: Medium
    light: Light | None
    development: Development
    scale: float
    reached: Reached | None
    span: tuple[float, float, float]


class Scenes(NamedTuple):
    """Pictures in the water that they have drawn, before an image is formed of them.

    Attributes:
        image (3xHxW or Bx3xHxW tensor): as it came.
        pictures (Bx3xHxW tensor): all of it, plain.
        color_space: of the pictures.
        chosen: the indices of those that have a water; what follows is of these N alone.
        z, metres (Nx1xHxW tensors): effective distances, and those without the field, m.
        settings: in what each of them is taken.
        alike: whether all have one law of widths, and are metered or none is.
    """

    image: Tensor
    pictures: Tensor
    color_space: ColorSpace
    chosen: Sequence[int] = ()
    z: Tensor = torch.zeros(0, 1, 1, 1)
    metres: Tensor = torch.zeros(0, 1, 1, 1)
    settings: Sequence[Setting] = ()
    alike: bool = True

    def formed(self) -> Tensor:
        """The image under water, of the type of the one that came."""
        if not self.chosen:
            return self.image
        pictures, index = self.pictures, None
        if len(self.chosen) < len(pictures):
            index = torch.tensor(self.chosen).to(pictures.device)
        for setting in self.settings:
            _warn_if_blank(setting)
        media, lights, developments, _, _, spans = zip(*self.settings, strict=True)
        with checks.full_precision(pictures):
            result = form_each(
                pictures if index is None else pictures[index],
                self.z,
                media,
                developments,
                color_space=self.color_space,
                spans=spans,
                alike=self.alike,
                lights=lights,
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
        each = zip(self.chosen, self.z, self.metres, self.settings, strict=True)
        for i, z, metres, setting in each:
            far, near = z[..., ::step, ::step], metres[..., ::step, ::step]
            shares[i] = contrast_left(far, setting.medium, light=setting.light, metres=near)
        return shares[0] if self.image.ndim == 3 else torch.stack(shares)

    def reached(self, picture: int) -> Reached | None:
        """What it took to reach the contrast that a picture asked for, if it did."""
        settings = dict(zip(self.chosen, self.settings, strict=True))
        return settings[picture].reached if picture in settings else None

    def settled(self) -> dict[str, Any]:
        """What this one picture settles for all frames of a film, see `Measured.of_film`."""
        (setting,) = self.settings
        medium, light = setting.medium.to(self.z), setting.light
        J = decoded(self.pictures, self.color_space).to(self.z.dtype)
        T = None if light is None else light.curves(medium, self.z, self.metres)
        development = setting.development.settled(J, self.z, medium, T)
        balance = development.white_balance
        return {
            "median": setting.span[1] / setting.scale,
            "exposure": development.exposure,
            "white_balance": balance if isinstance(balance, tuple) else None,
        }


def scenes_of(
    image: Tensor, pictures: Tensor, distance: Any, draws: Sequence[Draw], nouns: Mapping[str, Any]
) -> Scenes:
    """An image in the water of draws that are known to be good.

    Args:
        image (3xHxW or Bx3xHxW tensor), distance: as for `RandomUnderwater.transform`.
        pictures (Bx3xHxW tensor): all of the image, from `pictures_of`.
        draws: of each picture.
        nouns: by the names of `Draw`.
    """
    fast.load()  # else the first picture of a process would be off by the last bits
    water: RandomWater = nouns["water"]
    source: Source = nouns["distance"]
    space = nouns["development"].color_space
    maps = maps_for(pictures, distance, source)
    chosen = [i for i, draw in enumerate(draws) if draw.applied]
    if not chosen:
        return Scenes(image, pictures, space)
    with checks.full_precision(pictures):
        z = _metres_of(source, pictures, maps, draws, space)
        some = pictures if len(chosen) == len(pictures) else pictures[chosen]
        rig = getattr(nouns["light"], "value", None)  # the same for all pictures, in metres
        camera = {"metered": nouns["development"].metered, "lamps": bool(rig and rig.lamps)}
        looks = measured(some, z, **camera)
        if (again := _second_look(source, looks, pictures, z, chosen)) is not z:
            z, looks = again, measured(some, again, **camera)
        settings, seen, scales, drawn, is_film = [], [], [], [], False
        for i, look in zip(chosen, looks, strict=True):
            with naming(i, len(pictures)):
                if not (look.darkest >= 0 and look.brightest <= 1):
                    require_values(pictures[i], space)
                seen.append(look.of_film(draws[i].measured, draws[i].moved))
                settings.append(_setting(draws[i], look, seen[-1], nouns))
            scales.append(settings[-1].scale)
            drawn.append(draws[i].water)
            is_film = is_film or bool(draws[i].measured)
        metres = z.double() if pictures.dtype == torch.float64 else z
        if {*scales} != {1.0}:
            metres = metres * metres.new_tensor(scales)[:, None, None, None]
        metres = metres.clamp(max=FARTHEST)
        z = metres * water.fields(drawn, seen, metres)
    alike = water.has_one_law and not is_film
    return Scenes(image, pictures, space, chosen, z, metres, settings, alike)


def _setting(draw: Draw, look: Measured, seen: Measured, nouns: Mapping[str, Any]) -> Setting:
    """In what a picture is taken: `seen`, as its film has measured it, `look` as it is itself."""
    water: RandomWater = nouns["water"]
    medium, scale, reached = water.of(draw.water, seen)
    scaled = seen.scaled(scale)
    thin, dense = water.field or (1.0, 1.0)
    span = scale * thin * look.nearest, scale * look.median, scale * dense * look.farthest
    light = nouns["light"].of(draw.light, scaled)
    development = nouns["development"].of(draw.development, scaled)
    return Setting(medium, light, development, scale, reached, span)


def _metres_of(
    source: Source,
    pictures: Tensor,
    maps: Sequence[Tensor | None],
    draws: Sequence[Draw],
    color_space: ColorSpace,
) -> Tensor:
    """The distances (Nx1xHxW, m) of those pictures (Bx3xHxW) that are degraded. Those of `Metres()`
    come as they are, for a second look; of another source a device may have to wait for each.
    """
    results = []
    for i, (z, picture, draw) in enumerate(zip(maps, pictures, draws, strict=True)):
        if not draw.applied:
            continue
        if z is not None and isinstance(source, Metres) and checks.on_host(picture):
            first_maps.question(z, picture, stacklevel=5)
        if z is None or source != _AS_THEY_COME:
            shown = _as_srgb(picture, color_space) if source.reads_pictures else picture
            with naming(i, len(pictures)):
                z = source.metres(z, shown, draw.distance)
        if z.dtype.itemsize < 4:
            z = z.float()
        results.append(brought_to(picture.shape[-2:], z))
    return results[0][None] if len(results) == 1 else torch.stack(results)


def _as_srgb(picture: Tensor, color_space: ColorSpace) -> Tensor:
    if color_space == "srgb":
        return picture
    light = picture if picture.is_floating_point() else picture / 255
    return linear_to_srgb(light.clamp(0, 1))


def _second_look(
    source: Source, looks: Sequence[Measured], pictures: Tensor, z: Tensor, chosen: Sequence[int]
) -> Tensor:
    """The same distances, looked at once more where what was measured of `Metres()` is odd."""
    if all(s.nearest > 0 and s.farthest < FARTHEST_SEEN for s in looks) or source != _AS_THEY_COME:
        return z
    results = []
    for i, far in zip(chosen, z, strict=True):
        with naming(i, len(pictures)):
            results.append(source.metres(far, pictures[i], {}))
    return torch.stack(results)


def _warn_if_blank(setting: Setting) -> None:
    """Warn, once in a process, if next to nothing is left to see at the median distance; the far
    end of a scene is hidden in many a good draw.
    """
    median = setting.span[1]
    if not math.isfinite(median) or not _blank.due():
        return
    z = setting.medium.beta.new_full((1, 1, 1), median)
    if float(contrast_left(z, setting.medium, light=setting.light)) < FAINT:
        got = f"less than {100 * FAINT:g} % of the contrast is left on half of a picture or more"
        cure = "are distances metres? If so, take clearer water by contrast"
        _blank.warn(f"{got}, of median distance {median:.3g} m: {cure}")
