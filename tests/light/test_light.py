import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from referees.lamps import KINDS, random_case, veil_by_definition
from scenes import rand
from torch import Tensor

import uwaug
from uwaug import Light, Medium, Underwater, form_image
from uwaug.formation.scene import Terms
from uwaug.light.backscatter import grid_of, integrated, interpolated, polynomials_of
from uwaug.light.geometry import normals, ray_of, view_of

FOCAL = 50.0
MEDIUM = Medium.from_water("5C", vertical_depth=3.0).to(torch.float64)
TERMS = ("direct", "forward", "backscatter")


def beside(**options: Any) -> Light:
    """A lamp beside the camera."""
    values = {"power": 3.0, "cone": 45.0, **options}
    return Light.lamp((0.4, -0.3, 0.0), (-0.1, 0.1, 1.0), **values)


def scene(batch: int = 2, height: int = 30, width: int = 44) -> tuple[Tensor, Tensor]:
    return rand(batch, 3, height, width), 0.5 + 4 * rand(batch, 1, height, width, seed=1)


def formed(light: Light | None, medium: Medium = MEDIUM, **options: Any) -> Terms:
    image, z = scene()
    return form_image(image, z, medium, light=light, focal_px=FOCAL, **options)


@pytest.mark.parametrize("light", [None, Light.ambient()])
def test_the_default_is_todays_picture_bit_for_bit(light: Light | None) -> None:
    image, z = scene()
    today, ours = form_image(image, z, MEDIUM), formed(light)
    for term in TERMS:
        assert torch.equal(getattr(today, term), getattr(ours, term))


@pytest.mark.parametrize("field", [None, 0.6 + rand(2, 1, 30, 44, seed=5)])
@pytest.mark.parametrize("order", ["line_of_sight", "source"])
def test_lights_add(field: Tensor | None, order: Any) -> None:
    lights = [beside(), Light.ambient(0.3, gradient=0.5), Light.parallel(40.0, 30.0)]
    lights.append(Light.lamp((-0.5, 0.0, -0.2), (0.1, 0.0, 1.0), 2.0, rgb=(1.0, 0.5, 0.2)))
    plan = uwaug.blur.plan_blur(0.1, 6.0, 0.002)
    together = Light.none()
    apart = torch.zeros(2, 3, 30, 44, dtype=torch.float64)
    for light in lights:
        together = together + light
        apart += formed(light, field=field, order=order, plan=plan).image
    found = formed(together, field=field, order=order, plan=plan).image
    torch.testing.assert_close(found, apart, rtol=1e-12, atol=1e-12)


def test_a_far_wide_lamp_is_uniform_light() -> None:
    """On a plane that faces it, in clear water, whose ambient light has the lamp's power."""
    clear = Medium.from_coefficients((1e-9,) * 3, (1e-9,) * 3, (0.0,) * 3).to(torch.float64)
    image, _ = scene()
    view = view_of((30, 44), FOCAL, None, image)
    z = (2.0 / view.shortening()).expand(2, 1, -1, -1)
    far = 1e4
    lamp = Light.lamp((0, 0, -far), (0, 0, 1), far**2, cone=180.0)
    found = form_image(image, z, clear, light=lamp, focal_px=FOCAL).image
    torch.testing.assert_close(found, form_image(image, z, clear).image, rtol=1e-3, atol=0)


@pytest.mark.parametrize("gradient", [-0.5, 0.8])
def test_the_veil_follows_the_look(gradient: float) -> None:
    level, tilted = formed(Light.ambient()), formed(Light.ambient(gradient=gradient))
    rays = view_of((30, 44), FOCAL, None, level.image)
    sine = -rays.y * rays.shortening()
    wanted = level.backscatter * torch.exp(gradient * sine)
    torch.testing.assert_close(tilted.backscatter, wanted)
    assert torch.equal(tilted.direct, level.direct)


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.5, 0.2), (-0.3, 0.8)])
def test_normals_of_a_plane(tilt: tuple[float, float]) -> None:
    view = view_of((20, 33), FOCAL, None, rand(1))
    n = torch.tensor([*tilt, 1.0], dtype=torch.float64)
    planar = 3.0 / (view.x * n[0] + view.y * n[1] + n[2])
    found = normals(planar / view.shortening(), view)
    torch.testing.assert_close(found, (n / 3.0)[None, :, None, None].expand_as(found))


