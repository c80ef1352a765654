"""What is random about a camera."""

from dataclasses import asdict, dataclass
from typing import get_args

from uwaug._support import checks, codec
from uwaug._support.ranges import Range
from uwaug._support.types import ColorSpace
from uwaug.formation.development import Development, sensor_of
from uwaug.formation.sensor import Sensor
from uwaug.transforms.draws import Draw, checked
from uwaug.transforms.measured import Measured


@codec.plain
@dataclass(frozen=True)
class RandomDevelopment:
    """From what the development of each picture is drawn, see `uwaug.Development`.

    A range is a number or (low, high), drawn uniformly.

    Attributes:
        color_matrix: share of the camera's colour matrix, 0…1: photographs have been through
            cameras that apply much or little of theirs. None for grey surfaces, where a channel of
            the picture depends on that of the scene alone, see `uwaug.Medium.from_water`.
        exposure: stops.
        metered: whether they count from an automatic exposure, which keeps the mean luminance of
            the scene. If not, pictures get as dark as it is down there.
        white_balance, saturation, gamut, tone: as for `uwaug.Development`.
        color_space: of pictures, "srgb" or "linear".
        noise: the sensor, a `uwaug.Sensor` whose numbers may be ranges, full_well drawn uniformly
            in its logarithm; None for light without noise.

    Raises:
        ValueError: if a range falls or leaves its domain, or the colour space is unknown.
    """

    color_matrix: Range | None = (0.0, 0.8)
    exposure: Range = (-1.2, 0.4)
    metered: bool = True
    white_balance: Range = (-1.0, 0.3)
    saturation: Range = (0.85, 1.3)
    gamut: Range = (0.7, 1.0)
    tone: Range = (0.9, 1.6)
    color_space: ColorSpace = "srgb"
    noise: Sensor | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "noise", sensor_of(self.noise))
        checked(self.ranges())
        checks.one_of("color_space", self.color_space, get_args(ColorSpace))

    def ranges(self) -> dict[str, Range | None]:
        """Each number that a picture draws, by name; None where there is none."""
        fixed = ("metered", "color_space", "noise")
        own = {name: value for name, value in asdict(self).items() if name not in fixed}
        if self.noise is not None:
            own |= {name: getattr(self.noise, name) for name in ("full_well", "read_noise")}
            own["noise_seed"] = checks.DOMAIN["noise_seed"]
        return own

    def of(self, draw: Draw, seen: Measured) -> Development:
        """The development of a picture; that of a film has been settled."""
        numbers, noise = draw.numbers, self.noise
        if noise is not None:
            well, read = numbers["full_well"], numbers["read_noise"]
            noise = Sensor(well, read, int(numbers["noise_seed"]))
        return Development(
            exposure=numbers["exposure"] if seen.exposure is None else seen.exposure,
            white_balance=seen.white_balance or numbers["white_balance"],
            saturation=numbers["saturation"],
            gamut=numbers["gamut"],
            tone=numbers["tone"],
            metered=self.metered and seen.exposure is None,
            noise=noise,
        )
