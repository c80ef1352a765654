"""Marine snow: particles in the water, drawn one by one."""

import json
import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import torch
from refusing import refusals
from scenes import picture, rand
from torch import Tensor

from uwaug import (
    Lamp,
    Light,
    MarineSnow,
    Medium,
    RandomUnderwater,
    RandomWater,
    Underwater,
    contrast_left,
    form_image,
)
from uwaug._support import codec
from uwaug.optics.snow import COUNTED, SIZES, Particles

BETA, G, AMBIENT = (0.5, 0.3, 0.2), (0.3, 0.2, 0.1), (0.4, 0.6, 0.8)
WATER = Medium.from_coefficients(BETA, G, (0.1, 0.2, 0.3), light=AMBIENT)
LAMPS = Light((Lamp((0.4, -0.3, 0.0), 3.0, (-0.1, 0.1, 1.0), cone=60.0),), daylight=0.3)
SNOW = MarineSnow(3000, seed=7)
SIZE = (96, 128)


def far(size: tuple[int, int] = SIZE, metres: float = 6.0) -> Tensor:
    return torch.full((1, 1, *size), metres, dtype=torch.float64)


def layer(
    snow: MarineSnow, z: Tensor, light: Light | None = None, medium: Medium = WATER
) -> Tensor:
    """What particles add to a picture (3xHxW)."""
    black = z.new_zeros(1, 3, *z.shape[-2:])
    with_it = form_image(black, z, medium.with_snow(snow), light=light)
    return (with_it.image - form_image(black, z, medium, light=light).image)[0]


@pytest.fixture
def single(monkeypatch: pytest.MonkeyPatch):
    """Lets one round particle of full reflectance float before the camera."""

    def float_there(x: float, y: float, z: float, diameter: float) -> None:
        values = (x, y, z, diameter, 1.0, 0.3, 1.0)
        particle = Particles(*(np.array([value]) for value in values))
        monkeypatch.setattr(MarineSnow, "particles", lambda *_: particle)

    return float_there


def radiance(x: float, y: float, z: float, light: Light | None) -> Tensor:
    """Of a white surface at a point, by the definitions."""
    r = math.hypot(x * z, y * z, z)
    direct = torch.tensor(AMBIENT).double() * torch.exp(-torch.tensor(BETA).double() * r)
    if light is None:
        return direct
    (lamp,) = light.lamps
    to = torch.tensor([x * z, y * z, z]) - torch.tensor(lamp.position)
    path = float(to.norm())
    axis = torch.tensor(lamp.aim) / torch.tensor(lamp.aim).norm()
    inner, outer = lamp.fade
    t = min(max((float(to @ axis) / path - outer) / (inner - outer), 0.0), 1.0)
    cone = t * t * (3 - 2 * t)
    # to the particle what was scattered forward lights it, too; from there it is lost
    way = torch.tensor(G).double() * path + torch.tensor(BETA).double() * r
    return light.daylight * direct + lamp.power * cone / (path**2 + 0.03**2) * torch.exp(-way)


@pytest.mark.parametrize("light", [None, LAMPS])
@pytest.mark.parametrize(
    "place, diameter",
    [((0.0, 0.0, 1.5), 1e-4), ((0.23, -0.11, 0.4), 5e-4), ((-0.3, 0.3, 3.0), 4e-3)],
)
def test_a_particle_sends_its_radiance_times_its_area(single, place, diameter, light) -> None:
    single(*place, diameter)
    focal = SIZE[1] / 2 / math.tan(math.radians(30))
    area = math.pi / 4 * (diameter / place[2] * focal) ** 2
    added = layer(replace(SNOW, reflectance=0.4), far(), light)
    expected = 0.4 * area * radiance(*place, light)
    # a lamp has a radius, by which angles to it differ
    torch.testing.assert_close(added.sum((1, 2)), expected, rtol=5e-3, atol=1e-12)


def test_a_disc_has_its_radiance(single) -> None:
    # 50 px wide in focus, and 1.9 mm across a lens of 20 mm
    focal = 200 / math.tan(math.radians(30))
    z = far((400, 400))
    single(0.0, 0.0, 0.05, 50 / focal * 0.05)
    sharp = layer(replace(SNOW, reflectance=1.0, focus=0.05), z)
    white = radiance(0.0, 0.0, 0.05, None)
    torch.testing.assert_close(sharp[:, 200, 200], white, rtol=0.06, atol=0)
    single(0.0, 0.0, 0.1, 1.9e-3)
    blurred = layer(replace(SNOW, reflectance=1.0, aperture=0.02, focus=1e6), z)
    white = radiance(0.0, 0.0, 0.1, None)
    torch.testing.assert_close(blurred[:, 200, 200], white * 0.095**2, rtol=0.03, atol=0)
    # as wide as the circle of confusion: .2 of the distance along the axis
    reach = (blurred[1, 200] > 0.5 * blurred[1, 200, 200]).sum()
    assert abs(float(reach) - 0.2 * focal) < 2