@pytest.mark.parametrize("rounded, noise", [(0.01, 0.0), (0.0, 0.003)])
def test_normals_of_a_measured_map(rounded: float, noise: float) -> None:
    """Of a plane, as a camera with steps of 1 cm at 3 m or with .3 % of noise maps it."""
    view = view_of((60, 80), 500.0, None, torch.zeros((), dtype=torch.float64))
    plane = torch.tensor([0.1, -0.05, 0.3], dtype=torch.float64)
    inverse = plane[0] * view.x + plane[1] * view.y + plane[2]
    z = 1 / (inverse * view.shortening())
    generator = torch.Generator().manual_seed(0)
    measured = z * (1 + noise * torch.randn(z.shape, generator=generator, dtype=z.dtype))
    measured = (measured / rounded).round() * rounded if rounded else measured
    slopes = normals(measured, view)
    cosine = (slopes * plane.reshape(1, 3, 1, 1)).sum(1) / slopes.norm(dim=1) / plane.norm()
    degrees = torch.rad2deg(torch.acos(cosine.clamp(max=1)))[..., 10:-10, 10:-10]
    assert float(degrees.square().mean().sqrt()) < 3  # 21 and 45 without smoothing


def test_normals_stop_at_an_edge() -> None:
    view = view_of((20, 32), FOCAL, None, rand(1))
    planar = torch.where(torch.arange(32) < 16, 2.0, 6.0).double().expand(1, 1, 20, 32)
    found = normals(planar / view.shortening(), view)
    assert float(found[:, :2].abs().max()) < 1e-12


def test_the_sun_shades_by_lamberts_cosine() -> None:
    view = view_of((20, 32), FOCAL, None, rand(1))
    image, z = rand(1, 3, 20, 32), 3.0 / view.shortening()
    # from behind the camera, 30° above the horizon, onto a wall that faces the camera
    found = form_image(image, z, MEDIUM, light=Light.parallel(30, 180, diffuse=0.2), focal_px=FOCAL)
    wanted = form_image(image, z, MEDIUM)
    share = 0.2 + 0.8 * math.cos(math.radians(30))
    torch.testing.assert_close(found.direct, share * wanted.direct)
    torch.testing.assert_close(found.backscatter, wanted.backscatter)


def test_a_lamp_on_a_wall() -> None:
    """One point by hand: inverse square, cosine, both legs, no scattering."""
    a = torch.tensor([0.5, 0.2, 0.1], dtype=torch.float64)
    medium = Medium.from_coefficients(a, a, (0.0,) * 3)
    light = Light.lamp((1.0, 0.0, 0.0), (0, 0, 1), 4.0, cone=180.0, rgb=(1.0, 0.9, 0.8))
    view = view_of((11, 15), FOCAL, None, a)
    image, z = torch.ones(1, 3, 11, 15, dtype=torch.float64), 2.0 / view.shortening()
    found = form_image(image, z, medium, light=light, focal_px=FOCAL)
    squared = 1 + 4 + 0.03**2
    share = 4.0 / squared * 2 / math.sqrt(squared)
    colour = torch.tensor([1.0, 0.9, 0.8], dtype=torch.float64)
    wanted = share * colour * torch.exp(-a * (2 + math.sqrt(squared)))
    torch.testing.assert_close(found.direct[0, :, 5, 7], wanted)
    assert float(found.forward.abs().max()) < 1e-15
    assert not found.backscatter.any()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("water", ["I", "7C"])
