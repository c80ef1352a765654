import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from packaging.version import Version
from referees.lamps import KINDS, light_by_definition, random_case, veil_by_definition
from refusing import refusals
from scenes import rand
from torch import Tensor

from uwaug import (
    Light,
    Medium,
    PointSpread,
    RandomUnderwater,
    RandomWater,
    Scattering,
    Underwater,
    Water,
    contrast_left,
    form_image,
    load_camera,
)
from uwaug.light import Lamp
from uwaug.optics.curves import Curves
from uwaug.optics.spectra import WAVELENGTHS
from uwaug.optics.view import Rays, View

MEDIUM = Medium.from_water("5C", vertical_depth=3.0)
SPECTRAL = Medium.from_water("5C", vertical_depth=3.0, surfaces="spectral")
BESIDE = Lamp((0.4, -0.3, 0.0), 3.0, (-0.1, 0.1, 1.0), cone=45.0)
AROUND = Lamp((-0.5, 0.0, -0.2), 2.0, color=(1.0, 0.5, 0.2))
WIDE = View()


def scene(batch: int = 2) -> tuple[Tensor, Tensor]:
    return rand(batch, 3, 30, 44), 0.5 + 4 * rand(batch, 1, 30, 44, seed=1)


def wall(z: float, height: int, width: int) -> Tensor:
    """One that faces the camera: distances along the rays."""
    return z / WIDE.rays(torch.ones(1, 1, height, width, dtype=torch.float64)).shortening


@pytest.mark.parametrize("medium", [MEDIUM, SPECTRAL, MEDIUM.as_coefficients()])
def test_lights_add_and_daylight_and_gains_are_factors(medium: Medium) -> None:
    """Also in single precision."""
    _, z = scene()
    light = Light((BESIDE, AROUND), daylight=0.3)
    lamps = [Light((lamp,), 0.0).curves(medium, z, WIDE) for lamp in (BESIDE, AROUND)]
    single = light.curves(medium.to(torch.float32), z.float(), WIDE)
    brighter = light.curves(medium.brightened(torch.tensor([4.0])), z, WIDE)
    curves = light.curves(medium, z, WIDE), medium.curves(z), single, brighter
    for both, day, rounded, four_times, *parts in zip(*curves, *lamps, strict=True):
        torch.testing.assert_close(both, sum(parts) + 0.3 * day)
        torch.testing.assert_close(four_times, 4 * both)
        assert float((rounded - both).square().mean().sqrt()) < 2e-6


def test_what_arrives_is_the_spectral_integral() -> None:
    """Direct and forward together of a white wall: ∫ S_c·e^(−G(r + z)) dλ times 1/r²."""
    medium = Medium.from_water("7C", vertical_depth=40.0, tolerance=1e-6)
    light = Light((Lamp((1.0, 0.0, 0.0), 4.0),), daylight=0.0)
    z = wall(2.0, 11, 15)
    terms = form_image(torch.ones(1, 3, 11, 15).double(), z, medium, light=light)
    far = math.sqrt(5 + 0.03**2)
    water, camera = Water.jerlov("7C").at(WAVELENGTHS), load_camera("Nikon 5100 (NPL)")
    G = water.a + Scattering.CALIBRATED.g * water.b
    wanted = 4.0 / far**2 * torch.from_numpy(camera.weights(WAVELENGTHS).T @ np.exp(-G * (2 + far)))
    found = (terms.direct + terms.forward)[0, :, 5, 7]
    torch.testing.assert_close(found, wanted, rtol=0, atol=2e-6)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("water", ["I", "7C"])
def test_light_and_veil_are_by_definition(kind: str, water: str) -> None:
    medium = Medium.from_water(water, tolerance=0)
    rng = np.random.default_rng(KINDS.index(kind))
    for n in range(10):
        case = random_case(kind, rng)
        if n % 5 == 0:
            case = case._replace(lamp=replace(case.lamp, cone=None))
        # one pixel's ray
        z = torch.full((1, 1, 1, 1), case.z, dtype=torch.float64)
        ray = Rays.of(torch.full_like(z, case.x), torch.full_like(z, case.y))
        arrives, veil = Light((case.lamp,)).lit(medium.under_lamp(), ray, z)
        wanted = light_by_definition(case, medium.under_lamp())
        torch.testing.assert_close(arrives.flatten(), wanted, rtol=1e-9, atol=1e-12)
        wanted = veil_by_definition(case, medium.under_lamp())
        torch.testing.assert_close(veil.flatten(), wanted, rtol=0.005, atol=5e-4)


