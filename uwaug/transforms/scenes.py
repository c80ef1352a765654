"""Pictures in the water that they have drawn, and what a camera and a person see of them."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwaug import fast
from uwaug._support import checks
from uwaug._support.once import Once
from uwaug._support.types import ColorSpace
from uwaug.distance.doubts import first_maps, question
from uwaug.distance.sizes import brought_to
from uwaug.distance.sources import Metres, Source
from uwaug.distance.unknown import FARTHEST_SEEN
from uwaug.formation.colour import decoded, linear_to_srgb, require_values
from uwaug.formation.contrast import FAINT, contrast_left, metres_for
from uwaug.formation.image import form_each
from uwaug.formation.setting import Setting
from uwaug.optics.curves import FARTHEST
from uwaug.optics.medium import Medium
from uwaug.optics.view import View
from uwaug.optics.water import Water
from uwaug.transforms.draws import Draw
from uwaug.transforms.measured import Measured, measure
from uwaug.transforms.random_water import MOST_CONTENTS, PLACED_M, Clarity, RandomWater, odd_scene
from uwaug.transforms.samples import maps_for, naming, typed
from uwaug.transforms.truth import Truth, truth_of

_WHOLE_MAPS = Metres()  # whose maps are used as they come, if they measure like whole metres

_blank = Once(looks=16)
"""The warning that nothing is left to see. What is wrong with all pictures shows in the first."""


class Scene(NamedTuple):
    """One picture in the water that it has drawn."""

    setting: Setting
    vertical_depth: float | None  # m; None of a medium
    clarity: Clarity
    follows: bool  # True if the clarity is one for the scene's distances, whatever they are


class Scenes(NamedTuple):
    """Pictures in the water that they have drawn, before an image is formed of them."""

    image: Tensor  # as it came, 3xHxW or Bx3xHxW
    pictures: Tensor  # of the image, as a plain tensor, Bx3xHxW
    chosen: Sequence[int] = ()  # indices of the N pictures that are in water
    z: Tensor = torch.zeros(0, 1, 1, 1)  # m, effective distances: times the medium field, Nx1xHxW
    metres: Tensor = torch.zeros(0, 1, 1, 1)  # m, distances without the field, Nx1xHxW
    scenes: Sequence[Scene] = ()  # each of the N

    def formed(self) -> Tensor:
        """The image under water, of the class of the original."""
        if not self.chosen:
            return self.image
        pictures, index = self.pictures, None
        if len(self.chosen) < len(pictures):
            index = torch.tensor(self.chosen).to(pictures.device)
        settings = [scene.setting for scene in self.scenes]
        for scene in self.scenes if _blank.looks_left else ():
            if not scene.follows:
                _warn_if_blank(scene.setting)
        with checks.full_precision(pictures):
            submerged = pictures if index is None else pictures[index]
            result = form_each(submerged, self.z, self.metres, settings)
        if index is not None:
            result = pictures.index_copy(0, index, result)
        return typed(result[0] if self.image.ndim == 3 else result, type(self.image))

    def contrast_map(self, step: int = 1) -> Tensor:
        """Share of contrast that is left (1xhxw of a picture, Bx1xhxw of a batch), at each `step`th
        row and column; 1 where there is no water.
        """
        shares = list(torch.ones_like(self.pictures[:, :1, ::step, ::step], dtype=torch.float32))
        maps = [distances[..., ::step, ::step] for distances in (self.z, self.metres)]
        for i, z, metres, (setting, *_) in zip(self.chosen, *maps, self.scenes, strict=True):
            options = {"light": setting.light, "view": setting.view.resized(1 / step)}
            shares[i] = contrast_left(z, setting.medium, metres=metres, **options)
        return shares[0] if self.image.ndim == 3 else torch.stack(shares)

    def clarity(self, picture: int) -> Clarity | None:
        """The clarity of the water of one of the pictures, if it is in water."""
        scene = dict(zip(self.chosen, self.scenes, strict=True)).get(picture)
        return scene and scene.clarity

    def truth(self, picture: int | None = None) -> Truth | None:
        """What water and camera did to the picture, or to one of a batch; None if it is left alone.
        ValueError if a batch is asked without a number.
        """
        count = len(self.pictures)
        if picture is None and count > 1:
            raise ValueError(f"truth is of one picture: give 0…{count - 1}")
        picture = picture or 0
        if not 0 <= picture < count:
            raise IndexError(f"picture must be 0…{count - 1}, got {picture}")
        if picture not in self.chosen:
            return None
        i = list(self.chosen).index(picture)
        image, scene = self.pictures[picture, None], self.scenes[i]
        maps = self.z[i, None], self.metres[i, None]
        with checks.full_precision(image):
            J = decoded(image, scene.setting.color_space).to(self.z.dtype)
            return truth_of(J, *maps, scene.setting, scene.vertical_depth)

    def settled(self) -> dict[str, Any]:
        """Median distance, exposure, white balance and saturation of this one picture, for all
        frames of its film, see `Measured.of_film`.
        """
        ((setting, *_),) = self.scenes
        medium = setting.medium.to(self.z)
        J = decoded(self.pictures, setting.color_space).to(self.z.dtype)
        T = setting.curves(medium, self.z, self.metres)
        development = setting.development.settled(J, self.z, medium, T)
        balance = development.white_balance
        return {
            "median": setting.span[1],
            "exposure": development.exposure,
            "white_balance": balance if isinstance(balance, tuple) else None,
            "saturation": development.saturation,
        }


def scenes_of(
    image: Tensor,
    pictures: Tensor,
    distance: Any,
    draws: Sequence[Draw],
    nouns: Mapping[str, Any],
    view: View,
) -> Scenes:
    """Put an image, whose pictures are Bx3xHxW, into the water of their draws."""
    view.require(pictures.shape[-1])
    fast.load()  # else the first picture of a process would be off by the last bits
    water: RandomWater = nouns["water"]
    source: Source = nouns["distance"]
    space = nouns["development"].color_space
    maps = maps_for(pictures, distance, source)
    chosen = [i for i, draw in enumerate(draws) if draw.applied]
    if not chosen:
        return Scenes(image, pictures)
    with checks.full_precision(pictures):
        applied = [draws[i] for i in chosen]
        waters = list[tuple[Water | Medium, float]]()
        for n, draw in enumerate(() if source.has_size else applied):  # placed in their water
            of_it, contents = water.water(draw.water, PLACED_M)
            waters.append((of_it, contents))
            farthest = water.farthest(of_it, draw.water)
            placed = source.placed(draw.distance, partial(metres_for, of_it), farthest)
            # the veil grows on behind the far end, which would show the rim of open water; but it
            # must be endless where the water may still become clearer
            applied[n] = draw._replace(distance=placed | {"hides": "contrast" not in draw.water})
        metres = _metres_of(source, pictures, maps, chosen, applied, space, view)
        submerged = pictures if len(chosen) == len(pictures) else pictures[chosen]
        metered = nouns["development"].metered
        measurements = measure(submerged, metres, metered=metered)
        holed = [m for m in measurements if not (m.nearest > 0 and m.farthest < FARTHEST_SEEN)]
        if holed and source == _WHOLE_MAPS:
            metres = _metres_of(source, pictures, maps, chosen, applied, space, view, whole=False)
            measurements = measure(submerged, metres, metered=metered)
        scenes, of_films = [], []
        for n, (i, draw, measured) in enumerate(zip(chosen, applied, measurements, strict=True)):
            with naming(i, len(pictures)):
                if not (measured.darkest >= 0 and measured.brightest <= 1):
                    require_values(pictures[i], space)
                is_film = draw.measured or draw.moved or any(draw.motion)
                film = measured.of_film(draw.measured, draw.passed) if is_film else measured
                of_films.append(film)
                drawn = waters[n] if waters else water.water(draw.water, film.median)
                scenes.append(scene_of(draw, drawn, measured, film, nouns, view))
        metres = metres.double() if pictures.dtype == torch.float64 else metres
        metres = metres.clamp(max=FARTHEST)
        z = metres * water.fields(applied, of_films, metres, view)
    return Scenes(image, pictures, chosen, z, metres, scenes)


def scene_of(
    draw: Draw,
    drawn: tuple[Water | Medium, float],
    measured: Measured,
    of_film: Measured,
    nouns: Mapping[str, Any],
    view: View,
) -> Scene:
    """A picture in the water that it has drawn, by what was measured: by itself, of its film."""
    water: RandomWater = nouns["water"]
    light = nouns["light"].of(draw.light, of_film)
    medium, vertical_depth, made, contents = water.of(drawn[0], draw.water, of_film, light, view)
    development = nouns["development"].of(draw.development, of_film)
    thin, dense = water.field or (1.0, 1.0)
    span = thin * measured.nearest, measured.median, dense * measured.farthest
    space = nouns["development"].color_space
    setting = Setting(medium, light, development, view, space, span)
    clarity = Clarity(made, drawn[1] * contents, of_film.median, draw.water.get("contrast"))
    follows = "clearness" in draw.water and clarity.asked is None
    if not follows and not 0 < clarity.contents <= MOST_CONTENTS:
        odd_scene.warn(clarity.odd)
    return Scene(setting, vertical_depth, clarity, follows)


def _metres_of(
    source: Source,
    pictures: Tensor,
    maps: Sequence[Tensor | None],
    chosen: Sequence[int],
    applied: Sequence[Draw],
    color_space: ColorSpace,
    view: View,
    whole: bool = True,
) -> Tensor:
    """Distances (Nx1xHxW, m) of the pictures to degrade; of `Metres()` as they come, if `whole`."""
    results = list[Tensor]()
    for i, draw in zip(chosen, applied, strict=True):
        metres, picture = maps[i], pictures[i]
        if whole and first_maps.looks_left and isinstance(source, Metres) and picture.is_cpu:
            assert metres is not None
            question(metres, stacklevel=5)
        if metres is None or source != _WHOLE_MAPS or not whole:
            srgb = picture
            if source.reads_pictures and color_space == "linear":
                light = picture if picture.is_floating_point() else picture / 255
                srgb = linear_to_srgb(light.clamp(0, 1))
            with naming(i, len(pictures)):
                rays = view.planar(picture.shape[-1])
                metres = source.metres(metres, srgb, draw.distance, **rays)
        if metres.dtype.itemsize < 4:
            metres = metres.float()
        is_of_size = metres.shape[-2:] == picture.shape[-2:]
        results.append(metres if is_of_size else brought_to(picture.shape[-2:], metres))
    return results[0][None] if len(results) == 1 else torch.stack(results)


def _warn_if_blank(setting: Setting) -> None:
    """Warn, once in a process, if next to nothing is left to see at the median distance."""
    median = setting.span[1]
    if not math.isfinite(median) or not _blank.due():
        return
    z = setting.medium.beta.new_full((1, 1, 1), median)
    if float(contrast_left(z, setting.medium, light=setting.light)) < FAINT:
        got = f"less than {100 * FAINT:g} % of the contrast is left at a median of {median:.3g} m"
        _blank.warn(f"{got}: take clearer water by contrast, if distances are metres")