def test_the_veil_is_the_integral(kind: str, water: str) -> None:
    white = Medium.from_water(water).under()
    rng = np.random.default_rng(KINDS.index(kind))
    for _ in range(25):
        case = random_case(kind, rng)
        lamp, view = case.lamp, case.view
        own = white.brightened(lamp.power[:, None] * lamp.rgb)
        z = torch.full((1, 1, 1, 1), case.z, dtype=torch.float64)
        found = integrated(lamp, own, view, ray_of(lamp, view), z, lamp.wide).flatten()
        wanted = veil_by_definition(case, white)
        torch.testing.assert_close(found, wanted, rtol=0.005, atol=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_the_veil_of_a_wide_lamp_is_the_integral(kind: str) -> None:
    """A cone of more than a right angle lights a ray before the dark on its back, and behind it."""
    white = Medium.from_water("II").under()
    rng = np.random.default_rng(KINDS.index(kind))
    for _ in range(25):
        case, numbers = random_case(kind, rng), rng.uniform(size=2)
        cone, falloff = 90 + 85 * numbers[:1], numbers[1:].clip(0.02)
        lamp = replace(case.lamp, cone=torch.tensor(cone), falloff=torch.tensor(falloff))
        case = case._replace(light=Light((lamp,)))
        own, view = white.brightened(lamp.power[:, None] * lamp.rgb), case.view
        z = torch.full((1, 1, 1, 1), case.z, dtype=torch.float64)
        found = integrated(lamp, own, view, ray_of(lamp, view), z, lamp.wide).flatten()
        wanted = veil_by_definition(case, white)
        torch.testing.assert_close(found, wanted, rtol=0.01, atol=1e-5)


@pytest.mark.parametrize("cone", [90.0, 91.0, 100.0, 130.0])
@pytest.mark.parametrize("direction", [(-1, 0.2, 0.05), (0.1, 1, 0), (0, 0.1, -1), (0, 0, 1)])
def test_the_grid_of_a_wide_lamp(cone: float, direction: tuple[float, float, float]) -> None:
    white = Medium.from_water("II").under()
    (lamp,) = Light.lamp((0.4, -0.2, 0.0), direction, cone=cone, falloff=0.0).to(white.G).lamps
    size = 30, 40
    view = view_of(size, 35.0, None, white.G)
    z = torch.full((1, 1, *size), 4.0, dtype=torch.float64)
    found = interpolated(
        grid_of(lamp, white, view, 6, lamp.wide), view, ray_of(lamp, view), z, slice(0, 40)
    )
    exact = integrated(lamp, white, view, ray_of(lamp, view), z, lamp.wide)
    torch.testing.assert_close(found, exact, rtol=0, atol=0.01 * float(exact.max()))


@pytest.mark.parametrize("kind", KINDS[:2])
def test_the_grid_of_rays_is_fine_enough(kind: str) -> None:
    white = Medium.from_water("7C").under()
    rng, size = np.random.default_rng(5), (60, 80)
    view = view_of(size, 0.866 * 80, None, white.G)
    z = torch.from_numpy(0.2 * 100 ** rng.uniform(size=(1, 1, *size)))
    for _ in range(10):
        lamp = random_case(kind, rng).lamp
        assert not lamp.ahead
        own = white.brightened(lamp.power[:, None] * lamp.rgb)
        grid = grid_of(lamp, own, view, polynomials_of(lamp, own), lamp.wide)
        found = interpolated(grid, view, ray_of(lamp, view), z, slice(0, 80))
        exact = integrated(lamp, own, view, ray_of(lamp, view), z, lamp.wide)
        torch.testing.assert_close(found, exact, rtol=0, atol=0.002)


def test_gradients_of_the_picture() -> None:
    medium = Medium.from_coefficients((0.5,) * 3, (0.2,) * 3, (0.1,) * 3, b_mean=0.3)
    image, z = rand(1, 3, 5, 6), 1 + rand(1, 1, 5, 6, seed=2)

    def picture(position: Tensor, power: Tensor, gain: Tensor) -> Tensor:
        light = Light.lamp(position, (0.1, 0.2, 1.0), power, cone=60.0) + Light.ambient(gain)
        return form_image(image, z, medium, light=light, focal_px=6.0).image

    values = (torch.tensor([0.3, -0.2, -0.1]), torch.tensor(2.0), torch.tensor(0.5))
    leaves = [value.double().requires_grad_() for value in values]
    torch.autograd.gradcheck(picture, leaves)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.0, 0.0, 2.0), (0.0, 0.0, -1.0)])
