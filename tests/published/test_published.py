"""Each published system against its own equation, against pictures, and against the others."""

import math
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from referees import reference, systems
from referees.systems import LINEAR, SPECTRAL, Scene

from uwaug import JERLOV_TYPES, Lamp, Medium, PointSpread, Underwater, Water, published
from uwaug.formation.colour import linear_to_srgb, srgb_to_linear
from uwaug.published.equation import OTHER_NAMES, BandedWater
from uwaug.published.models import SLURPP, UWCNN

CHANNELS = {"hou-2020", "li-2020", "slurpp-2025"}
BLURRED = {"mcglamery-1980", "jaffe-1990", "schechner-2004", "ismiroglou-2025"}
LAMPS = ("mcglamery-1980", "jaffe-1990")
SEEN = torch.linspace(0.02, 0.98, 3 * 12 * 16, dtype=torch.float64)[torch.randperm(576)]
IMAGE = SEEN.reshape(3, 12, 16)
Z = torch.linspace(0.2, 9, 12 * 16, dtype=torch.float64).reshape(1, 12, 16).flip(2)


def random_water() -> Water:
    a, b, more = np.random.default_rng(0).uniform(0.02, 1.0, (3, len(reference.BANDS)))
    return Water(reference.BANDS, a, b, a + more)


@pytest.mark.parametrize("water", [Water.jerlov("7C"), random_water()], ids=["7C", "random"])
@pytest.mark.parametrize("name", SPECTRAL)
def test_equations_of_spectra(name, water):
    J = IMAGE if name in LINEAR else srgb_to_linear(IMAGE)
    # a plane that faces a camera whose view is 60° wide
    z = 3.0 / torch.from_numpy(systems.rays(12, 16))[2:] if name in LAMPS else Z
    exact = SPECTRAL[name](Scene(J.numpy(), z[0].numpy()), water)
    exact = torch.from_numpy(exact).clamp(0, 1)
    ours = published.system(name)(IMAGE, z, water)
    if name not in LINEAR:
        ours = srgb_to_linear(ours)
    error = ours - exact
    if name in BLURRED:  # within the tolerance of the blur; a lamp's veil is summed over 8 points
        assert error.square().mean().sqrt() < 1e-3
        assert error.abs().max() < 5e-3
    else:
        assert error.abs().max() < 1e-12


@pytest.mark.parametrize("water", ["I", "7C"])
def test_equations_of_channels(water):
    def column(*values: float) -> torch.Tensor:
        return torch.tensor(values, dtype=torch.float64)[:, None, None]

    t, B = column(0.35, 0.778, 0.728), column(0.15, 0.69, 0.6)
    torch.testing.assert_close(published.hou_2020(IMAGE, Z), IMAGE * t + B * (1 - t))
    N = column(*UWCNN[water])
    exact = 1.5 * N**4 * (IMAGE * N**Z + 1 - N**Z)
    torch.testing.assert_close(published.li_2020(IMAGE, Z, water), exact.clamp(max=1))
    t, B = torch.exp(-column(*SLURPP[water]) * Z), column(0.2, 0.5, 0.5)
    torch.testing.assert_close(published.slurpp_2025(IMAGE, Z, water), IMAGE * t + B * (1 - t))


@pytest.mark.parametrize("shape", ["gaussian", "exponential"])
def test_the_blur_of_each_pixel_is_within_the_tolerance(shape):
    J, z = reference.picture(24, 32), torch.linspace(0, 8, 24 * 32).reshape(24, 32).double()
    water = BandedWater.of("II", reference.NIKON, z)
    image = torch.from_numpy(J)[None]
    ours = water.scattered(image, z[None, None], 50.0, shape)[0].numpy()
    sigma = 50 * 24 / 518 * float((water.response @ water.b).mean()) * z.numpy()
    assert sigma.max() > 2
    exact = getattr(reference, f"varying_{shape}")(J, sigma).reshape(J.shape)
    error = math.sqrt(((ours - exact) ** 2).mean())
    assert error < 0.002 < 0.1 * math.sqrt(((J - exact) ** 2).mean())