def test_the_same_particles_at_any_size() -> None:
    pool = torch.nn.functional.avg_pool2d
    small, large = layer(SNOW, far()), layer(SNOW, far((2 * SIZE[0], 2 * SIZE[1])))
    pooled = pool(large, 2)
    torch.testing.assert_close(pooled.sum(), small.sum(), rtol=0.03, atol=0)
    assert pool(pooled - small, 4).abs().mean() < 0.15 * small.mean()
    other = layer(replace(SNOW, seed=6), far())
    assert pool(other - small, 4).abs().mean() > 0.5 * small.mean()


def test_the_scene_hides_what_is_behind_it() -> None:
    z = far()
    z[..., :64] = 0.04  # nearer than any particle
    z[..., 64:96] = 1.0
    seen, all_of_it = layer(SNOW, z), layer(SNOW, far())
    assert all_of_it[..., :64].max() > 0.01
    assert seen[..., :64].abs().max() < 1e-12
    torch.testing.assert_close(seen[..., 96:], all_of_it[..., 96:])
    assert 0.1 < seen[..., 64:96].sum() / all_of_it[..., 64:96].sum() < 0.95


@pytest.mark.parametrize("drift", [(0.0, 0.0, 0.0), (-2.3, 0.7, 31.1)])
def test_number_and_sizes_are_those_of_the_water(drift) -> None:
    near, at_2_mm, volume = 0.45, 0, 0.0
    count = 0
    for seed in range(20):
        drawn = replace(SNOW, density=20_000, seed=seed, drift=drift).particles(0.6, 0.4)
        inside = (np.abs(drawn.x) < 0.6) & (np.abs(drawn.y) < 0.4)
        inside &= (drawn.z > 0.2) & (drawn.z < near)
        count += int((inside & (drawn.diameter > COUNTED)).sum())
        at_2_mm += int((inside & (drawn.diameter > 4 * COUNTED)).sum())
        volume += 1.2 * 0.8 * (near**3 - 0.2**3) / 3
        assert SIZES[0] < drawn.diameter.min() < 1.2 * SIZES[0]
        assert 0.8 * SIZES[1] < drawn.diameter.max() < SIZES[1]
    # what is larger than 5 mm, 1 % of it, is not drawn
    expected = 20_000 * volume * (1 - 0.01)
    assert abs(count - expected) < 4 * math.sqrt(expected)
    assert abs(at_2_mm - expected / 16 * (1 - 0.16)) < 4 * math.sqrt(expected / 16)


@pytest.mark.parametrize("drift", [(0.05, 0.0, 0.0), (-0.03, 0.02, 0.0), (0.01, 0.0, -0.04)])
def test_each_particle_keeps_its_place_in_the_water(drift) -> None:
    focal = SIZE[1] / 2 / math.tan(math.radians(30))
    still, moved = (replace(SNOW, drift=way).particles(0.6, 0.4) for way in ((0, 0, 0), drift))
    # a diameter is a particle's own
    _, before, after = np.intersect1d(still.diameter, moved.diameter, return_indices=True)
    assert 0.6 * len(still.z) < len(before) < len(still.z)
    assert abs(len(moved.z) - len(still.z)) < 0.05 * len(still.z)
    z, steps = still.z[before], np.zeros((3, len(before)))
    for axis, name in enumerate("xy"):
        x, y = getattr(still, name)[before], getattr(moved, name)[after]
        steps[axis] = y * moved.z[after] - x * z
        if not drift[2]:  # near ones more: by f·t/z px
            px = focal * (y - x)
            assert np.mean(np.abs(px - focal * drift[axis] / z) < 1e-6) > 0.97
    steps[2] = moved.z[after] - z
    assert np.mean(np.abs(steps.T - drift).max(1) < 1e-9) > 0.97  # others come anew


@pytest.mark.parametrize("view", [(0.577, 144.0), (11.4, 8.6), (0.01, 0.01)])
def test_memory_goes_with_what_is_seen(view) -> None:
    tracemalloc.start()
    drawn = MarineSnow(1e5, seed=0).particles(*view)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(drawn.z) > 100
    assert peak < 250e6


def test_gradients_pass() -> None:
    image, z = rand(1, 3, *SIZE).requires_grad_(), far().requires_grad_()
    beta = torch.tensor(BETA, dtype=torch.float64, requires_grad=True)
    medium = Medium.from_coefficients(beta, G, (0.1, 0.2, 0.3)).with_snow(SNOW)
    total = form_image(image, z, medium, light=LAMPS).image.sum()
    for slope in torch.autograd.grad(total, (image, z, beta)):
        assert bool(slope.isfinite().all())
        assert bool((slope != 0).any())


