import copy
import itertools
import math
import pickle

import numpy as np
import pytest
import torch
from optical import CURVES, Z
from referees import reference

from uwaug.optics.camera import load_camera
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water


@pytest.mark.parametrize("b", [0.0, 0.3])
def test_a_water_that_absorbs_nothing(b: float) -> None:
    # β = 0 and G = 0, where B∞ = μ·b·E/G has the limit μ·b·E·z for the veil
    water = Water([400, 700], a=[0, 0], b=[b, b], kd=[0, 0])
    medium = Medium.from_water(water, g=0.0, mu=0.3)
    z = torch.tensor([0.0, 1e-3, 1.0, 20.0], dtype=torch.float64)
    veil, signal, transmission = medium.backscatter(z)[0], medium.signal(z), medium.transmission(z)
    ones = torch.ones(3, 4, dtype=torch.float64)
    kept = torch.exp(-b * z).expand(3, -1)
    torch.testing.assert_close(veil, (0.3 * b * z).expand(3, -1), rtol=1e-4, atol=1e-12)
    torch.testing.assert_close(signal[0], ones, rtol=0, atol=1e-4)
    torch.testing.assert_close(transmission[0], kept, rtol=0, atol=1e-12)
    assert medium.backscatter(torch.tensor(math.inf)).isfinite().all()
    assert signal.isfinite().all()


def test_clear_water_scatters_nothing() -> None:
    medium = Medium.from_water(Water([400, 700], a=[0.1, 0.4], b=[0, 0], kd=[0.1, 0.4]))
    z = torch.linspace(0, 20, 9).double()
    assert (medium.backscatter(z) == 0).all()
    torch.testing.assert_close(medium.signal(z), medium.transmission(z), rtol=0, atol=0.004)


def test_no_light_towards_the_camera() -> None:
    medium = Medium.from_water(Water.jerlov("II"), mu=0.0)
    assert (medium.backscatter(torch.tensor([1.0, 20.0])) == 0).all()


@pytest.mark.parametrize("depth", [300.0, 1e4, 5e4, 1e6])
def test_no_light_down_there(depth: float) -> None:
    medium = Medium.from_water(Water.jerlov("II"), vertical_depth=depth)
    assert all(t.isfinite().all() for t in medium.tensors())
    assert medium.signal(torch.tensor(0.0)).max() < 1e-6


def test_the_camera_and_its_bands_count() -> None:
    water = Water.jerlov("II")
    nikon = Medium.from_water(water, camera=reference.NIKON)
    sigma = Medium.from_water(water, camera="Sigma SDMerill (NPL)")
    z = torch.tensor(5.0)
    assert (nikon.transmission(z) - sigma.transmission(z)).abs().max() > 0.01
    bands = np.arange(400.0, 701.0, 50.0)
    coarse = Medium.from_water(water, wavelengths=bands, tolerance=0)
    exact = reference.spectral_curves(water, Z, depth=1.0, g=0.2, mu=0.3, bands=bands)
    for name, curve in zip(CURVES, exact, strict=True):
        ours = getattr(coarse, name)(torch.from_numpy(Z))[0].numpy()
        np.testing.assert_allclose(ours, curve, rtol=0, atol=1e-14)


def test_mean_scattering_is_the_mean_over_the_channels() -> None:
    water = Water.jerlov("7C")
    b = water.at(reference.BANDS).b @ load_camera(reference.NIKON).weights(reference.BANDS)
    assert float(Medium.from_water(water).b_mean) == pytest.approx(b.mean(), rel=1e-12)


def test_a_water_with_a_short_spectrum_uses_what_it_has() -> None:
    water = Water([450, 550, 600], a=[1.0, 0.77, 0.72], b=[13, 10, 9.5], kd=[2, 1.6, 1.5])
    medium = Medium.from_water(water, tolerance=0)
    assert medium.beta.shape == (1, 31)


COEFFICIENTS = {
    "beta": (0.6, 0.3, 0.25),
    "G": (0.4, 0.1, 0.08),
    "veil": (0.1, 0.3, 0.4),
    "light": (0.7, 0.9, 1.0),
}


def test_coefficients_are_one_exponential_per_channel() -> None:
    medium = Medium.from_coefficients(**COEFFICIENTS, b_mean=0.3, point_spread=PointSpread.paper())
    numbers = torch.tensor(list(COEFFICIENTS.values()), dtype=torch.float64)
    beta, G, veil, light = numbers[..., None]
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
    G = torch.tensor([[0.1, 0.2, 0.3]], dtype=torch.float64)
    veil = torch.tensor([[0.4, 0.5, 0.6]], dtype=torch.float64)
    torch.testing.assert_close(medium.G.double(), G)
    torch.testing.assert_close(medium.veil_weights.sum(-1).double(), veil)


