"""The medium: all that the image needs to know about water, camera and depth, as curves of
distance.

| symbol | meaning | unit |
|---|---|---|
| a, b, K_d | absorption, scattering, diffuse attenuation of the water at each wavelength | 1/m |
| β = a + b | beam attenuation | 1/m |
| g | share of the scattered light that leaves the line of sight | 1 |
| G = a + g·b | attenuation of what still carries the picture | 1/m |
| d | depth of the scene below the surface | m |
| E = e^(−K_d d) | light that is left at that depth | 1 |
| μ | share of the scattered light that is sent towards the camera | 1 |
| V(0) = μ·b·E/G | veil of endless water | 1 |
| S_c | response of the camera's channel c, ∫S_c dλ = 1 | 1/nm |
| z | distance along the ray; a medium field m multiplies it before it comes here | m |
| b̄ | mean of b over the channels | 1/m |

    T_β,c(z) = ∫ S_c·E·e^(−β z) dλ  ≈ Σ_k w_ck e^(−β_k z)    what arrives unscattered
    T_G,c(z) = ∫ S_c·E·e^(−G z) dλ  ≈ Σ_l s_cl e^(−G_l z)    what arrives at all (direct + forward)
    V_c(z) = ∫ S_c·V(0)·e^(−G z) dλ ≈ Σ_l v_cl e^(−G_l z)    so that the veil is V(0) − V(z)
    σ(z) = scale·(b̄ z)^exponent                              width of the forward scatter, px

Each integral becomes a sum of a few exponentials with positive weights: exact at z = 0, monotone,
right at any distance. The rates belong to the water and serve all three channels, and signal and
veil alike; only the weights belong to the camera. (For a tolerance of .002, one Gauss quadrature
per curve and channel needs 15 to 24 exponentials, shared rates need 4 to 8.)
"""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import index
from typing import Any

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from uwaug._support import checks
from uwaug._support.checks import DOMAIN
from uwaug.optics import derived
from uwaug.optics.bands import (
    Dims,
    Downwelling,
    VeilRate,
    band_coefficients,
    default_bands,
)
from uwaug.optics.camera import Camera, load_camera, response_at
from uwaug.optics.curves import FARTHEST, Sums
from uwaug.optics.inherent import Unlit, of_channels, unlit_bands
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.reduction import Forward, reduced, spectral_note
from uwaug.optics.water import Water

__all__ = ["Medium"]

_TENSORS = ("beta", "direct_weights", "G", "signal_weights", "veil_weights", "b_mean")


