"""The curves of distance under a given light, at every pixel: what `curves` is under the default.

A light is linear: that of several sources is the sum of what each gives. With c for a channel,

    daylight  shade·T_β, shade·(T_G − T_β), e^(gradient·sin e)·(V(0) − V)
    a lamp    share·A, (1 − share)·A, and its near-field veil (see `uwaug.light.fog`)

A = beam·T_G(z + r) is what arrives of a lamp's light after both legs, r and z: on the way to the
scene, light that is scattered forward still lights it. share = T_β(z)/T_G(z) of that has come
straight from the surface to the camera. In the water's own field m, both legs of a pixel get that
pixel's m, and its veil is multiplied by it: right to 4 % for m of .5 to 2, and too bright beyond.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.light.beam import Ray, beam_of, column, facing, ray_of
from uwaug.light.fog import Fog, fog_at, fog_of, fog_within, terms_of
from uwaug.light.rays import View, beyond, normals, require_centre, view_of
from uwaug.light.source import Daylight, Lamp
from uwaug.light.value import Light
from uwaug.optics.curves import FARTHEST, Curves, Sums, curves, decay
from uwaug.optics.inherent import Legs, legs_of
from uwaug.optics.medium import Medium

__all__ = ["Lit", "lamp_legs", "light_of", "lit_of", "planned", "seen", "settled"]

_ALL = slice(None)

_SPENT = 1e-30
"""Of light, stands for none."""


class Lit(NamedTuple):
    """A light on a scene, or on a part of it.

    Attributes:
        light: of the type of the picture.
        legs: for each source, the sums of its light; None for daylight.
        fogs: for each source, its veil along the rays of the whole picture; None for daylight, and
            where the veil is integrated at each pixel.
        view: the rays; None if no source differs from ray to ray.
        z (Bx1xHxW tensor): distance, m, without the field.
        field (Bx1xHxW tensor): m, or None.
        normals (Bx3xHxW tensor): see `uwaug.light.rays`; None for a whole scene, see `part`.
        columns: of the picture, which this part has.
        from_direct (B tensor): see `uwaug.optics.inherent.Unlit`; None where it is 0.
        gain (B tensor): by which an exposure brightens lamps, or None; daylight's is in the medium.
    """

    light: Light
    legs: tuple[Legs | None, ...]
    fogs: tuple[Fog | None, ...]
    view: View | None
    z: Tensor
    field: Tensor | None
    normals: Tensor | None = None
    columns: slice = _ALL
    from_direct: Tensor | None = None
    gain: Tensor | None = None

    def row(self, n: int) -> "Lit":
        """The light of the n-th picture."""

        def one(value: Tensor) -> Tensor:
            return value[n % len(value)][None]

        return self._replace(
            light=self.light.row(n),
            legs=tuple(legs and legs.map(one) for legs in self.legs),
            fogs=tuple(fog and fog._replace(planes=one(fog.planes)) for fog in self.fogs),
            z=one(self.z),
            field=None if self.field is None else one(self.field),
            from_direct=None if self.from_direct is None else one(self.from_direct),
            gain=None if self.gain is None else one(self.gain),
        )

    def part(self, rows: slice, columns: slice) -> "Lit":
        """The light on some rows and columns."""

        def cut(value: Tensor) -> Tensor:
            return value[..., rows, columns]

        return self._replace(
            view=None if self.view is None else self.view.part(rows, columns),
            z=cut(self.z),
            field=None if self.field is None else cut(self.field),
            normals=self._normals(rows, columns),
            columns=columns,
        )

    def whole(self) -> "Lit":
        """The light on the whole picture, where it is not formed in parts."""
        return self.part(slice(0, self.z.shape[-2]), slice(0, self.z.shape[-1]))

    def _normals(self, rows: slice, columns: slice) -> Tensor | None:
        """Those of a part: made with it, as long as it lies in the cache."""
        if self.view is None:
            return None
        (tall, top), (wide, left) = beyond(rows), beyond(columns)
        found = normals(self.z[..., tall, wide], self.view.part(tall, wide))
        return found[..., top, left]

    def at(self, pixels: Tensor) -> "Lit":
        """The light on some pixels, given by their flat indices (N), as one row of them."""
        width, view = self.z.shape[-1], self.view

        def pick(value: Tensor) -> Tensor:
            return value.flatten(-2)[..., pixels][:, :, None]

        slopes = None
        if view is not None:
            slopes = pick(normals(self.z, view))
            x, y = view.x.flatten()[pixels % width], view.y.flatten()[pixels // width]
            view = View(x.reshape(1, 1, 1, -1), y.reshape(1, 1, 1, -1))
        field = None if self.field is None else pick(self.field)
        nothing = (None,) * len(self.fogs)
        found = Lit(self.light, self.legs, nothing, view, pick(self.z), field, slopes)
        return found._replace(from_direct=self.from_direct, gain=self.gain)

    def brightened(self, gain: Tensor) -> "Lit":
        """The same as a camera of this gain (B or 1) sees it, with the medium brightened alike."""
        return self._replace(gain=gain)

    def curves(self, sums: Sums, z: Tensor) -> Curves:
        """What reaches the camera at each pixel.

        Args:
            sums: of the medium, for daylight.
            z (Bx1xHxW tensor): effective distance, m.
        """
        found: Curves | None = None
        daylight = any(isinstance(source, Daylight) for source in self.light.sources)
        sky = curves(sums, z) if daylight else None
        shares: dict[int, tuple[Tensor, Tensor]] = {}
        for source, legs, fog in zip(self.light.sources, self.legs, self.fogs, strict=True):
            if isinstance(source, Daylight):
                assert sky is not None
                one = self._daylit(source, sky)
            else:
                assert legs is not None
                key = id(source.spectrum)  # of the same light, the same share
                if key not in shares:
                    shares[key] = self._shares(legs, z)
                one = self._lamplit(source, legs, fog, z, shares[key])
            found = one if found is None else Curves(*map(torch.add, found, one))
        if found is None:
            dark = z.new_zeros(()).expand(z.shape[0], 3, *z.shape[-2:])
            found = Curves(dark, dark, dark)
        return found

    def _daylit(self, source: Daylight, sky: Curves) -> Curves:
        shade = veil = column(source.gain)
        if source.whole and not source.has_view:
            return sky
        if self.view is not None and not source.level:
            up = -self.view.y * self.view.shortening()
            veil = veil * torch.exp(column(source.gradient) * up)
        if source.sun is not None:
            assert self.normals is not None
            diffuse = column(source.diffuse)
            cosine = facing(self.normals, source.sun)
            shade = shade * (diffuse + (1 - diffuse) * cosine)
        return Curves(sky.direct * shade, sky.scatter * shade, sky.veil * veil)

    def _lamplit(
        self, lamp: Lamp, legs: Legs, fog: Fog | None, z: Tensor, shares: tuple[Tensor, Tensor]
    ) -> Curves:
        assert self.view is not None
        assert self.normals is not None
        ray = ray_of(lamp, self.view)
        beam = beam_of(lamp, self.view, ray, self.z, self.normals)
        path = beam.metres if self.field is None else beam.metres * self.field
        share, veil = beam.share, self._fogged(lamp, legs, fog, ray)
        if self.gain is not None:
            share, veil = share * column(self.gain), veil * column(self.gain)
        if self.field is not None:
            veil = veil * self.field
        arrives = _summed(legs.G, legs.signal, z + path) * share
        return Curves(arrives * shares[0], arrives * shares[1], veil)

    def _shares(self, legs: Legs, z: Tensor) -> tuple[Tensor, Tensor]:
        """Of what arrives, the shares that were not scattered on the way, and that were: T_β/T_G,
        and the rest.
        """
        found = _summed(legs.both, legs.parts, z)
        direct = (found[:, :3] / found[:, 3:].clamp(min=_SPENT)).clamp(max=1.0)
        scattered = 1 - direct
        if self.from_direct is not None:
            scattered = scattered * torch.lerp(
                torch.ones_like(direct), found[:, :3], column(self.from_direct)
            )
        return direct, scattered

    def _fogged(self, lamp: Lamp, legs: Legs, fog: Fog | None, ray: Ray) -> Tensor:
        assert self.view is not None
        if fog is None:
            return fog_at(lamp, legs, self.view, ray, self.z)
        return fog_within(fog, self.view, ray, self.z, self.columns)


def lit_of(
    light: Light | None,
    distance: Tensor,
    field: Tensor | None,
    medium: Medium,
    focal_px: float | None,
    centre: tuple[float, float] | None,
    held: Sequence[Legs] | None = None,
) -> Lit | None:
    """A light on a scene; None if it is daylight as the medium has it.

    Args:
        light: of B or 1 rows.
        distance, field: as for `uwaug.form_image`, valid.
        medium: of the type to compute in.
        focal_px, centre: as for `uwaug.form_image`.
        held: from `lamp_legs`, of the same light and medium; by default they are made.
    """
    if light is None or light.plain:
        return None
    light = light_of(light, focal_px, centre).to(medium.beta)
    z = _batch(distance, medium).clamp(0.0, FARTHEST)
    field = None if field is None else _batch(field, medium)
    if not light.has_view or not z.numel():
        nothing = (None,) * len(light.sources)
        return Lit(light, nothing, nothing, None, z, field)
    assert focal_px is not None
    view = view_of((z.shape[-2], z.shape[-1]), focal_px, centre, z)
    legs: list[Legs | None] = []
    fogs: list[Fog | None] = []
    rest = iter(lamp_legs(light, medium) if held is None else held)
    for source in light.sources:
        if isinstance(source, Daylight):
            legs.append(None)
            fogs.append(None)
            continue
        white = next(rest).map(lambda t: t.to(medium.beta))
        own = white.tinted(source.power[:, None] * source.colour)
        legs.append(own)
        # near a lamp in view, the veil is too steep for a grid
        terms = source.terms or terms_of(source, own)
        fogs.append(None if source.ahead else fog_of(source, own, view, terms))
    found = Lit(light, tuple(legs), tuple(fogs), view, z, field)
    return found._replace(from_direct=_from_direct(medium))


def _from_direct(medium: Medium) -> Tensor | None:
    if medium.unlit is None:
        return None
    # a module that was moved or cast keeps the bands where they were
    found = medium.unlit.from_direct.to(medium.beta)
    # compiled code cannot look
    return found if torch.compiler.is_compiling() or bool(found.any()) else None


def lamp_legs(light: Light, medium: Medium) -> list[Legs]:
    """The sums of each lamp's light in a medium."""
    lamps = [source for source in light.sources if isinstance(source, Lamp)]
    return [legs_of(medium, lamp.spectrum) for lamp in lamps]


