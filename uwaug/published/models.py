"""Published systems, oldest first. A function with `@published` is all that one takes.

J is the scene, z the distance, d the depth below the surface, S_c the response of the camera, and
a, b, β = a + b, K_d are spectra of the water. Water is homogeneous and surfaces are grey where
nothing else is said. A source that was not at hand stands here by general knowledge of the
literature.
"""

from typing import Literal

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.light.backscatter import backscatter
from uwaug.light.light import Lamp
from uwaug.optics.view import WIDE, View
from uwaug.optics.water import Water
from uwaug.published.equation import BandedWater, between, colour, published, spectral

# beside the camera, aimed 3 m ahead
_LAMP = Lamp(position=(-0.8, -0.5, 0.0), power=10.0, aim=(0.8, 0.5, 3.0), cone=50.0)
_ROWS_AT_ONCE = 16  # of a picture, whose bands of a lamp's beam stay in the cache

_RGB = tuple[float, float, float]


@spectral("srgb")
def mcglamery_1980(
    J: Tensor, z: Tensor, w: BandedWater, *, g: float = 0.05, lamp: Lamp = _LAMP, view: View = WIDE
) -> Tensor:
    """Direct light, forward scatter as a blur of the scene, and backscatter, under a lamp.

        I = L·e^(−βz)·J + L·(e^(−Gz) − e^(−βz))·PSF_z{J} + ∫beam,  PSF_z = F⁻¹{e^(−φzf)}

    Source: B. L. McGlamery, Proc. SPIE 0208 (1980) 221, doi:10.1117/12.958279; not at hand.
    Left open: the colours (it has one wavelength), and G and φ, which it fits, with a ≤ G ≤ K_d.
    Ours: spectra and a camera; G = a + g·b, which keeps that bound in all ten types; φ = 2π·.3 px·b̄
    where the short side has 518 px; a `view` 60° wide; the phase function of Henyey and Greenstein.
    The lamp's light L on the scene is color·cone·cos/r², and fades with G on its way.
    """
    G = w.a + g * w.b
    L, r, beam = _lit(lamp, view, z, G, w)
    direct, arriving = (L * w.integral(1.0, (rate, z), (G, r)) for rate in (w.beta, G))
    return direct * J + (arriving - direct) * w.scattered(J, z, 0.3) + beam


@spectral("srgb")
def jaffe_1990(
    J: Tensor, z: Tensor, w: BandedWater, *, g: float = 0.2, lamp: Lamp = _LAMP, view: View = WIDE
) -> Tensor:
    """McGlamery's model, but the direct light is blurred, and not the scene.

        D = L·e^(−βz)·J,  I = D + (e^(−Gz) − e^(−βz))·PSF_z{D} + ∫beam,  PSF_z = F⁻¹{e^(−φzf)}

    Source: J. S. Jaffe, IEEE J. Oceanic Eng. 15 (1990) 101, doi:10.1109/48.50695; not at hand.
    Left open: the colours, and G and φ, which it fits, with |G| ≤ β.
    Ours: as in `mcglamery_1980`, with another g. Each pixel takes weight and blur of its own
    distance.
    """
    G = w.a + g * w.b
    L, r, beam = _lit(lamp, view, z, G, w)
    direct = L * w.integral(1.0, (w.beta, z), (G, r))
    weight = [L * w.integral(1.0, (w.beta + rate, z), (G, r)) for rate in (G, w.beta)]
    forward = (weight[0] - weight[1]) * w.scattered(J, z, 0.3)
    return direct * J + forward + beam


@spectral("srgb")
def schechner_2004(
    J: Tensor,
    z: Tensor,
    w: BandedWater,
    *,
    vertical_depth: float = 1.0,
    g: float = 0.2,
    mu: float = 0.3,
) -> Tensor:
    """Jaffe's model under natural light: D + F is e^(−βz) times an effective scene L, the scene and
    a blur of it. The veil has one number at infinity.

        I = e^(−βz)·L + B∞·(1 − e^(−βz)),  L = E·(J + (e^(−Gz) − e^(−βz))·PSF_z{J}),
        B∞ = μbE/β,  E = e^(−K_d·d)

    Source: Y. Y. Schechner, N. Karpel, CVPR 2004, I-536, doi:10.1109/CVPR.2004.1315078 (not seen).
    Left open: colours, G, φ, and the veil, which the authors read from their pictures.
    Ours: spectra and a camera, G and φ as in `mcglamery_1980`, the veil of a homogeneous water.
    """
    G, E = w.a + g * w.b, w.daylight(vertical_depth)
    weight = w.integral(E, (w.beta + G, z)) - w.integral(E, (2 * w.beta, z))
    direct = w.integral(E, (w.beta, z)) * J
    veil = w.veil(mu * w.b * E, w.beta, z)
    return direct + weight * w.scattered(J, z, 0.3) + veil


