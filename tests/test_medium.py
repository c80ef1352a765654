import copy
import itertools
import math
import pickle

import numpy as np
import pytest
import reference
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import JERLOV_TYPES, Water

Z = np.concatenate(
    [[0.0], np.geomspace(1e-4, 1, 200), np.linspace(1, 20, 200)[1:]]
)  # finer near 0, where curves bend
CURVES = ("transmission", "signal", "backscatter")
DEPTHS, SHARES = (0.0, 1.0, 10.0), (0.0, 0.2, 1.0)


def errors(medium: Medium, water: Water, z: np.ndarray = Z, **kwargs: float) -> list[float]:
    exact = reference.spectral_curves(water, z, **kwargs)
    at = torch.from_numpy(z)
    return [
        float(np.abs(getattr(medium, name)(at)[0].numpy() - curve).max())
        for name, curve in zip(CURVES, exact, strict=True)
    ]


@pytest.fixture
def coastal() -> Medium:
    return Medium.from_water(Water.jerlov("3C"))


@pytest.mark.parametrize("type", JERLOV_TYPES)
@pytest.mark.parametrize("tolerance", [0.01, 0.002, 0.0005])
def test_curves_keep_the_tolerance(type: str, tolerance: float) -> None:
    water = Water.jerlov(type)
    worst = {}
    for depth, g in itertools.product(DEPTHS, SHARES):
        medium = Medium.from_water(water, vertical_depth=depth, g=g, mu=0.3, tolerance=tolerance)
        worst[depth, g] = max(errors(medium, water, depth=depth, g=g, mu=0.3))
    assert max(worst.values()) <= tolerance, {case: e for case, e in worst.items() if e > tolerance}


@pytest.mark.parametrize("type", ["I", "II", "9C"])
@pytest.mark.parametrize(
    "span", [(0.0, 0.5), (0.0, 200.0), (0.0, 1000.0), (5.0, 6.0), (3.0, 80.0)], ids=str
)
def test_curves_keep_the_tolerance_over_any_range(type: str, span: tuple[float, float]) -> None:
    water = Water.jerlov(type)
    medium = Medium.from_water(water, vertical_depth=0.0, distance_range=span)
    z = np.geomspace(max(span[0], 1e-3), span[1], 600)
    assert max(errors(medium, water, z, depth=0.0, g=0.2, mu=0.3)) <= 0.002


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_no_tolerance_keeps_all_bands(type: str) -> None:
    water = Water.jerlov(type)
    medium = Medium.from_water(water, vertical_depth=10.0, g=0.2, mu=0.3, tolerance=0)
    assert medium.beta.shape == (1, 61)
    assert max(errors(medium, water, depth=10.0, g=0.2, mu=0.3)) < 1e-14


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_no_more_rates_than_needed(type: str) -> None:
    water = Water.jerlov(type)
    media = [
        Medium.from_water(water, vertical_depth=0.0, tolerance=t)
        for t in np.geomspace(0.3, 0.0004, 60)
    ]
    for curves, rates in ((slice(0, 1), "beta"), (slice(1, 3), "G")):
        found = {
            getattr(m, rates).shape[1]: max(errors(m, water, depth=0.0, g=0.2, mu=0.3)[curves])
            for m in media
        }
        for tolerance in (0.002, 0.0005):
            needed = getattr(
                Medium.from_water(water, vertical_depth=0.0, tolerance=tolerance), rates
            ).shape[1]
            fewer = [error for k, error in found.items() if k < needed]
            assert fewer, f"no medium with fewer than {needed} rates to compare with"
            assert min(fewer) > tolerance


def test_the_water_decides_how_much_to_model() -> None:
    rates = {t: Medium.from_water(Water.jerlov(t), vertical_depth=0.0) for t in JERLOV_TYPES}
    assert all(len(m.beta[0]) <= 6 and len(m.G[0]) <= 7 for m in rates.values())
    assert len(rates["II"].beta[0]) < len(rates["I"].beta[0])


