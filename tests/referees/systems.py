"""The published systems, each written out from its own equation: NumPy, loops over wavelengths, and
figures read from the preset's file.
"""

import math
import tomllib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from referees import reference
from uwaug.optics.camera import load_camera
from uwaug.optics.water import Water
from uwaug.presets.files import bundled_preset

Array = np.ndarray
BANDS = np.arange(400.0, 701.0, 5.0)


class Scene(NamedTuple):
    J: Array  # (3, H, W)
    z: Array  # (H, W)
    blur: float = 0.0  # times the width that the file has


def table(name: str) -> dict[str, Any]:
    """A preset's file as it is."""
    return tomllib.loads(bundled_preset(name).read_text(encoding="utf-8"))


def response() -> Array:
    """(3, N), rows of sum 1."""
    camera = load_camera("Nikon 5100 (NPL)")
    rows = []
    for channel in range(3):
        row = np.interp(BANDS, camera.wavelengths, camera.response[:, channel])
        rows.append(row / row.sum())
    return np.stack(rows)


def bands(water: Water) -> list[tuple[float, float, float, Array]]:
    """a, b, K_d and the three responses of each wavelength."""
    S, found = response(), []
    for i, wavelength in enumerate(BANDS):
        of = [np.interp(wavelength, water.wavelengths, x) for x in (water.a, water.b, water.kd)]
        found.append((*map(float, of), S[:, i, None, None]))
    return found


def b_mean(water: Water) -> float:
    return float((response() @ np.interp(BANDS, water.wavelengths, water.b)).mean())


def scattered(name: str, scene: Scene, water: Water) -> Array:
    """The scene under the point spread of each pixel."""
    if scene.blur == 0:
        return scene.J
    law = table(name)["point_spread"]
    scale = scene.blur * law["scale_px"] * min(scene.z.shape) / law["short_side_px"]
    sigma = scale * b_mean(water) * scene.z
    exact = reference.varying_gaussian
    if law.get("shape") == "exponential":
        exact = reference.varying_exponential
    return exact(scene.J, sigma).reshape(scene.J.shape)


def mcglamery(name: str, scene: Scene, water: Water) -> Array:
    p, (J, z, _) = table(name)["medium"], scene
    D, weight, B = np.zeros_like(J), np.zeros_like(J), np.zeros_like(J)
    for a, b, kd, S in bands(water):
        c, G, E = a + b, a + p["g"] * b, math.exp(-kd * p["vertical_depth_m"])
        D += S * E * np.exp(-c * z) * J
        weight += S * E * (np.exp(-G * z) - np.exp(-c * z))
        B += S * p["mu"] * b * E / c * (1 - np.exp(-c * z))
    return D + weight * scattered(name, scene, water) + B


def jaffe(name: str, scene: Scene, water: Water) -> Array:
    p, (J, z, _) = table(name)["medium"], scene
    D, weight, B = np.zeros_like(J), np.zeros_like(J), np.zeros_like(J)
    for a, b, kd, S in bands(water):
        c, G, E = a + b, a + p["g"] * b, math.exp(-kd * p["vertical_depth_m"])
        attenuated = E * np.exp(-c * z)
        D += S * attenuated * J
        weight += S * attenuated * (np.exp(-G * z) - np.exp(-c * z))
        B += S * p["mu"] * b * E / c * (1 - np.exp(-c * z))
    return D + weight * scattered(name, scene, water) + B


def schechner(name: str, scene: Scene, water: Water) -> Array:
    p, (J, z, _) = table(name)["medium"], scene
    spread, result = scattered(name, scene, water), np.zeros_like(J)
    for a, b, kd, S in bands(water):
        c, G, E = a + b, a + p["g"] * b, math.exp(-kd * p["vertical_depth_m"])
        effective = E * (J + (np.exp(-G * z) - np.exp(-c * z)) * spread)
        at_infinity = p["mu"] * b * E / c
        result += S * (np.exp(-c * z) * effective + at_infinity * (1 - np.exp(-c * z)))
    return result