@pytest.mark.parametrize("rounded, noise", [(0.05, 0.0), (0.0, 0.01)])
def test_what_a_map_has_of_steps_and_noise_does_not_show(rounded: float, noise: float) -> None:
    """No relief is lit: light changes as the square of the distance does, and no more."""
    z = wall(3.0, 60, 80)
    generator = torch.Generator().manual_seed(0)
    measured = z * (1 + noise * torch.randn(z.shape, generator=generator, dtype=z.dtype))
    measured = (measured / rounded).round() * rounded if rounded else measured
    light, clear = Light((AROUND,), daylight=0.0), Medium.from_coefficients(*[(1e-9,) * 3] * 3)
    ours, smooth = (light.curves(clear, x, WIDE).direct for x in (measured, z))
    change, moved = (ours / smooth - 1).abs(), (measured / z - 1).abs()
    assert bool((change < 2.2 * moved + 1e-9).all())
    assert float(change.max()) > 0.01


def test_gradients_of_the_curves() -> None:
    z = 1 + rand(1, 1, 5, 6, seed=2)
    beta, G = torch.full((3,), 0.5).double(), torch.full((3,), 0.2).double()

    def curves(z: Tensor, beta: Tensor, G: Tensor, b: Tensor) -> Curves:
        medium = Medium.from_coefficients(beta, G, (0.1,) * 3, b_mean=b)
        return Light((BESIDE,)).curves(medium, z, WIDE)

    leaves = [value.requires_grad_() for value in (z, beta, G, torch.tensor(0.3).double())]
    torch.autograd.gradcheck(curves, leaves)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.0, 0.0, 2.0), (0.0, 0.0, -1.0)])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_no_nan_where_rays_meet_lamps(place: tuple[float, ...], dtype: torch.dtype) -> None:
    light = Light((Lamp(place, 2.0, cone=70.0), Lamp(place, aim=(1.0, 0.0, 0.0), cone=90.0)))
    for far in (0.0, 1e-3, 2.0, math.inf):
        image, z = rand(1, 3, 9, 9).to(dtype), torch.full((1, 1, 9, 9), 3.0, dtype=dtype)
        z[..., 4:6, 4:6] = far
        found = form_image(image, z.requires_grad_(), MEDIUM, light=light).image
        assert found.dtype == dtype
        assert found.isfinite().all()
        (slope,) = torch.autograd.grad(found.mean(), z)
        assert slope.isfinite().all()


def test_a_blur_is_planned_for_lamps() -> None:
    """Where daylight is gone, what a lamp's light scatters forward is blurred all the same."""
    deep = Medium.from_water("7C", vertical_depth=60.0, point_spread=PointSpread.calibrated())
    image, z = scene(1)
    light = Light((BESIDE,))
    found = form_image(image, z, deep, light=light, tolerance=0.001)
    exact = form_image(image, z, deep, light=light, tolerance=1e-5)
    law = replace(deep, scale=torch.zeros(1))
    sharp = form_image(image, z, law, light=light)
    assert float((found.image - exact.image).square().mean().sqrt()) < 0.001
    assert float((sharp.forward - exact.forward).square().mean().sqrt()) > 0.01