def test_it_takes_contrast() -> None:
    z, snowy = far().float(), WATER.with_snow(SNOW)
    left = [contrast_left(z, medium) for medium in (WATER, snowy)]
    assert bool((left[1] <= left[0] + 1e-6).all())
    assert (left[0] - left[1]).max() > 0.01
    # where a field makes water denser, no more particles float before what is near
    near = torch.full_like(z, 0.04)
    of_both = (contrast_left(100 * near, medium, metres=near) for medium in (WATER, snowy))
    torch.testing.assert_close(*of_both)


def test_in_copies_and_records() -> None:
    medium = WATER.with_snow(SNOW)
    both = Medium.stack([medium, WATER])
    assert both.snow == (SNOW, None)
    assert both[1].snow == (None,)
    assert medium.expand(3).snow == (SNOW,) * 3
    assert medium.to(torch.float32).snow == medium.under_lamp().snow == (SNOW,)
    plain = json.loads(json.dumps(codec.to_plain(both)))
    assert codec.from_plain(plain, Medium).snow == both.snow
    assert medium.with_snow(None).snow == Medium.stack([WATER, WATER]).snow == ()


@pytest.mark.parametrize("waters", ["II", WATER])
def test_drawn_anew_for_each_picture_and_moved_in_a_film(waters) -> None:
    snow = MarineSnow((500, 2000), aperture=0.002)
    augment = RandomUnderwater(RandomWater(waters, field=None, snow=snow), conditions=None)
    options = {"water": {"snow": {"density": [500, 2000], "aperture": 0.002}}}
    assert RandomUnderwater.from_dict(options).water.snow == snow
    image, z = picture(*SIZE), far().float()
    record = augment.make_params(image, torch.Generator().manual_seed(6))
    drawn = record["samples"][0]["water"]["snow"]
    assert drawn.keys() == {"density", "seed"}
    assert 500 <= drawn["density"] <= 2000
    film = augment.for_clip(record, image[0], z[0])
    still = augment.transform(image[0], z[0], film)
    for way in ({"moved": 0.1}, {"motion": [0.0, 0.05, 0.02]}):
        film["samples"][0] |= way
        moved = augment.transform(image[0], z[0], film)
        assert (still - moved).abs().max() > 0.02
        assert ((still - moved).abs() < 1e-3).float().mean() > 0.3
        still = moved


def test_a_seed_is_kept_and_a_film_adds_to_its_drift() -> None:
    """Less the way of the camera."""
    snow = replace(SNOW, drift=(0.25, 0.0, 0.0))
    augment = RandomUnderwater(RandomWater(["II", WATER], snow=snow))
    image, z = picture(*SIZE)[0], far().float()[0]
    drawn = augment.make_params(image, torch.Generator().manual_seed(0))["samples"][0]
    for name in ("II", "medium 1"):
        sample = {**drawn, "water": {**drawn["water"], "waters": [name]}, "moved": 0.5}
        sample["motion"] = [0.1, 0.2, 0.3]
        (scene,) = augment.scenes(image, z, {"samples": [sample]}).scenes
        (snow,) = scene.setting.medium.snow
        assert replace(snow, drift=SNOW.drift) == SNOW
        assert snow.drift == pytest.approx((0.65, -0.2, -0.3))


test_what_is_refused = refusals(
    (lambda: MarineSnow(density=0.0), "density"),
    (lambda: MarineSnow(density=(5000, 500)), "density"),
    (lambda: MarineSnow(reflectance=1.5), "reflectance"),
    (lambda: MarineSnow(focus=0.0), "focus"),
    (lambda: MarineSnow(drift=0.1), "drift"),
    (lambda: MarineSnow(seed=1.5), "seed"),
    (lambda: MarineSnow(seed=2**32), "seed"),
    (lambda: WATER.with_snow(MarineSnow((500, 5000))), "density"),
    (lambda: RandomWater(snow=2000.0), "snow must be"),
)


def test_without_a_seed_each_picture_of_a_batch_has_its_own() -> None:
    pictures, one_map = torch.zeros(2, 3, *SIZE), far().float()
    degrade = Underwater(WATER.with_snow(replace(SNOW, seed=None)), None, color_space="linear")
    for values in (pictures, pictures.double()):  # by the loops, by PyTorch
        first, second = degrade(values, one_map.to(values))
        assert (first - second).abs().max() > 1e-3


@pytest.mark.parametrize("light", [None, Light()])
def test_in_a_field_a_particle_keeps_its_place_and_loses_light(single, light) -> None:
    single(0.0, 0.0, 1.5, 5e-4)
    metres = far()
    degrade, snowy = (
        Underwater(medium, None, color_space="linear", light=light)
        for medium in (WATER, WATER.with_snow(SNOW))
    )

    def added(density: float) -> Tensor:
        values = metres.new_zeros(1, 3, *SIZE), metres, torch.full_like(metres, density)
        return (snowy(*values) - degrade(*values))[0].sum((1, 2))

    lost = torch.exp(-1.5 * torch.tensor(BETA).double())
    torch.testing.assert_close(added(2.0), lost * added(1.0))
