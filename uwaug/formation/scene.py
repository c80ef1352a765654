"""A picture in its water, and the one loop that forms it.

    I = T_β·J + (T_G − T_β)·blur_σ{J} + V(0) − V

Held pictures, pictures of 100 megapixels and pictures under lamps differ in what a tile of
radiance J, of distance z and of the transmittances T_β, T_G and V is, and in nothing else.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.tiles import RowSource, Tile, row_bands, rows_of
from uwaug._support.torch_func import transformed
from uwaug._support.types import ColorSpace, Order
from uwaug.blur.plan import BlurPlan
from uwaug.blur.stack import blurred, mixed, node_weights
from uwaug.blur.tiled import blurred_tiles
from uwaug.formation.colour import decoded, encoded, headroom, require_values
from uwaug.formation.contrast import contrast_of
from uwaug.formation.demand import farthest_blurred, plan_for
from uwaug.formation.development import (
    black_of,
    developed,
    finished,
    linear_part,
    look_of,
)
from uwaug.formation.engine import Engine, choose
from uwaug.formation.exposure import (
    arriving,
    balanced,
    farthest_veil,
    fixed_gain,
    metered,
    metering_points,
)
from uwaug.formation.loops.backend import RecordedEngine, can_read
from uwaug.formation.loops.backward import render_with_gradients
from uwaug.formation.loops.render import decode, render, render_in_rows
from uwaug.formation.setup import Setup
from uwaug.light.banded import BandedLight
from uwaug.light.lit import LampInWater, Lit, lit_of, planning_medium, transmittance
from uwaug.optics.curves import FARTHEST, Curves, Sums, mix, passed
from uwaug.optics.medium import Medium


@dataclass(frozen=True, eq=False)
class Terms:
    """The three terms of an image, each (BxCxHxW) in linear light; `image` is their sum."""

    direct: Tensor
    forward: Tensor
    backscatter: Tensor

    def __iter__(self) -> Iterator[Tensor]:
        return iter((self.direct, self.forward, self.backscatter))

    @property
    def image(self) -> Tensor:
        """Direct + forward + backscatter."""
        return self.direct + self.forward + self.backscatter


Finish = Callable[[Curves, Tensor, Tensor], tuple[Tensor, ...]]
"""What makes the result of transmittances T, radiance J and blurred radiance."""


def total(T: Curves, J: Tensor, blurred: Tensor) -> tuple[Tensor, ...]:
    """D + F + B."""
    if T.direct.ndim == 5:  # surfaces with spectra, under a lamp
        return (passed(T.direct, J).add_(passed(T.scatter, blurred)).add_(T.veil),)
    return (T.veil.addcmul(T.direct, J).addcmul_(T.scatter, blurred),)


def separate(T: Curves, J: Tensor, blurred: Tensor) -> tuple[Tensor, ...]:
    """D, F and B."""
    direct = passed(T.direct, J)
    return direct, passed(T.scatter, blurred), T.veil.expand_as(direct)


class EffectiveRange(NamedTuple):
    """The least and the largest effective distance, and the largest that asks for a blur, m."""

    nearest: float
    farthest: float
    blurred_to: float


@dataclass(frozen=True, eq=False)
class Scene:
    """Pictures in their water, made by `Scene.of`.

    Attributes:
        image (3xHxW or Bx3xHxW tensor): as it was given.
        setup: what it is taken with.
        engine: what computes its pictures.
        radiance (Bx3xHxW tensor or row source): J, linear light.
        z (Bx1xHxW tensor or row source): effective distance, m.
        medium: as the camera sees it, exposed and developed as far as that is linear.
        lit: the light, as the camera sees it; None for daylight as the medium has it.
        gain (B or 1 tensor): of the exposure.
        black (B or 1, 1, 1, 1 tensor): light that the development makes black.
        given_plan: of the blur; None to plan for the distances at hand.
        z_range: of the effective distances of a row source.
        image_max: the largest value of the image, where it is known.
    """

    image: Tensor
    setup: Setup
    engine: Engine
    radiance: Tensor | RowSource
    z: Tensor | RowSource
    medium: Medium
    lit: Lit | BandedLight | None
    gain: Tensor
    black: Tensor
    given_plan: BlurPlan | None
    z_range: EffectiveRange | None
    image_max: float | None

    @staticmethod
    def of(
        image: Tensor,
        distance: Tensor | RowSource,
        setup: Setup,
        field: Tensor | RowSource | None = None,
        recorded: RecordedEngine | None = None,
        *,
        plan: BlurPlan | None = None,
        gain: float | None = None,
        lamps: Sequence[LampInWater] | None = None,
        farthest: float = math.inf,
    ) -> "Scene":
        """Pictures in their water, of maps that are known to be good.

        Args:
            image (3xHxW or Bx3xHxW tensor): uint8 or floating point, in the setup's colour space.
            distance (1xHxW or Bx1xHxW tensor, or row source): metres along the ray, every pixel
                known.
            setup: what the picture is taken with.
            field (as distance, or None): multiplies the distance.
            recorded: the engine that a record names; None for the fastest.
            plan: of the blur; None for one for the distances at hand.
            gain: that a record names, in place of the setup's exposure.
            lamps: from `uwaug.light.lit.lamps_in_water`, where they are at hand.
            farthest: a bound of the distances, m.

        Raises:
            ValueError: if values of the image do not suit its colour space.
        """
        ends = require_values(image, setup.color_space)
        image_max = None if torch.compiler.is_compiling() else ends[1]
        maps = (distance,) if field is None else (distance, field)
        engine = choose(image, maps, setup, recorded)
        dtype = torch.promote_types(image.dtype, torch.float32)
        medium = setup.medium.to(dtype=dtype, device=image.device)
        pinhole = setup.focal_px, setup.centre
        radiance: Tensor | RowSource
        z: Tensor | RowSource
        lit: Lit | BandedLight | None
        z_range = None
        if engine in ("fused-rows", "tile-rows"):
            radiance = _radiance_rows(image, setup.color_space, ends, engine == "fused-rows")
            z = _distance_rows(maps, radiance.like)
            lit = None
            if setup.light is not None and not setup.light.plain:
                lit = BandedLight(setup.light, maps, medium, *pinhole)
            end = farthest_blurred(planning_medium(medium, setup.light), setup.order)
            z_range = _z_range(z, end)
        else:
            # older records call fused what the loops decoded, and no more
            by_loops = engine in ("fused", "fused-gradients") or recorded == "fused"
            # a view of other strides takes other paths through the kernels, which round otherwise
            light = _decoded(image.contiguous(), setup.color_space, ends, by_loops)
            radiance = light if light.ndim == 4 else light[None]
            metres = _whole(distance, dtype)
            factor = None if field is None else _whole(field, dtype)
            z = metres.clamp(max=FARTHEST) if farthest > FARTHEST else metres
            if torch.compiler.is_compiling():
                # compiled code does not look at its input: at least no distance is negative there
                # (in newer releases of torch, clamp has no gradient at its ends, such as 0 m)
                z = torch.where(z < 0, 0.0, z)
            z = z if factor is None else z * factor
            lit = lit_of(setup.light, metres, factor, medium, *pinhole, lamps)
        scene = Scene(
            image=image,
            setup=setup,
            engine=engine,
            radiance=radiance,
            z=z,
            medium=medium,
            lit=lit,
            gain=fixed_gain(medium, setup.exposure),
            black=medium.beta.new_zeros(1, 1, 1, 1),
            given_plan=plan,
            z_range=z_range,
            image_max=image_max,
        )
        visible = len(scene) > 0 and image.numel() > 0
        automatic = gain is None and setup.exposure == "auto"
        arrives = None
        if visible and (automatic or setup.development.measures):
            sums = medium.sums(exact_at_lens=False)
            light, arrives = scene._looks(sums)
            if automatic:
                scene = replace(scene, gain=scene._metered(light, arrives, sums))
        if gain is not None:
            scene = replace(scene, gain=medium.beta.new_full((1,), gain))
        if visible and not setup.development.is_neutral:
            return scene._developed(arrives)
        exposed = gain is not None or setup.exposure != "none"
        return scene._seen(scene.gain) if exposed else scene

    def __len__(self) -> int:
        lights = 1 if self.setup.light is None else self.setup.light.rows()
        lengths = (len(self.radiance), len(self.z), len(self.medium), lights)
        return max(lengths) if all(lengths) else 0

    @property
    def size(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.image.shape[-2], self.image.shape[-1]

    def _seen(self, gain: Tensor) -> "Scene":
        """The scene as a camera of this gain sees it, see `Medium.brightened`."""
        medium = self.medium.brightened(gain)
        lit = None if self.lit is None else self.lit.brightened(gain)
        return replace(self, medium=medium, lit=lit)

    def _looks(self, sums: Sums) -> tuple[Tensor, Tensor]:
        """Light (Bx3x1xN) of the scene at some pixels, and what arrives of it, unexposed."""
        if isinstance(self.radiance, Tensor) and isinstance(self.z, Tensor):
            assert not isinstance(self.lit, BandedLight)
            return metered(self.radiance, self.z, sums, self.lit)
        points = metering_points(*self.size, self.image.device)
        values = self.image.flatten(-2)[..., points].reshape(1, 3, 1, -1)
        T = self._transmittance_at(points, self._z_at(points), sums)
        light = decoded(values, self.setup.color_space)
        return light, arriving(light, T)

    def _metered(self, light: Tensor, arrives: Tensor, sums: Sums) -> Tensor:
        """The gain of an automatic exposure, from what `_looks` sees."""
        if isinstance(self.z, Tensor):
            farthest = self.z.amax((-3, -2, -1), keepdim=True)
        else:
            assert self.z_range is not None
            farthest = light.new_full((1, 1, 1, 1), self.z_range.farthest)
        return balanced(light, arrives, farthest_veil(sums, farthest, self.setup.light))

    def _developed(self, arrives: Tensor | None) -> "Scene":
        """The scene as its camera sees it, exposed and developed.

        arrives (Bx3x1xN tensor): light at some pixels, unexposed; None where nothing depends on it.
        """
        development, gain = self.setup.development, self.gain.reshape(-1, 1, 1, 1)
        light = self.gain.new_zeros(1, 3, 1, 1) if arrives is None else gain * arrives
        linear = linear_part(development, light)
        black = black_of(development, developed(light, linear))
        seen = self._seen(linear * gain.reshape(-1, *[1] * (linear.ndim - 1)))
        return replace(seen, black=black)

    @property
    def plan(self) -> BlurPlan:
        """The blur's plan."""
        if self.given_plan is not None:
            return self.given_plan
        medium, setup = planning_medium(self.medium, self.setup.light), self.setup
        z_range = self.z_range or _z_range(self.z, farthest_blurred(medium, setup.order))
        ends = z_range.nearest, z_range.blurred_to
        # the caller's medium: what is exposed by the picture has gradients where the picture has
        learned = setup.medium.requires_grad
        return plan_for(ends, self.size, medium, setup.tolerance, setup.order, learned)

    def picture(self) -> Tensor:
        """D + F + B, encoded, like the image; of several media or lights Bx3xHxW."""
        plan = self.plan
        if self.engine in ("fused", "fused-rows"):
            radiance, z = self.radiance, self.z
            srgb, dtype = self.setup.color_space == "srgb", self.image.dtype
            largest = headroom(self.image, self.image_max) if srgb else 1.0
            look = look_of(self.setup.development, self.black)
            options: Any = {"srgb": srgb, "largest": largest, "dtype": dtype, "look": look}
            if isinstance(radiance, Tensor) and isinstance(z, Tensor):
                return self._unbatched(render(radiance, z, self.medium, plan, **options))
            assert isinstance(radiance, RowSource)
            assert isinstance(z, RowSource)
            return self._unbatched(render_in_rows(radiance, z, self.medium, plan, **options))
        return self._encoded(plan, total)[0]

    def terms(self) -> Terms:
        """Direct, forward-scattered and backscattered light, Bx3xHxW, linear and not encoded."""
        return Terms(*self._rendered(self.plan, separate))

    def term_pictures(self) -> dict[str, Tensor]:
        """The three terms by name, each encoded like the image. In linear light they add up to the
        picture, before its black point, gamut and tone are developed; light out of sRGB is
        negative in some of them, which bytes do not hold.
        """
        pictures = self._encoded(self.plan, separate)
        return dict(zip(("direct", "forward", "backscatter"), pictures, strict=True))

    def contrast(self) -> Tensor:
        """The share of contrast that is left at each pixel (1xHxW), see `uwaug.contrast`."""
        if isinstance(self.z, Tensor) and not isinstance(self.lit, BandedLight):
            sums = self.medium.sums_at(self.z)
            return self._unbatched(contrast_of(transmittance(sums, self.z, self.lit)))
        parts = []
        for start, stop in row_bands(*self.size):
            tile = (..., slice(start, stop), slice(0, self.size[1]))
            lit = None if self.lit is None else self.lit.part(*tile[1:])
            z = self.z[tile]
            parts.append(contrast_of(transmittance(self.medium.sums_at(z), z, lit))[0])
        return torch.cat(parts, 1)

    def contrast_at_points(self) -> tuple[Tensor, Tensor]:
        """The share of contrast that is left at some pixels (N) of one picture, spread over it; and
        which of them show something else than open water (N, bool).
        """
        points = metering_points(*self.size, self.image.device)
        z = self._z_at(points)
        shares = contrast_of(self._transmittance_at(points, z, self.medium.sums_at(z)))
        return shares.flatten(), z.flatten() < checks.OPEN

    def _z_at(self, points: Tensor) -> Tensor:
        """Effective distances (1x1x1xN) of some pixels."""
        flat = self.z.flatten()[points] if isinstance(self.z, Tensor) else self.z.at(points)
        return flat.reshape(1, 1, 1, -1)

    def _transmittance_at(self, points: Tensor, z: Tensor, sums: Sums) -> Curves:
        if isinstance(self.lit, BandedLight):
            return self.lit.curves_at(points, z, sums)
        return transmittance(sums, z, None if self.lit is None else self.lit.at(points))

    def _unbatched(self, result: Tensor) -> Tensor:
        return result[0] if self.image.ndim == 3 and len(self) == 1 else result

    def _encoded(self, plan: BlurPlan, finish: Finish) -> tuple[Tensor, ...]:
        """Results as pictures like the image."""
        space, image = self.setup.color_space, self.image
        largest = headroom(image, self.image_max) if space == "srgb" else 1.0
        develop = finish is total and not self.setup.development.is_linear

        def encode(light: Tensor) -> Tensor:
            if develop:
                light = finished(self.setup.development, light, self.black)
            least = 0.0 if finish is total else -1.0
            return encoded(light, space, image.dtype, largest, least)

        if isinstance(self.radiance, RowSource):
            results = self._rendered(plan, finish, encode)
        else:
            results = tuple(map(encode, self._rendered(plan, finish)))
        return tuple(map(self._unbatched, results))

    def _rendered(
        self, plan: BlurPlan, finish: Finish, encode: Callable[[Tensor], Tensor] | None = None
    ) -> tuple[Tensor, ...]:
        """Results (Bx3xHxW), linear, or encoded a tile at a time so that no light is held."""
        batch = len(self)
        if batch == 0 or 0 in self.size:
            assert isinstance(self.radiance, Tensor)
            none = self.radiance[:batch].expand(batch, -1, -1, -1)
            return finish(Curves(none, none, none), none, none)
        if self.engine == "fused-gradients" and finish is total and len(plan.sigmas) > 1:
            assert isinstance(self.radiance, Tensor)
            assert isinstance(self.z, Tensor)
            return (render_with_gradients(self.radiance, self.z, self.medium, plan),)
        canvas: list[Tensor] = []
        for view, n, tile, blurs in self._views(plan):
            J, z = view.radiance[tile], view.z[tile]
            if plan.sigmas == (0.0,) and view.order == "line_of_sight":
                blurs = [J]  # itself, not a copy, of which `mix` makes use
            blur = mixture(blurs, z, view.medium, plan, self.size)
            results = view.results(finish, tile, z, J, blur)
            if n is None:
                return results
            if encode is not None:
                results = tuple(map(encode, results))
            canvas = canvas or [r.new_empty(batch, 3, *self.size) for r in results]
            for pictures, result in zip(canvas, results, strict=True):
                pictures[n][tile] = result[0]
        return tuple(canvas)

    def _views(self, plan: BlurPlan) -> Iterator[tuple["_View", int | None, Tile, list[Tensor]]]:
        """What the loop goes over: a view of a picture, its number, a tile and its blurs; or all
        pictures at once, without a number.
        """
        if self.engine in ("whole", "fused-gradients"):
            assert isinstance(self.radiance, Tensor)
            assert isinstance(self.z, Tensor)
            view = self._view(None, self.medium.any_at_lens(self.z))
            source = view.source()
            assert isinstance(source, Tensor)
            yield view, None, ..., blurred(source, plan)
            return
        exact = self._near_lens()
        views = [self._view(n, exact) for n in range(len(self))]
        # one picture in several waters is blurred once
        shared = len(self.radiance) == 1 and self.setup.order == "line_of_sight"
        groups = [range(len(views))] if shared else [range(n, n + 1) for n in range(len(views))]
        for group in groups:
            for tile, blurs in blurred_tiles(views[group[0]].source(), plan):
                for n in group:
                    yield views[n], n, tile, blurs

    def _near_lens(self) -> bool:
        if isinstance(self.z, Tensor):
            return self.medium.any_at_lens(self.z)
        assert self.z_range is not None
        nearest = self.medium.beta.new_full((1, 1, 1, 1), self.z_range.nearest)
        return self.medium.any_at_lens(nearest)

    def _view(self, n: int | None, exact: bool) -> "_View":
        """The n-th picture; None for all of them."""
        medium, lit, radiance, z = self.medium, self.lit, self.radiance, self.z
        if n is not None:
            radiance, z = (_row(x, n) for x in (radiance, z))
            medium = medium[n % len(medium)] if len(medium) > 1 else medium
            lit = lit.row(n) if isinstance(lit, Lit) else lit
        sums = medium.sums(exact_at_lens=exact)
        return _View(radiance, z, medium, sums, lit, self.setup.order)


