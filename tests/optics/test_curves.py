"""A medium's curves against integrals over the spectrum; the width law."""

import itertools
import math

import numpy as np
import pytest
import torch
from referees import reference
from scenes import CURVES, Z, coastal, errors

from uwaug import JERLOV_TYPES, Medium, PointSpread, Water
from uwaug.optics.view import View

ANY = np.sort(np.concatenate([np.geomspace(1e-6, 1e5, 1500), np.linspace(20, 150, 200)]))  # m


# all of whose light is gone before a distance that anyone would look at
INK = Water([400, 700], a=[20.0, 9e3], b=[3e3, 1e3], kd=[20.0, 9e3], name="ink")


@pytest.mark.parametrize("water", [*map(Water.jerlov, JERLOV_TYPES), INK], ids=lambda w: w.name)
def test_curves_keep_the_tolerance(water: Water) -> None:
    for depth, g in itertools.product((0.0, 10.0), (0.0, 0.02, 1.0)):
        for tolerance, z in ((0.002, ANY), (0.0005, Z)):
            options = {"vertical_depth": depth, "g": g, "mu": 0.3, "tolerance": tolerance}
            medium = Medium.from_water(water, **options)
            worst = max(errors(medium, water, z, depth=depth, g=g, mu=0.3))
            assert worst <= tolerance, options


@pytest.mark.parametrize("seed", range(8))
def test_mixtures_of_any_turbidity_keep_the_tolerance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = (Water.jerlov(type) for type in rng.choice(JERLOV_TYPES[1:], 2))
    water = one.mix(other, rng.uniform()).with_contrast(0.02, np.exp(rng.uniform(-0.5, 3)))
    tolerance = 10 ** rng.uniform(-5, -2)
    options = {"g": rng.uniform(0.02, 1.0), "mu": rng.uniform()}
    options["vertical_depth"] = rng.choice([0.0, 3.0, 15.0])
    options["camera"] = rng.choice([reference.NIKON, "Sigma SDMerill (NPL)"])
    medium = Medium.from_water(water, tolerance=tolerance, **options)
    exact = Medium.from_water(water, tolerance=0, **options)
    z = torch.logspace(-5, 4, 1500, dtype=torch.float64)
    for name in CURVES:
        error = (getattr(medium, name)(z) - getattr(exact, name)(z)).abs().max()
        # between the distances that are looked at, the error may be 1 % larger
        assert error <= 1.01 * tolerance
    assert all((t >= 0).all() for t in medium.tensors())


@pytest.mark.parametrize("type", ["I", "3C"])
def test_no_more_rates_than_needed(type: str) -> None:
    water, z = Water.jerlov(type), np.concatenate([Z, np.geomspace(20, 1e4, 200)])
    numbers = {"g": 0.2, "mu": 0.3}

    def medium(tolerance: float) -> Medium:
        return Medium.from_water(water, vertical_depth=0.0, tolerance=tolerance, **numbers)

    tried = [medium(tolerance) for tolerance in np.geomspace(0.3, 0.0004, 60)]
    worst = [errors(m, water, z, depth=0.0, **numbers) for m in tried]
    for curves, rates in ((slice(0, 1), "beta"), (slice(1, 3), "G")):
        counts = [getattr(m, rates).shape[1] for m in tried]
        for tolerance in (0.002, 0.0005):
            needed = getattr(medium(tolerance), rates).shape[1]
            fewer = [max(e[curves]) for e, n in zip(worst, counts, strict=True) if n < needed]
            assert min(fewer) > tolerance


def test_the_error_in_the_repr_is_the_error() -> None:
    water = Water.jerlov("9C")
    medium = Medium.from_water(water, g=0.2, mu=0.3, tolerance=0.0005)
    claimed = float(repr(medium).split("within ")[1].split(",")[0])
    assert max(errors(medium, water, depth=1.0, g=0.2, mu=0.3)) <= 1.1 * claimed


