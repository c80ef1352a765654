import copy
import itertools
import math
import pickle
import re
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from optical import CURVES, Z
from referees import reference

from uwaug.optics.camera import load_camera
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water


@pytest.fixture
def coastal() -> Medium:
    return Medium.from_water(Water.jerlov("3C"))


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


@pytest.mark.parametrize("depth", [300.0, 1e6])
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
    assert batch[-1].notes == media[1].notes
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


def test_a_water_under_a_lamp() -> None:
    water, z = Water.jerlov("3C"), torch.from_numpy(Z)
    medium = Medium.from_water(water, vertical_depth=30.0, tolerance=0, g=0.2)
    exact = reference.spectral_curves(water, Z, depth=0.0, g=0.2, mu=0.3)
    white = medium.under()
    np.testing.assert_allclose(white.transmission(z)[0], exact.direct, atol=1e-13)
    np.testing.assert_allclose(white.signal(z)[0], exact.signal, atol=1e-13)
    b = water.at(reference.BANDS).b @ load_camera(reference.NIKON).weights(reference.BANDS)
    np.testing.assert_allclose(white.veil_weights.sum(-1)[0], b, rtol=1e-12)
    red = medium.under(lambda nm: np.where(nm > 600, 1.0, 0.0)).signal_weights.sum(-1)[0]
    assert float(red.mean()) == pytest.approx(1)
    assert red[0] > 10 * red[2]


def test_copies_and_iteration(coastal: Medium) -> None:
    assert len(list(itertools.islice(coastal, 5))) == 1
    for twin in (pickle.loads(pickle.dumps(coastal)), copy.deepcopy(coastal)):
        pairs = zip(twin.tensors(), coastal.tensors(), strict=True)
        assert all(torch.equal(a, b) for a, b in pairs)
        assert (twin.point_spread, twin.notes) == (coastal.point_spread, coastal.notes)


def test_repr_says_what_it_models(coastal: Medium) -> None:
    text = repr(coastal)
    said = (
        "3C",
        "2 + 2 rates",
        "at any distance",
        "g = 0.2",
        "μ = 0.3",
        "gaussian",
        "518 px",
        "b̄ = ",
    )
    assert not [part for part in said if part not in text]
    assert "2 more" in repr(Medium.stack([coastal] * 3))
    law = PointSpread(torch.tensor([1.0], requires_grad=True))
    numbers = (1,) * 3, (1,) * 3, (0,) * 3
    assert "no blur" in repr(Medium.from_coefficients(*numbers))
    assert "learned" in repr(Medium.from_coefficients(*numbers, point_spread=law))
    beam = Medium.from_water("3C", tolerance=0, downwelling="beam")
    assert "61 + 61 rates" in repr(beam)
    assert "downwelling = beam" in repr(beam)


@pytest.mark.parametrize(
    "water, change, match",
    [
        ("II", {"vertical_depth": -1.0}, "vertical_depth.*-1"),
        ("II", {"g": 1.1}, r"g must.*\[0, 1\].*1.1"),
        ("II", {"mu": math.nan}, "mu must.*nan"),
        ("II", {"tolerance": 1.0}, "tolerance.*1"),
        ("II", {"camera": "Kodak"}, "Kodak"),
        ("II", {"wavelengths": [200.0, 400.0]}, "200"),
        ("sea", {}, r"water must be one of I, IA.*got 'sea'"),
        (Water([750, 800], a=[1, 1], b=[1, 1], kd=[1, 1]), {}, "no band of 400–700 nm"),
        ({"a": 1}, {}, r"water must be .* or a uwaug.Water, got \{'a': 1\}; see Water.jerlov"),
        ("7C", {"g": torch.tensor(0.5)}, "g must be a number, got a tensor; to .* learnable=True"),
    ],
)
def test_from_water_rejects(water: Any, change: dict[str, Any], match: str) -> None:
    with pytest.raises((TypeError, ValueError), match=match):
        Medium.from_water(water, **change)


@pytest.mark.parametrize(
    "change, match",
    [
        ({"beta": (0.1, 0.2)}, r"beta.*\(2,\)"),
        ({"veil": torch.rand(1, 1, 3)}, r"veil.*\(1, 1, 3\)"),
        ({"G": (0.1, math.nan, 0.3)}, "G must.*nan"),
        ({"light": (0.1, -1.0, 0.3)}, "light.*-1"),
        ({"beta": torch.rand(2, 3), "G": torch.rand(3, 3)}, "batch sizes"),
        ({"b_mean": torch.rand(2, 2)}, "b_mean"),
        (
            {"G": (0.4, 0.5, 0.1)},
            r"G must be beta at most.*got G = .*\[\[0.4, 0.5, 0.1\]\] and beta",
        ),
        ({"G": (0.4, 0.5, 0.1), "forward": "direct"}, "G must be beta at most"),
    ],
)
def test_from_coefficients_rejects(change: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        Medium.from_coefficients(**{**COEFFICIENTS, **change})


def test_medium_rejects_shapes_that_disagree(coastal: Medium) -> None:
    for i in range(6):
        tensors = list(coastal.tensors())
        tensors[i] = torch.rand(2, 5, 7)
        with pytest.raises(ValueError, match=r"Medium\.\w+ must have shape .* got"):
            Medium(*tensors, point_spread=PointSpread.none())


def test_stack_rejects(coastal: Medium) -> None:
    with pytest.raises(ValueError, match="media is empty"):
        Medium.stack(iter([]))
    with pytest.raises(TypeError, match=r"media must be a uwaug.Medium, got str"):
        Medium.stack("7C")
    calibrated = Medium.from_water("II", point_spread=PointSpread.calibrated(400.0))
    message = r"shape and reference_size .*exponential σ = 12·.*gaussian σ = 0\.3·.* 518 px"
    with pytest.raises(ValueError, match=message):
        Medium.stack([coastal, calibrated])


def test_slices_of_media() -> None:
    beta = torch.arange(1.0, 13.0).reshape(4, 3)
    law = PointSpread(torch.arange(4.0))
    medium = Medium.from_coefficients(beta, beta / 2, beta / 3, point_spread=law)
    for part in (slice(0, 2), slice(1, None), slice(None, None, 2), slice(-2, None)):
        torch.testing.assert_close(medium[part].beta, beta[part])
        torch.testing.assert_close(medium[part].point_spread.scale, torch.arange(4.0)[part])
        assert medium[part].notes == medium.notes[part]
    with pytest.raises(IndexError, match=re.escape("medium slice(4, 9, None) of 4")):
        medium[4:9]
    with pytest.raises(TypeError, match="str"):
        medium["a"]


SILLY = st.floats(0, 1e300) | st.sampled_from([0.0, 5e-324, 1e-300, 1e-9, 1e150])


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.lists(SILLY, min_size=6, max_size=6), st.floats(0, 1e6), st.floats(0, 1), st.floats(0, 1))
@pytest.mark.filterwarnings("error")
def test_silly_waters_pass_in_silence(
    values: list[float], depth: float, g: float, mu: float
) -> None:
    water = Water([400, 700], values[:2], values[2:4], values[4:])
    medium = Medium.from_water(water, vertical_depth=depth, g=g, mu=mu)
    assert all(not t.isnan().any() for t in medium.tensors())
    assert all((t >= 0).all() for t in medium.tensors())