@spectral("srgb")
def akkaynak_2018(J: Tensor, z: Tensor, w: BandedWater, *, vertical_depth: float = 1.0) -> Tensor:
    """Revised model: picture and veil have two coefficients of attenuation, each the mean of a
    spectrum that changes with distance. Both follow from the spectra.

        I_c = J_c·e^(−β_c^D·z) + B_c∞·(1 − e^(−β_c^B·z))
            = J_c·∫S_c·E·e^(−βz) + ∫S_c·(bE/β)·(1 − e^(−βz)),  E = e^(−K_d·d)

    Source: D. Akkaynak, T. Treibitz, CVPR 2018, 6723, doi:10.1109/CVPR.2018.00703; not at hand.
    Left open: the spectrum of the reflectance in the mean; here it is grey.
    Ours: depth and camera.
    """
    return _revised(J, z, w, w.daylight(vertical_depth))


@spectral("linear")
def ueda_2019(
    J: Tensor,
    z: Tensor,
    w: BandedWater,
    *,
    vertical_depth: float = 1.0,
    veil: tuple[_RGB, _RGB] = ((0.4, 0.7, 0.7), (0.5, 0.8, 0.8)),
    generator: torch.Generator | None = None,
) -> Tensor:
    """Spectra and a camera, one attenuation for picture and veil, and a random veil. Light falls
    with depth by beam attenuation instead of K_d.

        I_c = J_c·t_c(d + z) + B_c·(t_c(d) − t_c(d + z)),  t_c(x) = ∫S_c·e^(−βx),  B_c random

    Source: T. Ueda, K. Yamada, Y. Tanaka, ICIP 2019, 2115, doi:10.1109/ICIP.2019.8803195, by
    github.com/Jacobs-University/ICIP6-Underwater-Image-Synthesis, an independent implementation.
    Ours: a depth of 1 m; white daylight; the middle of the veil without a generator.
    """
    B, vertical = between(*veil, generator, z), w.integral(torch.exp(-w.beta * vertical_depth))
    both = w.integral(1.0, (w.beta, vertical_depth + z))
    return J * both + B * (vertical - both)


@published("linear")
def hou_2020(
    image: Tensor,
    z: Tensor,
    *,
    transmission: _RGB = (0.35, 0.778, 0.728),
    veil: _RGB = (0.15, 0.69, 0.6),
) -> Tensor:
    """SUID: one transmission for each channel, whatever the distance, and a veil, both read from a
    real underwater picture by the red-channel prior.

        I_c = J_c·t_c + B_c·(1 − t_c)

    Source: G. Hou et al., IEEE Access 8 (2020) 122078, doi:10.1109/ACCESS.2020.3006359, by
    github.com/vismiroglou/SUID_data_generation, an independent implementation with a smooth map of
    transmissions. One number for each channel is from a table of arXiv:2509.15011.
    Ours: a green-blue veil, a transmission of .35 in red, and the others by the source's rule,
    t_c = t_r^(b_c·B_r / (b_r·B_c)) with b = 1.62517 − .00113·λ/nm at 620, 540 and 450 nm.
    """
    t, B = colour(transmission, z), colour(veil, z)
    return image * t + B * (1 - t)


UWCNN = {
    "I": (0.85, 0.961, 0.982),
    "IA": (0.84, 0.955, 0.975),
    "IB": (0.83, 0.95, 0.968),
    "II": (0.80, 0.925, 0.94),
    "III": (0.75, 0.885, 0.89),
    "1C": (0.75, 0.885, 0.875),
    "3C": (0.71, 0.82, 0.8),
    "5C": (0.67, 0.73, 0.67),
    "7C": (0.62, 0.61, 0.5),
    "9C": (0.55, 0.46, 0.29),
}
"""Shares of red, green and blue that are left after a metre of each type, for `li_2020`."""


@published("linear")
def li_2020(
    image: Tensor,
    z: Tensor,
    water: str | Water = "II",
    *,
    vertical_depth: tuple[float, float] = (3.0, 5.0),
    generator: torch.Generator | None = None,
) -> Tensor:
    """UWCNN: three numbers N for each of ten Jerlov types, the shares left after one metre. The
    light at a random depth, 1.5·N^d, multiplies the picture and is the veil.

        I_c = A_c·J_c·N_c^z + A_c·(1 − N_c^z),  A_c = 1.5·N_c^d,  d random in 3…5 m

    Source: C. Li, S. Anwar, F. Porikli, Pattern Recognition 98 (2020) 107038,
    doi:10.1016/j.patcog.2019.107038; arXiv:1807.03528; the authors' script as copied in
    github.com/evysb/generate_image_underwater, where distances are a map of 0…1 times .5…15 m.
    (github.com/deepxzy/underwater-image-synthesis-algorithm has .805 and .804 for red in I and IA.)
    Ours: the middle of the depths without a generator.
    """
    N = colour(_row(water, UWCNN), z)
    A = 1.5 * N ** between(*vertical_depth, generator, z)
    return A * image * N**z + A * (1 - N**z)


