"""Tools of the published systems: light of pictures, the list, integrals over spectra."""

import math
import os
from collections.abc import Callable, Sequence
from functools import wraps
from inspect import Signature, signature
from typing import Any, NamedTuple, TypeVar, cast

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import ColorSpace, Shape
from uwaug.blur import plan_blur, varying_blur
from uwaug.formation.colour import decoded, encoded, require_values
from uwaug.formation.inputs import batch_sizes
from uwaug.optics.camera import Camera, load_camera
from uwaug.optics.curves import FARTHEST
from uwaug.optics.reduction import default_bands
from uwaug.optics.water import Water, load_water

Equation = TypeVar("Equation", bound=Callable[..., Tensor])

AnyWater = str | os.PathLike[str] | Water
AnyCamera = str | os.PathLike[str] | Camera

_PIXELS_AT_ONCE = 4096

FUNCTIONS: dict[str, Callable[..., Tensor]] = {}
"""Published systems by the names of their functions."""

OTHER_NAMES = {
    "Jaffe-McGlamery": "jaffe-1990",
    "SUID": "hou-2020",
    "UWCNN": "li-2020",
    "RUIG": "desai-2021",
    "RSUIGM": "desai-2024",
    "STSR": "ismiroglou-2025",
    "SLURPP": "slurpp-2025",
}
"""Systems by the names that they, their data or their code go by."""


def published(color_space: ColorSpace) -> Callable[[Equation], Equation]:
    """Make a system, on the list, of an equation between light (Bx3xHxW) and distance (Bx1xHxW).

    Args:
        color_space: "srgb" decodes pictures, "linear" takes their values for light.
    """

    def wrap(equation: Equation) -> Equation:
        @wraps(equation)
        def of_picture(image: Tensor, z: Tensor, *args: Any, **kwargs: Any) -> Tensor:
            light, metres = _opened(image, z, color_space)
            result = equation(light, metres, *args, **kwargs).clamp(0, 1)
            result = encoded(result, color_space, image.dtype, 1.0)
            return result[0] if image.ndim == z.ndim == 3 else result

        FUNCTIONS[equation.__name__] = of_picture
        return cast(Equation, of_picture)

    return wrap


def spectral(color_space: ColorSpace) -> Callable[[Callable[..., Tensor]], Callable[..., Tensor]]:
    """As `published`, of an equation whose third argument is a `BandedWater`, in place of which the
    system has a water and a camera.
    """

    def wrap(equation: Callable[..., Tensor]) -> Callable[..., Tensor]:
        @wraps(equation)
        def in_bands(
            image: Tensor,
            z: Tensor,
            water: AnyWater = "II",
            camera: AnyCamera = "Nikon 5100 (NPL)",
            **options: Any,
        ) -> Tensor:
            return equation(image, z, BandedWater.of(water, camera, z), **options)

        own, theirs = (
            [*signature(each, follow_wrapped=False).parameters.values()]
            for each in (in_bands, equation)
        )
        in_bands.__signature__ = Signature([*own[:4], *theirs[3:]])  # type: ignore[attr-defined]
        return published(color_space)(in_bands)

    return wrap


def _opened(image: Tensor, z: Tensor, color_space: ColorSpace) -> tuple[Tensor, Tensor]:
    checks.batches(batch_sizes(image=image, z=z))
    require_values(image, color_space)
    checks.distances("z", z)
    light = decoded(image, color_space)
    dtype = torch.promote_types(light.dtype, z.dtype)
    light, metres = (x.to(dtype).reshape(-1, *x.shape[-3:]) for x in (light, z))
    rows = max(len(light), len(metres))
    return light.expand(rows, -1, -1, -1), metres.expand(rows, -1, -1, -1).clamp(max=FARTHEST)


def systems() -> list[str]:
    """Names of the published systems, oldest first: "mcglamery-1980" is `mcglamery_1980`."""
    names = [name.replace("_", "-") for name in FUNCTIONS]
    return sorted(names, key=lambda name: (name[-4:], name))


def system(name: str) -> Callable[..., Tensor]:
    """Function of a published system, by its name, or by another: "UWCNN" is "li-2020"."""
    own = {other.lower(): name for other, name in OTHER_NAMES.items()}
    name = own.get(name.lower(), name)
    checks.one_of("system", name, (*systems(), *OTHER_NAMES))
    return FUNCTIONS[name.replace("-", "_")]


