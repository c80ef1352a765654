"""The medium: everything that the image needs to know about water, camera and depth, as curves of distance.

| symbol | meaning | unit |
|---|---|---|
| a, b, K_d | absorption, scattering, diffuse attenuation of the water, at each wavelength | 1/m |
| β = a + b | beam attenuation | 1/m |
| g | share of the scattered light that leaves the line of sight | 1 |
| G = a + g·b | attenuation of what still carries the picture | 1/m |
| d, E = e^(−K_d d) | depth of the scene below the surface, light that is left there | m, 1 |
| μ, V(0) = μ·b·E/G | share of the scattered light sent towards the camera, veil of endless water | 1 |
| S_c | response of the camera's channel c, ∫S_c = 1 | 1/nm |
| z | distance along the ray; a medium field m multiplies it before it comes here | m |

    T_β,c(z) = ∫ S_c·E·e^(−β z) dλ  ≈ Σ_k w_ck e^(−β_k z)    what arrives unscattered
    T_G,c(z) = ∫ S_c·E·e^(−G z) dλ  ≈ Σ_l s_cl e^(−G_l z)    what arrives at all (direct + forward)
    V_c(z) = ∫ S_c·V(0)·e^(−G z) dλ ≈ Σ_l v_cl e^(−G_l z)    so that the veil is V(0) − V(z)
    σ(z) = scale·(b̄ z)^exponent                              width of the forward scatter, px

Each integral becomes a sum of a few exponentials with positive weights: exact at z = 0, monotone, and never divided by
z. The rates belong to the water and serve all three channels, and signal and veil alike; only the weights belong to
the camera. (One Gauss quadrature per curve and channel needs 15 to 24 exponentials for a tolerance of .002; shared
rates need 5 to 12.)
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from uwaug import checks
from uwaug.camera import Camera, load_camera
from uwaug.checks import DOMAIN
from uwaug.water import Water

Array = NDArray[np.float64]
Shape = Literal["gaussian", "exponential"]

WAVELENGTHS = np.arange(400.0, 701.0, 5.0)
"""nm, the 61 bands that stand for the integral."""

FARTHEST = 1e9
"""m, stands for z = +inf, so that 0·inf never arises; any rate above 1e-7/m is spent by then."""

PAPER_SIZE = 518
"""px, short side of the paper's pictures."""

_LOSSLESS = 1e-6  # 1/m: stands for G = 0, where the veil has the limit μ·b·E·z
_MOST_RATES = 12
_LOG2E = math.log2(math.e)
_TENSORS = ("beta", "direct_weights", "G", "signal_weights", "veil_weights", "b_mean")


def pixel_scale(reference_size: float | None, size: tuple[int, int] | None) -> float | Tensor:
    """Px of an image of (height, width) `size` per px of one whose short side is `reference_size`."""
    if reference_size is None or size is None:
        return 1.0
    if isinstance(size[0], torch.SymInt):  # type: ignore[unreachable]
        # in a graph for any size; a quotient of symbolic numbers would enter it in single precision
        height, width = (torch.full((), side, dtype=torch.float64) for side in size)  # type: ignore[unreachable]
        return torch.minimum(height, width) / reference_size
    return min(size) / reference_size