@pytest.mark.parametrize("far", [0.0, 1e-3, 2.0, math.inf])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.float16])
def test_no_nan_where_rays_meet_lamps(
    place: tuple[float, float, float], far: float, dtype: torch.dtype
) -> None:
    image, z = rand(1, 3, 9, 9).to(dtype), torch.full((1, 1, 9, 9), 3.0, dtype=dtype)
    z[..., 4:6, 4:6] = far
    position = torch.tensor(place, requires_grad=True)
    image.requires_grad_()
    light = Light.lamp(position, (0.0, 0.0, 1.0), 2.0, cone=70.0) + Light.parallel(90, 0)
    found = form_image(image, z, MEDIUM, light=light, focal_px=8.0).image
    assert found.dtype == dtype
    assert found.isfinite().all()
    found.float().mean().backward()
    assert position.grad is not None
    assert position.grad.isfinite().all()
    assert image.grad is not None
    assert image.grad.isfinite().all()


def test_each_picture_has_its_lamp() -> None:
    image, z = scene()
    positions = torch.tensor([[0.3, 0.0, 0.0], [-0.4, 0.2, -0.5]], dtype=torch.float64)
    powers = torch.tensor([2.0, 5.0], dtype=torch.float64)
    light = Light.lamp(positions, (0, 0, 1), powers, cone=50.0)
    found = formed(light).image
    plan = None
    for n in range(2):
        alone = Light.lamp(positions[n], (0, 0, 1), powers[n], cone=50.0)
        one = form_image(image[n], z[n], MEDIUM, light=alone, focal_px=FOCAL, plan=plan).image
        torch.testing.assert_close(found[n], one, rtol=0, atol=0.002)
    one_image = form_image(image[0], z[0], MEDIUM, light=light, focal_px=FOCAL).image
    assert one_image.shape == (2, 3, 30, 44)


def test_strips_and_the_whole_agree() -> None:
    """Without gradients a picture is formed in strips."""
    image, z = scene(1, 300, 260)
    plan = uwaug.blur.plan_blur(0.1, 6.0, 0.002)
    light = beside() + Light.parallel(20, 40, gradient=0.2)

    def picture(image: Tensor) -> Tensor:
        return form_image(image, z, MEDIUM, light=light, focal_px=300.0, plan=plan).image

    whole = picture(image.clone().requires_grad_()).detach()
    torch.testing.assert_close(picture(image), whole, rtol=0, atol=1e-10)


def test_a_lamp_shows_where_daylight_is_gone() -> None:
    deep = Medium.from_water("7C", vertical_depth=60.0)
    assert formed(None, deep).image.max() < 1e-6
    assert formed(beside(), deep).direct.max() > 0.01
    # and it does not depend on the depth
    shallow = Medium.from_water("7C", vertical_depth=1.0)
    plan = uwaug.blur.plan_blur(0.1, 6.0, 0.002)
    pictures = [formed(beside(), medium, plan=plan).image for medium in (deep, shallow)]
    torch.testing.assert_close(*pictures)


def test_a_spectrum_colours_the_lamp() -> None:
    red = beside(spectrum=([400, 590, 610, 700], [0.0, 0.0, 1.0, 1.0]))
    white = beside(spectrum=([400, 700], [1.0, 1.0]))
    near = formed(red).direct.mean((0, 2, 3))
    assert near[0] > 5 * near[2]
    torch.testing.assert_close(formed(white).direct, formed(beside()).direct, rtol=0, atol=0.005)