@pytest.mark.parametrize("surfaces", ["grey", "spectral"])
def test_a_field_is_denser_water(surfaces: Any) -> None:
    """The lamps and the scene stay where they are."""
    water = Water.jerlov("5C").at(range(400, 701, 5))
    denser = Water(water.wavelengths, 1.7 * water.a, 1.7 * water.b, 1.7 * water.kd)
    options: dict[str, Any] = {"surfaces": surfaces, "tolerance": 0}
    thin = Medium.from_water(water, vertical_depth=1.7, **options)
    dense = Medium.from_water(denser, vertical_depth=1.0, **options)
    image, z = scene()
    z[:, :, :2], z[:, :, -2:] = 1e-3, math.inf
    field = torch.full_like(z[:1], 1.7)
    degrade, wanted = (
        Underwater(medium, None, light=Light((BESIDE, AROUND))) for medium in (thin, dense)
    )
    found = degrade(image, z, field)
    torch.testing.assert_close(found, wanted(image, z), rtol=0, atol=1e-5)
    assert (found - degrade(image, 1.7 * z)).abs().max() > 0.05
    left = contrast_left(1.7 * z, thin, light=degrade.light, metres=z)
    torch.testing.assert_close(left, contrast_left(z, dense, light=degrade.light))


def test_a_drawn_field_moves_no_lamps() -> None:
    """In water so clear that a field does not show."""
    clear = Medium.from_coefficients((1e-7,) * 3, (1e-7,) * 3, (0.0,) * 3)
    light = Light((BESIDE,), daylight=0.0)
    waters = (RandomWater(clear, field=field) for field in ((0.3, 3.0), None))
    uneven, even = (RandomUnderwater(water, light=light) for water in waters)
    image, z = (value[0] for value in scene(1))
    params = uneven.make_params(image)
    without = {"samples": [{**params["samples"][0], "water": {"waters": ["medium 0"]}}]}
    for name in ("transform", "contrast_left"):
        ours = getattr(uneven, name)(image, z, params)
        theirs = getattr(even, name)(image, z, without)
        torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-5)


WRONG: list[tuple[Any, str, Any]] = [
    (Lamp, "position", (0, 0)),
    (Lamp, "position", (0, math.nan, 0)),
    (Lamp, "power", -1.0),
    (Lamp, "power", torch.ones(())),
    (Lamp, "aim", (0, 0, 0)),
    (Lamp, "cone", 120.0),
    (Lamp, "color", (1.0, -1.0, 1.0)),
    (Light, "lamps", BESIDE),
    (Light, "lamps", (3,)),
    (Light, "daylight", -1.0),
]
test_wrong_lights_are_refused = refusals(
    *((partial(kind, **{name: value}), f"{name} must") for kind, name, value in WRONG)
)


def test_a_state_holds_what_lamps_need() -> None:
    image, z = (x.float() for x in scene(1))
    light = Light((BESIDE,), daylight=0.0)
    for tolerance in (0.002, 0.0):
        media = [Medium.from_water(w, tolerance=tolerance) for w in ("3C", "5C")]
        module, other = (Underwater(medium, light=light) for medium in media)
        module.load_state_dict(other.state_dict())
        torch.testing.assert_close(module(image, z), other(image, z), rtol=0, atol=1e-6)


def test_a_stack_keeps_what_lamps_need() -> None:
    image, z = scene(1)
    sharp = PointSpread.none()
    light = Light((BESIDE,), daylight=0.2)
    bare = Medium.from_coefficients((0.5, 0.3, 0.2), (0.4, 0.2, 0.1), (0.1, 0.2, 0.3))
    grey = Medium.from_water("7C", vertical_depth=10.0, point_spread=sharp)
    spectral = Medium.from_water("II", surfaces="spectral", point_spread=sharp)
    for parts in ([grey, replace(bare, law=grey.law)], [grey, spectral]):
        for values in ((image, z), (image.float(), z.float())):  # by PyTorch, by the loops
            together = Underwater(Medium.stack(parts), None, light=light)(*values)
            for row, part in enumerate(parts):
                alone = Underwater(part, None, light=light)(*values)
                torch.testing.assert_close(together[row : row + 1], alone, rtol=0, atol=2e-6)


def test_lamps_compile() -> None:
    if Version(torch.__version__) < Version("2.13"):
        pytest.skip("torch.compile takes the module whole from torch 2.13 on")
    image, z = scene()
    module = Underwater(SPECTRAL, light=Light((BESIDE,), 0.2))
    compiled = torch.compile(module, fullgraph=True, backend="aot_eager")
    with torch.no_grad():
        torch.testing.assert_close(compiled(image, z), module(image, z), rtol=0, atol=1e-5)