@dataclass(frozen=True)
class PointSpread:
    """Width law of the forward scatter, σ(z) = scale·(b̄ z)^exponent, in px.

    Attributes:
        scale: width at one scattering length, px ≥ 0; a float, or a tensor (B,) that can be learned.
        exponent: > 0; a float, or a tensor (B,).
        shape: "gaussian", or "exponential" for the classical transfer function e^(−2πσf), see
            `uwaug.plan_blur`.
        reference_size: None if px are px of the image at hand; else the short side, px, of the image that `scale`
            refers to, so that the picture does not depend on its resolution.
    """

    scale: float | Tensor
    exponent: float | Tensor = 1.0
    shape: Shape = "gaussian"
    reference_size: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("scale", self.scale), ("exponent", self.exponent)):
            if not isinstance(value, Tensor):
                checks.within(f"PointSpread.{name}", value, *DOMAIN[name])
        checks.one_of("PointSpread.shape", self.shape, get_args(Shape))
        if self.reference_size is not None:
            checks.positive("PointSpread.reference_size", self.reference_size, "px")

    @staticmethod
    def paper(coefficient: float = 0.3) -> "PointSpread":
        """The paper's law φ = coefficient·b̄ (table 2: .3, figure 7: .8), in px of its pictures, 518 px high."""
        return PointSpread(coefficient, 1.0, reference_size=PAPER_SIZE)

    @staticmethod
    def calibrated(focal_px: float) -> "PointSpread":
        """Fitted to Monte Carlo light transport with Petzold's measured phase functions and Henyey–Greenstein's of mean
        cosine .924 (`benchmarks/physics.py`). Use with g = .05, and with μ = .075, the paper's μ/g.

        Mean RMSE of direct + forward light over b̄z = .1…5: .0066 with Petzold's, .0075 with HG .924, .0100 with HG .90,
        .0181 with HG .85. One Gaussian of .080·focal_px, exponent .51, g = .066 has .0115, .0108, .0088, .0123; the
        paper's law .037, .053, .050, .046. The tails need more blurs: about 1.5 times the time of that Gaussian.

        Args:
            focal_px: focal length, px of the image at hand; .866·width for a 60° field of view.
        """
        checks.positive("focal_px", focal_px, "px")
        return PointSpread(0.030 * focal_px, 0.62, "exponential")

    @staticmethod
    def none() -> "PointSpread":
        """No blur: forward scatter adds light but moves none."""
        return PointSpread(0.0)

    @staticmethod
    def stack(laws: "Sequence[PointSpread]", rows: Sequence[int], dtype: torch.dtype) -> "PointSpread":
        """One law for several media of `rows` rows each; tensors only where the laws differ."""
        kinds = {(law.shape, law.reference_size) for law in laws}
        if len(kinds) > 1:
            got = sorted({str(law) for law in laws})
            raise ValueError(f"media must share the shape and reference_size of their point spreads, got {got}")

        def join(name: str) -> float | Tensor:
            values = [getattr(law, name) for law in laws]
            if all(not isinstance(value, Tensor) and value == values[0] for value in values):
                return values[0]  # type: ignore[no-any-return]
            parts = [torch.as_tensor(v, dtype=dtype).expand(n) for v, n in zip(values, rows, strict=True)]
            return torch.cat(parts)

        return replace(laws[0], scale=join("scale"), exponent=join("exponent"))

    def rows(self, count: int, like: Tensor) -> dict[str, Tensor]:
        """Scale and exponent as tensors of `count` rows."""
        law = {"scale": self.scale, "exponent": self.exponent}
        return {name: torch.as_tensor(value).to(like).expand(count) for name, value in law.items()}

    def map(self, function: Callable[[Tensor], Tensor]) -> "PointSpread":
        """The same law with `function` applied to what it holds as tensors."""
        law = {"scale": self.scale, "exponent": self.exponent}
        scale, exponent = (function(value) if isinstance(value, Tensor) else value for value in law.values())
        return replace(self, scale=scale, exponent=exponent)

    def sigma(self, lengths: Tensor, size: tuple[int, int] | None) -> Tensor:
        """σ, px.

        Args:
            lengths (BxC'xHxW tensor): scattering lengths b̄·z, ≥ 0.
            size: (height, width) of the image, px; None for px of `reference_size`.
        """
        scale, exponent = (
            value.reshape(-1, 1, 1, 1).to(lengths) if isinstance(value, Tensor) else value
            for value in (self.scale, self.exponent)
        )
        # x^exponent below 1 has an infinite slope at 0; at 1e4 scattering lengths all light is gone
        x = lengths.clamp(1e-6, 1e4)
        # ONNX Runtime would compute x^1
        power = x if isinstance(exponent, float) and exponent == 1 else x**exponent
        return scale * pixel_scale(self.reference_size, size) * power

    def __str__(self) -> str:
        if not isinstance(self.scale, Tensor) and self.scale == 0:
            return "no blur"
        scale, exponent = (
            "learned" if isinstance(value, Tensor) else f"{value:.3g}" for value in (self.scale, self.exponent)
        )
        unit = "px" if self.reference_size is None else f"px at {self.reference_size:g} px short side"
        return f"{self.shape} σ = {scale}·(b̄ z)^{exponent} {unit}"


