"""A light on a scene: the curves of distance at every pixel.

A light is linear: that of several sources is the sum of what each gives. With c for a channel,

    daylight  gain·shade·T_β, gain·shade·(T_G − T_β), gain·e^(gradient·sin e)·(V(0) − V)
    a lamp    share·A, (1 − share)·A, and its near-field backscatter

A = irradiance·T_G(z + r) is what arrives of a lamp's light after both ways, r from the lamp and z:
on the way to the scene, light that is scattered forward still lights it. share = T_β(z)/T_G(z) of
that has come straight from the surface to the camera. In the water's own field m, both ways of a
pixel get that pixel's m, and its backscatter is multiplied by it: right to 4 % for m of .5 to 2,
and too bright beyond.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.light.backscatter import Grid, grid_of, integrated, interpolated, polynomials_of
from uwaug.light.geometry import Place, as_map, facing, irradiance, ray_of, require_centre, view_of
from uwaug.light.light import Daylight, Lamp, Light
from uwaug.optics.curves import FARTHEST, Curves, Sums, added, amplified, curves, decay, dimmed
from uwaug.optics.medium import Medium
from uwaug.optics.surfaces import white

_DARK = 1e-30
"""Of light, stands for none."""


class LampInWater(NamedTuple):
    """What is the same for all pictures with a lamp in a water.

    Attributes:
        water: `Medium.under` the lamp's spectrum.
        ahead, wide: see `Lamp`.
        polynomials: see `uwaug.light.backscatter.polynomials_of`.
    """

    water: Medium
    ahead: bool
    wide: bool
    polynomials: int

    @staticmethod
    def of(lamp: Lamp, medium: Medium) -> "LampInWater":
        """A lamp of the medium's type."""
        water = medium.under(lamp.spectrum)
        polynomials = polynomials_of(lamp, water.brightened(lamp.power[:, None] * lamp.rgb))
        return LampInWater(water, lamp.ahead, lamp.wide, polynomials)


def lamps_in_water(light: Light, medium: Medium) -> list[LampInWater]:
    """Each lamp of a light in a medium."""
    return [LampInWater.of(lamp, medium) for lamp in light.to(medium.beta).lamps]


class Part:
    """A part of a scene: what its sources share, computed when the first asks for it.

    Args:
        place: its surfaces.
        sums: of the medium, for daylight.
        z (Bx1xHxW tensor): effective distance, m.
    """

    def __init__(self, place: Place, sums: Sums, z: Tensor) -> None:
        self.place, self.sums, self.z = place, sums, z
        self._daylight: Curves | None = None
        self._normals: Tensor | None = None
        self._shares: dict[int, tuple[Tensor, Tensor]] = {}

    def daylight(self) -> Curves:
        """The curves of the medium under its own daylight."""
        if self._daylight is None:
            self._daylight = curves(self.sums, self.z)
        return self._daylight

    def normals(self) -> Tensor:
        """The normals of the surfaces (Bx3xHxW), see `uwaug.light.geometry.normals`."""
        if self._normals is None:
            self._normals = self.place.normals()
        return self._normals

    def shares(self, source: "LampOnScene") -> tuple[Tensor, Tensor]:
        """The shares of a lamp's light that were not scattered on the way to the camera, and that
        were: T_β/T_G, and the rest. Lamps of one spectrum have them in common.
        """
        key = id(source.lamp.spectrum)
        if key not in self._shares:
            self._shares[key] = source.shares(self.z)
        return self._shares[key]


class DaylightOnScene(NamedTuple):
    """Light from the surface on a scene."""

    source: Daylight

    def row(self, n: int) -> "DaylightOnScene":
        """That of the n-th picture."""
        return DaylightOnScene(self.source.row(n))

    def brightened(self, gain: Tensor) -> "DaylightOnScene":
        """As a camera of this gain sees it: the medium has that already."""
        return self

    def curves(self, part: Part) -> Curves:
        """What reaches the camera at each pixel."""
        sky, source, view = part.daylight(), self.source, part.place.view
        if source.gain is None and not source.has_view:
            return sky
        gain = sky.direct.new_ones(1) if source.gain is None else source.gain
        shade = veil = as_map(gain)
        if source.gradient is not None:
            assert view is not None
            veil = veil * torch.exp(as_map(source.gradient) * (-view.y * view.shortening()))
        if source.sun is not None:
            assert source.diffuse is not None
            diffuse = as_map(source.diffuse)
            shade = shade * (diffuse + (1 - diffuse) * facing(part.normals(), source.sun))
        return Curves(dimmed(sky.direct, shade), dimmed(sky.scatter, shade), sky.veil * veil)