@pytest.mark.parametrize("type", JERLOV_TYPES)
def test_exact_at_zero(type: str) -> None:
    water = Water.jerlov(type)
    medium = Medium.from_water(water, vertical_depth=1.0)
    light = reference.spectral_curves(water, np.zeros(()), depth=1.0, g=0.2, mu=0.3).direct
    zero = torch.zeros((), dtype=torch.float64)
    torch.testing.assert_close(
        medium.transmission(zero)[0], torch.from_numpy(light), rtol=0, atol=1e-13
    )
    torch.testing.assert_close(medium.signal(zero)[0], torch.from_numpy(light), rtol=0, atol=1e-13)
    assert (medium.backscatter(zero) == 0).all()


@pytest.mark.parametrize("type", JERLOV_TYPES)
@pytest.mark.parametrize("g", SHARES)
def test_monotone_bounded_and_positive_at_any_distance(type: str, g: float) -> None:
    medium = Medium.from_water(Water.jerlov(type), vertical_depth=0.0, g=g)
    assert all((t >= 0).all() for t in medium.tensors())
    z = torch.cat([torch.zeros(1), torch.logspace(-6, 6, 300), torch.tensor([math.inf])]).double()
    assert (medium.transmission(z).diff() <= 1e-15).all()
    assert (medium.signal(z).diff() <= 1e-15).all()
    assert (medium.backscatter(z).diff() >= -1e-15).all()
    assert (medium.transmission(z)[..., -1] == 0).all()
    assert (medium.signal(z)[..., -1] == 0).all()
    torch.testing.assert_close(medium.backscatter(z)[..., -1], medium.veil_weights.sum(-1))


def test_a_thin_layer_of_water_has_a_veil_in_float32() -> None:
    medium = Medium.from_water(Water.jerlov("3C"), vertical_depth=0.0)
    z = torch.logspace(-9, -3, 13)
    expected = reference.medium_curves(medium, z.double().numpy()).veil
    torch.testing.assert_close(
        medium.backscatter(z)[0].double(), torch.from_numpy(expected), rtol=1e-5, atol=0
    )


@pytest.mark.parametrize("b", [0.0, 0.3])
def test_a_water_that_absorbs_nothing(b: float) -> None:
    # β = 0 and G = 0, where B∞ = μ·b·E/G has the limit μ·b·E·z for the veil
    water = Water([400, 700], a=[0, 0], b=[b, b], kd=[0, 0])
    medium = Medium.from_water(water, g=0.0, mu=0.3)
    z = torch.tensor([0.0, 1e-3, 1.0, 20.0], dtype=torch.float64)
    torch.testing.assert_close(
        medium.backscatter(z)[0], (0.3 * b * z).expand(3, -1), rtol=1e-4, atol=1e-12
    )
    torch.testing.assert_close(
        medium.signal(z)[0], torch.ones(3, 4, dtype=torch.float64), rtol=0, atol=1e-4
    )
    torch.testing.assert_close(
        medium.transmission(z)[0], torch.exp(-b * z).expand(3, -1), rtol=0, atol=1e-12
    )
    assert all(
        c.isfinite().all() for c in (medium.backscatter(torch.tensor(math.inf)), medium.signal(z))
    )


def test_a_water_that_absorbs_in_part_of_the_spectrum_only() -> None:
    water = Water(
        [400, 500, 600, 700], a=[0, 0, 0.1, 0.3], b=[0.3, 0.2, 0.2, 0.2], kd=[0.1, 0.1, 0.2, 0.3]
    )
    medium = Medium.from_water(water, g=0.0)
    assert max(errors(medium, water, depth=1.0, g=0.0, mu=0.3)) <= 0.002


def test_clear_water_scatters_nothing() -> None:
    medium = Medium.from_water(Water([400, 700], a=[0.1, 0.4], b=[0, 0], kd=[0.1, 0.4]))
    z = torch.linspace(0, 20, 9).double()
    assert (medium.backscatter(z) == 0).all()
    torch.testing.assert_close(medium.signal(z), medium.transmission(z), rtol=0, atol=0.004)


