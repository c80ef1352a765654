"""Media: from waters and coefficients, in batches, copied, cast."""

import copy
import itertools
import json
import math
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from referees import reference
from refusing import refusals
from scenes import CURVES, Z, coastal

from uwaug import Lamp, Light, MarineSnow, Medium, PointSpread, Water, load_camera
from uwaug._support import codec
from uwaug.optics.view import WIDE

FIT = Medium.from_coefficients([0.4, 0.2, 0.1], [0.3, 0.15, 0.1], [0.1, 0.3, 0.4], b_mean=0.2)
SIGMA = "Sigma SDMerill (NPL)"


@pytest.mark.parametrize("b", [0.0, 0.3])
def test_a_water_that_absorbs_nothing(b: float) -> None:
    # β = 0 and G = 0, where B∞ = μ·b·E/G has the limit μ·b·E·z for the veil
    medium = Medium.from_water(Water([400, 700], a=[0, 0], b=[b, b], kd=[0, 0]), g=0.0, mu=0.3)
    z = torch.tensor([0.0, 1e-3, 1.0, 20.0], dtype=torch.float64)
    direct, signal, veil = (getattr(medium, name)(z)[0] for name in CURVES)
    torch.testing.assert_close(veil, (0.3 * b * z).expand(3, -1), rtol=1e-4, atol=1e-12)
    torch.testing.assert_close(signal, torch.ones_like(signal), rtol=0, atol=1e-4)
    torch.testing.assert_close(direct, torch.exp(-b * z).expand(3, -1), rtol=0, atol=1e-12)
    assert medium.backscatter(torch.tensor(math.inf)).isfinite().all()


def test_a_water_under_a_lamp() -> None:
    water, z = Water.jerlov("3C"), torch.from_numpy(Z)
    deep = Medium.from_water(water, vertical_depth=30.0, tolerance=0, g=0.2).under_lamp()
    exact = reference.spectral_curves(water, Z, depth=0.0, g=0.2, mu=0.3)
    np.testing.assert_allclose(deep.transmission(z)[0], exact.direct, atol=1e-13)
    np.testing.assert_allclose(deep.signal(z)[0], exact.signal, atol=1e-13)
    b = water.at(reference.BANDS).b @ load_camera(reference.NIKON).weights(reference.BANDS)
    np.testing.assert_allclose(deep.veil_weights.sum(-1)[0], b, rtol=1e-12)


# ---- coefficients


COEFFICIENTS = {
    "beta": (0.6, 0.3, 0.25),
    "G": (0.4, 0.1, 0.08),
    "veil": (0.1, 0.3, 0.4),
    "light": (0.7, 0.9, 1.0),
}


@pytest.mark.parametrize("kind", [tuple, np.array, torch.tensor])
def test_coefficients_are_one_exponential_per_channel(kind: Any) -> None:
    given = {name: kind(values) for name, values in COEFFICIENTS.items()}
    medium = Medium.from_coefficients(**given, b_mean=0.3, point_spread=PointSpread.paper())
    beta, G, veil, light = torch.tensor(list(COEFFICIENTS.values())).to(medium.beta)[..., None]
    z = torch.from_numpy(Z)
    torch.testing.assert_close(medium.transmission(z)[0], light * torch.exp(-beta * z))
    torch.testing.assert_close(medium.signal(z)[0], light * torch.exp(-G * z))
    torch.testing.assert_close(medium.backscatter(z)[0], -veil * torch.expm1(-G * z))
    assert (len(medium), round(float(medium.b_mean), 6)) == (1, 0.3)
    assert medium.is_of_coefficients


@pytest.mark.parametrize("surfaces", ["grey", "spectral"])
@pytest.mark.parametrize("water, depth", [("I", 0.0), ("3C", 1.0), ("9C", 40.0)])
def test_as_coefficients(water: str, depth: float, surfaces: Any) -> None:
    medium = Medium.from_water(water, vertical_depth=depth, surfaces=surfaces)
    classic, far = medium.as_coefficients(2.0), torch.tensor([0.0, 2.0, math.inf]).double()
    assert classic.is_of_coefficients
    assert not medium.is_of_coefficients

    def white(T: torch.Tensor) -> torch.Tensor:
        return T.sum(2) if T.ndim == 4 else T

    for name in ("transmission", "signal"):
        wanted, found = (white(getattr(m, name)(far)) for m in (medium, classic))
        torch.testing.assert_close(found, wanted.clamp(min=0), rtol=0, atol=2e-3)
    veil = medium.veil_weights.sum(-1).clamp(min=0)
    torch.testing.assert_close(classic.veil_weights.sum(-1), veil)
    assert torch.equal(classic.as_coefficients(2.0).beta.isfinite(), torch.ones(1, 3).bool())


# ---- batches, copies