class LampOnScene(NamedTuple):
    """A lamp on a scene: its light on the surfaces, and its near-field backscatter.

    Attributes:
        lamp: of the type of the picture.
        white: `Medium.under` its spectrum.
        water: the same of its power and colour.
        grid: its backscatter along the rays of the whole picture; None where that is integrated at
            each pixel: near a lamp in view, it is too steep for a grid.
        from_direct (B tensor): see `uwaug.optics.bands.Bands`; None where it is 0.
        wide: see `Lamp.wide`.
        gain: what a camera makes of it, as for `Medium.brightened`; or None.
    """

    lamp: Lamp
    white: Medium
    water: Medium
    grid: Grid | None
    from_direct: Tensor | None
    wide: bool
    gain: Tensor | None = None

    def row(self, n: int) -> "LampOnScene":
        """That of the n-th picture."""

        def pick(value: Tensor) -> Tensor:
            return value[n % len(value)][None]

        return LampOnScene(
            self.lamp.row(n),
            self.white[n % len(self.white)],
            self.water[n % len(self.water)],
            self.grid and self.grid._replace(planes=pick(self.grid.planes)),
            None if self.from_direct is None else pick(self.from_direct),
            self.wide,
            None if self.gain is None else pick(self.gain),
        )

    def brightened(self, gain: Tensor) -> "LampOnScene":
        """As a camera of this gain sees it, see `Medium.brightened`."""
        return self._replace(gain=gain)

    def curves(self, part: Part) -> Curves:
        """What reaches the camera at each pixel."""
        lamp, place, field = self.lamp, part.place, part.place.field
        assert place.view is not None
        ray = ray_of(lamp, place.view)
        share, path = irradiance(lamp, place.view, ray, place.z, part.normals())
        if self.grid is None:
            veil = integrated(lamp, self.water, place.view, ray, place.z, self.wide)
        else:
            veil = interpolated(self.grid, place.view, ray, place.z, place.columns)
        if field is not None:
            path, veil = path * field, veil * field
        arrives = dimmed(_summed(self.water.G, self.water.signal_weights, part.z + path), share)
        direct, scattered = part.shares(self)
        T = Curves(dimmed(arrives, direct), dimmed(arrives, scattered), veil)
        return T if self.gain is None else amplified(T, self.gain)

    def shares(self, z: Tensor) -> tuple[Tensor, Tensor]:
        """`Part.shares` at effective distances z (Bx1xHxW), m."""
        direct = _summed(self.white.beta, white(self.white.direct_weights), z)
        signal = _summed(self.white.G, white(self.white.signal_weights), z)
        if self.white.is_spectral:  # a channel may be black or negative, the sum of all is not
            direct, signal = direct.sum(1, keepdim=True), signal.sum(1, keepdim=True)
        share = (direct / signal.clamp(min=_DARK)).clamp(max=1.0)
        scattered = 1 - share
        if self.from_direct is not None:
            ones = torch.ones_like(direct)
            scattered = scattered * torch.lerp(ones, direct, as_map(self.from_direct))
        return share, scattered


class Lit(NamedTuple):
    """A light on a scene, or on a part of it.

    Attributes:
        light: of the type of the picture.
        sources: those of the light, on the scene.
        place: the surfaces.
    """

    light: Light
    sources: tuple[DaylightOnScene | LampOnScene, ...]
    place: Place

    def row(self, n: int) -> "Lit":
        """The light of the n-th picture."""
        sources = tuple(source.row(n) for source in self.sources)
        return Lit(self.light.row(n), sources, self.place.row(n))

    def part(self, rows: slice, columns: slice) -> "Lit":
        """The light on some rows and columns."""
        return self._replace(place=self.place.part(rows, columns))

    def at(self, pixels: Tensor) -> "Lit":
        """The light on some pixels, given by their flat indices (N), as one row of them."""
        sources = [
            source._replace(grid=None) if isinstance(source, LampOnScene) else source
            for source in self.sources
        ]
        return Lit(self.light, tuple(sources), self.place.at(pixels))

    def brightened(self, gain: Tensor) -> "Lit":
        """The light as a camera of this gain sees it, with the medium brightened alike."""
        return self._replace(sources=tuple(source.brightened(gain) for source in self.sources))

    def curves(self, sums: Sums, z: Tensor) -> Curves:
        """What reaches the camera at each pixel.

        Args:
            sums: of the medium, for daylight.
            z (Bx1xHxW tensor): effective distance, m.
        """
        part = Part(self.place, sums, z)
        maps = [source.curves(part) for source in self.sources]
        if not maps:
            dark = z.new_zeros(()).expand(z.shape[0], 3, *z.shape[-2:])
            return Curves(dark, dark, dark)
        total = maps[0]
        for more in maps[1:]:
            total = added(total, more)
        return total


