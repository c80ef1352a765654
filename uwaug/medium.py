"""The medium: everything that the image needs to know about water, camera and depth, as curves of distance.

    T_β,c(z) = Σ_k w_ck e^(−β_k z)    what arrives unscattered
    T_G,c(z) = Σ_l s_cl e^(−G_l z)    what arrives at all (direct + forward)
    V_c(z)   = Σ_l v_cl e^(−G_l z)    so that the veil is V(0) − V(z)

Each is a spectral integral replaced by a few exponentials with positive weights: exact at z = 0, monotone, never
divided by z. The rates belong to the water and serve all three channels, and signal and veil alike; only the weights
belong to the camera. (One Gauss quadrature per curve and channel needs 15 to 24 exponentials for a tolerance of .002;
shared rates need 5 to 12.)
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from uwaug.blur import Shape
from uwaug.camera import Camera, load_camera
from uwaug.water import Array, Water

WAVELENGTHS = np.arange(400.0, 701.0, 5.0)  # nm, the 61 bands that stand for the integral
_LOSSLESS = 1e-6  # 1/m: what stands for G = 0, where the veil has the limit μ·b·E·z
_MOST_RATES = 12
PAPER_SIZE = 518  # px, short side of the paper's pictures


def pixel_scale(reference_size: float | None, size: tuple[int, int]) -> float:
    """Px of an image of (height, width) `size` per px of one whose short side is `reference_size`."""
    return 1.0 if reference_size is None else min(size) / reference_size


@dataclass(frozen=True)
class PointSpread:
    """Width law of the forward scatter, σ(z) = scale·(b̄ z)^exponent, in px.

    Attributes:
        scale: width at one scattering length, px ≥ 0; a float, or a tensor (B,) that can be learned.
        exponent: > 0; a float, or a tensor (B,).
        shape: "gaussian", or "exponential" for the classical transfer function e^(−2πσf), see
            `uwaug.blur.plan_blur`.
        reference_size: None if px are px of the image at hand; else the short side, px, of the image that `scale`
            refers to, so that the picture does not depend on its resolution.
    """

    scale: float | Tensor
    exponent: float | Tensor = 1.0
    shape: Shape = "gaussian"
    reference_size: float | None = None

    def __post_init__(self) -> None:
        for name, value, least in (("scale", self.scale, 0.0), ("exponent", self.exponent, 1e-3)):
            if isinstance(value, (int, float)) and not least <= value < math.inf:
                raise ValueError(f"PointSpread.{name} must be a finite number ≥ {least:g}, got {value}")
        if self.shape not in ("gaussian", "exponential"):
            raise ValueError(f"PointSpread.shape must be 'gaussian' or 'exponential', got {self.shape!r}")
        if self.reference_size is not None and not 0 < self.reference_size < math.inf:
            raise ValueError(f"PointSpread.reference_size must be finite and > 0 px or None, got {self.reference_size}")

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
        if not 0 < focal_px < math.inf:
            raise ValueError(f"focal_px must be a positive focal length in pixels, got {focal_px}")
        return PointSpread(0.030 * focal_px, 0.62, "exponential")

    @staticmethod
    def none() -> "PointSpread":
        """No blur: forward scatter adds light but moves none."""
        return PointSpread(0.0)

    def variance(self, lengths: Tensor, size: tuple[int, int]) -> Tensor:
        """σ², px².

        Args:
            lengths (BxC'xHxW tensor): scattering lengths b̄·z, finite, ≥ 0.
            size: (height, width) of the image, px.
        """
        scale, exponent = (
            v.reshape(-1, 1, 1, 1).to(lengths) if isinstance(v, Tensor) else v for v in (self.scale, self.exponent)
        )
        # x^(2·exponent) with 2·exponent < 1 has an infinite slope at 0; at 1e4 scattering lengths all light is gone
        return (scale * pixel_scale(self.reference_size, size)) ** 2 * lengths.clamp(1e-6, 1e4) ** (2 * exponent)

    def map(self, function: Callable[[Tensor], Tensor]) -> "PointSpread":
        """The same law with `function` applied to what it holds as tensors."""
        if not isinstance(self.scale, Tensor) and not isinstance(self.exponent, Tensor):
            return self
        scale, exponent = (function(v) if isinstance(v, Tensor) else v for v in (self.scale, self.exponent))
        return replace(self, scale=scale, exponent=exponent)

    def __str__(self) -> str:
        if isinstance(self.scale, (int, float)) and self.scale == 0:
            return "no blur"
        scale, exponent = (
            f"{v:.3g}" if isinstance(v, (int, float)) else "learned" for v in (self.scale, self.exponent)
        )
        unit = "px" if self.reference_size is None else f"px at {self.reference_size:g} px short side"
        return f"{self.shape} σ = {scale}·(b̄ z)^{exponent} {unit}"


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
        b, k, n = len(self.beta), self.beta.shape[-1], self.G.shape[-1]
        wanted = {
            "beta": (b, k),
            "direct_weights": (b, 3, k),
            "G": (b, n),
            "signal_weights": (b, 3, n),
            "veil_weights": (b, 3, n),
            "b_mean": (b,),
        }
        for name, shape in wanted.items():
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
        together; the weights fit each curve by non-negative least squares over the distance range, with the value at z
        = 0 exact.

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
        for name, value, high in (("vertical_depth", vertical_depth, math.inf), ("g", g, 1.0), ("mu", mu, 1.0)):
            if not 0 <= value <= high or math.isinf(value):
                raise ValueError(f"{name} must lie in [0, {high:g}], got {value}")
        near, far = distance_range
        if not 0 <= near < far < math.inf:
            raise ValueError(f"distance_range must be 0 ≤ near < far < inf in metres, got {distance_range}")
        if not 0 <= tolerance < 1:
            raise ValueError(f"tolerance must lie in [0, 1) (image scale 0…1), got {tolerance}")
        if wavelengths is None:
            low, high = water.wavelengths[[0, -1]]
            wavelengths = WAVELENGTHS[(low <= WAVELENGTHS) & (high >= WAVELENGTHS)]
            if len(wavelengths) == 0:
                raise ValueError(
                    f"water covers {low:g}–{high:g} nm: no band of 400–700 nm; give wavelengths in its range"
                )
        bands = water.at(wavelengths)
        response = load_camera(camera).weights(wavelengths).T  # (3, bands), rows sum to 1
        beta, G = bands.a + bands.b, bands.a + g * bands.b
        light = np.exp(-bands.kd * vertical_depth)
        lossy = np.maximum(G, _LOSSLESS)
        veil = mu * bands.b * light / lossy
        # linear steps for slow rates, logarithmic ones for the fast
        z = np.concatenate([[0.0], np.geomspace(max(near, 1e-4 * far), far, 65), np.linspace(near, far, 33)[1:-1]])
        rates, (direct,), error = _reduce(beta, (response * light,), z, tolerance)
        scatter, (signal, backscatter), error_scatter = _reduce(
            lossy, (response * light, response * veil), z, tolerance
        )
        point_spread = PointSpread.paper() if point_spread is None else point_spread
        note = (
            f"{water.name}: {len(rates)} + {len(scatter)} rates, "
            f"curves within {max(error, error_scatter):.1g} over {near:g}…{far:g} m, "
            f"{vertical_depth:g} m deep, g = {g:g}, μ = {mu:g}"
        )
        tensors = [torch.from_numpy(x)[None] for x in (rates, direct, scatter, signal, backscatter)]
        b_mean = torch.from_numpy(np.array([(response @ bands.b).mean()]))
        return assemble([*tensors, b_mean], point_spread, (note,))

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
        rows = {k: torch.as_tensor(v, dtype=None if isinstance(v, Tensor) else dtype) for k, v in given.items()}
        for name, row in rows.items():
            if row.ndim not in (1, 2) or row.shape[-1] != 3:
                raise ValueError(f"{name} must have shape (3,) or (B, 3), got {tuple(row.shape)}")
            low = row.detach().min() if row.numel() else torch.zeros(())
            if not bool(low >= 0) or not bool(torch.isfinite(row.detach()).all()):
                raise ValueError(f"{name} must be finite and ≥ 0, got {row.detach().tolist()}")
        batches = {name: len(row) if row.ndim == 2 else 1 for name, row in rows.items()}
        mean = torch.as_tensor(b_mean, dtype=None if isinstance(b_mean, Tensor) else dtype).to(dtype)
        if mean.ndim > 1 or not bool((mean.detach() >= 0).all()) or not bool(mean.detach().isfinite().all()):
            raise ValueError(f"b_mean must be a number or (B,), finite and ≥ 0 in 1/m, got {mean.detach().tolist()}")
        batches["b_mean"] = len(mean) if mean.ndim else 1
        b = max(batches.values())
        if any(n not in (1, b) for n in batches.values()):
            raise ValueError(f"batches must agree or be 1, got {batches}")
        rates, scatter, sky, ambient = (r.to(dtype).expand(b, 3) for r in rows.values())
        mean = mean.expand(b)
        point_spread = PointSpread.none() if point_spread is None else point_spread
        note = "coefficients: 3 + 3 rates, one per channel"
        diagonal = torch.diag_embed(ambient)
        return Medium(rates, diagonal, scatter, diagonal, torch.diag_embed(sky), mean, point_spread, (note,) * b)

    @staticmethod
    def stack(media: "Sequence[Medium]") -> "Medium":
        """One batch of several media; their width laws must share shape and reference size."""
        if not media:
            raise ValueError("media is empty: stack needs at least one Medium")
        laws = [m.point_spread for m in media]
        if len({(p.shape, p.reference_size) for p in laws}) > 1:
            raise ValueError(
                "media must share the shape and reference_size of their point spreads, "
                f"got {sorted(set(map(str, laws)))}"
            )

        def join(name: str) -> Tensor:
            parts = [getattr(m, name) for m in media]
            width = max(p.shape[-1] for p in parts)
            return torch.cat([torch.nn.functional.pad(p, (0, width - p.shape[-1])) for p in parts])

        def join_law(values: list[float | Tensor]) -> float | Tensor:
            if all(isinstance(v, (int, float)) and v == values[0] for v in values):
                return values[0]
            return torch.cat([torch.as_tensor(v, dtype=m.beta.dtype).expand(len(m)) for v, m in zip(values, media)])

        scale, exponent = join_law([p.scale for p in laws]), join_law([p.exponent for p in laws])
        law = replace(laws[0], scale=scale, exponent=exponent)
        tensors = [join(name) if name != "b_mean" else torch.cat([m.b_mean for m in media]) for name in _TENSORS]
        return assemble(tensors, law, tuple(n for m in media for n in m.notes))

    def __len__(self) -> int:
        return len(self.beta)

    def __getitem__(self, i: int) -> "Medium":
        """The i-th medium, as a batch of one."""
        if not -len(self) <= i < len(self):
            raise IndexError(f"medium {i} of {len(self)}")
        part = slice(i, i + 1 or None)
        return assemble(
            [t[part] for t in self.tensors()],
            self.point_spread.map(lambda v: v[part] if v.ndim else v),
            self.notes[part],
        )

    def tensors(self) -> tuple[Tensor, ...]:
        """Rates, weights and b̄, in the order of the attributes."""
        return tuple(getattr(self, name) for name in _TENSORS)

    def to(self, *args: Any, **kwargs: Any) -> "Medium":
        """Move or cast, as `torch.Tensor.to`."""
        if all(t.to(*args, **kwargs) is t for t in self.tensors()):
            return self
        law = self.point_spread.map(lambda v: v.to(*args, **kwargs))
        return assemble([t.to(*args, **kwargs) for t in self.tensors()], law, self.notes)

    def transmission(self, z: Tensor) -> Tensor:
        """T_β(z): share of the light at the surface that arrives unscattered.

        Args:
            z: distance, m; (B or 1, 1, H, W), (1, H, W), or any number of values (N,) or ().

        Returns:
            (B, 3, H, W), or (B, 3, N), or (B, 3).
        """
        return _curve(self.beta, self.direct_weights, z, torch.exp)

    def signal(self, z: Tensor) -> Tensor:
        """T_G(z): share of the light at the surface that arrives at all; shapes as `transmission`."""
        return _curve(self.G, self.signal_weights, z, torch.exp)

    def backscatter(self, z: Tensor) -> Tensor:
        """V(0) − V(z), the veil in front of a point at distance z; shapes as `transmission`."""
        return -_curve(self.G, self.veil_weights, z, torch.expm1)

    def width(self, z: Tensor, size: tuple[int, int]) -> Tensor:
        """σ(z), px, for distances (B or 1, 1, H, W) in an image of (height, width) `size`."""
        z = z.clamp(max=FARTHEST)
        return self.point_spread.variance(self.b_mean.reshape(-1, 1, 1, 1).to(z) * z, size).sqrt()

    def __repr__(self) -> str:
        notes = self.notes or ("",)
        more = f", and {len(self) - 1} more" if len(self) > 1 else ""
        b_mean = ", ".join(f"{float(b):.3g}" for b in self.b_mean.detach()[:3]) + (", …" if len(self) > 3 else "")
        return f"Medium({notes[0]}{more}; {self.point_spread}, b̄ = {b_mean}/m)"


_TENSORS = tuple(f.name for f in fields(Medium) if f.name not in ("point_spread", "notes"))
FARTHEST = 1e9  # m: what stands for z = +inf, so that 0·inf never arises; any rate above 1e-7/m is spent by then


def assemble(tensors: Sequence[Tensor], law: PointSpread, notes: tuple[str, ...]) -> Medium:
    """A medium from its tensors, in the order of its attributes."""
    beta, direct_weights, G, signal_weights, veil_weights, b_mean = tensors
    return Medium(beta, direct_weights, G, signal_weights, veil_weights, b_mean, law, notes)


def _curve(rates: Tensor, weights: Tensor, z: Tensor, function: Callable[[Tensor], Tensor]) -> Tensor:
    with torch.autocast(z.device.type, enabled=False):
        z = z.to(torch.promote_types(z.dtype, torch.float32)).clamp(max=FARTHEST)
        rates, weights = rates.to(z), weights.to(z)
        if z.ndim <= 1:
            values = weights @ function(-rates[:, :, None] * z.reshape(1, 1, -1))
            return values.squeeze(-1) if z.ndim == 0 else values
        flat = z.reshape(len(z) if z.ndim == 4 else 1, 1, z.shape[-2] * z.shape[-1])
        curve = weights @ function(-rates[:, :, None] * flat)
        return curve.reshape(*curve.shape[:2], *z.shape[-2:])


def _reduce(rates: Array, measures: tuple[Array, ...], z: Array, tolerance: float) -> tuple[Array, list[Array], float]:
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