class Curves(NamedTuple):
    """T_β, T_G − T_β and V(0) − V at given distances, one value for each channel."""

    direct: Tensor
    scatter: Tensor
    veil: Tensor


class Sums(NamedTuple):
    """A medium's curves as one matrix product of exponentials, see `curves`; made by `Medium.sums`.

    Attributes:
        rates (BxRx1): 0, whose exponential carries the constants; those of the direct term; those of signal and veil.
        weights (Bx9xR): the three curves, of three channels each.
        shifted: the first of the rates whose exponentials stand for e^−x − 1; None if all stand for e^−x.
    """

    rates: Tensor
    weights: Tensor
    shifted: int | None


class Inherent(NamedTuple):
    """What follows from a water's coefficients at each band; see `inherent`."""

    beta: Array
    G: Array
    light: Array
    veil: Array


def inherent(a: Array, b: Array, kd: Array, *, vertical_depth: float, g: float | Array, mu: float) -> Inherent:
    """β = a + b, G = a + g·b, E = e^(−K_d d) and V(0) = μ·b·E/G, band by band; G is kept above 1e-6/m."""
    G = np.maximum(a + g * b, _LOSSLESS)
    light = np.exp(-kd * vertical_depth)
    return Inherent(a + b, G, light, mu * b * light / G)


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
    """

    beta: Tensor
    direct_weights: Tensor
    G: Tensor
    signal_weights: Tensor
    veil_weights: Tensor
    b_mean: Tensor
    point_spread: PointSpread
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        b, k, n = self.beta.shape[0], self.beta.shape[-1], self.G.shape[-1]
        shapes = ((b, k), (b, 3, k), (b, n), (b, 3, n), (b, 3, n), (b,))
        for name, shape in zip(_TENSORS, shapes, strict=True):
            if tuple(getattr(self, name).shape) != shape:
                raise ValueError(f"Medium.{name} must have shape {shape}, got {tuple(getattr(self, name).shape)}")

    @staticmethod
    def from_water(
        water: Water,
        camera: str | Camera = "Nikon 5100 (NPL)",
        *,
        vertical_depth: float = 1.0,
        g: float = 0.2,
        mu: float = 0.3,
        point_spread: PointSpread | None = None,
        tolerance: float = 0.002,
        distance_range: tuple[float, float] = (0.0, 20.0),
        wavelengths: Array | None = None,
    ) -> "Medium":
        """Reduce spectra to as few exponentials as the tolerance allows.

        The rates are the nodes of the Gauss quadrature (Golub & Welsch 1969) of the three channels' measures taken
        together; the weights fit each curve by non-negative least squares over the distance range, with the value at
        z = 0 exact.

        Args:
            water: spectra a, b, K_d.
            camera: name of a colour-science response, path of a CSV file, or a `Camera`.
            vertical_depth: d, depth of the scene below the surface, m, ≥ 0.
            g: share of the scattered light that leaves the line of sight, 0…1. Not the asymmetry of a phase function:
                .2 (the paper) for a subject that fills part of the view, .05 for one that fills it.
            mu: share of the scattered light that is sent towards the camera, 0…1, where 1 in the image means a white
                vertical plate.
            point_spread: width law, by default `PointSpread.paper()`.
            tolerance: largest error of each curve over `distance_range`; 0 keeps every band.
            distance_range: (nearest, farthest) effective distance m·z, m. Beyond it the curves stay monotone and
                bounded.
            wavelengths: bands, nm, by default 400…700 in steps of 5 as far as the water reaches.

        Raises:
            ValueError: if an argument is outside its domain.
        """
        if not isinstance(water, Water):
            raise TypeError(f"water must be a uwaug.Water, as Water.jerlov('7C') gives; got {water!r}")
        for name, value in (("vertical_depth", vertical_depth), ("g", g), ("mu", mu)):
            checks.within(name, value, *DOMAIN[name])
        near, far = distance_range
        if not 0 <= near < far < math.inf:
            raise ValueError(f"distance_range must be 0 ≤ near < far < inf in metres, got {distance_range}")
        if tolerance != 0:
            checks.tolerance(tolerance)
        if wavelengths is None:
            wavelengths = default_bands(water)
        bands = water.at(wavelengths)
        response = load_camera(camera).weights(wavelengths).T  # (3, bands), rows sum to 1
        beta, G, light, veil = inherent(bands.a, bands.b, bands.kd, vertical_depth=vertical_depth, g=g, mu=mu)
        # linear steps for slow rates, logarithmic ones for the fast
        z = np.concatenate([[0.0], np.geomspace(max(near, 1e-4 * far), far, 65), np.linspace(near, far, 33)[1:-1]])
        rates, (direct,), error = reduce_rates(beta, (response * light,), z, tolerance)
        scatter, (signal, backscatter), error_scatter = reduce_rates(
            G, (response * light, response * veil), z, tolerance
        )
        note = (
            f"{water.name}: {len(rates)} + {len(scatter)} rates, "
            f"curves within {max(error, error_scatter):.1g} over {near:g}…{far:g} m, "
            f"{vertical_depth:g} m deep, g = {g:g}, μ = {mu:g}"
        )
        arrays = (rates, direct, scatter, signal, backscatter, (response @ bands.b).mean())
        tensors = {name: torch.from_numpy(np.asarray(x))[None] for name, x in zip(_TENSORS, arrays, strict=True)}
        law = PointSpread.paper() if point_spread is None else point_spread
        return Medium(**tensors, point_spread=law, notes=(note,))

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
            G (3 or Bx3): effective attenuation of signal and veil, 1/m, ≥ 0. With G = beta there is no forward scatter.
            veil (3 or Bx3): veil at infinite distance, B∞ = V(0).
            b_mean (number or B): scattering coefficient of the width law, 1/m.
            point_spread: width law, by default no blur.
            light (3 or Bx3): ambient light at the scene, e^(−K_d d).

        Tensors keep their gradients; all are float64 inside unless given as tensors of another type.
        """
        given = {"beta": beta, "G": G, "veil": veil, "light": light}
        floats = [v.dtype for v in given.values() if isinstance(v, Tensor) and v.is_floating_point()]
        dtype = floats[0] if floats else torch.float64
        rows = {name: _rows(name, value, (3,), dtype) for name, value in given.items()}
        rows["b_mean"] = _rows("b_mean", b_mean, (), dtype)
        batches = {name: len(row) for name, row in rows.items()}
        b = max(batches.values())
        if not set(batches.values()) <= {1, b}:
            raise ValueError(f"batches must agree or be 1, got {batches}")
        rates, scatter, sky, ambient, mean = (row.expand(b, *row.shape[1:]) for row in rows.values())
        law = PointSpread.none() if point_spread is None else point_spread
        note = "coefficients: 3 + 3 rates, one per channel"
        diagonal = torch.diag_embed(ambient)
        return Medium(rates, diagonal, scatter, diagonal, torch.diag_embed(sky), mean, law, (note,) * b)

    @staticmethod
    def stack(media: "Sequence[Medium]") -> "Medium":
        """One batch of several media; their width laws must share shape and reference size."""
        if not media:
            raise ValueError("media is empty: stack needs at least one Medium")
        law = PointSpread.stack([m.point_spread for m in media], [len(m) for m in media], media[0].beta.dtype)

        def join(name: str) -> Tensor:
            parts = [getattr(m, name) for m in media]
            if parts[0].ndim == 1:
                return torch.cat(parts)
            width = max(part.shape[-1] for part in parts)
            return torch.cat([F.pad(part, (0, width - part.shape[-1])) for part in parts])

        notes = tuple(note for m in media for note in m.notes)
        return Medium(**{name: join(name) for name in _TENSORS}, point_spread=law, notes=notes)

    def __len__(self) -> int:
        return len(self.beta)

    def __getitem__(self, i: int) -> "Medium":
        """The i-th medium, as a batch of one."""
        if not -len(self) <= i < len(self):
            raise IndexError(f"medium {i} of {len(self)}")
        part = slice(i, i + 1 or None)
        return replace(self.map(lambda t: t[part] if t.ndim else t), notes=self.notes[part])

    def map(self, function: Callable[[Tensor], Tensor]) -> "Medium":
        """The same medium with `function` applied to each of its tensors, the width law's included."""
        tensors = {name: function(getattr(self, name)) for name in _TENSORS}
        return Medium(**tensors, point_spread=self.point_spread.map(function), notes=self.notes)

    def to(self, *args: Any, **kwargs: Any) -> "Medium":
        """Move or cast, as `torch.Tensor.to`."""
        if all(t.to(*args, **kwargs) is t for t in self.tensors()):
            return self
        return self.map(lambda t: t.to(*args, **kwargs))

    def tensors(self) -> tuple[Tensor, ...]:
        """Rates, weights and b̄, in the order of the attributes."""
        return tuple(getattr(self, name) for name in _TENSORS)

    @property
    def requires_grad(self) -> bool:
        """Whether any tensor, the width law's included, records gradients."""
        return any(t.requires_grad for t in self.parameters().values())

    def parameters(self) -> dict[str, Tensor]:
        """All that is continuous in a medium, by name, each with a row for every medium.

        Shapes: beta (B, K), direct_weights (B, 3, K), G (B, L), signal_weights and veil_weights (B, 3, L), b_mean,
        scale and exponent (B,).
        """
        tensors = dict(zip(_TENSORS, self.tensors(), strict=True))
        return tensors | self.point_spread.rows(len(self), self.beta)

    @staticmethod
    def of(parameters: Mapping[str, Tensor], like: "Medium") -> "Medium":
        """The inverse of `parameters`; shape and reference size of the width law, and notes, are those of `like`."""
        tensors = dict(parameters)
        law = replace(like.point_spread, scale=tensors.pop("scale"), exponent=tensors.pop("exponent"))
        return Medium(**tensors, point_spread=law, notes=like.notes)

    def sums(self, *, near: bool) -> Sums:
        """What `curves` takes.

        near: keep the veil's relative precision at the lens: a veil of a millimetre of water is small, not zero.
        Otherwise V(0) − V(z) is subtracted, which is right to 2e-5 of itself from an optical depth of 1/256 on, and
        takes half the time.
        """
        direct, signal, veil = self.direct_weights, self.signal_weights, self.veil_weights
        rates = torch.cat([torch.zeros_like(self.beta[:, :1]), self.beta, self.G], 1)[..., None]
        no_direct, no_signal = torch.zeros_like(direct), torch.zeros_like(signal)
        nothing = torch.zeros_like(direct[..., :1])
        # where the exponentials of G are e^−x − 1, T_G(z) is T_G(0) + Σ s(e^−Gz − 1), and V(0) − V(z) is −Σ v(e^−Gz − 1)
        signal_at_0 = signal.sum(-1, keepdim=True) if near else nothing
        veil_at_0 = nothing if near else veil.sum(-1, keepdim=True)
        weights = [
            torch.cat([nothing, direct, no_signal], 2),
            torch.cat([signal_at_0, -direct, signal], 2),
            torch.cat([veil_at_0, no_direct, -veil], 2),
        ]
        return Sums(rates, torch.cat(weights, 1), 1 + self.beta.shape[1] if near else None)

    def _at(self, z: Tensor, *, near: bool = False) -> Curves:
        """The curves at distances in any of the shapes that `transmission` takes."""
        with torch.autocast(z.device.type, enabled=False):
            x = z.to(torch.promote_types(z.dtype, torch.float32)).clamp(max=FARTHEST)
            flat = x if z.ndim > 2 else x.reshape(1, 1, 1, -1)
            found = curves(self.to(x).sums(near=near), flat if flat.ndim == 4 else flat[None])
        if z.ndim > 2:
            return found
        return Curves(*(c.reshape(len(c), 3, *z.shape) for c in found))

    def transmission(self, z: Tensor) -> Tensor:
        """T_β(z): share of the light at the surface that arrives unscattered.

        Args:
            z: distance, m; (B or 1, 1, H, W), (1, H, W), or any number of values (N,) or ().

        Returns:
            (B, 3, H, W), or (B, 3, N), or (B, 3).
        """
        return self._at(z).direct

    def signal(self, z: Tensor) -> Tensor:
        """T_G(z): share of the light at the surface that arrives at all; shapes as `transmission`."""
        found = self._at(z)
        return found.direct + found.scatter

    def backscatter(self, z: Tensor) -> Tensor:
        """V(0) − V(z), the veil in front of a point at distance z; shapes as `transmission`."""
        return self._at(z, near=True).veil

    def lengths(self, z: Tensor) -> Tensor:
        """Scattering lengths b̄·z of finite distances (B or 1, 1, H, W)."""
        return self.b_mean.reshape(-1, 1, 1, 1).to(z) * z

    def width(self, z: Tensor, size: tuple[int, int] | None) -> Tensor:
        """σ(z), px, for distances (B or 1, 1, H, W) in an image of (height, width) `size`; None: in the law's px."""
        return self.point_spread.sigma(self.lengths(z.clamp(max=FARTHEST)), size)

    def __repr__(self) -> str:
        notes = self.notes or ("",)
        more = f", and {len(self) - 1} more" if len(self) > 1 else ""
        b_mean = ", ".join(f"{float(b):.3g}" for b in self.b_mean.detach()[:3])
        cut = ", …" if len(self) > 3 else ""
        return f"Medium({notes[0]}{more}; {self.point_spread}, b̄ = {b_mean}{cut}/m)"