@pytest.mark.parametrize("light", [beside() + Light.ambient(0.2), Light.parallel(40, 200)])
def test_compiled_modules_agree(light: Light) -> None:
    image, z = (t.float() for t in scene())
    module = Underwater(MEDIUM, light=light, focal_px=FOCAL, color_space="linear")
    compiled = torch.compile(module, fullgraph=True, backend="aot_eager")
    with torch.no_grad():
        torch.testing.assert_close(compiled(image, z), module(image, z), rtol=0, atol=1e-5)


def test_directions_need_a_focal_length() -> None:
    image, z = scene()
    for light in (beside(), Light.parallel(30, 0), Light.ambient(gradient=0.1)):
        with pytest.raises(ValueError, match=r"focal_px is missing.*\.866"):
            form_image(image, z, MEDIUM, light=light)
        with pytest.raises(ValueError, match="focal_px is missing"):
            Underwater(MEDIUM, light=light)
    with pytest.raises(ValueError, match="focal_px must be"):
        form_image(image, z, MEDIUM, light=beside(), focal_px=-3.0)
    with pytest.raises(TypeError, match="centre must be"):
        form_image(image, z, MEDIUM, light=beside(), focal_px=3.0, centre=4.0)  # type: ignore[arg-type]
    # without a direction none is needed
    form_image(image, z, MEDIUM, light=Light.ambient(0.5))


def test_numbers_there_and_back() -> None:
    spectrum = ([400.0, 500.0, 700.0], [0.1, 1.0, 0.3])
    light = beside() + Light.parallel(35, -120, diffuse=0.3, gradient=0.1)
    light = light + Light.ambient(0.4) + beside(spectrum=spectrum)
    again = Light.from_list(json.loads(json.dumps(light.to_list())))
    assert repr(again) == repr(light) == repr(sum([light]))
    torch.testing.assert_close(formed(again).image, formed(light).image)
    batch = Light.from_list(Light.ambient(torch.tensor([0.5, 1.0])).to_list())
    assert (batch.rows(), Light.ambient(1.0).plain) == (2, True)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: beside(power=-1.0), "power must be finite and ≥ 0"),
        (lambda: beside(power=True), r"power must be a number or a tensor \(B,\)"),
        (lambda: beside(power=[]), "power must be a number"),
        (lambda: beside(power=[1.0, 4.0]).require_one(), "for one picture, got one for 2"),
        (lambda: beside(cone=200.0), r"cone must be in \[0, 180\], in degrees"),
        (lambda: beside(rgb=(1.0, 2.0)), r"rgb must be 3 numbers or a tensor \(B, 3\), light"),
        (lambda: beside(rgb="red"), "rgb must be 3 numbers"),
        (lambda: beside(rgb=(1.0,) * 3, spectrum=([400, 700], [1, 1])), "give one of them"),
        (lambda: beside(spectrum=3.0), "spectrum must be a pair of arrays"),
        (lambda: beside(spectrum=([400, 700], [0, 0])), "spectrum is 0"),
        (lambda: Light.lamp((0, 0, 0), (0, 0, 0)), "direction must point somewhere"),
        (lambda: Light.lamp((0, math.nan, 0), (0, 0, 1)), "position must be in"),
        (lambda: Light.parallel(100.0, 0.0), r"elevation must be in \[-90, 90\]"),
        (lambda: Light.ambient(gradient=1e3), r"gradient must be in \[-10, 10\]"),
        (lambda: formed("lamp"), r"light must be a uwaug\.Light, got str"),
        (lambda: formed(beside(power=torch.ones(3))), "batch sizes must agree.*'light': 3"),
        (
            lambda: formed(
                beside(spectrum=([400, 700], [1, 1])),
                Medium.from_coefficients((0.3,) * 3, (0.2,) * 3, (0.1,) * 3),
            ),
            "spectrum: the medium has three channels",
        ),
    ],
)
def test_wrong_lights_are_refused(make: Callable[[], Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        make()
