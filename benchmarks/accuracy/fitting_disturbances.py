"""What a picture goes through before it is fitted, and whether the fit says how far it can be
trusted: of each disturbance, how many 95 % intervals hold the truth, and the verdict.
"""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image
from torch import Tensor

from benchmarks.accuracy.fitting_recovery import MAIN, Row, compared, run
from benchmarks.accuracy.fitting_scenes import Truth, formed, photographed, view
from uwaug.distance import along_ray
from uwaug.fitting import fit
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear
from uwaug.optics.point_spread import PointSpread

WIDTH = 247  # px, a third of the scene
SEED = 4
BETA, G, VEIL = (0.62, 0.41, 0.48), (0.30, 0.15, 0.20), (0.10, 0.28, 0.33)
WIDENED = 1.4  # px, σ after one scattering length
PIXELS = 6000
CLIPPED = 2.3  # of the exposure that saturates the highlights


class Shot(NamedTuple):
    """What is given to a fit: sRGB of 8 bits (3xHxW) without water and in it; metres (1xHxW)."""

    clean: Tensor
    observed: Tensor
    z: Tensor


Change = Callable[[Shot], Shot]


def truth() -> Truth:
    """The water of all these pictures; what is scattered forward is a Gaussian."""
    law = PointSpread(WIDENED, 0.9)
    return Truth("gaussian", np.array(BETA), np.array(G), np.array(VEIL), law)


def shot(gain: float = 1.0) -> Shot:
    """The scene as it is seen by a camera that does nothing to it."""
    scene = view(WIDTH)
    light = gain * formed(truth(), scene)
    observed = photographed(light, np.random.default_rng(SEED))
    return Shot((255 * scene.srgb).round().to(torch.uint8), observed, scene.distance)


# ---- what files and cameras do


def as_bytes(srgb: Tensor) -> Tensor:
    """0…1 as 8 bits."""
    return (255 * srgb.clamp(0, 1)).round().to(torch.uint8)


def developed(change: Callable[[Tensor], Tensor]) -> Change:
    """The observed picture, changed as sRGB of 0…1."""
    return lambda s: s._replace(observed=as_bytes(change(s.observed.double() / 255)))


def exposed(gains: Tensor) -> Change:
    """The observed picture with gains in linear light (that broadcast with 3xHxW)."""
    return developed(lambda srgb: linear_to_srgb(gains * srgb_to_linear(srgb)))


def jpeg(picture: Tensor, quality: int, subsampling: int) -> Tensor:
    """Through a JPEG file; subsampling 0 is 4:4:4, 2 is 4:2:0."""
    file = io.BytesIO()
    image = Image.fromarray(picture.permute(1, 2, 0).numpy())
    image.save(file, "JPEG", quality=quality, subsampling=subsampling)
    return torch.from_numpy(np.array(Image.open(file))).permute(2, 0, 1)


def both_jpeg(quality: int, subsampling: int) -> Change:
    """Both pictures are JPEG."""
    return lambda s: s._replace(
        clean=jpeg(s.clean, quality, subsampling), observed=jpeg(s.observed, quality, subsampling)
    )


def shifted(picture: Tensor, right: int) -> Tensor:
    """Moved to the right; the edge is repeated."""
    return F.pad(picture[None].double(), (right, 0, 0, 0), mode="replicate")[
        0, ..., : picture.shape[-1]
    ].to(picture.dtype)


def gaussian(picture: Tensor, sigma: float) -> Tensor:
    """Blurred by a Gaussian."""
    radius = round(4 * sigma)
    x = torch.arange(-radius, radius + 1).double()
    kernel = torch.exp(-x * x / (2 * sigma * sigma))
    kernel /= kernel.sum()
    planes = F.pad(picture[:, None].double(), (radius,) * 4, mode="reflect")
    across = F.conv2d(planes, kernel.reshape(1, 1, 1, -1))
    return F.conv2d(across, kernel.reshape(1, 1, -1, 1))[:, 0]


def sharpened(srgb: Tensor) -> Tensor:
    """An unsharp mask as cameras apply it."""
    return srgb + 0.6 * (srgb - gaussian(srgb, 1.0))


def median(srgb: Tensor) -> Tensor:
    """The median of 3×3 pixels, as noise is taken out."""
    patches = F.pad(srgb[None], (1, 1, 1, 1), mode="reflect").unfold(2, 3, 1).unfold(3, 3, 1)
    return patches.flatten(-2).median(-1).values[0]


def radius(like: Tensor) -> Tensor:
    """Distance from the middle (HxW), 1 in the corners."""
    h, w = like.shape[-2:]
    y = (torch.arange(h).double() - (h - 1) / 2)[:, None]
    x = (torch.arange(w).double() - (w - 1) / 2)[None]
    r = (x * x + y * y).sqrt()
    return r / r.max()


def across(like: Tensor) -> Tensor:
    """−1 at the left edge to 1 at the right (1xW)."""
    return torch.linspace(-1, 1, like.shape[-1], dtype=torch.float64)[None]


def uneven_veil(s: Shot) -> Shot:
    """A lamp to the right: the veil is 30 % brighter there and 30 % darker on the left."""
    G_, veil = (torch.tensor(x, dtype=torch.float64)[:, None, None] for x in (G, VEIL))
    more = -0.3 * across(s.z) * veil * torch.expm1(-G_ * s.z.double())
    return exposed_by(s, more)


def exposed_by(s: Shot, more: Tensor) -> Shot:
    """More light (3xHxW, linear) on the observed picture."""
    return developed(lambda srgb: linear_to_srgb((srgb_to_linear(srgb) + more).clamp(min=0)))(s)