def test_systems_that_are_one_equation():
    p = published
    law = PointSpread.paper()
    medium = Medium.from_water("7C", g=0.2, mu=0.3, point_spread=law, tolerance=0)
    own_model = Underwater(medium, (0.1, 10.0), color_space="linear")(IMAGE, Z)
    assert (p.ismiroglou_2025(IMAGE, Z, "7C") - own_model).abs().max() < 1e-3
    deep = p.akkaynak_2018(IMAGE, Z, "7C", vertical_depth=5.0)
    assert torch.equal(deep, p.desai_2024(IMAGE, Z, "7C"))
    assert torch.equal(deep, p.liu_2022(IMAGE, Z, "7C", light="parallel", vertical_depth=5.0))
    lens = p.akkaynak_2018(IMAGE, Z, vertical_depth=0.0)
    torch.testing.assert_close(p.desai_2021(IMAGE, Z, vertical_depth=0.0), lens)
    torch.testing.assert_close(p.liu_2022(IMAGE, Z), lens)
    reference_model = p.ismiroglou_reference_2025(IMAGE, Z)
    torch.testing.assert_close(p.ismiroglou_2025(IMAGE, Z, g=1.0, mu=1.0), reference_model)


def test_lius_artificial_light_is_summed_along_the_ray():
    z, aside, power = 2.0, 0.5, 0.7
    water = BandedWater.of("1C", reference.NIKON, torch.zeros((), dtype=torch.float64))
    s = (torch.arange(40_000, dtype=torch.float64) + 0.5)[:, None] / 40_000 * z
    r = (s**2 + aside**2).sqrt()
    source = water.b * power / r**2 * torch.exp(-water.beta * (s + r))
    exact = water.response @ source.sum(0) * z / 40_000
    r = math.sqrt(z * z + aside * aside)
    exact += 0.5 * power / r**2 * water.response @ torch.exp(-water.beta * (z + r))
    image = linear_to_srgb(torch.full((3, 2, 2), 0.5, dtype=torch.float64))
    ours = published.liu_2022(
        image, torch.full((1, 2, 2), z).double(), "1C", light="artificial", power=power
    )
    torch.testing.assert_close(srgb_to_linear(ours[:, 0, 0]), exact, rtol=0, atol=1e-3)


def test_what_mcglamery_asks_of_G():
    for type in JERLOV_TYPES:
        water = Water.jerlov(type).at(reference.BANDS)
        assert (water.kd >= water.a + 0.05 * water.b).all()


def test_hous_transmissions_follow_the_sources_rule():
    b, B = 1.62517 - 0.00113 * np.array([620.0, 540.0, 450.0]), np.array([0.15, 0.69, 0.6])
    t = 0.35 ** (b * B[0] / (b[0] * B))
    np.testing.assert_allclose([0.35, 0.778, 0.728], t, atol=5e-4)


def test_slurpps_rates_follow_the_sources_rule():
    # blue, green, red in the source; the middle of both draws
    source = {"I": (0.02206, 0.04805, 0.22922), "II": (0.4818, 0.4339, 0.537)}
    source |= {"7C": (3.398, 2.773, 2.331), "5C": (1.914, 1.567, 9.09)}
    for type, printed in source.items():
        beta = np.array(printed)[::-1] * (0.01 + 1) / 2
        if beta.min() > 0.5:
            beta = beta / beta.max() * 0.2
        np.testing.assert_allclose(SLURPP[type], beta, atol=6e-6)