def lit_of(
    light: Light | None,
    distance: Tensor,
    field: Tensor | None,
    medium: Medium,
    focal_px: float | None,
    centre: tuple[float, float] | None,
    lamps: Sequence[LampInWater] | None = None,
) -> Lit | None:
    """A light on a scene; None if it is daylight as the medium has it.

    Args:
        light: of B or 1 rows.
        distance, field: as for `uwaug.form_image`, valid.
        medium: of the type to compute in.
        focal_px, centre: as for `uwaug.form_image`.
        lamps: from `lamps_in_water`, of this light and medium; by default they are made.
    """
    if light is None or light.plain:
        return None
    light = checked_light(light, focal_px, centre).to(medium.beta)
    z = _batch(distance, medium).clamp(0.0, FARTHEST)
    field = None if field is None else _batch(field, medium)
    if not z.numel():
        return Lit(light, (), Place(z, field, None))
    view = None
    if light.has_view:
        assert focal_px is not None
        view = view_of((z.shape[-2], z.shape[-1]), focal_px, centre, z)
    in_water = iter(lamps_in_water(light, medium) if lamps is None else lamps)
    from_direct = None if medium.bands is None else medium.bands.from_direct.to(medium.beta)
    # compiled code cannot look
    if not torch.compiler.is_compiling() and from_direct is not None and not from_direct.any():
        from_direct = None
    sources: list[DaylightOnScene | LampOnScene] = []
    for source in light.sources:
        if isinstance(source, Daylight):
            sources.append(DaylightOnScene(source))
            continue
        assert view is not None
        white, ahead, wide, polynomials = next(in_water)
        white = white.to(medium.beta)
        water = white.brightened(source.power[:, None] * source.rgb)
        grid = None if ahead else grid_of(source, water, view, polynomials, wide)
        sources.append(LampOnScene(source, white, water, grid, from_direct, wide))
    return Lit(light, tuple(sources), Place(z, field, view))


def _batch(value: Tensor, medium: Medium) -> Tensor:
    return (value if value.ndim == 4 else value[None]).to(medium.beta)


def checked_light(
    light: Light, focal_px: float | None, centre: tuple[float, float] | None
) -> Light:
    """A light and what is known of the camera, checked."""
    checks.instance("light", light, Light)
    require_centre(centre)
    if focal_px is not None:
        checks.positive("focal_px", focal_px, "px")
    elif light.has_view:
        cure = "in px of the image, such as .866·width for a view 60° wide"
        raise ValueError(f"focal_px is missing: {light!r} has directions; give it {cure}")
    return light


def transmittance(sums: Sums, z: Tensor, lit: Lit | None) -> Curves:
    """T_β, T_G − T_β and V(0) − V at each pixel.

    Args:
        sums: of the medium, see `Medium.sums` and `Medium.sums_at`.
        z (Bx1xHxW tensor): effective distance, m.
        lit: the light on these pixels; None for daylight as the medium has it.
    """
    return curves(sums, z) if lit is None else lit.curves(sums, z)


def planning_medium(medium: Medium, light: Light | None) -> Medium:
    """The medium for which a blur is planned: a lamp may light the scene as daylight does at the
    surface, however dim daylight is at the scene.
    """
    if light is None or not light.lamps:
        return medium
    near = medium.under()
    return Medium.stack([medium, replace(near, veil_weights=torch.zeros_like(near.veil_weights))])


def _summed(rates: Tensor, weights: Tensor, z: Tensor) -> Tensor:
    """Σ weight·e^(−rate·z) for three channels (Bx3xHxW), or for matrices (Bx3x3xHxW)."""
    decays = decay(rates[..., None], z.flatten(1)[:, None])
    if weights.ndim == 3:
        return torch.unflatten(weights @ decays, -1, z.shape[-2:])
    sums = weights.flatten(1, 2) @ decays
    return sums.reshape(sums.shape[0], 3, 3, *z.shape[-2:])