@dataclass(frozen=True, eq=False)
class Medium:
    """A batch of B media: rates, weights and a width law. Every tensor may require gradients.

    Attributes:
        beta (BxK tensor): rates of the direct term, 1/m, ≥ 0.
        direct_weights (Bx3xK tensor): weights of T_β.
        G (BxL tensor): rates of signal and veil, 1/m, ≥ 0.
        signal_weights (Bx3xL tensor): weights of T_G.
        veil_weights (Bx3xL tensor): weights of V; their sum is the veil at infinite distance.
        b_mean (B tensor): b̄, scattering coefficient for the width law, 1/m.
        point_spread: the width law.
        notes: one line per medium on what it models.
        unlit: the water band by band, for lamps; None if only the sums are known.
    """

    beta: Tensor
    direct_weights: Tensor
    G: Tensor
    signal_weights: Tensor
    veil_weights: Tensor
    b_mean: Tensor
    point_spread: PointSpread
    notes: tuple[str, ...] = ()
    unlit: Unlit | None = None

    def __post_init__(self) -> None:
        b, k, n = self.beta.shape[0], self.beta.shape[-1], self.G.shape[-1]
        shapes = ((b, k), (b, 3, k), (b, n), (b, 3, n), (b, 3, n), (b,))
        for name, shape in zip(_TENSORS, shapes, strict=True):
            got = tuple(getattr(self, name).shape)
            if got != shape:
                raise ValueError(f"Medium.{name} must have shape {shape}, got {got}")
        self.point_spread.require_rows(b)

    @staticmethod
    def from_water(
        water: str | Water,
        camera: str | os.PathLike[str] | Camera = "Nikon 5100 (NPL)",
        *,
        vertical_depth: float = 1.0,
        g: float = 0.2,
        mu: float = 0.3,
        point_spread: PointSpread | None = None,
        tolerance: float = 0.002,
        wavelengths: ArrayLike | None = None,
        downwelling: Downwelling = "kd",
        dims: Dims = "both",
        veil_rate: VeilRate = "G",
        forward: Forward = "image",
    ) -> "Medium":
        """Reduce spectra to as few exponentials as the tolerance allows.

        Args:
            water: spectra a, b, K_d; or the name of a Jerlov type.
            camera: name of a colour-science response, path of a CSV file, or a `Camera`.
            vertical_depth: d, depth of the scene below the surface, m, ≥ 0.
            g: share of the scattered light that leaves the line of sight, 0…1. Not the asymmetry of
                a phase function: .2 (the paper) for a subject that fills part of the view, .05 for
                one that fills it.
            mu: share of the scattered light that is sent towards the camera, 0…1, where 1 in the
                image means a white vertical plate.
            point_spread: width law, by default `PointSpread.paper()`.
            tolerance: largest error of each curve, at any distance; 0 keeps every band.
            wavelengths: bands, nm, by default 400…700 in steps of 5 as far as the water reaches.

        Other models of water (see `uwaug.presets.published_systems`) differ in:
            downwelling: what dims light on its way down: "kd"; "beam", β; or "none".
            dims: what that light is lost to: "both"; "direct", the picture (direct and forward); or
                "veil".
            veil_rate: "G", or "beta": V(0) = μ·b·E/β, and e^(−βz) for the veil.
            forward: what forward scatter blurs: "image", J; or "direct", D, so that F has
                e^(−βz)·(e^(−Gz) − e^(−βz)) for a weight, which is e^(−βz) times that of J: the
                nearer the scene, the more equal the two.

        Raises:
            TypeError, ValueError: if an argument is no water, no number, or outside its domain.
        """
        if isinstance(water, str):
            water = Water.jerlov(water)
        checks.instance("water", water, Water, "; see Water.jerlov")
        drawn: dict[str, Any] = {"vertical_depth": vertical_depth, "g": g, "mu": mu}
        for name, value in drawn.items():
            checks.within(name, value, *DOMAIN[name])
        if tolerance != 0:
            checks.tolerance(tolerance)
        bands = water.at(default_bands(water) if wavelengths is None else wavelengths)
        response = response_at(load_camera(camera), bands.wavelengths.tobytes())
        choices: dict[str, Any] = {"downwelling": downwelling, "dims": dims, "veil_rate": veil_rate}
        found = band_coefficients(bands.a, bands.b, bands.kd, **drawn, **choices)
        tensors, error = reduced(found, response, forward, tolerance)
        note = spectral_note(water.name, tensors, error, drawn, {**choices, "forward": forward})
        b_mean = torch.as_tensor([(response @ bands.b).mean()])
        law = PointSpread.paper() if point_spread is None else point_spread
        axis, tensors = bands.wavelengths, [*tensors, b_mean]
        unlit = unlit_bands(axis, found, bands.b, response, forward, tolerance)
        return Medium.of_tensors(tensors, law, (note,), unlit)

    @staticmethod
    def from_coefficients(
        beta: Tensor | Sequence[float],
        G: Tensor | Sequence[float],
        veil: Tensor | Sequence[float],
        *,
        b_mean: Tensor | float = 0.0,
        point_spread: PointSpread | None = None,
        light: Tensor | Sequence[float] = (1.0, 1.0, 1.0),
        veil_rate: Tensor | Sequence[float] | None = None,
        forward: Forward = "image",
    ) -> "Medium":
        """The classical model, one exponential per channel.

        Args:
            beta (3 or Bx3): beam attenuation per channel, 1/m, ≥ 0.
            G (3 or Bx3): effective attenuation of signal and veil, 1/m, ≥ 0. With G = beta there is
                no forward scatter.
            veil (3 or Bx3): veil at infinite distance, V(0).
            b_mean (number or B): scattering coefficient of the width law, 1/m.
            point_spread: width law, by default no blur.
            light (3 or Bx3): ambient light at the scene, e^(−K_d d).
            veil_rate (3 or Bx3): attenuation of the veil, 1/m, ≥ 0, if it is another than G.
            forward: as for `from_water`.

        Tensors keep their gradients; all are float64 inside unless given as tensors of another
        type.

        Raises:
            ValueError: if a shape is another, batches differ, or a value is negative or infinite.
        """
        given = {"beta": beta, "G": G, "veil": veil, "light": light, "b_mean": b_mean}
        rows = derived.channel_rows({**given, "veil_rate": veil_rate})
        tensors = derived.channel_tensors(rows, forward)
        law = PointSpread.none() if point_spread is None else point_spread
        unlit = of_channels(rows["beta"], rows["G"], rows["b_mean"], forward)
        return Medium.of_tensors(tensors, law, derived.channel_notes(tensors), unlit)

    @staticmethod
    def from_transmission(
        transmission: Tensor | Sequence[float], veil: Tensor | Sequence[float]
    ) -> "Medium":
        """Water of one transmission, whatever the distance (.1 mm or more): I = t·J + (1 − t)·B.

        Args:
            transmission (3 or Bx3): t per channel, 0…1.
            veil (3 or Bx3): B, ≥ 0.

        Raises:
            ValueError: if a shape is another, batches differ, or a value is out of range.
        """
        return Medium.from_coefficients(**derived.without_distance(transmission, veil))

    @staticmethod
    def stack(media: "Iterable[Medium]") -> "Medium":
        """One batch of several media; their width laws must share shape and reference size."""
        media = list(media)
        for medium in media:
            checks.instance("media", medium, Medium, "; see Medium.from_water")
        return derived.stacked(media)

    def __len__(self) -> int:
        return len(self.beta)

    def __getitem__(self, i: int | slice) -> "Medium":
        """The i-th medium, as a batch of one; or those of a slice."""
        part = i if isinstance(i, slice) else slice(index(i), index(i) + 1 or None)
        if not range(len(self))[part]:
            raise IndexError(f"medium {i!r} of {len(self)}")
        return replace(self.map(lambda t: t[part] if t.ndim else t), notes=self.notes[part])

    def map(self, function: Callable[[Tensor], Tensor]) -> "Medium":
        """`function` applied to each tensor, the width law's included."""
        law, unlit = self.point_spread.map(function), self.unlit and self.unlit.map(function)
        return self.of_tensors(list(map(function, self.tensors())), law, self.notes, unlit)

    @staticmethod
    def of_tensors(
        tensors: Sequence[Tensor],
        point_spread: PointSpread,
        notes: tuple[str, ...],
        unlit: Unlit | None = None,
    ) -> "Medium":
        """The inverse of `tensors`."""
        named: dict[str, Any] = dict(zip(_TENSORS, tensors, strict=True))
        return Medium(**named, point_spread=point_spread, notes=notes, unlit=unlit)

    def to(self, *args: Any, **kwargs: Any) -> "Medium":
        """Move or cast, as `torch.Tensor.to`."""
        if all(t.to(*args, **kwargs) is t for t in self.tensors()):
            return self
        return self.map(lambda t: t.to(*args, **kwargs))

    def tensors(self) -> tuple[Tensor, ...]:
        """Rates, weights and b̄, in the order of the attributes."""
        return tuple(getattr(self, name) for name in _TENSORS)

    def parameters(self) -> dict[str, Tensor]:
        """All that is continuous in a medium, by name, each with a row for every medium.

        Shapes: beta (B, K), direct_weights (B, 3, K), G (B, L), signal_weights and veil_weights
        (B, 3, L), b_mean, scale and exponent (B,).
        """
        tensors = dict(zip(_TENSORS, self.tensors(), strict=True))
        return tensors | self.point_spread.rows(len(self), self.beta)

    @staticmethod
    def of(parameters: Mapping[str, Tensor], like: "Medium") -> "Medium":
        """The inverse of `parameters`; kind of width law and notes are those of `like`."""
        tensors = [parameters[name] for name in _TENSORS]
        numbers: dict[str, Any] = {name: parameters[name] for name in PointSpread.NUMBERS}
        law = replace(like.point_spread, **numbers)
        return Medium.of_tensors(tensors, law, like.notes)

    @property
    def requires_grad(self) -> bool:
        """Whether any tensor, the width law's included, records gradients."""
        return any(t.requires_grad for t in self.parameters().values())

    def sums(self, *, exact_at_lens: bool) -> Sums:
        """What `curves` takes.

        exact_at_lens: compute the veil without cancellation, so that a millimetre of water gives a
        small veil, not 0. Otherwise V(0) − V(z) is subtracted, which takes half the time; see
        `uwaug.formation.any_at_lens` for where that is right.
        """
        return derived.sums_of(self, exact_at_lens)

    def transmission(self, z: Tensor) -> Tensor:
        """T_β(z): share of the light at the surface that arrives unscattered.

        Args:
            z: distance, m; (B or 1, 1, H, W), (1, H, W), or any number of values (N,) or ().

        Returns:
            (B, 3, H, W), or (B, 3, N), or (B, 3).
        """
        return derived.curves_at(self, z).direct

    def signal(self, z: Tensor) -> Tensor:
        """T_G(z): share of the light at the surface that arrives at all; as `transmission`."""
        found = derived.curves_at(self, z)
        return found.direct + found.scatter

    def backscatter(self, z: Tensor) -> Tensor:
        """V(0) − V(z), the veil in front of a point at distance z; as `transmission`."""
        return derived.curves_at(self, z, exact_at_lens=True).veil

    def brightened(self, gain: Tensor) -> "Medium":
        """The medium as seen by a camera that multiplies all light by `gain` (B or 1)."""
        return derived.brightened(self, gain)

    def with_veil(self, veil: Tensor | Sequence[float], curve: derived.Veil = "veil") -> "Medium":
        """The same water with a given veil at infinite distance.

        Args:
            veil (3 or Bx3): per channel, ≥ 0; one for all media, or one for each.
            curve: how it comes in with distance: as the medium's own "veil", or as the "signal"
                goes, V(0)·(1 − T_G(z)/T_G(0)).

        Raises:
            ValueError: if a shape is another, batches differ, a value is negative or infinite, or a
                channel has no curve of its own to follow.
        """
        return derived.with_veil(self, veil, curve)

    def lengths(self, z: Tensor) -> Tensor:
        """Scattering lengths b̄·z of finite distances (B or 1, 1, H, W)."""
        return self.b_mean.reshape(-1, 1, 1, 1).to(z) * z

    def width(self, z: Tensor, size: tuple[int, int] | None) -> Tensor:
        """σ(z), px, of distances (B or 1, 1, H, W) in an image of `size`; None: in the law's px."""
        return self.point_spread.sigma(self.lengths(z.clamp(max=FARTHEST)), size)

    def __repr__(self) -> str:
        more = f", and {len(self) - 1} more" if len(self) > 1 else ""
        b_mean = ", ".join(f"{float(b):.3g}" for b in self.b_mean.detach()[:3])
        cut = ", …" if len(self) > 3 else ""
        note = self.notes[0] if self.notes else ""
        return f"Medium({note}{more}; {self.point_spread}, b̄ = {b_mean}{cut}/m)"
