"""The medium: all that the image needs to know about water, camera and depth, as curves of
distance z. Symbols are those of `uwaug/formation/README.md`; S_c is the response of the camera's
channel c, ∫S_c dλ = 1, E = e^(−K_d d) the light that is left at a depth d below the surface, and b̄
the mean of b over the channels.

    T_β,c(z) = ∫ S_c·E·e^(−β z) dλ  ≈ Σ_k w_ck e^(−β_k z)    light that arrives unscattered
    T_G,c(z) = ∫ S_c·E·e^(−G z) dλ  ≈ Σ_l s_cl e^(−G_l z)    the same, and scattered forward
    V_c(z) = ∫ S_c·V(0)·e^(−G z) dλ ≈ Σ_l v_cl e^(−G_l z)    the veil is V(0) − V(z)
    σ(z) = scale·(b̄ z)^exponent                              width of the forward scatter

With surfaces that have spectra, T_β and T_G are matrices from channel j of the scene to channel c,
with S_c·ρ_j for S_c. S is the response of the camera with its colour matrix, which may be negative
(see `uwaug.optics.surfaces`).

The rates belong to the water and serve all three channels, and signal and veil alike; only the
weights belong to the camera.
"""

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import index
from typing import TYPE_CHECKING, Any, ClassVar, get_args

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from uwaug._support import checks
from uwaug._support.checks import DOMAIN
from uwaug._support.codec import from_plain, plain
from uwaug._support.types import Array
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.curves import FARTHEST, Curves, Sums, curves, mix
from uwaug.optics.point_spread import IN_PIXELS, Law, PointSpread, widths
from uwaug.optics.reduction import reduced
from uwaug.optics.scattering import Scattering
from uwaug.optics.snow import MarineSnow
from uwaug.optics.surfaces import Surfaces, as_matrices, mixed, nine_rows, row_of, white
from uwaug.optics.view import Size, View
from uwaug.optics.water import Water, load_water
from uwaug.optics.weights import Weights

_OF_COEFFICIENTS = "coefficients: one rate per channel"
_G_ROUNDING = 1e-6  # rounding by which G may exceed beta, in 1/m and as a share of it
_MIN_LIGHT = 1e-30  # stands for the light of a channel that gets none
_MIN_SHARE = 1e-6  # smallest share of a channel's light from which a rate is taken
# Optical depth below which 1 − e^−x keeps less than 16 of the 24 bits of single precision, and the
# veil is off by 2e-5 of itself.
_MIN_DEPTH = 1 / 256
_PIXELS = Law()


def absent(value: float = 0.0) -> Any:
    """Declare a tensor of a medium that is the same number everywhere unless it is given."""
    number = torch.tensor(value, device="cpu")
    return field(default_factory=lambda: number)


