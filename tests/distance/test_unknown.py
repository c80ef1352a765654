"""Numbers in maps that are no distance: the sky, unknown pixels, the end of a range."""

import math
from itertools import product

import pytest
import torch
from augmenting import picture
from torch import Tensor

from uwaug import RandomUnderwater, RandomWater
from uwaug.distance import Inverse, Metres, Relative, Source
from uwaug.distance.unknown import of_metres, of_shares, range_end

H, W = 24, 33
WATER = RandomWater("3C", contrast=0.5)
RECORD = RandomUnderwater(WATER).make_params(picture(), torch.Generator().manual_seed(0))
NUMBERS = {"near": 1.0, "far": 5.0, "gamma": 1.0}


def floor() -> Tensor:
    """Distances of a floor that ends at a wall, which is up, 1xHxW."""
    return (2 / torch.linspace(0.1, 1, H)).clamp(max=8.0)[:, None].expand(1, H, W).clone()


def sky(value: float, rows: int = 14, z: Tensor | None = None) -> Tensor:
    z = floor() if z is None else z.clone()
    z[:, :rows] = value
    return z


def holed(z: Tensor, *values: float) -> Tensor:
    """A map with several numbers in place of distances."""
    z = z.clone()
    for k, value in enumerate(values):
        z[..., 3:6, 4 + 5 * k : 9 + 5 * k] = value
    return z


def transformed(z: Tensor, source: Source | None = None) -> Tensor:
    augment = RandomUnderwater(WATER, distance=source or Metres())
    return augment.transform(picture(), z, RECORD)


@pytest.mark.parametrize("source", [Metres(), Metres("behind"), Metres("fill")])
@pytest.mark.parametrize("value", [51.3, 306.0, 459.1, 123.456])
def test_facades_and_horizons_are_no_stand_ins(value: float, source: Metres) -> None:
    """One number, far beyond all others, as planar depth has of whatever faces the camera."""
    horizon = 3 * floor()
    horizon[:, 0] = value
    for z in (holed(3 * floor(), value), horizon):
        kept = source.metres(z, picture(), {})
        # 20 times the median are open water, as where a renderer ends
        open_water = (kept == torch.inf) & (z == value) & (value > 200)
        assert bool(((kept == z) | open_water).all())


@pytest.mark.parametrize("rows, is_lidar", [(slice(None, None, 4), True), (slice(9), False)])
def test_infinity_among_near_pixels_is_unknown(rows: slice, is_lidar: bool) -> None:
    """Every fourth row, as of a lidar; or a sky."""
    lidar, holed = floor(), floor()
    lidar[:, rows], holed[:, rows] = math.inf, math.nan
    for source in (Metres("behind"), Metres(3.0)):
        expected = source.metres(holed if is_lidar else lidar, picture(), {})
        assert torch.equal(source.metres(lidar, picture(), {}), expected)
    for source in (Metres(), Metres("far")):
        assert torch.equal(source.metres(lidar, picture(), {}), lidar)


@pytest.mark.parametrize("z", [sky(65535.0, z=1000 * floor()), torch.full((1, H, W), 3000.0)])
def test_millimetres_are_told_from_a_sky(z: Tensor) -> None:
    with pytest.raises(ValueError, match="divide by 1000"):
        transformed(z)


TRUE: dict[str, Tensor] = {
    "a slope": torch.linspace(2, 90, H * W).reshape(1, H, W),
    "a wall": torch.full((1, H, W), 60.0),
    "a wall behind a floor": sky(60.0, 8, torch.linspace(80, 2, H)[:, None].expand(1, H, W)),
    "a box before a wall": holed(torch.full((1, H, W), 55.0), 3.0),
    "a wall at 49 m": sky(49.0, 8),
    "wild pixels": floor().index_fill(2, torch.tensor(3), 80.0) + torch.rand(1, H, W),
}


@pytest.mark.parametrize("name", TRUE)
def test_true_distances_stay(name: str) -> None:
    z = TRUE[name]
    assert torch.equal(Metres().metres(z, picture(), {}), z)
    assert not bool((of_metres(z) | range_end(z)).any())