def takes_spectra(name: str) -> bool:
    """False of a system that knows the ten Jerlov types alone, by a table of three colours."""
    parameters = signature(system(name)).parameters
    return "camera" in parameters or "water" not in parameters


def picture(name: str, image: Tensor, z: Tensor, water: AnyWater = "II") -> Tensor:
    """Picture that a published system makes in a water. "hou-2020" has one water, whatever is
    given; see also `takes_spectra`.
    """
    function = system(name)
    return function(image, z, *[water] * ("water" in signature(function).parameters))


class BandedWater(NamedTuple):
    """Spectra of a water (1/m) and a camera in N bands."""

    a: Tensor  # absorption
    b: Tensor  # scattering
    beta: Tensor  # attenuation of a beam
    kd: Tensor  # attenuation of daylight
    response: Tensor  # S of red, green and blue, 3xN; rows sum to 1

    @staticmethod
    def of(water: AnyWater, camera: AnyCamera, like: Tensor) -> "BandedWater":
        """Bands from 400 to 700 nm in steps of 5, where the water has data."""
        water = load_water(water)
        axis = default_bands(water)
        bands, response = water.at(axis), load_camera(camera).weights(axis).T
        arrays = (bands.a, bands.b, bands.beta, bands.kd, response)
        return BandedWater(*(torch.from_numpy(array.copy()).to(like) for array in arrays))

    def integral(self, light: Tensor | float, *legs: tuple[Tensor, Tensor]) -> Tensor:
        """Camera's signal ∫ S_c·light·e^(−Σ rate·path) dλ (Bx3xHxW; 1x3x1x1 without legs), of the
        light of each band, with rate (N, 1/m) and path (Bx1xHxW, m) of each leg of its way.
        """
        weights = self.response * light
        if not legs:
            return weights.sum(1).reshape(1, 3, 1, 1)
        rates, paths = (torch.stack(part) for part in zip(*legs, strict=True))
        # few pixels at a time, whose bands stay in the cache
        parts = torch.split(paths.flatten(1), _PIXELS_AT_ONCE, 1)
        sums = [weights @ torch.exp(-(rates.T @ part)) for part in parts]
        rows, _, height, width = paths.shape[1:]
        return torch.cat(sums, 1).reshape(3, rows, height, width).transpose(0, 1)

    def daylight(self, vertical_depth: float) -> Tensor:
        """Light (N) at a depth, m, relative to the surface."""
        return torch.exp(-self.kd * vertical_depth)

    def veil(self, light: Tensor, rate: Tensor, z: Tensor) -> Tensor:
        """Light (N) of each metre of water on the way z, lost at a rate (N, 1/m)."""
        endless = light / rate
        return self.integral(endless) - self.integral(endless, (rate, z))

    def scattered(
        self, image: Tensor, z: Tensor, scale: float, shape: Shape = "exponential"
    ) -> Tensor:
        """Blur a picture by σ = scale·b̄·z px, for a short side of 518 px and the mean b̄ of b over
        the channels. An exponential shape has the transfer function e^(−2πσf).
        """
        size = z.shape[-2:]
        sigma = scale * min(size) / 518 * (self.response @ self.b).mean() * z
        sigma = sigma.clamp(max=max(size))
        # rounded up, so that pictures share plans
        widest = 2.0 ** math.ceil(math.log2(max(float(sigma.detach().max()), 1e-6)))
        return varying_blur(image, sigma, plan_blur(0.0, widest, shape=shape, longest=max(size)))


def between(
    low: float | Sequence[float],
    high: float | Sequence[float],
    generator: torch.Generator | None,
    like: Tensor,
) -> Tensor:
    """Middle of a range of numbers (1x1x1x1) or colours (1x3x1x1); with a generator, numbers or
    colours drawn in it for each picture of a batch (Bx1x1x1 or Bx3x1x1).
    """
    ends = [torch.tensor(end, dtype=torch.float64).reshape(1, -1, 1, 1) for end in (low, high)]
    share = torch.full((1, 1, 1, 1), 0.5, dtype=torch.float64)
    if generator is not None:
        rows = (len(like), *ends[0].shape[1:])
        share = torch.rand(rows, generator=generator, dtype=torch.float64)
    return (ends[0] + (ends[1] - ends[0]) * share).to(like)


def colour(values: Sequence[float] | Tensor, like: Tensor) -> Tensor:
    """Three numbers (1x3x1x1), of the type of pictures."""
    return torch.as_tensor(values, dtype=torch.float64).to(like).reshape(1, 3, 1, 1)