@plain
@dataclass(frozen=True, eq=False)
class Medium:
    """A batch of B media: rates, weights and a width law. Every tensor may require gradients. What
    `from_water` makes, and a transform draws, are arrays until somebody asks for a tensor.

    Attributes:
        beta (BxK tensor): rates of the direct term, 1/m, ≥ 0.
        direct_weights (Bx3xK tensor, or Bx3x3xK of surfaces with spectra): weights of T_β.
        G (BxL tensor): rates of signal and veil, 1/m, ≥ 0.
        signal_weights (Bx3xL or Bx3x3xL tensor): weights of T_G.
        veil_weights (Bx3xL tensor): weights of V; their sum is the veil at infinite distance.
        b_mean (B tensor): b̄, scattering coefficient for the width law, 1/m.
        scale, exponent (B tensors): numbers of the width law, see `PointSpread`.
        lamp_…: the first five in the light of a lamp, of other numbers of rates, see `under_lamp`;
            without rates where they follow from the others.
        law: shape and unit of the width law.
        notes: a line on each medium.
        snow: particles of each medium, see `with_snow`; empty if none has any.
    """

    TENSORS: ClassVar = {
        "beta": "BK",
        "direct_weights": "BCSK",
        "G": "BL",
        "signal_weights": "BCSL",
        "veil_weights": "BCL",
        "b_mean": "B",
        "scale": "B",
        "exponent": "B",
        "lamp_beta": "BM",
        "lamp_direct_weights": "BCTM",
        "lamp_G": "BN",
        "lamp_signal_weights": "BCTN",
        "lamp_veil_weights": "BCN",
    }
    # Axes: B media, K rates of the direct term, L of signal and veil, M and N of these under lamps,
    # C channels of the picture, and of surfaces with spectra S channels of the scene, T under
    # lamps. All code that copies, stacks, brightens, learns, stores or exports media goes by it.

    beta: Tensor
    direct_weights: Tensor
    G: Tensor
    signal_weights: Tensor
    veil_weights: Tensor
    b_mean: Tensor
    scale: Tensor = absent()
    exponent: Tensor = absent(1.0)
    lamp_beta: Tensor = absent()
    lamp_direct_weights: Tensor = absent()
    lamp_G: Tensor = absent()  # noqa: N815
    lamp_signal_weights: Tensor = absent()
    lamp_veil_weights: Tensor = absent()
    law: Law = _PIXELS
    notes: tuple[str, ...] = ()
    snow: tuple[MarineSnow | None, ...] = ()

    def __post_init__(self) -> None:
        rates = {"K": self.beta, "L": self.G, "M": self.lamp_beta, "N": self.lamp_G}
        sizes = {axis: t.shape[-1] if t.ndim else 0 for axis, t in rates.items()}
        sizes |= {"B": self.beta.shape[0], "C": 3}
        of_scene = {"S": self.direct_weights, "T": self.lamp_direct_weights}
        sizes |= {axis: 3 for axis, weights in of_scene.items() if weights.ndim == 4}
        for name, axes in self.TENSORS.items():
            tensor = getattr(self, name)
            shape = tuple(map(sizes.__getitem__, filter(sizes.__contains__, axes)))
            if tensor.ndim == 0:
                object.__setattr__(self, name, tensor.to(self.beta).expand(shape))
            elif tuple(tensor.shape) != shape:
                got = tuple(tensor.shape)
                raise ValueError(f"Medium.{name} must have shape {shape}, got {got}")

    if not TYPE_CHECKING:  # a checker would take any name for an attribute

        def __getattr__(self, name: str) -> Any:
            """Make the tensors of arrays, when somebody asks for the first."""
            if name not in Medium.TENSORS or "_arrays" not in vars(self):
                raise AttributeError(f"Medium has no attribute {name!r}")
            others = {"law": self.law, "notes": self.notes, "snow": self.snow}
            with torch.inference_mode(False):  # its tensors cannot be used outside
                tensors = {n: row_of(array) for n, array in self._arrays.items()}
                vars(self).update(vars(Medium(**tensors, **others)))
            return vars(self)[name]

    @staticmethod
    def of_plain(**values: Any) -> "Medium":
        """A medium of stored numbers, or, as a person writes them, as `from_coefficients`."""
        if "direct_weights" not in values:
            law = from_plain(values.pop("point_spread", None), PointSpread)
            return Medium.from_coefficients(**values, point_spread=law)
        stored = values.keys() & Medium.TENSORS
        tensors = {name: torch.tensor(values[name], dtype=torch.float64) for name in stored}
        return Medium(**values | tensors)

    @staticmethod
    def from_water(
        water: str | os.PathLike[str] | Water,
        camera: str | os.PathLike[str] | Camera = "Nikon 5100 (NPL)",
        *,
        vertical_depth: float = 1.0,
        g: float = Scattering.CALIBRATED.g,
        mu: float | None = None,
        point_spread: PointSpread | None = None,
        surfaces: Surfaces = "grey",
        color_matrix: float = 1.0,
        tolerance: float = 0.002,
    ) -> "Medium":
        """Reduce spectra to as few exponentials as the tolerance allows.

        Args:
            water: spectra a, b, K_d; or a Jerlov type, contents or the path of a CSV file, see
                `uwaug.load_water`.
            camera: a name, the path of a CSV file (see `uwaug.load_camera`), or a `Camera`.
            vertical_depth: d, depth of the scene below the surface, m, ≥ 0.
            g: share of the scattered light that leaves the line of sight, 0…1.
            mu: share of the scattered light that is sent towards the camera, 0…1; None for 1.5·g.
            point_spread: width law, by default `PointSpread.calibrated()`; the paper's presets say
                `PointSpread.paper()` and g = .2.
            surfaces: "grey", where a channel of the picture depends on that channel of the scene
                alone, as in the paper; or "spectral", see `uwaug.optics.surfaces`.
            color_matrix: share of the camera's colour matrix that is applied to surfaces with
                spectra, 0…1. With 0 its raw channels are shown.
            tolerance: largest error of each curve, at any distance, as a share of the light at the
                surface; 0 keeps every band, which deep scenes with a high exposure want.

        Raises:
            TypeError, ValueError: if an argument is no water, no number, or outside its domain.
        """
        water = load_water(water)
        if mu is None:
            mu = min(1.5 * g, 1.0)
        numbers = {"vertical_depth": vertical_depth, "g": g, "mu": mu, "color_matrix": color_matrix}
        for name, value in numbers.items():
            checks.within(name, value, *DOMAIN[name])
        if tolerance != 0:
            checks.tolerance(tolerance)
        checks.one_of("surfaces", surfaces, get_args(Surfaces))
        spectral = surfaces == "spectral"
        options = vertical_depth, g, mu, color_matrix if spectral else None, tolerance
        law = PointSpread.calibrated() if point_spread is None else point_spread
        return Medium.of_arrays(*reduced(water, load_camera(camera), *options, lamps=True), law)

    @staticmethod
    def of_arrays(arrays: Mapping[str, Array], note: str, law: PointSpread) -> "Medium":
        """A medium of one row. Tensors, made when somebody asks, share the arrays' memory; weights
        of matrices have 9 rows.
        """
        medium = object.__new__(Medium)
        width = {"scale": np.array(law.scale), "exponent": np.array(law.exponent)}
        vars(medium).update(_arrays={**arrays, **width}, law=law.law, notes=(note,), snow=())
        return medium

    @property
    def is_of_arrays(self) -> bool:
        """True until somebody asks for a tensor: no values have changed, and none records."""
        return "beta" not in vars(self)

    @staticmethod
    def from_coefficients(
        beta: Tensor | Sequence[float],
        G: Tensor | Sequence[float],
        veil: Tensor | Sequence[float],
        *,
        b_mean: Tensor | float = 0.0,
        point_spread: PointSpread | None = None,
        light: Tensor | Sequence[float] = (1.0, 1.0, 1.0),
    ) -> "Medium":
        """The classical model, one exponential per channel.

        Args:
            beta (3 or Bx3): beam attenuation per channel, 1/m, ≥ 0.
            G (3 or Bx3): attenuation of signal and veil, 1/m, 0…beta; with G = beta there is no
                forward scatter.
            veil (3 or Bx3): veil at infinite distance, V(0).
            b_mean (number or B): scattering coefficient of the width law, 1/m.
            point_spread: width law, by default no blur.
            light (3 or Bx3): ambient light at the scene, e^(−K_d d).

        Tensors keep their gradients. All take the type of the first floating-point tensor, or
        float64.

        Raises:
            ValueError: if shapes or batches differ, a value is negative or infinite, or G > beta.
        """
        rows = _rows({"beta": beta, "G": G, "veil": veil, "light": light, "b_mean": b_mean})
        beta, G, b = rows["beta"], rows["G"], rows["b_mean"]
        if bool((G - beta > _G_ROUNDING * (1 + beta)).any()):
            got = f"G = {G.tolist()} and beta = {beta.tolist()}"
            raise ValueError(f"G must be beta at most, got {got}")
        weights = torch.diag_embed(rows["light"])
        law = PointSpread.none() if point_spread is None else point_spread
        return Medium(
            beta=beta,
            direct_weights=weights,
            G=G,
            signal_weights=weights,
            veil_weights=torch.diag_embed(rows["veil"]),
            b_mean=b,
            scale=b.new_full((len(b),), law.scale),
            exponent=b.new_full((len(b),), law.exponent),
            law=law.law,
            notes=(_OF_COEFFICIENTS,) * len(b),
        )

    @staticmethod
    def stack(media: "Iterable[Medium]") -> "Medium":
        """Join media, at least one, to one batch; their width laws must share shape and unit."""
        media = list(media)
        for medium in media:
            checks.instance("media", medium, Medium, "; see Medium.from_water")
        if len(laws := {medium.law for medium in media}) != 1:
            raise ValueError(f"media must share one law of point spreads, got {laws or 'no media'}")
        if any(medium.knows_lamps for medium in media):
            media = [medium.lamplit() for medium in media]
        tensors = {name: padded([getattr(m, name) for m in media]) for name in Medium.TENSORS}
        notes = sum((medium.notes for medium in media), ())
        snow: Any = sum((medium.snow or (None,) * len(medium) for medium in media), ())
        snow = snow if any(snow) else ()
        return Medium(**tensors, law=media[0].law, notes=notes, snow=snow)

    def with_snow(self, snow: MarineSnow | None) -> "Medium":
        """The same water with particles that a camera sees one by one; None takes them out."""
        if snow is not None:
            checks.instance("snow", snow, MarineSnow)
            snow.require_fixed("snow")
        medium = object.__new__(type(self))
        vars(medium).update(vars(self), snow=() if snow is None else (snow,) * len(self))
        return medium

    def with_contents(self, factor: float) -> "Medium":
        """The same media with `factor` times their loss and scattering in every metre; the light
        that comes down to them stays.
        """
        checks.within("factor", factor, 0.0)
        rates = ("beta", "G", "b_mean", "lamp_beta", "lamp_G", "lamp_veil_weights")
        scaled = {name: factor * getattr(self, name) for name in rates}
        notes = tuple(f"{note}; {factor:g} times as much in the water" for note in self.notes)
        return replace(self, **scaled, notes=notes)

    def __len__(self) -> int:
        return self.beta.shape[0] if "beta" in vars(self) else 1

    def __getitem__(self, i: int | slice) -> "Medium":
        """The i-th medium as a batch of one, or the media of a slice."""
        part = i if isinstance(i, slice) else slice(index(i), index(i) + 1 or None)
        if not range(len(self))[part]:
            raise IndexError(f"medium {i!r} of {len(self)}")
        rows = self.map(lambda t: t[part])
        return replace(rows, notes=self.notes[part], snow=self.snow[part])

    def expand(self, rows: int) -> "Medium":
        """One medium as a batch of `rows` equal ones; a batch stays as it is."""
        if rows == 1 or len(self) != 1:  # in a graph their number is unknown
            return self
        wide = self.map(lambda t: t.expand(rows, *t.shape[1:]))
        return replace(wide, notes=self.notes * rows, snow=self.snow * rows)

    def map(self, function: Callable[[Tensor], Tensor]) -> "Medium":
        """Apply a function to each tensor."""
        tensors: dict[str, Any] = {name: function(x) for name, x in self.named_tensors().items()}
        return replace(self, **tensors)

    def to(self, *args: Any, **kwargs: Any) -> "Medium":
        """Move or cast, as `torch.Tensor.to`."""
        for tensor in self.tensors():
            if tensor.to(*args, **kwargs) is not tensor:
                return self.map(lambda t: t.to(*args, **kwargs))
        return self

    def tensors(self) -> tuple[Tensor, ...]:
        """The tensors, in the order of `TENSORS`."""
        return tuple([getattr(self, name) for name in self.TENSORS])

    def named_tensors(self) -> dict[str, Tensor]:
        """The tensors by name."""
        return dict(zip(self.TENSORS, self.tensors(), strict=True))

    def weights(self) -> Weights:
        """The medium as arrays, which share its memory where they can."""
        if (arrays := vars(self).get("_arrays")) is not None:
            beta, direct, G, signal, veil, *width = [arrays[name][None] for name in _OF_WEIGHTS]
            return Weights(beta, nine_rows(direct), G, nine_rows(signal), veil, *width)
        tensors = (getattr(self, name).detach().cpu().double() for name in _OF_WEIGHTS)
        beta, direct, G, signal, veil, *width = (x.contiguous().numpy() for x in tensors)
        direct, signal = (nine_rows(x.reshape(len(x), -1, x.shape[-1])) for x in (direct, signal))
        return Weights(beta, direct, G, signal, veil, *width)

    @property
    def is_spectral(self) -> bool:
        """True if each channel of the picture depends on all three of the scene."""
        return self.direct_weights.ndim == 4

    @property
    def is_of_coefficients(self) -> bool:
        """True if each channel has one rate of each curve, as `from_coefficients` makes them."""
        weights = (self.direct_weights, self.signal_weights, self.veil_weights)
        square = all(w.ndim == 3 and w.shape[-1] == 3 for w in weights)
        return square and all(torch.equal(w, w * torch.eye(3).to(w)) for w in weights)

    def as_coefficients(self, metres: float = 3.0) -> "Medium":
        """The medium with one exponential per channel: right for white at the lens and at `metres`,
        with the same veil far away.
        """
        light = white(self.direct_weights).sum(-1)

        def rate(weights: Tensor, rates: Tensor) -> Tensor:
            arriving = white(weights) @ torch.exp(-rates * metres)[..., None]
            # with a colour matrix the light of a channel may be negative
            share = arriving[..., 0] / light.clamp(min=_MIN_LIGHT)
            return -torch.log(share.clamp(_MIN_SHARE, 1.0)) / metres

        beta = rate(self.direct_weights, self.beta)
        weights = torch.diag_embed(light.clamp(min=0.0))
        return replace(
            self.without_lamps(),
            beta=beta,
            direct_weights=weights,
            G=rate(self.signal_weights, self.G).minimum(beta),
            signal_weights=weights,
            veil_weights=torch.diag_embed(self.veil_weights.sum(-1).clamp(min=0.0)),
            notes=(_OF_COEFFICIENTS,) * len(self),
        )

    def ambient(self) -> Tensor:
        """Light of a white surface in front of the lens (B, 3): e^(−K_d d) of each channel."""
        return white(self.signal_weights).sum(-1)

    @property
    def requires_grad(self) -> bool:
        """True if a tensor records gradients."""
        return checks.records(*self.tensors())

    def sums(self, *, exact_at_lens: bool) -> Sums:
        """The three curves as sums of exponentials. With `exact_at_lens` a millimetre of water has
        a small veil, not 0; V(0) − V(z) loses digits there, and takes half the time.
        """
        direct, signal = self.direct_weights.flatten(1, -2), self.signal_weights.flatten(1, -2)
        veil = self.veil_weights
        rates = torch.cat([torch.zeros_like(self.beta[:, :1]), self.beta, self.G], 1)[..., None]
        no_direct, no_signal = torch.zeros_like(direct), torch.zeros_like(signal)
        nothing, no_veil = no_direct[..., :1], no_direct[:, :3]
        # if the exponentials of G stand for e^−x − 1, T_G(z) is T_G(0) + Σ s(e^−Gz − 1), and the
        # veil is −Σ v(e^−Gz − 1)
        signal_at_0 = signal.sum(-1, keepdim=True) if exact_at_lens else nothing
        veil_at_0 = no_veil[..., :1] if exact_at_lens else veil.sum(-1, keepdim=True)
        weights = [
            torch.cat([nothing, direct, no_signal], 2),
            torch.cat([signal_at_0, -direct, signal], 2),
            torch.cat([veil_at_0, no_veil, -veil], 2),
        ]
        split = 1 + self.beta.shape[1] if exact_at_lens else None
        return Sums(rates, torch.cat(weights, 1), self.beta.shape[1], split)

    def _any_at_lens(self, z: Tensor) -> bool:
        """True if V(0) − V(z) would cancel at a distance z (B or 1, …), m, or may on a device."""
        if not checks.on_host(z):
            return True
        slowest = self.G.masked_fill(self.G <= 0, math.inf).amin(1)
        nearest = z.flatten(1).amin(1) if z.ndim > 1 else z
        return bool((slowest * nearest <= _MIN_DEPTH).any())

    def under_lamp(self) -> "Medium":
        """The water in the white light of a lamp, which does not come down from the surface.

            T_β,c(z) = ∫ S_c·e^(−β z) dλ        light that arrives unscattered
            T_G,c(z) = ∫ S_c·e^(−G z) dλ        the same, and scattered forward
            b_c(x) = ∫ S_c·b·e^(−G x) dλ        scattered by a metre of water, seen after x metres

        The `veil_weights` of the result are those of b_c, 1/m. Where `lamp_…` has no rates, as in a
        medium that learns, the medium's stand for these curves, and b̄ for b.
        """
        if self.knows_lamps:
            lit: dict[str, Any] = {name: getattr(self, f"lamp_{name}") for name in OF_LAMPS}
            return replace(self.without_lamps(), **lit)
        light = self.ambient().clamp(min=_MIN_LIGHT)
        light = light.reshape(len(self), 3, *[1] * (self.signal_weights.ndim - 2))
        signal = self.signal_weights / light
        return replace(
            self,
            direct_weights=self.direct_weights / light,
            signal_weights=signal,
            veil_weights=white(signal) * self.b_mean[:, None, None],
        )

    @property
    def knows_lamps(self) -> bool:
        """True if the medium has rates of its own under lamps."""
        return self.lamp_G.shape[-1] > 0

    def without_lamps(self) -> "Medium":
        """The medium without rates of its own under lamps."""
        nothing: Any = {f"lamp_{name}": torch.zeros((), device="cpu") for name in OF_LAMPS}
        return replace(self, **nothing)

    def lamplit(self) -> "Medium":
        """The medium with rates of its own under lamps."""
        if self.knows_lamps:
            return self
        water = self.under_lamp()
        lit: dict[str, Any] = {f"lamp_{name}": getattr(water, name) for name in OF_LAMPS}
        return replace(self, **lit)

    def curves(self, z: Tensor) -> Curves:
        """T_β, T_G − T_β and V(0) − V at effective distances (Bx1xHxW), m, finite, ≥ 0."""
        return curves(self.sums(exact_at_lens=self._any_at_lens(z)), z)

    def image(self, z: Tensor, J: Tensor, soft: Tensor, T: Curves | None = None) -> Tensor:
        """D + F + B = Σ T_β·(J − soft) + T_G·soft + V(0) − V and the `further_terms`, of linear
        light J (Bx3xHxW) and its blur, at distances z (Bx1xHxW), m, finite, ≥ 0. T are curves there
        that stand for the medium's, as under lamps.
        """
        # `mix` loops over the rates, whose number a graph does not know
        if T is None and self.is_spectral and not torch.compiler.is_compiling():
            arriving = mix(self.sums(exact_at_lens=self._any_at_lens(z)), z, J, soft)
        else:
            arriving = (self.curves(z) if T is None else T).image(J, soft)
        for term in self.further_terms(z).values():
            arriving = arriving + term
        return arriving

    def parts(
        self, z: Tensor, J: Tensor, soft: Tensor, T: Curves | None = None
    ) -> dict[str, Tensor]:
        """The terms of the image (Bx3xHxW) by name, which add up to `image`."""
        direct, forward, backscatter = (self.curves(z) if T is None else T).parts(J, soft)
        terms = {"direct": direct, "forward": forward, "backscatter": backscatter}
        terms |= self.further_terms(z)
        wide = torch.broadcast_tensors(*terms.values())  # type: ignore[no-untyped-call]
        return dict(zip(terms, wide, strict=True))

    def further_terms(self, z: Tensor) -> dict[str, Tensor]:
        """Light (B or 1, 3, H, W) that the water adds before a point at distance z (Bx1xHxW), m, by
        names of `uwaug.formation.Terms`. A new term, such as plankton that glows, goes here.
        """
        return {}

    def transmission(self, z: Tensor) -> Tensor:
        """T_β(z): share of the light at the surface that arrives unscattered: (B, 3, H, W) of
        distances z (B or 1, 1, H, W), m; (B, 3, N) of (N,); (B, 3) of a number. Of surfaces with
        spectra, matrices (B, 3, 3, …) from channels of the scene to those of the picture.
        """
        return self._curves(z).direct

    def signal(self, z: Tensor) -> Tensor:
        """T_G(z): share of the light at the surface that arrives at all; as `transmission`."""
        arriving = self._curves(z)
        return arriving.direct + arriving.scatter

    def backscatter(self, z: Tensor) -> Tensor:
        """V(0) − V(z), the veil in front of a point at distance z; as `transmission`."""
        return self._curves(z, exact_at_lens=True).veil

    def _curves(self, z: Tensor, *, exact_at_lens: bool = False) -> Curves:
        with checks.full_precision(z):
            x = z.to(torch.promote_types(z.dtype, torch.float32)).clamp(max=FARTHEST)
            plane = x if z.ndim > 2 else x.reshape(1, 1, -1)
            batch = plane if plane.ndim == 4 else plane[None]
            maps = curves(self.to(x).sums(exact_at_lens=exact_at_lens), batch)
        if z.ndim > 2:
            return maps
        return Curves(*(curve.reshape(*curve.shape[:-2], *z.shape) for curve in maps))

    def brightened(self, gain: Tensor) -> "Medium":
        """The medium as seen by a camera that multiplies light by `gain`: numbers (B or 1), one for
        each channel (B or 1, 3), or matrices that mix channels (B or 1, 3, 3).
        """
        wide, gain = self.lamplit().expand(len(gain)), gain.to(self.beta)
        gained: dict[str, Any] = {}
        for name, axes in self.TENSORS.items():
            weights = getattr(wide, name)
            if "C" in axes and gain.ndim == 3:
                weights = as_matrices(weights) if {"S", "T"} & {*axes} else weights
                gained[name] = mixed(gain, weights)
            elif "C" in axes:
                gained[name] = gain.reshape(len(gain), -1, *[1] * (weights.ndim - 2)) * weights
        notes = tuple(f"{note}; brightened" for note in wide.notes)
        return replace(wide, **gained, notes=notes)

    def in_pixels(self, size: Size, view: View) -> "Medium":
        """The medium whose widths are px of an image of (height, width) `size`."""
        if self.law.unit == "px":
            return self
        scale = self.scale * self.law.pixels(size, view)
        return replace(self, scale=scale, law=IN_PIXELS[self.law.shape])

    def width(self, z: Tensor) -> Tensor:
        """σ(z) at distances (B or 1, 1, H, W), m, in units of the law."""
        numbers = (getattr(self, name).reshape(-1, 1, 1, 1).to(z) for name in _OF_WIDTHS)
        width: Tensor = widths(z.clamp(max=FARTHEST), *numbers)
        return width

    @property
    def width_law(self) -> str:
        """The law of the widths and its numbers, in words."""
        if not bool((self.scale != 0).any()):
            return "no blur"
        units = {"px": "px", "paper": "px at 518 px short side", "focal": "focal lengths"}
        width = f"{_short(self.scale)}·(b̄ z)^{_short(self.exponent)}"
        return f"{self.law.shape} σ = {width} {units[self.law.unit]}"

    def __repr__(self) -> str:
        more = f", and {len(self) - 1} more" if len(self) > 1 else ""
        note = self.notes[0] if self.notes else "of numbers"
        return f"Medium({note}{more}; {self.width_law}, b̄ = {_short(self.b_mean)}/m)"