def test_no_light_towards_the_camera() -> None:
    assert (
        Medium.from_water(Water.jerlov("II"), mu=0.0).backscatter(torch.tensor([1.0, 20.0])) == 0
    ).all()


@pytest.mark.parametrize("depth", [300.0, 1e4, 5e4, 1e6])
def test_no_light_down_there(depth: float) -> None:
    medium = Medium.from_water(Water.jerlov("II"), vertical_depth=depth)
    assert all(t.isfinite().all() for t in medium.tensors())
    assert medium.signal(torch.tensor(0.0)).max() < 1e-6


def test_the_camera_and_its_bands_count() -> None:
    water = Water.jerlov("II")
    nikon, sigma = (
        Medium.from_water(water, camera=c) for c in (reference.NIKON, "Sigma SDMerill (NPL)")
    )
    z = torch.tensor(5.0)
    assert (nikon.transmission(z) - sigma.transmission(z)).abs().max() > 0.01
    bands = np.arange(400.0, 701.0, 50.0)
    coarse = Medium.from_water(water, wavelengths=bands, tolerance=0)
    exact = reference.spectral_curves(water, Z, depth=1.0, g=0.2, mu=0.3, bands=bands)
    for name, curve in zip(CURVES, exact, strict=True):
        np.testing.assert_allclose(
            getattr(coarse, name)(torch.from_numpy(Z))[0].numpy(), curve, rtol=0, atol=1e-14
        )


def test_mean_scattering_is_the_mean_over_the_channels() -> None:
    water = Water.jerlov("7C")
    from uwaug.optics.camera import load_camera

    b = water.at(reference.BANDS).b @ load_camera(reference.NIKON).weights(reference.BANDS)
    assert float(Medium.from_water(water).b_mean) == pytest.approx(b.mean(), rel=1e-12)


def test_a_water_with_a_short_spectrum_uses_what_it_has() -> None:
    medium = Medium.from_water(
        Water([450, 550, 600], a=[1.0, 0.77, 0.72], b=[13, 10, 9.5], kd=[2, 1.6, 1.5]), tolerance=0
    )
    assert medium.beta.shape == (1, 31)


COEFFICIENTS = {
    "beta": (0.6, 0.3, 0.25),
    "G": (0.4, 0.1, 0.08),
    "veil": (0.1, 0.3, 0.4),
    "light": (0.7, 0.9, 1.0),
}


def test_coefficients_are_one_exponential_per_channel() -> None:
    medium = Medium.from_coefficients(**COEFFICIENTS, b_mean=0.3, point_spread=PointSpread.paper())
    beta, G, veil, light = (
        torch.tensor(v, dtype=torch.float64)[:, None] for v in COEFFICIENTS.values()
    )
    z = torch.from_numpy(Z)
    torch.testing.assert_close(medium.transmission(z)[0], light * torch.exp(-beta * z))
    torch.testing.assert_close(medium.signal(z)[0], light * torch.exp(-G * z))
    torch.testing.assert_close(medium.backscatter(z)[0], -veil * torch.expm1(-G * z))
    assert (len(medium), float(medium.b_mean)) == (1, 0.3)


def test_coefficients_may_be_batches_and_tensors() -> None:
    beta = torch.rand(4, 3)
    medium = Medium.from_coefficients(beta, beta / 2, (0.1, 0.2, 0.3), b_mean=torch.rand(4))
    assert len(medium) == 4
    assert medium.beta.dtype == torch.float32
    torch.testing.assert_close(medium.transmission(torch.tensor(2.0)), torch.exp(-2 * beta))


@pytest.mark.parametrize(
    "numbers",
    [torch.tensor([1, 2, 3]), np.array([1, 2, 3]), [1, 2, 3]],
    ids=["tensor", "array", "list"],
)
def test_whole_numbers_are_numbers(numbers: object) -> None:
    medium = Medium.from_coefficients(numbers, (0.1, 0.2, 0.3), (0.4, 0.5, 0.6))
    torch.testing.assert_close(
        medium.G.double(), torch.tensor([[0.1, 0.2, 0.3]], dtype=torch.float64)
    )
    torch.testing.assert_close(
        medium.veil_weights.sum(-1).double(), torch.tensor([[0.4, 0.5, 0.6]], dtype=torch.float64)
    )