def test_a_stack_equals_its_members() -> None:
    laws = {
        "I": PointSpread(1.0, 0.5),
        "II": PointSpread(2.0, 0.7),
        "9C": PointSpread(3.0, 0.9),
    }
    media = [Medium.from_water(type, point_spread=law) for type, law in laws.items()]
    assert len({m.beta.shape for m in media}) > 1, "sizes should differ, or padding is not tested"
    batch = Medium.stack([*media, Medium.stack(media[:2])])
    z = 10 * torch.rand(1, 1, 6, 7, dtype=torch.float64)
    for i, member in enumerate([*media, *media[:2]]):
        for name in CURVES:
            ours, own = (getattr(m, name)(z) for m in (batch, batch[i]))
            torch.testing.assert_close(ours[i], getattr(member, name)(z)[0], rtol=0, atol=1e-14)
            torch.testing.assert_close(own[0], ours[i], rtol=0, atol=1e-14)
        torch.testing.assert_close(batch.width(z)[i], member.width(z)[0], rtol=1e-6, atol=0)
        assert batch[i].notes == member.notes
    assert (len(batch), batch[-1].notes) == (5, media[1].notes)
    for part in (slice(1, None), slice(None, None, 2), slice(-2, None)):
        pairs = zip(batch[part].tensors(), batch.tensors(), strict=True)
        assert all(torch.equal(own, all_of_them[part]) for own, all_of_them in pairs)
        assert batch[part].notes == batch.notes[part]
    wide = batch[1].expand(3)
    assert (len(wide), wide.notes) == (3, batch[1].notes * 3)
    assert torch.equal(wide.beta, batch.beta[[1, 1, 1]])
    assert len(list(itertools.islice(batch, 9))) == 5


@pytest.mark.parametrize("lamp", [None, Lamp((0.4, -0.3, 0.1), 2.0, (0.1, 0.2, 1.0), 40.0)])
@pytest.mark.parametrize("make", [lambda: Medium.from_water("3C"), lambda: FIT])
def test_twice_the_contents_are_half_the_lengths(make: Any, lamp: Lamp | None) -> None:
    medium, z = make(), torch.linspace(0.3, 4, 12, dtype=torch.float64).reshape(1, 1, 3, 4)
    wide = medium.with_contents(2.0)
    torch.testing.assert_close(wide.width(z), medium.width(2 * z))
    if lamp is None:
        pairs = zip(wide.curves(z), medium.curves(2 * z), strict=True)
    else:
        x, y, forward = lamp.position
        far = replace(lamp, position=(2 * x, 2 * y, 2 * forward), power=4 * lamp.power)
        pairs = zip(
            Light((lamp,), 0.0).curves(wide, z, WIDE),
            Light((far,), 0.0).curves(medium, 2 * z, WIDE),
            strict=True,
        )
    for ours, wanted in pairs:
        # sums over the way of a lamp's light are good to half a percent
        torch.testing.assert_close(
            ours, wanted, rtol=1e-2 if lamp else 1e-4, atol=1e-4 if lamp else 1e-6
        )
    nothing = medium.with_contents(0.0).transmission(z)
    torch.testing.assert_close(nothing, medium.transmission(0 * z))


def test_to_casts_every_tensor_and_keeps_gradients() -> None:
    scale = torch.tensor([0.5], dtype=torch.float64, requires_grad=True)
    beta = torch.tensor([0.6, 0.3, 0.2], dtype=torch.float64, requires_grad=True)
    medium = Medium.from_coefficients(beta, (0.1,) * 3, (0.2,) * 3, b_mean=0.3)
    medium = replace(medium, scale=scale).to(torch.float32)
    assert {t.dtype for t in medium.tensors()} == {torch.float32}
    width = medium.width(torch.ones(1, 1, 1, 1))
    (medium.transmission(torch.tensor(1.0)).sum() + width.sum()).backward()
    assert beta.grad is not None
    assert scale.grad is not None


def test_copies() -> None:
    stack = Medium.stack([Medium.from_water(w, surfaces="spectral") for w in ("I", "II")])
    for medium in (coastal(), stack, Medium.from_coefficients(**COEFFICIENTS)):
        stored = codec.from_plain(json.loads(json.dumps(codec.to_plain(medium))), Medium)
        for again in (copy.deepcopy(medium), pickle.loads(pickle.dumps(medium)), stored):
            pairs = zip(again.tensors(), medium.tensors(), strict=True)
            assert all(torch.equal(a, b) for a, b in pairs)
            assert (again.law, again.notes) == (medium.law, medium.notes)


def test_arrays_and_the_tensors_that_are_made_of_them() -> None:
    for water, surfaces in (("II", "grey"), ("7C", "spectral")):
        medium = Medium.from_water(water, surfaces=surfaces).with_snow(MarineSnow(seed=1))
        before = medium.weights()
        twins = [copy.deepcopy(medium), pickle.loads(pickle.dumps(medium)), medium[0]]
        assert not medium.is_of_arrays, "a slice asks for tensors"
        for twin in twins:
            pairs = zip(twin.tensors(), medium.tensors(), strict=True)
            assert all(torch.equal(a, b) for a, b in pairs)
        tensors = replace(medium, notes=("of tensors",)).weights()
        for arrays in (medium.weights(), tensors):
            assert all(map(np.array_equal, arrays, before))
    medium, factor = Medium.from_water("II"), torch.ones(1, requires_grad=True)
    with torch.inference_mode():
        asked = medium.beta.tolist()
    (factor * medium.beta).sum().backward()  # saves the rates, which serve outside, too
    assert factor.grad == pytest.approx(sum(*asked))
    with pytest.raises(AttributeError, match="no attribute 'alpha'"):
        medium.alpha  # noqa: B018