class _View(NamedTuple):
    """A picture of a scene, or all of them, as the loop sees it."""

    radiance: Tensor | RowSource
    z: Tensor | RowSource
    medium: Medium
    sums: Sums
    lit: Lit | BandedLight | None
    order: Order

    def results(
        self, finish: Finish, tile: Tile, z: Tensor, J: Tensor, blurred: Tensor
    ) -> tuple[Tensor, ...]:
        """What `finish` makes of a tile."""
        daylight = self.lit is None and self.order == "line_of_sight"
        if daylight and self.sums.is_spectral and finish is total:
            return (mix(self.sums, z, J, blurred),)
        return finish(self.transmittance(tile, z), J, blurred)

    def transmittance(self, tile: Tile, z: Tensor) -> Curves:
        """T_β, T_G − T_β and V(0) − V of a tile, which has distances z."""
        T = self._transmittance(tile, z)
        # in source order light is weighted before it is blurred
        return T if self.order == "line_of_sight" else T._replace(scatter=z.new_ones(()))

    def source(self) -> Tensor | RowSource:
        """What is blurred."""
        if self.order == "line_of_sight":
            return self.radiance
        if isinstance(self.radiance, Tensor):
            return self._weighted(...)
        width = self.radiance.shape[-1]

        def rows(start: int, stop: int) -> Tensor:
            return self._weighted((..., slice(start, stop), slice(0, width)))[0]

        return RowSource(rows, (3, *self.radiance.size), self.radiance.like)

    def _weighted(self, tile: Tile) -> Tensor:
        return passed(self._transmittance(tile, self.z[tile]).scatter, self.radiance[tile])

    def _transmittance(self, tile: Tile, z: Tensor) -> Curves:
        lit = self.lit if self.lit is None or tile is ... else self.lit.part(*tile[1:])
        assert not isinstance(lit, BandedLight)
        return transmittance(self.sums, z, lit)