@pytest.mark.parametrize("shape", [(), (5,), (1, 4, 6), (1, 1, 4, 6), (3, 1, 4, 6)], ids=str)
def test_shapes(shape: tuple[int, ...]) -> None:
    media = Medium.stack([Medium.from_water(Water.jerlov(t)) for t in ("I", "3C", "9C")])
    z = 5 * torch.rand(shape, dtype=torch.float64)
    for name in CURVES:
        curve = getattr(media, name)(z)
        assert curve.shape == (3, 3, *shape[-2:])
        for row in range(3):
            own = z[row, 0] if shape[:1] == (3,) else z.reshape(shape[-2:])
            expected = reference.medium_curves(media, own.numpy(), row)[CURVES.index(name)]
            np.testing.assert_allclose(curve[row].numpy(), expected, rtol=0, atol=1e-13)


def test_curves_are_computed_in_the_type_of_the_distance(coastal: Medium) -> None:
    assert coastal.signal(torch.rand(5)).dtype == torch.float32
    assert coastal.signal(torch.rand(5).double()).dtype == torch.float64


def test_autocast_changes_nothing(coastal: Medium) -> None:
    z = 10 * torch.rand(1, 1, 6, 7)
    with torch.autocast("cpu", torch.bfloat16):
        results = [getattr(coastal, name)(z) for name in CURVES]
    for name, result in zip(CURVES, results, strict=True):
        torch.testing.assert_close(result, getattr(coastal, name)(z), rtol=0, atol=1e-6)


def test_a_stack_equals_its_members() -> None:
    waters = ("I", "II", "9C")
    laws = (
        PointSpread(1.0, 0.5),
        PointSpread(2.0, 0.7),
        PointSpread(torch.tensor([3.0]), torch.tensor([0.9])),
    )
    media = [
        Medium.from_water(Water.jerlov(t), point_spread=law)
        for t, law in zip(waters, laws, strict=True)
    ]
    assert len({m.beta.shape for m in media}) > 1, "sizes should differ, or padding is not tested"
    batch = Medium.stack([*media, Medium.stack(media[:2])])
    assert len(batch) == 5
    z = 10 * torch.rand(1, 1, 6, 7, dtype=torch.float64)
    for i, member in enumerate([*media, *media[:2]]):
        for name in CURVES:
            both = getattr(batch, name)(z)[i], getattr(batch[i], name)(z)[0]
            torch.testing.assert_close(both[0], getattr(member, name)(z)[0], rtol=0, atol=1e-14)
            torch.testing.assert_close(both[0], both[1], rtol=0, atol=0)
        width = member.width(z, (6, 7))
        torch.testing.assert_close(batch.width(z, (6, 7))[i], width[0], rtol=1e-6, atol=0)
        torch.testing.assert_close(batch[i].width(z, (6, 7)), width, rtol=1e-6, atol=0)
        assert batch[i].notes == member.notes


def test_a_stack_keeps_plain_width_laws_plain() -> None:
    media = [Medium.from_water(Water.jerlov(t)) for t in ("I", "II")]
    assert Medium.stack(media).point_spread == PointSpread.paper()


def test_indexing(coastal: Medium) -> None:
    batch = Medium.stack([coastal, Medium.from_water(Water.jerlov("I"))])
    assert batch[-1].notes == batch[1].notes
    assert batch[-2].notes == batch[0].notes
    for i in (2, -3, 100):
        with pytest.raises(IndexError):
            batch[i]


def test_iteration_ends(coastal: Medium) -> None:
    assert len(list(itertools.islice(coastal, 5))) == 1