@spectral("srgb")
def desai_2021(J: Tensor, z: Tensor, w: BandedWater, *, vertical_depth: float = 1.0) -> Tensor:
    """RUIG: the revised model with a veil computed from the water. Depth dims the veil alone.

        I_c = J_c·∫S_c·e^(−βz) + ∫S_c·(b·e^(−K_d·d)/β)·(1 − e^(−βz))

    Source: C. Desai, R. A. Tabib, S. S. Reddy, U. Patil, U. Mudenagudi, CVPR Workshops 2021, 2181;
    not at hand. The review in arXiv:2509.15011 tells that the veil is analytic and that β^D ≠ β^B;
    the abstract of the authors' RSUIGM, that light from above in the direct term is new there.
    Ours: depth, camera, and a grey reflectance in the means.
    """
    return _revised(J, z, w, w.daylight(vertical_depth), on_scene=1.0)


@spectral("srgb")
def liu_2022(
    J: Tensor,
    z: Tensor,
    w: BandedWater,
    *,
    light: Literal["uniform", "parallel", "artificial"] = "uniform",
    vertical_depth: float = 1.0,
    power: float = 10.0,
    aside: float = 0.5,
) -> Tensor:
    """Attenuation, and a veil computed from the water, under uniform, parallel or artificial light.

        I_c = J_c·∫S_c·E(z)·e^(−βz) + ∫_0^z ∫S_c·b·E(s)·e^(−βs) ds
        E = 1 (uniform), e^(−K_d·d) (parallel), P·e^(−βr)/r² (artificial)

    Source: Y. Liu et al., Information 13 (2022) 187, doi:10.3390/info13040187; the abstract, and
    the review in arXiv:2509.15011 for veil and lights.
    Ours: uniform light by default; spectra and a camera; a lamp to all sides of `power` P (of a
    white plate at 1 m), `aside` m from the camera, so that r² = z² + aside².
    """
    checks.one_of("light", light, ("uniform", "parallel", "artificial"))
    if light != "artificial":
        return _revised(J, z, w, w.daylight(vertical_depth if light == "parallel" else 0.0))
    r = (z.square() + aside**2).sqrt()
    result = J * power / r.square() * w.integral(1.0, (w.beta, z + r))
    # in the angle θ = atan(s/aside), ds/r² is dθ/aside
    span, steps = torch.atan(z / aside), 16
    for step in range(steps):
        theta = span * (step + 0.5) / steps
        path = aside * (torch.tan(theta) + 1 / torch.cos(theta))
        result = result + power * span / (aside * steps) * w.integral(w.b, (w.beta, path))
    return result


@spectral("srgb")
def desai_2024(J: Tensor, z: Tensor, w: BandedWater, *, vertical_depth: float = 5.0) -> Tensor:
    """RSUIGM: light from above, e^(−K_d·d), in the direct term and in a veil computed from the
    water.

        I_c = J_c·∫S_c·E·e^(−βz) + ∫S_c·(bE/β)·(1 − e^(−βz)),  E = e^(−K_d·d)

    Source: C. Desai et al., ACM Trans. Multimedia Comput. Commun. Appl. 21 (2024),
    doi:10.1145/3656473; the abstract, and the review in arXiv:2509.15011.
    Ours: depth, camera, and a grey reflectance in the means.
    """
    return _revised(J, z, w, w.daylight(vertical_depth))


@spectral("linear")
def ismiroglou_reference_2025(
    J: Tensor, z: Tensor, w: BandedWater, *, vertical_depth: float = 1.0
) -> Tensor:
    """Reference model of Ismiroglou et al., to which they compare theirs: g = μ = 1, and no blur.

        I_c = J_c·∫S_c·E·e^(−βz) + ∫S_c·(bE/β)·(1 − e^(−βz)),  E = e^(−K_d·d)

    Source: V. Ismiroglou et al., arXiv:2509.15011. As there, sRGB values are taken for light.
    Ours: the camera, as data of its Nikon D90 are for non-commercial use alone.
    """
    return _revised(J, z, w, w.daylight(vertical_depth))