def other_light(s: Shot) -> Shot:
    """The clean picture was taken in other light: 20 % brighter above, 20 % darker below."""
    down = torch.linspace(1, -1, s.z.shape[-2], dtype=torch.float64)[:, None]
    light = srgb_to_linear(s.clean.double() / 255) * (1 + 0.2 * down)
    return s._replace(clean=as_bytes(linear_to_srgb(light)))


def of_map(change: Callable[[Tensor], Tensor]) -> Change:
    """The distances, changed."""
    return lambda s: s._replace(z=change(s.z))


def noisy(z: Tensor) -> Tensor:
    """Each pixel is 3 % off."""
    rng = np.random.default_rng(SEED)
    return z * (1 + 0.03 * torch.from_numpy(rng.standard_normal(z.shape)))


def planar(z: Tensor) -> Tensor:
    """The depth along the axis in place of the distance along the ray."""
    unit = torch.ones_like(z)
    return z / along_ray(unit, focal_px=view(WIDTH).focal_px)


def noisy_clean(s: Shot) -> Shot:
    """The clean picture has noise of 2 % of white."""
    rng = np.random.default_rng(SEED + 1)  # of its own: not that of the observed picture
    noise = torch.from_numpy(0.02 * rng.standard_normal(s.clean.shape))
    return s._replace(clean=as_bytes(s.clean.double() / 255 + noise))


def s_curve(srgb: Tensor) -> Tensor:
    """Half of a smooth step: darks darker, lights lighter."""
    return 0.5 * srgb + 0.5 * srgb * srgb * (3 - 2 * srgb)


def six_bits(srgb: Tensor) -> Tensor:
    """Rounded to 64 levels."""
    return (63 * srgb).round() / 63


CHANNELS = torch.tensor([1.25, 1.0, 0.9], dtype=torch.float64)[:, None, None]
DISTURBANCES: dict[str, Change] = {
    "none": lambda s: s,
    "6 bits": developed(six_bits),
    "JPEG 95 4:4:4, both": both_jpeg(95, 0),
    "JPEG 85 4:2:0, both": both_jpeg(85, 2),
    "JPEG 60 4:2:0, both": both_jpeg(60, 2),
    "clean is JPEG 75": lambda s: s._replace(clean=jpeg(s.clean, 75, 2)),
    "white balance 1.25, 1, .9": exposed(CHANNELS),
    "exposure × 1.3": exposed(torch.tensor(1.3)),
    "gamma 1.15": developed(lambda srgb: srgb**1.15),
    "S-curve": developed(s_curve),
    "observed 1 px aside": lambda s: s._replace(observed=shifted(s.observed, 1)),
    "observed 2 px aside": lambda s: s._replace(observed=shifted(s.observed, 2)),
    "map 3 px aside": of_map(lambda z: shifted(z, 3)),
    "map blurred over 9 px": of_map(lambda z: F.avg_pool2d(z[None], 9, 1, 4, False, False)[0]),
    "map with 3 % noise": of_map(noisy),
    "map in steps of .5 m": of_map(lambda z: (2 * z).round() / 2),
    "map + .3 m": of_map(lambda z: z + 0.3),
    "planar depth": of_map(planar),
    "clipped highlights": lambda s: shot(CLIPPED),
    "vignetting 30 %": lambda s: exposed(1 - 0.3 * radius(s.z) ** 2)(s),
    "uneven veil": uneven_veil,
    "sharpened": developed(sharpened),
    "defocus 1.5 px": developed(lambda srgb: gaussian(srgb, 1.5)),
    "median of 3×3": developed(median),
    "other light on clean": other_light,
    "clean with 2 % noise": noisy_clean,
}


def disturbed(index: int, pixels: int = PIXELS) -> Row:
    """What a fit makes of one of the disturbances."""
    torch.set_num_threads(1)
    name, change = list(DISTURBANCES.items())[index]
    found = fit(*change(shot()), pixels=pixels)
    rows = compared(truth(), found)
    numbers = {key: row for key, row in rows.items() if key.rpartition("_")[0] in MAIN}
    known = [row for row in numbers.values() if row[1] is not None]
    return {
        "seed": index,
        "name": name,
        "model": found.fitted.name,
        "known": len(known),
        "hold": sum(low <= right <= high for right, _, _, low, high, _ in known),
        "not_identified": len(numbers) - len(known),
        "worst": max((abs(value / right - 1) for right, value, *_ in known), default=0.0),
        "verdict": verdict(found.message),
    }


def verdict(message: str) -> str:
    """What a fit's message says of its errors, in a word or some; nothing if there is none."""
    for line in message.splitlines():
        if line.startswith("Verdict: "):
            return line.removeprefix("Verdict: ").partition(".")[0]
    return ""


def disturbances(quick: bool, progress: Path | None = None) -> dict[str, Any]:
    """Run, print, return."""
    places = list(range(len(DISTURBANCES)))
    rows = [disturbed(0, pixels=500)] if quick else run(disturbed, places, progress)
    for row in rows:
        print(
            f"{row['name']:26} {row['hold']} of {row['known']} hold, worst "
            f"{100 * row['worst']:.0f} %, {row['model']}: {row['verdict']}"
        )
    numbers = sum(row["known"] + row["not_identified"] for row in rows)
    right = sum(row["hold"] + row["not_identified"] for row in rows)
    return {"share_percent": 100 * right / numbers, "rows": rows}