def test_a_stack_equals_its_members() -> None:
    laws = {
        "I": PointSpread(1.0, 0.5),
        "II": PointSpread(2.0, 0.7),
        "9C": PointSpread(torch.tensor([3.0]), torch.tensor([0.9])),
    }
    media = [Medium.from_water(Water.jerlov(t), point_spread=law) for t, law in laws.items()]
    assert len({m.beta.shape for m in media}) > 1, "sizes should differ, or padding is not tested"
    batch = Medium.stack([*media, Medium.stack(media[:2])])
    assert len(batch) == 5
    z = 10 * torch.rand(1, 1, 6, 7, dtype=torch.float64)
    for i, member in enumerate([*media, *media[:2]]):
        for name in CURVES:
            both = getattr(batch, name)(z)[i], getattr(batch[i], name)(z)[0]
            torch.testing.assert_close(both[0], getattr(member, name)(z)[0], rtol=0, atol=1e-14)
            # products of batches and of one may differ in the last bit
            torch.testing.assert_close(both[0], both[1], rtol=0, atol=1e-15)
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
    law = PointSpread(scale)
    medium = Medium.from_coefficients(beta, (0.1,) * 3, (0.2,) * 3, b_mean=0.3, point_spread=law)
    medium = medium.to(torch.float32)
    assert {t.dtype for t in (*medium.tensors(), medium.point_spread.scale)} == {torch.float32}
    transmission = medium.transmission(torch.tensor(1.0))
    width = medium.width(torch.ones(1, 1, 1, 1), (9, 9))
    (transmission.sum() + width.sum()).backward()
    assert beta.grad is not None
    assert scale.grad is not None


def test_copies_survive(coastal: Medium) -> None:
    for twin in (pickle.loads(pickle.dumps(coastal)), copy.deepcopy(coastal)):
        pairs = zip(twin.tensors(), coastal.tensors(), strict=True)
        assert all(torch.equal(a, b) for a, b in pairs)
        assert (twin.point_spread, twin.notes) == (coastal.point_spread, coastal.notes)


def test_repr_says_what_it_models(coastal: Medium) -> None:
    text = repr(coastal)
    for part in (
        "3C",
        "2 + 2 rates",
        "at any distance",
        "g = 0.2",
        "μ = 0.3",
        "gaussian",
        "518 px",
        "b̄ = ",
    ):
        assert part in text
    assert "2 more" in repr(Medium.stack([coastal] * 3))
    numbers = (1,) * 3, (1,) * 3, (0,) * 3
    assert "no blur" in repr(Medium.from_coefficients(*numbers))
    law = PointSpread(torch.tensor([1.0], requires_grad=True))
    assert "learned" in repr(Medium.from_coefficients(*numbers, point_spread=law))
    exact = Medium.from_water(Water.jerlov("3C"), tolerance=0)
    assert "61 + 61 rates" in repr(exact)


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
        ({"camera": "Kodak"}, "Kodak"),
        ({"wavelengths": [200.0, 400.0]}, "200"),
    ],
)
def test_from_water_rejects(change: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        Medium.from_water(Water.jerlov("II"), **change)


def test_from_water_wants_a_water() -> None:
    with pytest.raises(TypeError, match=r"water must be a uwaug.Water, got dict; see Water.jerlov"):
        Medium.from_water({"a": 1})
    with pytest.raises(ValueError, match=r"type must be one of I, IA.*got 'sea'"):
        Medium.from_water("sea")


def test_from_water_takes_the_name_of_a_jerlov_type() -> None:
    named, given = Medium.from_water("7C"), Medium.from_water(Water.jerlov("7C"))
    pairs = zip(named.tensors(), given.tensors(), strict=True)
    assert all(torch.equal(one, other) for one, other in pairs)


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


TENSORS = ("beta", "direct_weights", "G", "signal_weights", "veil_weights", "b_mean")


@pytest.mark.parametrize("name", TENSORS)
def test_medium_rejects_shapes_that_disagree(name: str, coastal: Medium) -> None:
    fields = dict(zip(TENSORS, coastal.tensors(), strict=True))
    with pytest.raises(ValueError, match=r"Medium\.\w+ must have shape .* got"):
        Medium(**{**fields, name: torch.rand(2, 5, 7)}, point_spread=PointSpread.none())


def test_stack_rejects(coastal: Medium) -> None:
    with pytest.raises(ValueError, match="media is empty"):
        Medium.stack([])
    other = Medium.from_water(Water.jerlov("II"), point_spread=PointSpread(1.0))
    with pytest.raises(ValueError, match="reference_size"):
        Medium.stack([coastal, other])
    law = PointSpread.calibrated(400.0)
    calibrated = Medium.from_water(Water.jerlov("II"), g=0.05, mu=0.075, point_spread=law)
    message = r"shape and reference_size .*exponential σ = 12·.*gaussian σ = 0\.3·.* 518 px"
    with pytest.raises(ValueError, match=message):
        Medium.stack([coastal, calibrated])
    with pytest.raises(ValueError, match=r"got \['exponential .*', 'gaussian .*'\]"):
        Medium.stack([other, calibrated])