def settled(light: Light, medium: Medium) -> Light:
    """A light that holds what else would be looked for in each picture."""
    legs = iter(lamp_legs(light, medium))
    sources: list[Daylight | Lamp] = []
    for source, alike in zip(light.sources, light.to(medium.beta).sources, strict=True):
        if isinstance(source, Lamp) and isinstance(alike, Lamp):
            own = next(legs).tinted(alike.power[:, None] * alike.colour)
            source = replace(source, terms=terms_of(alike, own))
        sources.append(source)
    return Light(tuple(sources))


def _batch(value: Tensor, medium: Medium) -> Tensor:
    return (value if value.ndim == 4 else value[None]).to(medium.beta)


def light_of(light: Light, focal_px: float | None, centre: tuple[float, float] | None) -> Light:
    """A light and what is known of the camera, checked."""
    checks.instance("light", light, Light)
    require_centre(centre)
    if focal_px is not None:
        checks.positive("focal_px", focal_px, "px")
    elif light.has_view:
        cure = "in px of the image, such as .866·width for a view 60° wide"
        raise ValueError(f"focal_px is missing: {light!r} has directions; give it {cure}")
    return light


def seen(sums: Sums, z: Tensor, lit: Lit | None) -> Curves:
    """The curves at each pixel under a light; None for daylight as the medium has it."""
    return curves(sums, z) if lit is None else lit.curves(sums, z)


def _summed(rates: Tensor, weights: Tensor, z: Tensor) -> Tensor:
    """Σ weight·e^(−rate·z) for three channels (Bx3xHxW)."""
    left = decay(rates[..., None], z.flatten(1)[:, None])
    return torch.unflatten(weights @ left, -1, z.shape[-2:])


def planned(medium: Medium, light: Light | None) -> Medium:
    """The medium for which a blur is planned: a lamp may light the scene as daylight does at the
    surface, however dim daylight is at the scene.
    """
    if light is None or not light.has_lamp:
        return medium
    legs = legs_of(medium)
    k = legs.both.shape[1] - legs.G.shape[1]
    near = Medium(
        beta=legs.both[:, :k],
        direct_weights=legs.parts[:, :3, :k],
        G=legs.G,
        signal_weights=legs.signal,
        veil_weights=torch.zeros_like(legs.signal),
        b_mean=medium.b_mean,
        point_spread=medium.point_spread,
        notes=medium.notes,
    )
    return Medium.stack([medium, near])
