"""What a picture is taken with: water, light, exposure, camera; and the same as plain values."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, get_args

import torch
from torch import Tensor

from uwaug._support import checks
from uwaug._support.types import ColorSpace, Order
from uwaug.formation.development import NEUTRAL, Development
from uwaug.formation.exposure import Exposure, require_exposure
from uwaug.light.light import Light
from uwaug.light.lit import checked_light
from uwaug.optics.bands import Bands
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread


@dataclass(frozen=True, eq=False)
class Setup:
    """What a picture is taken with.

    Attributes:
        medium: one, or one for each picture of a batch.
        light: what shines; None for daylight as the medium has it.
        exposure: "none", "auto", or a gain in stops; see `uwaug.Underwater`.
        color_space: of the picture, given and made.
        focal_px, centre: of the camera, see `uwaug.form_image`.
        tolerance, order: as for `uwaug.form_image`.
        development: of the picture, in linear light.
    """

    medium: Medium
    light: Light | None = None
    exposure: Exposure = "none"
    color_space: ColorSpace = "srgb"
    focal_px: float | None = None
    centre: tuple[float, float] | None = None
    tolerance: float = 0.002
    order: Order = "line_of_sight"
    development: Development = NEUTRAL

    def to_dict(self) -> dict[str, Any]:
        """The setup as plain numbers and words, which JSON can hold."""
        medium, law = self.medium, self.medium.point_spread
        numbers: dict[str, Any] = {
            name: value.detach().tolist() for name, value in medium.parameters().items()
        }
        for name, value in law.numbers().items():
            if not isinstance(value, Tensor):
                numbers[name] = value
        values: dict[str, Any] = {
            "medium": numbers,
            "law": {"shape": law.shape, "reference_size": law.reference_size},
            "notes": list(medium.notes),
            "exposure": self.exposure,
            "color_space": self.color_space,
            "tolerance": self.tolerance,
            "order": self.order,
        }
        if self.development != NEUTRAL:
            values["development"] = asdict(self.development)
        if (self.focal_px, self.centre) != (None, None):
            values["camera"] = self.focal_px, self.centre
        if self.light is not None:
            values["light"] = self.light.to_list()
            if medium.bands is not None:  # which only lamps ask for
                bands = [tensor.detach().double().tolist() for tensor in medium.bands.tensors()]
                values["unlit"] = [*bands, medium.bands.tolerance]
        return values

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> "Setup":
        """The inverse of `to_dict`; what is missing but the medium is as by default.

        Raises:
            ValueError: if a value is none that `to_dict` can have given.
        """
        options = {name: values[name] for name in _OPTIONS if name in values}
        require_exposure(options.get("exposure", "none"))
        checks.one_of("color_space", options.get("color_space", "srgb"), get_args(ColorSpace))
        checks.one_of("order", options.get("order", "line_of_sight"), get_args(Order))
        checks.tolerance(options.get("tolerance", 0.002))
        focal_px, centre = values.get("camera", (None, None))
        options |= {"focal_px": focal_px, "centre": None if centre is None else tuple(centre)}
        options["development"] = Development(**values.get("development", {}))
        if "light" in values:
            light = Light.from_list(values["light"])
            options["light"] = checked_light(light, focal_px, options["centre"])
        return Setup(_medium_from(values), **options)


_OPTIONS = ("exposure", "color_space", "tolerance", "order")


def _medium_from(values: Mapping[str, Any]) -> Medium:
    numbers: dict[str, Any] = {
        name: torch.tensor(value, dtype=torch.float64) if isinstance(value, list) else float(value)
        for name, value in values["medium"].items()
    }
    law = {name: numbers.pop(name) for name in PointSpread.NUMBERS}
    bands = None
    if "unlit" in values:
        *tensors, tolerance = values["unlit"]
        doubles = [torch.tensor(t, dtype=torch.float64) for t in tensors]
        bands = Bands.of_tensors(doubles, tolerance)
    spread = PointSpread(**law, **values["law"])
    medium = Medium(**numbers, point_spread=spread, notes=tuple(values["notes"]), bands=bands)
    medium.parameters()  # has a row of each number for every medium, or raises
    return medium