@spectral("linear")
def ismiroglou_2025(
    J: Tensor,
    z: Tensor,
    w: BandedWater,
    *,
    vertical_depth: float = 1.0,
    g: float = 0.2,
    mu: float = 0.3,
) -> Tensor:
    """Model that `uwaug` follows: direct light, forward scatter as a blur of the scene, and a veil
    with the rate G of forward scatter.

        I = E·e^(−βz)·J + E·(e^(−Gz) − e^(−βz))·Gauss_σ{J} + (μbE/G)·(1 − e^(−Gz)),
        G = a + g·b,  σ = 0.3·b̄·z,  E = e^(−K_d·d)

    Source: V. Ismiroglou et al., arXiv:2509.15011, table 2. As there, sRGB values are taken for
    light.
    Left open: the size of picture that σ refers to (here a short side of 518 px, as in the paper),
    and the order of weighting and blurring (here blurred first).
    Ours: the camera, as data of its Nikon D90 are for non-commercial use alone. For a medium field
    give z·field.
    """
    G, E = w.a + g * w.b, w.daylight(vertical_depth)
    direct, arriving = (w.integral(E, (rate, z)) for rate in (w.beta, G))
    forward = (arriving - direct) * w.scattered(J, z, 0.3, "gaussian")
    return direct * J + forward + w.veil(mu * w.b * E, G, z)


SLURPP = {
    "I": (0.11576, 0.02427, 0.01114),
    "IA": (0.11657, 0.02566, 0.01361),
    "IB": (0.13968, 0.05222, 0.04343),
    "II": (0.27119, 0.21912, 0.24331),
    "III": (0.16606, 0.17174, 0.20000),
    "1C": (0.27775, 0.23382, 0.27573),
    "3C": (0.15768, 0.16765, 0.20000),
    "5C": (0.20000, 0.03448, 0.04211),
    "7C": (0.13720, 0.16321, 0.20000),
    "9C": (0.13054, 0.16147, 0.20000),
}
"""Attenuation of red, green and blue in each type, 1/m, for `slurpp_2025`."""


@published("linear")
def slurpp_2025(
    image: Tensor,
    z: Tensor,
    water: str | Water = "II",
    *,
    veil: tuple[_RGB, _RGB] = ((0.05, 0.3, 0.3), (0.35, 0.7, 0.7)),
    generator: torch.Generator | None = None,
) -> Tensor:
    """Example of what restoration is trained on: one attenuation for each channel, shared by
    picture and veil; stored veils; no linear light.

        I_c = J_c·e^(−β_c·z) + B_c·(1 − e^(−β_c·z)),  B_c stored

    Source: J. Wu et al., arXiv:2507.07878, from the authors' data loader, as in
    github.com/CoMPASLab/SLURPP (slurpp/datasets/UR_revised_dataloader.py). Attenuation is one of
    ten rows (Jerlov types, one of them with a misprint: 5C, red, 9.09), times a number drawn in
    .01…1. Where all three then exceed .5, their ratio is kept and the largest becomes a number
    drawn in .1….3. The table here has the middle of both draws.
    Ours: the range of the veils, whose file was not read, and its middle without a generator.
    """
    beta, B = colour(_row(water, SLURPP), z), between(*veil, generator, z)
    t = torch.exp(-beta * z)
    return image * t + B * (1 - t)


def _lit(
    lamp: Lamp, view: View, z: Tensor, G: Tensor, w: BandedWater
) -> tuple[Tensor, Tensor, Tensor]:
    """Light of a lamp on surfaces that face the camera (Bx3xHxW), without the water; its way there
    (Bx1xHxW, m); and the veil of its beam (Bx3xHxW).
    """
    rays = view.rays(z)
    sent = lamp.sent(rays, z)
    facing = (z * rays.shortening - lamp.position[2]).clamp(min=0.0) / sent.path
    cone, scattering, strips = sent.cone, (w.response * w.b)[None], []
    for first in range(0, z.shape[-2], _ROWS_AT_ONCE):
        rows = (..., slice(first, first + _ROWS_AT_ONCE), slice(None))
        if sent.cone is not None:
            cone = sent.cone._replace(across=sent.cone.across[rows], along=sent.cone.along[rows])
        maps = sent.nearest[rows], sent.height[rows], cone, z[rows]
        strips.append(backscatter(G[None], scattering, *maps))
    light = lamp.power * z.new_tensor(lamp.color)[:, None, None]
    return light * sent.share * facing, sent.path, light * torch.cat(strips, 2)


def _revised(
    J: Tensor, z: Tensor, w: BandedWater, E: Tensor, on_scene: Tensor | float | None = None
) -> Tensor:
    """As `akkaynak_2018`, by daylight E of the veil, and another on the scene."""
    direct = w.integral(E if on_scene is None else on_scene, (w.beta, z)) * J
    return direct + w.veil(w.b * E, w.beta, z)


def _row(water: str | Water, table: dict[str, _RGB]) -> _RGB:
    name = water.name if isinstance(water, Water) else water
    checks.one_of("water", name, table)
    return table[name]