def curves(sums: Sums, z: Tensor) -> Curves:
    """T_β, T_G − T_β and V(0) − V at every pixel: the one place where exponentials are summed.

    Args:
        sums: from `Medium.sums`.
        z (Bx1xHxW tensor): effective distance, m, finite, ≥ 0.

    Returns:
        Each (B, 3, H, W), B the larger of the two batches.
    """
    flat, split = z.flatten(1)[:, None], sums.shifted
    if split is None:
        decay = _decay(sums.rates, flat)
    else:
        shifted = torch.mul(-sums.rates[:, split:], flat).expm1_()
        decay = torch.cat([_decay(sums.rates[:, :split], flat), shifted], 1)
    b = decay.shape[0]  # len() of it would be fixed in a graph
    shape = (b, 3, *z.shape[-2:])
    if torch.compiler.is_compiling():  # ONNX Runtime would copy the parts of one product
        return Curves(*((sums.weights[:, i : i + 3] @ decay).reshape(shape) for i in (0, 3, 6)))
    # three products take half as long again
    values = sums.weights.expand(b, -1, -1) @ decay
    return Curves(*(part.reshape(shape) for part in torch.split(values, 3, 1)))


def _decay(rates: Tensor, z: Tensor) -> Tensor:
    if torch.compiler.is_compiling():
        return torch.exp(-rates * z)  # ONNX has no exp2
    return (rates * -_LOG2E * z).exp2_()  # four times as fast as exp