def test_repr_says_what_it_models() -> None:
    text = repr(Medium.from_water("3C").with_contents(3).brightened(torch.tensor([4.0])))
    numbers = ("2 + 3 rates", "g = 0.05", "μ = 0.075", "0.03·(b̄ z)^0.62 focal lengths")
    changes = ("3 times as much in the water", "; brightened")
    said = ("3C", "curves within", "exponential", *numbers, *changes)
    assert [part for part in said if part not in text] == []
    assert "2 more" in repr(Medium.stack([coastal()] * 3))
    assert "no blur" in repr(Medium.from_coefficients(**COEFFICIENTS))
    said = Medium.from_water("III", g=0.05, mu=0.3).notes[0]
    assert re.search(r"; veil of 3\.\d times white$", said)
    assert "times white" not in Medium.from_water("III", g=0.05).notes[0]
    assert "61 + 61 rates" in repr(Medium.from_water("3C", tolerance=0))


# ---- refusals


def of_water(water: Any = "II", **options: Any) -> Callable[[], Medium]:
    return lambda: Medium.from_water(water, **options)


def of_coefficients(**changes: Any) -> Callable[[], Medium]:
    return lambda: Medium.from_coefficients(**{**COEFFICIENTS, **changes})


def with_odd_tensor(at: int) -> Medium:
    tensors = list(coastal().tensors())
    tensors[at] = torch.rand(2, 5, 7)
    return Medium(*tensors)


FAR_RED = Water([750, 800], a=[1, 1], b=[1, 1], kd=[1, 1])
TWO_LAWS = [coastal(), coastal(point_spread=PointSpread.calibrated())]

test_what_is_refused = refusals(
    (of_water(vertical_depth=-1.0), "vertical_depth.*-1"),
    (of_water(g=1.1), r"g must.*\[0, 1\].*1.1"),
    (of_water(g=torch.tensor(0.5)), r"g must be a number, got a tensor; .*learnable=True"),
    (of_water(tolerance=1.0), "tolerance.*1"),
    (of_water(camera="Kodak"), "camera must be one of .*Kodak"),
    (of_water(surfaces="matt"), "surfaces must be one of grey, spectral"),
    (of_water("sea"), r"water must be one of I, IA.*got 'SEA'"),
    (of_water(FAR_RED), "no band of 400–700 nm"),
    (of_water({"a": 1}), r"water must be .* or a uwaug.Water, got \{'a': 1\}"),
    (of_coefficients(beta=(0.1, 0.2)), r"beta.*\(2,\)"),
    (of_coefficients(veil=torch.rand(1, 1, 3)), r"veil.*\(1, 1, 3\)"),
    (of_coefficients(G=(0.1, math.nan, 0.3)), "G must.*nan"),
    (of_coefficients(light=(0.1, -1.0, 0.3)), "light.*-1"),
    (of_coefficients(beta=torch.rand(2, 3), G=torch.rand(3, 3)), "batch sizes"),
    (of_coefficients(b_mean=torch.rand(2, 2)), "b_mean"),
    (
        of_coefficients(G=(0.4, 0.5, 0.1)),
        r"G must be beta at most.*got G = .*\[\[0.4, 0.5, 0.1\]\]",
    ),
    *((with_odd_tensor, at, r"Medium\.\w+ must have shape .* got") for at in range(6)),
    (Medium.stack, iter([]), "got no media"),
    (Medium.stack, "7C", "media must be a uwaug.Medium, got str"),
    (Medium.stack, TWO_LAWS, "one law of point spreads, got"),
    (lambda: coastal()[3], "medium 3 of 1"),
    error=(TypeError, ValueError, IndexError),
)


SILLY = st.floats(0, 1e300) | st.sampled_from([0.0, 5e-324, 1e-300, 1e-9, 1e150, 6e16])


@settings(max_examples=150)
@given(st.lists(SILLY, min_size=4, max_size=4), st.floats(0, 1e6), st.floats(0, 1), st.floats(0, 1))
# rates that no distance tells apart, of curves whose weights would be negative
@example([7.1e9, 0.0, 0.0, 5.7e15], 0.0, 1.0, 0.3)
@pytest.mark.filterwarnings("error")
def test_silly_waters_pass_in_silence(
    values: list[float], depth: float, g: float, mu: float
) -> None:
    water = Water([400, 700], values[:2], values[2:], values[:2])
    medium = Medium.from_water(water, vertical_depth=depth, g=g, mu=mu)
    assert all(((t >= 0) & ~t.isnan()).all() for t in medium.tensors())
    if mu == 0 or values[2:] == [0, 0]:
        assert (medium.backscatter(torch.from_numpy(Z)) == 0).all()