def mixture(
    blurs: list[Tensor], z: Tensor, medium: Medium, plan: BlurPlan, size: tuple[int, int]
) -> Tensor:
    """The blurred picture: each pixel's own mixture of the plan's blurs.

    z (Bx1xRxW tensor): effective distances of a tile of a picture of (height, width) `size`.
    """
    learns = torch.is_grad_enabled() and medium.requires_grad
    if len(blurs) == 1 and not (learns or transformed()):
        return blurs[0]
    sigma = medium.point_spread.sigma(medium.lengths(z), size)
    if len(blurs) == 1:  # the width does nothing: its gradient is 0, not missing
        return blurs[0] + 0 * sigma
    return mixed(blurs, node_weights(sigma, plan))


def _decoded(
    image: Tensor, color_space: ColorSpace, ends: tuple[float, float], by_loops: bool
) -> Tensor:
    """Linear light of values that are known to be good, and to lie between these ends."""
    srgb = color_space == "srgb"
    if by_loops and (srgb or image.dtype == torch.uint8) and can_read(image):
        return decode(image, srgb, ends[0] < 0 or ends[1] > 1)
    return decoded(image, color_space)


def _radiance_rows(
    image: Tensor, color_space: ColorSpace, ends: tuple[float, float], by_loops: bool
) -> RowSource:
    """The linear light of a picture, a few rows at a time."""
    # a view with other strides takes other paths through the kernels, which round differently
    picture = image.reshape(image.shape[-3:]).contiguous()

    def rows(start: int, stop: int) -> Tensor:
        return _decoded(picture[:, start:stop].contiguous(), color_space, ends, by_loops)

    dtype = torch.promote_types(image.dtype, torch.float32)
    return RowSource(rows, (3, *image.shape[-2:]), picture.new_empty(0, dtype=dtype))