def default_bands(water: Water) -> Array:
    """Those of `WAVELENGTHS` that the water covers."""
    low, high = water.wavelengths[[0, -1]]
    bands: Array = WAVELENGTHS[(low <= WAVELENGTHS) & (high >= WAVELENGTHS)]
    if len(bands) == 0:
        raise ValueError(f"water covers {low:g}–{high:g} nm: no band of 400–700 nm; give wavelengths in its range")
    return bands


def _rows(name: str, value: Any, shape: tuple[int, ...], dtype: torch.dtype) -> Tensor:
    """A coefficient of `shape`, or a batch of them, as (B, *shape); finite and ≥ 0."""
    row = torch.as_tensor(value, dtype=None if isinstance(value, Tensor) else dtype).to(dtype)
    if row.ndim not in (len(shape), len(shape) + 1) or row.shape[row.ndim - len(shape) :] != shape:
        wanted = "a number or (B,)" if shape == () else "(3,) or (B, 3)"
        raise ValueError(f"{name} must have shape {wanted}, got {tuple(row.shape)}")
    known = row.detach()
    if not bool(((known >= 0) & known.isfinite()).all()):
        raise ValueError(f"{name} must be finite and ≥ 0, got {known.tolist()}")
    return row if row.ndim > len(shape) else row[None]