# tensors that a medium has twice, for daylight and for lamps
OF_LAMPS = tuple(name[5:] for name in Medium.TENSORS if name.startswith("lamp_"))
_OF_WIDTHS = ("b_mean", "scale", "exponent")
_OF_WEIGHTS = (*OF_LAMPS, *_OF_WIDTHS)


def _short(numbers: Tensor) -> str:
    words = [f"{x:.3g}" for x in dict.fromkeys(numbers.detach().tolist())]
    return ", ".join(words[:3] + ["…"] * (len(words) > 3))


def padded(parts: Sequence[Tensor]) -> Tensor:
    """Join a tensor of several media to one, (B) or (B, …, K); missing rates and weights are 0."""
    if parts[0].ndim == 1:
        return torch.cat(list(parts))
    if any(part.ndim == 4 for part in parts):
        parts = [as_matrices(part) for part in parts]
    width = max(part.shape[-1] for part in parts)
    return torch.cat([pad(part, (0, width - part.shape[-1])) for part in parts])


def _rows(coefficients: Mapping[str, Any]) -> dict[str, Tensor]:
    """Check coefficients by name, and make them tensors of one type: b_mean (B), others (B, 3)."""
    tensors = (v for v in coefficients.values() if isinstance(v, Tensor) and v.is_floating_point())
    dtype = next((tensor.dtype for tensor in tensors), torch.float64)
    rows: dict[str, Tensor] = {}
    for name, value in coefficients.items():
        if not isinstance(value, Tensor):
            value = torch.as_tensor(value, dtype=dtype, device="cpu")
        row = value.to(dtype)
        shape = () if name == "b_mean" else (3,)
        is_batch = row.ndim == len(shape) + 1
        if row.shape[is_batch:] != shape:
            expected = "a number or (B,)" if name == "b_mean" else "(3,) or (B, 3)"
            raise ValueError(f"{name} must have shape {expected}, got {tuple(row.shape)}")
        if not bool(((row >= 0) & row.isfinite()).all()):
            raise ValueError(f"{name} must be finite and ≥ 0, got {row.tolist()}")
        rows[name] = row if is_batch else row[None]
    batches = {name: len(row) for name, row in rows.items()}
    checks.batches(batches)
    b = max(batches.values())
    return {name: row.expand(b, *row.shape[1:]) for name, row in rows.items()}
