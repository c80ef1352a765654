"""The noise of a sensor: of the photons that it counts, and of reading it out."""

from collections.abc import Sequence
from dataclasses import MISSING, dataclass
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from uwaug._support.codec import plain
from uwaug._support.nouns import Seeded, number
from uwaug._support.ranges import Range

# Number of standard normals. Each row of a picture is a run of them from a random start, so that no
# two pictures look alike. (1024² take .3 ms; by torch.randn 7 ms.)
_COUNT = 1 << 20


@plain
@dataclass(frozen=True)
class Sensor(Seeded):
    """A sensor, in electrons of one pixel of the picture.

    White light at the surface, 1, fills the well: light L frees N = full_well·L electrons, which
    are read with the variance N + read_noise². Exposure, white balance and saturation come after
    and multiply the noise with the light, as ISO does.

    A pixel of the sensor holds 3 000 to 60 000 electrons, with a read noise of 1 to 5; a pixel that
    stands for n of them holds n times as many, with √n times the read noise.

    Attributes:
        full_well: electrons, ≥ 1; in `uwaug.RandomDevelopment` also a range (low, high).
        read_noise: rms, electrons; likewise.
        seed: a whole number for the same noise at each call; None for new noise.

    Source: the photon transfer curve, σ² = N + read_noise² (J. R. Janesick, *Photon Transfer*, SPIE
    2007; EMVA 1288). A normal distribution stands for Poisson's.
    """

    full_well: Range | Tensor = number(MISSING, 1.0, logarithmic=True)
    read_noise: Range | Tensor = number(3.0, 0.0)
    seed: Any = None

    @staticmethod
    def stack(sensors: "Sequence[Sensor]", like: Tensor) -> "Sensor":
        """Join the sensors of a batch, on the device of `like`."""
        columns = [[s.full_well for s in sensors], [s.read_noise for s in sensors]]
        well, read = torch.tensor(columns, dtype=like.dtype).to(like.device)[..., None, None, None]
        return Sensor(well, read, [s.seed for s in sensors])

    @property
    def variance(self) -> tuple[Any, Any]:
        """Variance of light 0, and its growth with light."""
        well: Any = self.full_well
        return (self.read_noise / well) ** 2, 1 / well

    def starts(self, batch: int, size: tuple[int, int]) -> Tensor:
        """Indices (Bx3xH) in `standard_normals` at which each row of each channel begins."""
        seeds, rows = (self.seed if isinstance(self.seed, list) else [self.seed]), []
        shape = batch // len(seeds), 3, size[0]
        for seed in seeds:
            source = None if seed is None else torch.Generator().manual_seed(seed)
            rows.append(torch.randint(_COUNT - size[1] + 1, shape, generator=source, device="cpu"))
        return torch.cat(rows)

    def normals(self, batch: int, size: tuple[int, int], like: Tensor) -> Tensor:
        """Standard normals (Bx3xHxW) of the type and on the device of `like`."""
        if self.seed is None and torch.compiler.is_compiling():  # generators cannot be traced
            return torch.randn(batch, 3, *size, dtype=like.dtype, device=like.device)
        starts = self.starts(batch, size).to(like.device)
        runs = standard_normals(like.device).unfold(0, size[1], 1)  # a view of all
        return runs.index_select(0, starts.flatten()).reshape(batch, 3, *size).to(like.dtype)

    def read(self, light: Tensor, normals: Tensor) -> Tensor:
        """Light (Bx3xHxW) with its noise, which is a constant to gradients."""
        dark, photons = self.variance
        noise: Tensor = (light.detach().clamp(min=0.0) * photons + dark).sqrt() * normals
        return light + noise


@lru_cache(maxsize=4)
def standard_normals(device: torch.device) -> Tensor:
    """Standard normals (`_COUNT`), the same in every process."""
    with torch.inference_mode(False):  # tensors of inference mode cannot be used outside
        generator = torch.Generator().manual_seed(0)
        normals = torch.randn(_COUNT, generator=generator, dtype=torch.float32, device="cpu")
        return normals.to(device)