def reduce_rates(
    rates: Array, measures: tuple[Array, ...], z: Array, tolerance: float
) -> tuple[Array, list[Array], float]:
    """Replace sums over all bands by sums over as few shared rates as `tolerance` allows.

    Args:
        rates (M): rate of each band.
        measures: each (3, M), the weights of three curves Σ_m measure_cm e^(−rate_m z).
        z (N): distances at which the error counts; z[0] = 0.
        tolerance: largest error of any curve.

    Returns:
        The rates (K), ascending; the weights, (3, K) for each measure; the largest error.
    """
    wanted = np.concatenate(measures)  # (C, M)
    if tolerance == 0:
        return rates, list(measures), 0.0
    if wanted.max() < 1e-300:  # no light so deep
        return rates[:1], [m[:, :1] for m in measures], 0.0
    exact = wanted @ np.exp(-rates[:, None] * z)  # (C, N)
    jacobi = _jacobi(rates, (wanted / np.maximum(wanted.sum(1, keepdims=True), 1e-300)).sum(0))
    for k in range(1, len(jacobi) + 1):
        nodes = np.maximum(np.linalg.eigvalsh(jacobi[:k, :k]), 0.0).astype(np.float64)
        basis = np.exp(-nodes[:, None] * z)
        weights = _fit_weights(basis, exact)
        if np.abs(weights @ basis - exact).max() > tolerance:
            continue  # and non-negative weights fit no better
        for row in np.flatnonzero(weights.min(1) < 0):
            weights[row] = _fit_positive(basis, exact[row])
        error = float(np.abs(weights @ basis - exact).max())
        if error <= tolerance:
            return nodes, list(np.split(weights, len(measures))), error
    return rates, list(measures), 0.0  # every band is a rate: slow, and exact