def revised(name: str, scene: Scene, water: Water) -> Array:
    """By the coefficients β^D and β^B, which change with distance."""
    p, (J, z, _) = table(name)["medium"], scene
    lit, left, at_infinity, come = 0.0, 0.0, 0.0, 0.0
    for a, b, kd, S in bands(water):
        c, E = a + b, math.exp(-kd * p["vertical_depth_m"])
        lit = lit + S * E
        left = left + S * E * np.exp(-c * z)
        at_infinity = at_infinity + S * b * E / c
        come = come + S * b * E / c * (1 - np.exp(-c * z))
    beta_D = np.log(lit / left) / z
    beta_B = -np.log(1 - come / at_infinity) / z
    return J * lit * np.exp(-beta_D * z) + at_infinity * (1 - np.exp(-beta_B * z))


def analytic(name: str, scene: Scene, water: Water, *, direct: bool, veil: bool) -> Array:
    """A veil computed from the water; K_d in the direct term or not, in the veil or not."""
    p, (J, z, _) = table(name)["medium"], scene
    result = np.zeros_like(J)
    for a, b, kd, S in bands(water):
        c, E = a + b, math.exp(-kd * p["vertical_depth_m"])
        result += S * (E if direct else 1) * np.exp(-c * z) * J
        result += S * b * (E if veil else 1) / c * (1 - np.exp(-c * z))
    return result


def desai_2021(name: str, scene: Scene, water: Water) -> Array:
    return analytic(name, scene, water, direct=False, veil=True)


def desai_2024(name: str, scene: Scene, water: Water) -> Array:
    return analytic(name, scene, water, direct=True, veil=True)


def liu(name: str, scene: Scene, water: Water) -> Array:
    return analytic(name, scene, water, direct=False, veil=False)


def ueda(name: str, scene: Scene, water: Water) -> Array:
    file, (J, z, _) = table(name), scene
    d = file["medium"]["vertical_depth_m"]
    vertical, both = 0.0, 0.0
    for a, b, _, S in bands(water):
        vertical = vertical + S * math.exp(-(a + b) * d)
        both = both + S * np.exp(-(a + b) * (d + z))
    horizontal = both / vertical
    B = (np.array(file["veil"]["low"]) + file["veil"]["high"])[:, None, None] / 2
    return J * vertical * horizontal + B * vertical * (1 - horizontal)


def paper(name: str, scene: Scene, water: Water) -> Array:
    p, (J, z, _) = table(name)["medium"], scene
    D, weight, B = np.zeros_like(J), np.zeros_like(J), np.zeros_like(J)
    for a, b, kd, S in bands(water):
        G, E = a + p["g"] * b, math.exp(-kd * p["vertical_depth_m"])
        D += S * E * np.exp(-(a + b) * z) * J
        weight += S * E * (np.exp(-G * z) - np.exp(-(a + b) * z))
        B += S * p["mu"] * b * E / G * (1 - np.exp(-G * z))
    return D + weight * scattered(name, scene, water) + B


def hou(name: str, scene: Scene, water: str) -> Array:
    file, (J, _, _) = table(name), scene
    t = np.array(file["channels"]["left"])[:, None, None]
    return J * t + np.array(file["veil"]["low"])[:, None, None] * (1 - t)


def uwcnn(name: str, scene: Scene, water: str) -> Array:
    file, (J, z, _) = table(name), scene
    N = np.array(file["channels"]["left_per_m"][water])[:, None, None]
    A = 1.5 * N ** file["medium"]["vertical_depth_m"]
    t = N**z
    return A * J * t + (1 - t) * A


def slurpp(name: str, scene: Scene, water: str) -> Array:
    file, (J, z, _) = table(name), scene
    beta = np.array(file["channels"]["beta_per_m"][water])[:, None, None]
    B = (np.array(file["veil"]["low"]) + file["veil"]["high"])[:, None, None] / 2
    return J * np.exp(-beta * z) + B * (1 - np.exp(-beta * z))


Equation = Callable[[str, Scene, Any], Array]

SPECTRAL: dict[str, Equation] = {
    "mcglamery-1980": mcglamery,
    "jaffe-1990": jaffe,
    "schechner-2004": schechner,
    "akkaynak-2018": revised,
    "ueda-2019": ueda,
    "desai-2021": desai_2021,
    "liu-2022": liu,
    "desai-2024": desai_2024,
    "ismiroglou-2025": paper,
    "ismiroglou-reference-2025": revised,
}
CHANNELS: dict[str, Equation] = {"hou-2020": hou, "li-2020": uwcnn, "slurpp-2025": slurpp}
