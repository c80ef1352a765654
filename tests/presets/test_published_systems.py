"""Each published system against its own equation, and against the others."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from presetting import same
from referees import reference, systems
from referees.systems import CHANNELS, SPECTRAL, Scene

import uwaug.presets.scene
from uwaug import JERLOV_TYPES, Camera, Medium, PointSpread, Water, form_image
from uwaug.presets import load_preset, published_systems
from uwaug.presets.files import bundled_preset

SIZE = (7, 5)
BLURRED = ("mcglamery-1980", "jaffe-1990", "schechner-2004", "ismiroglou-2025")


def random_water(seed: int) -> Water:
    a, b, kd = np.random.default_rng(seed).uniform(0.02, 1.5, (3, len(systems.BANDS)))
    return Water(systems.BANDS, a, b, kd)


def waters() -> list[Water]:
    return [Water.jerlov("II"), Water.jerlov("7C"), random_water(0), random_water(1)]


def random_scene(size: tuple[int, int], seed: int = 0) -> Scene:
    rng = np.random.default_rng(seed)
    return Scene(rng.uniform(0, 1.5, (3, *size)), rng.uniform(0.05, 12, size))


def tensors(scene: Scene) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.from_numpy(scene.J), torch.from_numpy(scene.z)[None]


def test_each_system_has_its_equation_here():
    assert {*SPECTRAL, *CHANNELS} == set(published_systems())
    years = [int(name.rpartition("-")[2]) for name in published_systems()]
    assert years == sorted(years)


@pytest.mark.parametrize("name", SPECTRAL)
def test_equations_of_spectra(name):
    for seed, water in enumerate(waters()):
        scene = random_scene(SIZE, seed)
        medium = load_preset(name, water=water, tolerance=0).medium
        medium = replace(medium, point_spread=PointSpread.none())
        ours = form_image(*tensors(scene), medium).image.numpy()
        exact = SPECTRAL[name](name, scene, water)
        np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", CHANNELS)
def test_equations_of_channels(name):
    for seed, water in enumerate(JERLOV_TYPES):
        scene = random_scene(SIZE, seed)
        preset = load_preset(name, water=None if name == "hou-2020" else water)
        ours = form_image(*tensors(scene), preset.medium).image.numpy()
        np.testing.assert_allclose(ours, CHANNELS[name](name, scene, water), rtol=0, atol=1e-10)


@pytest.mark.parametrize("water", ["II", "7C"])
@pytest.mark.parametrize("name", BLURRED)
def test_blurs_at_each_pixel_are_within_the_tolerance(name, water):
    J, z = reference.picture(24, 32), random_scene((24, 32)).z
    medium = load_preset(name, water=water, tolerance=0).medium
    law = medium.point_spread
    assert law.scale == systems.table(name)["point_spread"]["scale_px"]
    # so small a picture shows little of so narrow a blur
    medium = replace(medium, point_spread=law.widened(30))
    ours = form_image(*tensors(Scene(J, z)), medium).image.numpy()
    blurred = SPECTRAL[name](name, Scene(J, z, blur=30), Water.jerlov(water))
    plain = SPECTRAL[name](name, Scene(J, z), Water.jerlov(water))
    error = math.sqrt(((ours - blurred) ** 2).mean())
    assert error < 0.002
    assert error < 0.5 * math.sqrt(((plain - blurred) ** 2).mean())


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_what_mcglamery_asks_of_G(type):
    g, water = systems.table("mcglamery-1980")["medium"]["g"], Water.jerlov(type).at(systems.BANDS)
    G = water.a + g * water.b
    assert (water.a <= G).all()
    assert (water.kd >= G).all()
    g = systems.table("jaffe-1990")["medium"]["g"]
    assert (water.a + g * water.b <= water.beta).all()


def test_hous_transmissions_follow_the_sources_rule():
    file = systems.table("hou-2020")
    b = 1.62517 - 0.00113 * np.array([620.0, 540.0, 450.0])
    B = np.array(file["veil"]["low"])
    t = file["channels"]["left"][0] ** (b * B[0] / (b[0] * B))
    np.testing.assert_allclose(file["channels"]["left"], t, atol=5e-4)


def test_slurpps_rates_follow_the_sources_rule():
    # blue, green, red in the source; the middle of both draws
    source = {"I": (0.02206, 0.04805, 0.22922), "II": (0.4818, 0.4339, 0.537)}
    source |= {"7C": (3.398, 2.773, 2.331), "5C": (1.914, 1.567, 9.09)}
    rates = systems.table("slurpp-2025")["channels"]["beta_per_m"]
    for type, printed in source.items():
        beta = np.array(printed)[::-1] * (0.01 + 1) / 2
        if beta.min() > 0.5:
            beta = beta / beta.max() * 0.2
        np.testing.assert_allclose(rates[type], beta, atol=6e-6)


# ----------------------------------------------------------------- reductions


def test_systems_that_are_one_equation_are_one_medium():
    load = load_preset
    assert same(load("jaffe-1990").medium, load("schechner-2004").medium)
    assert same(load("akkaynak-2018").medium, load("ismiroglou-reference-2025").medium)
    one = {"g": 1.0, "mu": 1.0, "point_spread": PointSpread.none()}
    assert same(load("akkaynak-2018").medium, Medium.from_water("II", **one))
    assert same(load("desai-2024").medium, Medium.from_water("II", vertical_depth=5.0, **one))
    # without depth, all analytic veils are one
    for choice in ({"dims": "veil"}, {"dims": "direct"}, {"downwelling": "beam"}, {}):
        medium = Medium.from_water("II", vertical_depth=0.0, **one, **choice)
        assert same(load("liu-2022").medium, medium)
    assert same(load("ismiroglou-2025").medium, load("survey", water="II").medium)


@pytest.mark.parametrize("tolerance", [0, 0.002])
@pytest.mark.parametrize("water", ["I", "II", "7C"])
def test_with_g_1_the_full_model_has_no_forward_scatter(water, tolerance):
    z = torch.linspace(0, 20, 50, dtype=torch.float64)
    for rate in ("G", "beta"):
        medium = Medium.from_water(water, g=1.0, mu=1.0, tolerance=tolerance, veil_rate=rate)
        assert (medium.signal(z) - medium.transmission(z)).abs().max() < 1e-15
        other = Medium.from_water(water, g=1.0, mu=1.0, tolerance=tolerance)
        found = medium.backscatter(z) - other.backscatter(z)
        assert found.abs().max() <= (1e-15 if tolerance == 0 else 2 * tolerance)


def three_bands(beta: np.ndarray) -> tuple[Water, Camera]:
    """A water whose three wavelengths are red, green and blue."""
    nm = [450.0, 550.0, 600.0]
    a, b = 0.4 * beta[::-1], 0.6 * beta[::-1]
    return Water(nm, a, b, 2 * a), Camera(nm, np.eye(3)[::-1])


def test_the_full_model_of_three_wavelengths_is_that_of_three_coefficients():
    z = torch.linspace(0, 8, 30, dtype=torch.float64)
    file = systems.table("slurpp-2025")
    beta = np.array(file["channels"]["beta_per_m"]["II"])
    spectra = {"tolerance": 0, "g": 1.0, "wavelengths": [450, 550, 600]}
    water, camera = three_bands(beta)
    full = Medium.from_water(water, camera, downwelling="none", **spectra)
    middle = [(x + y) / 2 for x, y in zip(file["veil"]["low"], file["veil"]["high"], strict=True)]
    assert_alike(full.with_veil(middle), load_preset("slurpp-2025").medium, z)

    beta = -np.log(np.array(systems.table("li-2020")["channels"]["left_per_m"]["II"]))
    water, camera = three_bands(beta)
    full = Medium.from_water(water, camera, downwelling="beam", vertical_depth=4.0, **spectra)
    full = full.brightened(torch.tensor([1.5], dtype=torch.float64))
    veil = full.signal(torch.tensor(0.0, dtype=torch.float64))
    assert_alike(full.with_veil(veil, curve="signal"), load_preset("li-2020").medium, z)


def assert_alike(first: Medium, second: Medium, z: torch.Tensor) -> None:
    for curve in ("transmission", "signal", "backscatter"):
        ours, theirs = getattr(first, curve)(z), getattr(second, curve)(z)
        torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-12)


def test_a_picture_of_channels_is_a_medium_of_hous_at_the_distance_where_that_much_is_left():
    beta, veil = torch.tensor([0.5, 0.2, 0.1], dtype=torch.float64), (0.1, 0.4, 0.5)
    z = torch.tensor(3.0, dtype=torch.float64)
    classical = Medium.from_coefficients(beta, beta, veil)
    constant = Medium.from_transmission(torch.exp(-3 * beta), veil)
    for distance in (0.01, 3.0, math.inf):
        anywhere = torch.tensor(distance, dtype=torch.float64)
        for curve in ("transmission", "signal", "backscatter"):
            ours, theirs = getattr(constant, curve)(anywhere), getattr(classical, curve)(z)
            torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-14)


def test_the_full_models_veil_can_have_the_rate_of_mcglamery():
    z = torch.linspace(0, 20, 40, dtype=torch.float64)
    options = {"g": 0.05, "mu": 0.075, "tolerance": 0}
    full = Medium.from_water("II", **options)
    medium = load_preset("mcglamery-1980", tolerance=0).medium
    assert torch.equal(medium.transmission(z), full.transmission(z))
    torch.testing.assert_close(medium.signal(z), full.signal(z), rtol=0, atol=1e-15)
    assert (medium.backscatter(z) - full.backscatter(z)).abs().max() > 0.01
    # with a veil of that rate, which is given, it is Medium.from_coefficients
    given = Medium.from_coefficients((0.6,) * 3, (0.2,) * 3, (0.3,) * 3, veil_rate=(0.6,) * 3)
    exact = 0.3 * -torch.expm1(-0.6 * z)
    torch.testing.assert_close(given.backscatter(z)[0], exact.expand(3, -1), rtol=0, atol=1e-15)
    usual = Medium.from_coefficients((0.6,) * 3, (0.2,) * 3, (0.3,) * 3)
    again = Medium.from_coefficients((0.6,) * 3, (0.2,) * 3, (0.3,) * 3, veil_rate=(0.2,) * 3)
    assert_alike(usual, again, z)


@pytest.mark.parametrize("name", ["beta_per_channel", "II"])
def test_forward_scatter_from_D_is_that_from_J_near_the_lens(name):
    def medium(forward: str) -> Medium:
        if name == "II":
            return Medium.from_water("II", tolerance=0, forward=forward)
        beta, G = (0.9, 0.5, 0.4), (0.2, 0.1, 0.1)
        return Medium.from_coefficients(beta, G, (0.2,) * 3, forward=forward)

    def scatter(forward: str, z: torch.Tensor) -> torch.Tensor:
        one = medium(forward)
        return one.signal(z) - one.transmission(z)

    z = torch.logspace(-6, 1, 30, dtype=torch.float64)
    from_J, from_D = scatter("image", z), scatter("direct", z)
    rate = medium("image").beta.max()
    # e^(−βz) times it: less, and the nearer the more equal
    assert (from_D < from_J).all()
    assert (from_D >= from_J * torch.exp(-rate * z) * (1 - 1e-6) - 1e-15).all()
    if name != "II":
        left = medium("image").transmission(z)
        torch.testing.assert_close(from_D, left * from_J, rtol=0, atol=1e-15)


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_reduced_curves_keep_the_tolerance_with_every_choice(type):
    z = torch.cat([torch.zeros(1), torch.logspace(-4, 2, 200)]).double()
    choices = [{"forward": "direct"}, {"veil_rate": "beta"}, {"downwelling": "beam"}]
    choices += [{"dims": "veil", "forward": "direct", "veil_rate": "beta", "g": 0.05}]
    for choice in choices:
        few, every = (Medium.from_water(type, tolerance=t, **choice) for t in (0.002, 0))
        for curve in ("transmission", "signal", "backscatter"):
            error = (getattr(few, curve)(z) - getattr(every, curve)(z)).abs().max()
            assert error <= 0.002, (choice, curve)
        assert few.G.shape[1] <= 24
        assert "within" in few.notes[0]


# ----------------------------------------------------------------- the files


@pytest.mark.parametrize("name", published_systems())
def test_every_system_on_the_bundled_scene(name):
    scene = uwaug.presets.scene.motorcycle()
    # the systems plan for 1 to 5 m, and 3 % of the scene lie a little farther
    image, distance = scene.image[:, ::4, ::4], scene.distance[:, ::4, ::4].clamp(max=5.0)
    for water in (None,) if name == "hou-2020" else ("II", "7C"):
        preset = load_preset(name, water=water)
        assert preset.waters == (() if water is None else JERLOV_TYPES)
        result = preset.module(focal_px=150.0)(image, distance)
        assert result.isfinite().all()
        assert (result - image).abs().mean() > 0.01
        terms = form_image(image, distance, preset.medium)
        for term in (terms.direct, terms.forward, terms.backscatter):
            assert term.isfinite().all()
            assert term.min() >= -1e-6


@pytest.mark.parametrize("name", published_systems())
def test_each_file_states_source_equation_and_what_is_ours(name):
    text, preset = bundled_preset(name).read_text(encoding="utf-8"), load_preset(name)
    assert preset.name == name
    assert preset.equation.startswith(("I", "D"))
    assert any(mark in preset.source for mark in ("doi:10.", "arXiv:", "CVPR"))
    comment = " ".join(line for line in text.splitlines() if line.startswith("#"))
    assert any(word in comment for word in ("Ours:", "here it is another", "is another"))
    assert preset.field_range == (1.0, 1.0)
    field = preset.field((1, 1, 8, 9))
    assert torch.equal(field, torch.ones(1, 1, 8, 9))


def test_draws_stay_within_the_files_ranges_and_repeat():
    def drawn(name: str, seed: int) -> Medium:
        return load_preset(name, generator=torch.Generator().manual_seed(seed)).medium

    for name in ("ueda-2019", "li-2020", "slurpp-2025"):
        veils = torch.cat([drawn(name, seed).veil_weights.sum(-1) for seed in range(30)])
        assert same(drawn(name, 3), drawn(name, 3))
        assert (veils.std(0) > 1e-3).all()
        if name == "slurpp-2025":
            file = systems.table(name)["veil"]
            low, high = (torch.tensor(file[end], dtype=torch.float64) for end in ("low", "high"))
            assert ((low <= veils) & (veils <= high)).all()
    depths = [
        load_preset("li-2020", generator=torch.Generator().manual_seed(seed)).vertical_depth
        for seed in range(30)
    ]
    assert 3 <= min(depths) < 3.5
    assert 4.5 < max(depths) <= 5
    assert same(drawn("jaffe-1990", 0), load_preset("jaffe-1990").medium)  # nothing is random


def test_what_random_underwater_can_draw():
    drawable = {name for name in published_systems() if load_preset(name).drawable}
    expected = {"akkaynak-2018", "desai-2024", "ismiroglou-2025", "ismiroglou-reference-2025"}
    assert drawable == expected
    for name in drawable:
        uwaug.RandomUnderwater.from_preset(name, water="3C")
    message = r"'jaffe-1990' has veil_rate = beta, forward = direct, which RandomUnderwater"
    with pytest.raises(ValueError, match=message):
        uwaug.RandomUnderwater.from_preset("jaffe-1990")
    with pytest.raises(ValueError, match="'ueda-2019' has downwelling = beam, veil = given"):
        load_preset("ueda-2019").options()
