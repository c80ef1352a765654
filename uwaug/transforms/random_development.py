"""Random development: what a camera makes of the light."""

from dataclasses import dataclass
from typing import Any, ClassVar, get_args

from uwaug._support import checks, codec
from uwaug._support.nouns import Drawn, Noun, number
from uwaug._support.ranges import Range
from uwaug._support.types import ColorSpace
from uwaug.formation.development import DOMAINS, Development
from uwaug.formation.sensor import Sensor
from uwaug.transforms.measured import Measured

_SENSOR = Sensor((5e3, 1e6))  # from dim frames of an action camera to pictures made small


@codec.plain
@dataclass(frozen=True, repr=False)
class RandomDevelopment(Noun):
    """Draws the development of each picture. A range is a number or (low, high), drawn uniformly.

    Attributes:
        exposure: stops, counted from an automatic exposure if `metered`.
        metered: True for an automatic exposure, which keeps the mean luminance of the scene; False
            for pictures as dark as it is down there.
        white_balance, saturation, gamut, tone: as for `uwaug.Development`.
        color_space: of pictures, "srgb" or "linear".
        noise: a `uwaug.Sensor`, whose numbers may be ranges, or None.

    `PLAIN` are the options of a camera that changes nothing.

    Raises:
        ValueError: if a range falls or leaves its domain, or the colour space is unknown.
    """

    PLAIN: ClassVar = {
        "exposure": 0.0,
        "metered": False,
        "white_balance": 0.0,
        "saturation": 1.0,
        "gamut": 0.0,
        "tone": 1.0,
        "noise": None,
    }

    exposure: Range = number((-1.5, 1.0), *DOMAINS["exposure"])
    metered: bool = True
    white_balance: Range = number((-1.0, 1.0), *DOMAINS["white_balance"])
    saturation: Range = number((0.75, 1.5), *DOMAINS["saturation"])
    gamut: Range = number((0.0, 1.0), *DOMAINS["gamut"])
    tone: Range = number((0.8, 1.6), *DOMAINS["tone"])
    color_space: ColorSpace = "srgb"
    noise: Sensor | None = _SENSOR

    def __post_init__(self) -> None:
        if self.noise is not None:
            checks.instance("noise", self.noise, Sensor)
        checks.truth("metered", self.metered)
        checks.one_of("color_space", self.color_space, get_args(ColorSpace))
        self.require_ranges()

    def of(self, draw: Drawn, measured: Measured) -> Development:
        options: dict[str, Any] = {**draw, "metered": self.metered}
        if self.noise is not None:
            options["noise"] = self.noise.of(draw["noise"])
        if measured.exposure is not None:
            options |= {"exposure": measured.exposure, "metered": False}
        if measured.white_balance is not None:
            options["white_balance"] = measured.white_balance
        if measured.saturation is not None:
            options["saturation"] = measured.saturation
        return checks.unchecked(Development, **options)