@pytest.mark.parametrize("type", ["I", "II", "9C"])
@pytest.mark.parametrize("g", [0.0, 0.2, 1.0])
def test_monotone_bounded_and_exact_at_the_ends(type: str, g: float) -> None:
    medium = Medium.from_water(type, g=g, mu=0.3)
    assert all((t >= 0).all() for t in medium.tensors())
    z = torch.cat([torch.zeros(1), torch.logspace(-6, 6, 300), torch.tensor([math.inf])]).double()
    direct, signal, veil = (getattr(medium, name)(z)[0] for name in CURVES)
    assert (direct.diff() <= 1e-15).all()
    assert (signal.diff() <= 1e-15).all()
    assert (veil.diff() >= -1e-15).all()
    assert direct[:, -1].abs().max() == signal[:, -1].abs().max() == veil[:, 0].abs().max() == 0
    exact = reference.spectral_curves(Water.jerlov(type), np.zeros(()), depth=1.0, g=g, mu=0.3)
    for curve in (direct, signal):
        np.testing.assert_allclose(curve[:, 0], exact.direct, rtol=0, atol=1e-13)
    torch.testing.assert_close(veil[:, -1], medium.veil_weights[0].sum(-1))


@pytest.mark.parametrize("shape", [(), (1, 4, 6), (3, 1, 4, 6)], ids=str)
@pytest.mark.parametrize("surfaces", ["grey", "spectral"])
def test_shapes(surfaces: str, shape: tuple[int, ...]) -> None:
    types = ("I", "3C", "9C")
    media = Medium.stack([Medium.from_water(type, surfaces=surfaces) for type in types])
    z = 5 * torch.rand(shape, dtype=torch.float64)
    for number, name in enumerate(CURVES):
        curve = getattr(media, name)(z)
        channels = (3, 3) if surfaces == "spectral" and name != "backscatter" else (3,)
        assert curve.shape == (3, *channels, *shape[-2:])
        for row in range(3):
            own = z[row, 0] if shape[:1] == (3,) else z.reshape(shape[-2:])
            expected = reference.medium_curves(media, own.numpy(), row)[number]
            np.testing.assert_allclose(curve[row].numpy(), expected, rtol=0, atol=1e-13)


def test_gradients_of_every_tensor() -> None:
    def evaluate(*tensors: torch.Tensor) -> torch.Tensor:
        *medium, z = tensors
        m = Medium(*medium)
        width = m.width(z).expand(2, 3, 3, 4)
        return torch.cat([m.transmission(z), m.signal(z), m.backscatter(z), width])

    shapes = [(2, 2), (2, 3, 2), (2, 3), (2, 3, 3), (2, 3, 3), (2,), (2,), (2,), (1, 1, 3, 4)]
    inputs = [(0.1 + torch.rand(*shape, dtype=torch.float64)).requires_grad_() for shape in shapes]
    assert torch.autograd.gradcheck(evaluate, inputs)


def test_width_laws() -> None:
    lengths = torch.tensor([0.0, 0.5, 2.0, 8.0], dtype=torch.float64).reshape(1, 1, 1, 4)
    for law, scale, exponent, size in (
        (PointSpread.paper(), 0.3 * 259 / 518, 1.0, (259, 300)),
        (PointSpread.paper(0.8), 0.8, 1.0, (800, 518)),
        (PointSpread.calibrated(), 0.03 * 400.0, 0.62, (64, 64)),
        (PointSpread(3.0, 2.0), 3.0, 2.0, (9, 9)),
        (PointSpread.none(), 0.0, 1.0, (9, 9)),
    ):
        medium = coastal(point_spread=law).in_pixels(size, View(focal_px=400.0))
        width = medium.width(lengths / medium.b_mean)
        assert width[..., 0] < 0.05  # px; where the law has an infinite slope it may start above 0
        expected = (scale * lengths**exponent)[..., 1:]
        torch.testing.assert_close(width[..., 1:], expected, rtol=1e-12, atol=0)