def _distance_rows(maps: Sequence[Tensor | RowSource], like: Tensor) -> RowSource:
    """The effective distance, m·z, a few rows at a time."""
    distance, *field = map(rows_of, maps)

    def rows(start: int, stop: int) -> Tensor:
        z = distance(start, stop).to(like).clamp(0.0, FARTHEST)
        return z * field[0](start, stop).to(z) if field else z

    return RowSource(rows, (1, *maps[0].shape[-2:]), like)


def _whole(x: Tensor | RowSource, dtype: torch.dtype) -> Tensor:
    """All of a map, with a batch dimension."""
    values = x if isinstance(x, Tensor) else x[...]
    return (values if values.ndim == 4 else values[None]).to(dtype)


def _row(x: Tensor | RowSource, n: int) -> Tensor | RowSource:
    """The n-th of a batch, or the only one."""
    return x if isinstance(x, RowSource) else x[n % len(x)][None]


def _z_range(z: Tensor | RowSource, end: float) -> EffectiveRange:
    """Look at all distances once; from `end` on they ask for no blur."""
    if isinstance(z, Tensor):
        parts = iter((z.detach(),) if z.numel() else ())
    else:
        parts = (z.rows(*band) for band in row_bands(*z.size))
    nearest, farthest, blurred_to = math.inf, 0.0, -math.inf
    for band in parts:
        least, largest = (float(value) for value in band.aminmax())
        nearest, farthest = min(nearest, least), max(farthest, largest)
        if largest >= end < FARTHEST:
            band = band[band < end]
            largest = float(band.max()) if band.numel() else -math.inf
        blurred_to = max(blurred_to, largest)
    if nearest > farthest:  # no pixel
        return EffectiveRange(0.0, 0.0, 0.0)
    return EffectiveRange(nearest, farthest, max(blurred_to, nearest))
