"""Measurements of a picture, on which its draw may depend."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from uwaug._support import checks
from uwaug.formation.development import metering_points

SAMPLED = 2048  # pixels of which the median distance is taken; it is right within 2 %


class Measured(NamedTuple):
    """Measurements of a picture, its distances and its camera, on which its draw may depend.

    Attributes:
        width, height: px.
        darkest, brightest: ends of the values, of 0…1; of bytes 0 and 1.
        nearest, farthest, median: distances, m; the last two of all but open water, else infinite.
        metered: True if an exposure makes up for the light that is lost above the scene.
        exposure: stops that a meter has settled for all frames of a film; None: to be metered.
        white_balance: factors of red, green and blue, likewise.
        saturation: likewise.
        moved: m by which the water of a film has moved to the right, down and away.
    """

    width: int
    height: int
    darkest: float
    brightest: float
    nearest: float
    farthest: float
    median: float
    metered: bool = False
    exposure: float | None = None
    white_balance: tuple[float, float, float] | None = None
    saturation: float | None = None
    moved: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def of_film(self, settled: Mapping[str, Any], moved: tuple[float, float, float]) -> "Measured":
        """The same picture, with what is settled once for all frames of its film."""
        balance = settled.get("white_balance")  # a list, as JSON holds it
        attributes = {**settled, "white_balance": balance and tuple(balance)}
        return self._replace(**attributes, moved=moved)


def measure(pictures: Tensor, metres: Tensor, *, metered: bool) -> list[Measured]:
    """Measure pictures (Bx3xHxW) and their distances (Bx1xHxW, m): all that the host waits for
    where they are on a device.
    """
    height, width = metres.shape[-2:]
    points = metering_points(height, width, metres.device)[:SAMPLED]
    values, distances = pictures.detach().flatten(1), metres.detach().flatten(1)
    rows = _rows_on_host if checks.on_host(metres) else _rows_on_device
    measurements = []
    for i, (dark, bright, near, far, median) in enumerate(rows(values, distances, points)):
        if math.isinf(median):  # all is open water, or all of the points
            median = _median(distances[i].cpu().numpy())
        measurements.append(Measured(width, height, dark, bright, near, far, median, metered))
    return measurements


def _rows_on_host(values: Tensor, distances: Tensor, points: Tensor) -> list[list[float]]:
    """Ends of values, ends and median of distances, for each picture."""
    rows = []  # along a dimension PyTorch takes 15 times as long as over all of a picture
    for picture, metres in zip(values, distances, strict=True):
        nearest, farthest = checks.extent(metres)
        if math.isinf(farthest):
            farthest = checks.extent(metres.nan_to_num(posinf=0.0))[1] or math.inf
        ends = checks.extent(picture) if picture.is_floating_point() else (0.0, 1.0)
        median = _median(metres.index_select(0, points).numpy())
        rows.append([*ends, nearest, farthest, median])
    return rows


def _rows_on_device(values: Tensor, distances: Tensor, points: Tensor) -> list[list[float]]:
    solid = torch.where(distances.isfinite(), distances, -math.inf).amax(1).abs()
    samples = distances.index_select(1, points).sort(1).values  # open water and NaN come last
    middle = samples.isfinite().sum(1, keepdim=True) // 2
    median = samples.gather(1, middle.clamp(max=samples.shape[1] - 1))[:, 0]
    darkest, brightest = median.new_zeros(len(values)), median.new_ones(len(values))
    if values.is_floating_point():
        darkest, brightest = values.amin(1), values.amax(1)
    columns = (darkest, brightest, distances.amin(1), solid, median)
    kind = torch.promote_types(distances.dtype, torch.float32)
    rows: list[list[float]] = torch.stack([x.to(kind) for x in columns], 1).cpu().tolist()
    return rows


def _median(distances: Any) -> float:
    solid = distances[np.isfinite(distances)]
    middle = solid.size // 2
    return float(np.partition(solid, middle)[middle]) if solid.size else math.inf