def test_to_casts_every_tensor_and_keeps_gradients() -> None:
    scale = torch.tensor([0.5], dtype=torch.float64, requires_grad=True)
    beta = torch.tensor([0.6, 0.3, 0.2], dtype=torch.float64, requires_grad=True)
    medium = Medium.from_coefficients(
        beta, (0.1,) * 3, (0.2,) * 3, b_mean=0.3, point_spread=PointSpread(scale)
    ).to(torch.float32)
    assert {t.dtype for t in (*medium.tensors(), medium.point_spread.scale)} == {torch.float32}
    (
        medium.transmission(torch.tensor(1.0)).sum()
        + medium.width(torch.ones(1, 1, 1, 1), (9, 9)).sum()
    ).backward()
    assert beta.grad is not None
    assert scale.grad is not None


def test_gradients_of_every_tensor() -> None:
    def evaluate(*tensors: torch.Tensor) -> torch.Tensor:
        *medium, scale, exponent, z = tensors
        m = Medium(*medium, PointSpread(scale, exponent))
        return torch.cat(
            [
                m.transmission(z),
                m.signal(z),
                m.backscatter(z),
                m.width(z, (3, 4)).expand(2, 3, 3, 4),
            ]
        )

    rand = lambda *shape: torch.rand(*shape, dtype=torch.float64, requires_grad=True)  # noqa: E731
    inputs = (
        rand(2, 2),
        rand(2, 3, 2),
        rand(2, 3),
        rand(2, 3, 3),
        rand(2, 3, 3),
        rand(2),
        rand(2),
        rand(2),
        rand(1, 1, 3, 4),
    )
    assert torch.autograd.gradcheck(evaluate, inputs)


@pytest.mark.parametrize("z", [0.0, 1e-30, 1e4, math.inf])
@pytest.mark.parametrize("rate", [0.0, 0.5, 1e4])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_at_the_ends(z: float, rate: float, dtype: torch.dtype) -> None:
    rates = torch.full((3,), rate, dtype=dtype, requires_grad=True)
    veil = torch.full((3,), 0.3, dtype=dtype, requires_grad=True)
    distance = torch.full((1, 1, 2, 2), z, dtype=dtype, requires_grad=True)
    b_mean, scale, exponent = (
        torch.full((1,), v, dtype=dtype, requires_grad=True) for v in (rate, 2.0, 0.5)
    )
    medium = Medium.from_coefficients(
        rates, rates, veil, b_mean=b_mean, point_spread=PointSpread(scale, exponent)
    )
    total = sum(getattr(medium, name)(distance).sum() for name in CURVES)
    total.backward()
    tensors = (rates, veil, distance)
    assert all(t.grad is not None and t.grad.isfinite().all() for t in tensors)
    assert not medium.width(distance, (9, 9)).isnan().any()


def test_copies_survive(coastal: Medium) -> None:
    for twin in (pickle.loads(pickle.dumps(coastal)), copy.deepcopy(coastal)):
        assert all(
            torch.equal(a, b) for a, b in zip(twin.tensors(), coastal.tensors(), strict=True)
        )
        assert (twin.point_spread, twin.notes) == (coastal.point_spread, coastal.notes)


def test_repr_says_what_it_models(coastal: Medium) -> None:
    text = repr(coastal)
    for part in ("3C", "3 + 3 rates", "0…20 m", "g = 0.2", "μ = 0.3", "gaussian", "518 px", "b̄ = "):
        assert part in text
    assert "2 more" in repr(Medium.stack([coastal] * 3))
    assert "no blur" in repr(Medium.from_coefficients((1,) * 3, (1,) * 3, (0,) * 3))
    law = PointSpread(torch.tensor([1.0], requires_grad=True))
    assert "learned" in repr(
        Medium.from_coefficients((1,) * 3, (1,) * 3, (0,) * 3, point_spread=law)
    )
    exact = Medium.from_water(Water.jerlov("3C"), tolerance=0)
    assert "61 + 61 rates" in repr(exact)