STRETCHED: dict[str, Tensor] = {
    "a network's, with a sky": (1 / sky(math.inf, 3, torch.linspace(99, 1, H * W).view(1, H, W))),
    "a network's, in 8 bits": ((255 / floor()).round() - 31) / 96,
    "a network's, standardised": torch.linspace(-2, 2, H * W).reshape(1, H, W),
    "of a floor, of which a box is nearest": holed(8 / floor(), 6.0),
    "relative, stretched": (floor() - 2) / 6,
    "flat but for a box": holed(torch.ones(1, H, W), 0.0),
    "a network's, below 0 behind": torch.where(
        torch.arange(W) < 12, 1.5 + 0.1 * torch.rand(1, H, W), torch.linspace(-1, -0.1, H)[:, None]
    ),
}


@pytest.mark.parametrize("name", STRETCHED)
def test_stretched_maps_have_no_number_alone(name: str) -> None:
    assert not bool(of_shares(STRETCHED[name]).any())


UNKNOWN: dict[str, tuple[Source, Tensor, tuple[float, ...]]] = {
    "0 in a disparity": (Inverse(holes="behind"), 100 / floor(), (0.0,)),
    "−1 in a disparity": (Inverse(holes="behind"), 100 / floor(), (-1.0,)),
    "−1 and 0 in a disparity": (Inverse(holes="far"), 100 / floor(), (-1.0, 0.0)),
    "0 in a disparity that is near 0 far away": (Inverse(holes="fill"), 100 / floor() ** 2, (0.0,)),
    "65535 in a disparity": (Inverse(holes="behind"), 100 / floor(), (65535.0,)),
    "−1 in a relative map": (Relative(holes="fill"), (floor() - 2) / 6, (-1.0,)),
    "0 in a map divided by its largest": (Relative(holes="behind"), floor() / 8, (0.0,)),
    "1 in a map divided by 65535": (Relative(holes="far"), floor() / 65.535, (1.0,)),
    "65.535 m": (Metres("behind"), floor(), (65.535,)),
    "65.535 m in a wide scene": (Metres("behind"), 7 * floor(), (65.535,)),
    "0 and 32.767 m of a wide scene": (Metres("fill"), 3 * floor(), (0.0, 327.67)),
}


@pytest.mark.parametrize("case", UNKNOWN)
def test_stand_ins_are_unknown_pixels(case: str) -> None:
    source, z, values = UNKNOWN[case]
    expected = source.metres(holed(z, *[torch.nan for _ in values]), picture(), NUMBERS)
    assert torch.equal(source.metres(holed(z, *values), picture(), NUMBERS), expected)


SKIES = [*product((327.67, 655.35, 9999.0, 65504.0, 1e7, 3e38), (1, 14, 20)), (1e7, H), (1e10, H)]


@pytest.mark.parametrize("value, rows", SKIES)
@pytest.mark.parametrize("host", [True, False])
def test_a_sky_that_stands_alone_or_that_no_one_sees_is_open_water(
    value: float, rows: int, host: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uwaug._support.checks.on_host", lambda x: host)
    expected = transformed(sky(math.inf, rows))
    for source in (Metres(), Metres("far")):
        assert torch.equal(transformed(sky(value, rows), source), expected)


@pytest.mark.parametrize("host", [True, False])
def test_a_renderer_ends_somewhere(host: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A ground goes on to the end of the range, at 1000 m, where the sky is."""
    monkeypatch.setattr("uwaug._support.checks.on_host", lambda x: host)
    z = floor()
    z[:, 14] = torch.linspace(200, 990, W)
    z[:, 15] = torch.linspace(20, 190, W)
    expected = transformed(sky(math.inf, 14, z))
    assert torch.equal(transformed(sky(1000.0, 14, z)), expected)


@pytest.mark.parametrize(
    "source, z, value",
    [(Metres(), floor(), 65.535), (Inverse(), 100 / floor(), 0.0), (Relative(), floor() / 8, 0.0)],
)
@pytest.mark.usefixtures("nothing_is_said")
def test_what_may_be_a_hole_is_asked_for_once(source: Source, z: Tensor, value: float) -> None:
    few = holed(z, value)
    with pytest.warns(UserWarning, match=rf"1.9 % of a map are {value:g}, a gap .*--holes behind"):
        metres = source.metres(few, picture(), NUMBERS)
    assert torch.equal(source.metres(few, picture(), NUMBERS), metres)  # silent
    if source == Metres():
        assert torch.equal(metres, few)


@pytest.mark.parametrize("value", [-1.0, 9e4])
def test_other_numbers_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match=rf"1.9 % of a map are {value:g}, a gap .*--holes behind"):
        Inverse().metres(holed(100 / floor(), value), picture(), NUMBERS)