@pytest.mark.parametrize("name", published.systems())
def test_types_batches_open_water_and_gradients(name):
    image = (255 * IMAGE).round().to(torch.uint8)
    z = Z.float().clone()
    z[0, :3] = torch.inf
    z[0, 3] = 0.0
    one = published.picture(name, image, z)
    assert one.dtype == torch.uint8
    both = published.picture(name, torch.stack([image, 255 - image]).float() / 255, z)
    assert (both.shape, both.dtype) == ((2, 3, 12, 16), torch.float32)
    assert (255 * both[0] - one).abs().max() <= 0.6
    half, metres = (IMAGE / 2).requires_grad_(), Z.clone().requires_grad_()
    published.picture(name, half, metres).sum().backward()
    assert half.grad.isfinite().all()
    assert half.grad.abs().sum() > 0
    assert name == "hou-2020" or metres.grad.isfinite().all()


@pytest.mark.parametrize("name", ["li-2020", "slurpp-2025", "ueda-2019"])
def test_draws_are_of_each_picture_within_the_range_and_repeat(name):
    black, far = torch.zeros(40, 3, 1, 1), torch.full((40, 1, 1, 1), torch.inf)

    def drawn(seed: int) -> torch.Tensor:
        generator = torch.Generator().manual_seed(seed)
        return published.system(name)(black, far, water, generator=generator)[:, :, 0, 0]

    water = "7C" if name == "li-2020" else "II"  # where it is not clipped to 1
    veils, middle = drawn(3), published.system(name)(black, far, water)[0, :, 0, 0]
    assert torch.equal(veils, drawn(3))
    assert (veils.std(0) > 1e-3).all()
    assert (veils.amin(0) < middle).all()
    assert (veils.amax(0) > middle).all()
    if name == "slurpp-2025":
        assert (veils >= torch.tensor([0.05, 0.3, 0.3])).all()
        assert (veils <= torch.tensor([0.35, 0.7, 0.7])).all()


@pytest.mark.parametrize(
    ("function", "arguments", "words"),
    [
        (published.system, ("jaffe",), "system must be one of mcglamery-1980, jaffe-1990"),
        (published.li_2020, (IMAGE, Z, "11C"), "water must be one of I, IA, IB"),
        (published.slurpp_2025, (IMAGE, Z, random_water()), "water must be one of I"),
        (partial(published.liu_2022, light="lamp"), (IMAGE, Z), "light must be one of uniform"),
        (published.jaffe_1990, (255 * IMAGE, Z), "image.*divide"),
        (published.hou_2020, (IMAGE, -Z), "z.*metres ≥ 0"),
        (published.hou_2020, (IMAGE, Z[:, 1:]), "height and width must agree"),
        (published.hou_2020, (IMAGE[:1], Z), "image must have shape"),
    ],
)
def test_what_is_refused(function, arguments, words):
    with pytest.raises(ValueError, match=words):
        function(*arguments)


@pytest.mark.parametrize("name", LAMPS)
def test_lamps_have_a_colour(name):
    image, z = torch.full((3, 12, 16), 0.5), torch.full((1, 12, 16), 1.5)
    lamp = Lamp((-0.3, -0.2, 0.0), 3.0, cone=60.0)
    white, red = (
        published.system(name)(image, z, lamp=replace(lamp, color=colour))
        for colour in ((1.0, 1.0, 1.0), (1.0, 0.0, 0.0))
    )
    torch.testing.assert_close(red[0], white[0])
    assert float(red[1:].abs().max()) < 1e-6 < float(white[1:].min())


def test_oldest_first_each_public_with_its_equation_and_source():
    names = published.systems()
    assert {*SPECTRAL, *CHANNELS} == set(names)
    years = [int(name.rpartition("-")[2]) for name in names]
    assert years == sorted(years)
    for name in names:
        function = getattr(published, name.replace("-", "_"))
        assert function is published.system(name)
        for part in (r"\n        (I|D)(_c)? = ", "Source: ", "Ours: ", r"doi:10\.|arXiv:|CVPR"):
            assert re.search(part, function.__doc__), (name, part)
    for other, own in OTHER_NAMES.items():
        assert published.system(other.lower()) is published.system(own)