def test_the_error_in_the_repr_is_the_error() -> None:
    water = Water.jerlov("9C")
    medium = Medium.from_water(water, tolerance=0.0005)
    claimed = float(repr(medium).split("within ")[1].split()[0])
    assert max(errors(medium, water, depth=1.0, g=0.2, mu=0.3)) <= 1.1 * claimed


@pytest.mark.parametrize(
    "change, match",
    [
        ({"vertical_depth": -1.0}, "vertical_depth.*-1"),
        ({"vertical_depth": math.inf}, "vertical_depth.*inf"),
        ({"vertical_depth": math.nan}, "vertical_depth.*nan"),
        ({"g": -0.1}, r"g must.*\[0, 1\].*-0.1"),
        ({"g": 1.1}, "g must.*1.1"),
        ({"mu": 30.0}, "mu must.*30"),
        ({"mu": math.nan}, "mu must.*nan"),
        ({"tolerance": -0.1}, "tolerance.*-0.1"),
        ({"tolerance": 1.0}, "tolerance.*1"),
        ({"tolerance": math.nan}, "tolerance.*nan"),
        ({"distance_range": (5.0, 1.0)}, r"distance_range.*\(5.0, 1.0\)"),
        ({"distance_range": (0.0, 0.0)}, "distance_range"),
        ({"distance_range": (-1.0, 2.0)}, "distance_range"),
        ({"distance_range": (0.0, math.inf)}, "distance_range"),
        ({"distance_range": (math.nan, 2.0)}, "distance_range"),
        ({"camera": "Kodak"}, "Kodak"),
        ({"wavelengths": [200.0, 400.0]}, "200"),
    ],
)
def test_from_water_rejects(change: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        Medium.from_water(Water.jerlov("II"), **change)


def test_from_water_wants_a_water() -> None:
    with pytest.raises(TypeError, match="water"):
        Medium.from_water("7C")  # Water.jerlov("7C") was meant


def test_from_water_says_so_if_the_spectrum_is_elsewhere() -> None:
    with pytest.raises(ValueError, match="400"):
        Medium.from_water(Water([750, 800], a=[1, 1], b=[1, 1], kd=[1, 1]))


@pytest.mark.parametrize(
    "change, match",
    [
        ({"beta": (0.1, 0.2)}, r"beta.*\(2,\)"),
        ({"G": torch.rand(2, 4)}, r"G must.*\(2, 4\)"),
        ({"veil": torch.rand(1, 1, 3)}, r"veil.*\(1, 1, 3\)"),
        ({"beta": (0.1, -0.2, 0.3)}, "beta.*-0.2"),
        ({"G": (0.1, math.nan, 0.3)}, "G must.*nan"),
        ({"veil": (0.1, math.inf, 0.3)}, "veil.*inf"),
        ({"light": (0.1, -1.0, 0.3)}, "light.*-1"),
        ({"beta": torch.rand(2, 3), "G": torch.rand(3, 3)}, "beta|G"),
        ({"b_mean": -1.0}, "b_mean.*-1"),
        ({"b_mean": math.nan}, "b_mean.*nan"),
        ({"b_mean": torch.rand(2, 2)}, "b_mean"),
    ],
)
def test_from_coefficients_rejects(change: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        Medium.from_coefficients(**{**COEFFICIENTS, **change})


@pytest.mark.parametrize(
    "name", ["beta", "direct_weights", "G", "signal_weights", "veil_weights", "b_mean"]
)
def test_medium_rejects_shapes_that_disagree(name: str, coastal: Medium) -> None:
    fields = dict(
        zip(
            ("beta", "direct_weights", "G", "signal_weights", "veil_weights", "b_mean"),
            coastal.tensors(),
            strict=True,
        )
    )
    with pytest.raises(ValueError, match=r"Medium\.\w+ must have shape .* got"):
        Medium(**{**fields, name: torch.rand(2, 5, 7)}, point_spread=PointSpread.none())


def test_stack_rejects(coastal: Medium) -> None:
    with pytest.raises(ValueError, match="media is empty"):
        Medium.stack([])
    other = Medium.from_water(Water.jerlov("II"), point_spread=PointSpread(1.0))
    with pytest.raises(ValueError, match="reference_size"):
        Medium.stack([coastal, other])
    calibrated = Medium.from_water(
        Water.jerlov("II"), g=0.05, mu=0.075, point_spread=PointSpread.calibrated(400.0)
    )
    with pytest.raises(
        ValueError,
        match=r"shape and reference_size .*exponential σ = 12·.*gaussian σ = 0\.3·.* 518 px",
    ):
        Medium.stack([coastal, calibrated])
    with pytest.raises(ValueError, match=r"got \['exponential .*', 'gaussian .*'\]"):
        Medium.stack([other, calibrated])


def test_calibrated_media_of_several_cameras_stack() -> None:
    laws = [PointSpread.calibrated(focal) for focal in (200.0, 400.0, 900.0)]
    medium = Medium.stack([Medium.from_water(Water.jerlov("II"), point_spread=law) for law in laws])
    z = torch.tensor([0.5, 3.0], dtype=torch.float64).reshape(1, 1, 1, 2)
    for i, law in enumerate(laws):
        expected = Medium.from_water(Water.jerlov("II"), point_spread=law).width(z, (64, 64))
        torch.testing.assert_close(medium.width(z, (64, 64))[i : i + 1], expected)
        assert medium[i].point_spread.shape == law.shape == "exponential"


def test_width_laws() -> None:
    lengths = torch.tensor([0.0, 0.5, 2.0, 8.0], dtype=torch.float64).reshape(1, 1, 1, 4)
    for law, scale, exponent, size in (
        (PointSpread.paper(), 0.3 * 259 / 518, 1.0, (259, 300)),
        (PointSpread.paper(0.8), 0.8, 1.0, (800, 518)),
        (PointSpread.calibrated(400.0), 12.0, 0.62, (64, 64)),
        (PointSpread(3.0, 2.0), 3.0, 2.0, (9, 9)),
        (PointSpread.none(), 0.0, 1.0, (9, 9)),
    ):
        expected = scale * lengths**exponent
        width = law.sigma(lengths, size)
        assert width[..., 0] < 0.05  # px; where the law has an infinite slope it may start above 0
        torch.testing.assert_close(width[..., 1:], expected[..., 1:], rtol=1e-12, atol=0)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.floats(0, 100), st.floats(0.05, 3), st.floats(0, 1e9))
def test_width_grows_with_distance_and_is_finite(scale: float, exponent: float, z: float) -> None:
    lengths = (
        torch.tensor([z, 2 * z + 1e-3], dtype=torch.float64).reshape(1, 1, 1, 2).requires_grad_()
    )
    width = PointSpread(scale, exponent).sigma(lengths, (100, 100))
    width.sum().backward()
    assert width.isfinite().all()
    assert lengths.grad.isfinite().all()
    assert (width.diff() >= 0).all()


@pytest.mark.parametrize(
    "arguments, match",
    [
        ({"scale": -1.0}, "scale.*-1"),
        ({"scale": math.nan}, "scale.*nan"),
        ({"scale": math.inf}, "scale.*inf"),
        ({"scale": 1.0, "exponent": 0.0}, "exponent.*0"),
        ({"scale": 1.0, "exponent": -1.0}, "exponent.*-1"),
        ({"scale": 1.0, "shape": "lorentzian"}, "shape.*lorentzian"),
        ({"scale": 1.0, "reference_size": 0.0}, "reference_size.*0"),
        ({"scale": 1.0, "reference_size": math.nan}, "reference_size.*nan"),
        ({"scale": 1.0, "reference_size": math.inf}, "reference_size.*inf"),
    ],
)
def test_point_spread_rejects(arguments: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        PointSpread(**arguments)


@pytest.mark.parametrize("focal", [0.0, -3.0, math.inf, math.nan])
def test_calibrated_wants_a_focal_length(focal: float) -> None:
    with pytest.raises(ValueError, match="focal_px"):
        PointSpread.calibrated(focal)