def _jacobi(points: Array, weights: Array) -> Array:
    """Jacobi matrix of a discrete measure: its leading k×k block has the nodes of the k-point Gauss rule as
    eigenvalues.

    From the QR factors of weighted Chebyshev polynomials; Lanczos' recurrence gives the same and takes six times as
    long.
    """
    low, high = points.min(), points.max()
    scaled = np.clip(2 * (points - low) / max(high - low, 1e-300) - 1, -1, 1)
    basis = np.polynomial.chebyshev.chebvander(scaled, min(_MOST_RATES, len(points)) - 1)
    q, r = np.linalg.qr(np.sqrt(weights)[:, None] * basis)
    diagonal = np.abs(np.diag(r))
    rank = int((diagonal > 1e-9 * diagonal[0]).cumprod().sum())
    q = q[:, :rank]
    jacobi: Array = q.T @ (points[:, None] * q)
    return jacobi


def _fit_weights(basis: Array, exact: Array) -> Array:
    """Least-squares weights (C, K), weights @ basis ≈ exact; equal in the first column (z = 0), where the basis is 1.

    The sum of the weights is kept by eliminating the last of them.
    """
    free = np.linalg.lstsq((basis[:-1] - basis[-1]).T, (exact - exact[:, :1] * basis[-1]).T, rcond=None)[0].T
    weights: Array = np.concatenate([free, exact[:, :1] - free.sum(1, keepdims=True)], 1)
    return weights


def _fit_positive(basis: Array, curve: Array) -> Array:
    """The same for one curve, with weights ≥ 0: the most negative is struck out and the rest refitted."""
    weights = np.zeros(len(basis))
    active = list(range(len(basis)))
    while True:
        values = _fit_weights(basis[active], curve[None])[0]
        if values.min() >= 0:
            break
        del active[int(values.argmin())]
    weights[active] = values
    return weights
