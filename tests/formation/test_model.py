import itertools
import math
from typing import NamedTuple

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from referees import reference
from referees.terms import TERMS, check, expected
from scenes import LAW, coefficients, rand, stepped, tracked

from uwaug.formation.demand import blur_demand
from uwaug.formation.model import form_image
from uwaug.formation.scene import Terms
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water


class Spectral(NamedTuple):
    type: str
    depth: float
    g: float
    mu: float


@pytest.mark.parametrize("order", ["line_of_sight", "source"])
@pytest.mark.parametrize(
    "case",
    [Spectral("I", 1.0, 0.2, 0.3), Spectral("3C", 5.0, 0.0, 0.3), Spectral("9C", 0.0, 0.5, 1.0)],
    ids=str,
)
def test_the_three_terms_from_spectra(case, order) -> None:
    water = Water.jerlov(case.type)
    image = torch.from_numpy(reference.picture(40, 52))[None]
    z = stepped(1, 1, 40, 52)
    m = 0.7 + 0.6 * rand(1, 1, 40, 52)
    law = PointSpread(2.5, 0.6)
    kwargs = {"vertical_depth": case.depth, "g": case.g, "mu": case.mu, "point_spread": law}
    path = (z * m)[0, 0].numpy()
    curves = reference.spectral_curves(water, path, depth=case.depth, g=case.g, mu=case.mu)
    b_mean = float(Medium.from_water(water, **kwargs).b_mean)
    sigma = 2.5 * (b_mean * path) ** 0.6
    direct, forward, veil = reference.terms(image[0].numpy(), path, curves, sigma, order)
    for tolerance, bound in ((0, 1e-12), (0.002, 0.002)):
        medium = Medium.from_water(water, tolerance=tolerance, **kwargs)
        terms = form_image(image, z, medium, m, order=order)
        assert np.abs(terms.direct[0].numpy() - direct).max() <= bound
        assert np.abs(terms.backscatter[0].numpy() - veil).max() <= bound
        assert reference.psnr(terms.forward[0], forward) >= 54
        total = terms.direct + terms.forward + terms.backscatter
        torch.testing.assert_close(terms.image, total, rtol=0, atol=1e-15)


def test_the_orders_differ_at_an_edge_and_agree_on_a_plane() -> None:
    image, medium = torch.from_numpy(reference.picture(40, 40))[None], coefficients()
    z = torch.ones(1, 1, 40, 40).double()
    plane = [form_image(image, 2 * z, medium, order=o).forward for o in ("line_of_sight", "source")]
    torch.testing.assert_close(*plane, rtol=0, atol=1e-12)
    z[..., 20:] = 5
    edge = [form_image(image, z, medium, order=o).forward for o in ("line_of_sight", "source")]
    assert (edge[0] - edge[1]).abs().max() > 0.01


SIZES = [(1, 1), (1, 9), (7, 5), (16, 16), (31, 33), (32, 64), (65, 129), (130, 47), (40, 2100)]


BATCHES = [
    (1, 1, 1, 0),
    (3, 1, 1, 0),
    (3, 3, 1, 1),
    (3, 3, 3, 3),
    (1, 1, 3, 0),
    (1, 3, 1, 3),
    (1, 3, 3, 0),
    (3, 1, 3, 3),
    (1, 1, 1, 3),
]


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize(
    "dtype, atol", [(torch.float32, 3e-6), (torch.float64, 1e-12)], ids=["float32", "float64"]
)
def test_the_path_without_gradients_equals_the_one_with(size, dtype, atol) -> None:
    image, z = rand(2, 3, *size, dtype=dtype), stepped(2, 1, *size).to(dtype)
    medium = Medium.stack([coefficients(), coefficients(5)])
    # of one plan: by default that for gradients is finer
    plan = blur_demand(medium, (float(z.min()), float(z.max())), 0.001).plan(size)
    with_gradients = form_image(image, z, tracked(medium), plan=plan)
    without = form_image(image, z, medium, plan=plan)
    for name in TERMS:
        a, b = getattr(with_gradients, name), getattr(without, name)
        assert (a.requires_grad, b.requires_grad) == (True, False)
        torch.testing.assert_close(a.detach(), b, rtol=0, atol=atol)


@pytest.mark.parametrize("batch", BATCHES, ids=str)
@pytest.mark.parametrize("order", ["line_of_sight", "source"])
def test_batches_broadcast(batch, order) -> None:
    images, zs, media, fields = batch
    image = torch.from_numpy(np.stack([reference.picture(20, 36, seed) for seed in range(images)]))
    z = stepped(zs, 1, 20, 36)
    medium = Medium.stack([coefficients(seed) for seed in range(media)])
    field = 0.7 + 0.6 * rand(fields, 1, 20, 36) if fields else None
    path = z if field is None else z * field
    for m in (medium, tracked(medium)):
        terms = form_image(image, z, m, field, order=order)
        assert terms.image.shape == (max(batch), 3, 20, 36)
        plain = Terms(*(getattr(terms, name).detach() for name in TERMS))
        check(plain, image, path, medium, order)


@pytest.mark.parametrize(
    # a heavy tail, within its tolerance, reaches the one column at the step
    "law, columns",
    [(PointSpread(32.0, 0.51), 16), (PointSpread.calibrated(400.0), 15)],
    ids=str,
)
def test_in_source_order_a_pixel_at_the_lens_sees_only_itself(law, columns) -> None:
    # its own width is 0, however bright the scattered light of its neighbours
    z = torch.zeros(1, 1, 32, 32).double()
    z[..., 16:] = 4
    image, medium = torch.ones(1, 3, 32, 32).double(), coefficients(law=law)
    terms = form_image(image, z, medium, order="source")
    assert terms.forward[..., :columns].abs().max() < 0.005
    check(terms, image, z, medium, order="source")


def test_one_image_without_a_batch() -> None:
    image = rand(3, 9, 12)
    z = stepped(1, 1, 9, 12)[0]
    field = 0.7 + 0.6 * rand(1, 9, 12)
    medium = coefficients()
    terms = form_image(image, z, medium, field)
    assert terms.image.shape == (3, 9, 12)
    batched = form_image(image[None], z[None], medium, field[None])
    assert torch.equal(batched.image[0], terms.image)
    assert form_image(image, z, Medium.stack([medium] * 4)).image.shape == (4, 3, 9, 12)
    assert form_image(image, z.expand(2, 1, 9, 12), medium).image.shape == (2, 3, 9, 12)


LAWS = {
    "of each image": (
        PointSpread(torch.tensor([0.5]), 0.5),
        PointSpread(torch.tensor([3.0]), torch.tensor([1.0])),
        PointSpread(0.0),
    ),
    "in pixels": (PointSpread(2.0, 0.5),),
    "for 10 px": (PointSpread(2.0, 0.5, reference_size=10.0),),
    "for 400 px": (PointSpread(2.0, 0.5, reference_size=400.0),),
}


@pytest.mark.parametrize("name", LAWS)
def test_width_laws(name) -> None:
    medium = Medium.stack([coefficients(3, law) for law in LAWS[name]])
    image, z = torch.from_numpy(reference.picture(28, 44))[None], stepped(1, 1, 28, 44)
    check(form_image(image, z, medium), image, z, medium)


@pytest.mark.parametrize("order", ["line_of_sight", "source"])
def test_a_batch_of_focal_lengths(order) -> None:
    focals = {3: 20.0, 4: 55.0, 5: 300.0}
    media = [coefficients(seed, PointSpread.calibrated(f)) for seed, f in focals.items()]
    image, z = torch.from_numpy(reference.picture(30, 36))[None], stepped(1, 1, 30, 36)
    together = form_image(image, z, Medium.stack(media), order=order)
    check(together, image, z, Medium.stack(media), order)
    for i, medium in enumerate(media):
        alone = form_image(image, z, medium, order=order).forward[0]
        # the batch has one plan, of more blurs
        assert reference.psnr(together.forward[i], alone) >= 54


def test_an_exponential_point_spread() -> None:
    image = torch.from_numpy(reference.picture(48, 48))[None]
    z = torch.full((1, 1, 48, 48), 3.0).double()
    law = PointSpread(0.5, shape="exponential")
    medium = Medium.from_coefficients(
        (1e3,) * 3, (0.1,) * 3, (0,) * 3, b_mean=1.0, point_spread=law
    )
    exact = math.exp(-0.3) * reference.exponential(image[0].numpy(), 1.5)
    assert reference.psnr(form_image(image, z, medium).forward[0], exact) >= 57


@pytest.mark.parametrize(
    "law",
    [PointSpread.none(), LAW, PointSpread(32.0, 0.51), PointSpread.calibrated(400.0)],
    ids=str,
)
@pytest.mark.parametrize("order", ["line_of_sight", "source"])
def test_what_arrives_of_a_white_wall_is_the_signal(law, order) -> None:
    # D + F = T_G·J for a constant image at a constant distance; in line-of-sight order at any
    # distances
    medium, image = coefficients(3, law), torch.full((1, 3, 40, 30), 0.8).double()
    maps = [torch.full((1, 1, 40, 30), 2.5).double()]
    if order == "line_of_sight":
        maps.append(stepped(1, 1, 40, 30))
    for z in maps:
        terms = form_image(image, z, medium, order=order)
        arrives = terms.direct + terms.forward
        torch.testing.assert_close(arrives, 0.8 * medium.signal(z), rtol=0, atol=1e-7)


def test_all_scattered_light_leaves_the_line_of_sight() -> None:
    image, z = rand(1, 3, 12, 12), stepped(1, 1, 12, 12)

    def brightest(**kwargs: float) -> float:
        medium = Medium.from_water(Water.jerlov("3C"), **kwargs)
        return float(form_image(image, z, medium).forward.abs().max())

    assert brightest(g=1.0, tolerance=0) < 1e-14
    assert brightest(g=1.0) < 0.004
    assert brightest(g=0.2) > 0.1


def test_one_pixel_of_open_water_does_not_spoil_the_others() -> None:
    # its distance stretches the range that the blur is planned for
    image, z = torch.from_numpy(reference.picture(24, 24))[None], 4 + 8 * rand(1, 1, 24, 24)
    open_water = z.clone()
    open_water[..., 0, 0] = math.inf
    laws = PointSpread.calibrated(35.0), PointSpread(2.0, 1.0)
    for law, water in itertools.product(laws, ("I", "II", "9C")):
        medium = Medium.from_water(Water.jerlov(water), vertical_depth=0.0, point_spread=law)
        for distance in (z, open_water):
            terms = form_image(image, distance, medium)
            check(terms, image, distance, medium)
        veil = medium.veil_weights.sum(-1)[0]
        torch.testing.assert_close(terms.image[0, :, 0, 0], veil, rtol=0, atol=1e-12)


@pytest.mark.parametrize("tolerance", [0.002, 0.0005])
def test_open_water_does_not_hide_where_light_scatters(tolerance) -> None:
    # a channel that hardly fades scatters for a kilometre, the others for metres; with +inf the
    # range is endless
    image, z = torch.from_numpy(reference.picture(67, 24))[None], 0.12 + 0.4 * rand(1, 1, 67, 24)
    beta, G, law = (0.5, 0.9, 7.0), (0.004, 0.02, 0.024), PointSpread(1.3, 1.14)
    medium = Medium.from_coefficients(beta, G, (0.3,) * 3, b_mean=0.32, point_spread=law)
    for _ in range(2):
        terms = form_image(image, z, medium, tolerance=tolerance)
        check(terms, image, z, medium, tolerance=tolerance)
        z[..., :16, :] = math.inf


@pytest.mark.parametrize("factor", [None, 0.7, 1.3])
def test_open_water_is_as_wide_as_very_far_water_in_source_order(factor) -> None:
    # light that is scattered elsewhere reaches it
    image, far = torch.from_numpy(reference.picture(48, 48))[None], stepped(1, 1, 48, 48)
    far[..., 24:] = 1e8
    open_water = torch.where(far == 1e8, math.inf, far)
    medium = coefficients(law=PointSpread(4.0, 1.0))
    field = None if factor is None else torch.full_like(far, factor)
    finite, endless = (
        form_image(image, z, medium, field, order="source").image for z in (far, open_water)
    )
    assert (finite - endless).abs().max() <= 0.002


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.data())
def test_forward_scatter_keeps_the_tolerance(data) -> None:
    def between(low: float, high: float) -> float:
        return math.exp(data.draw(st.floats(math.log(low), math.log(high))))

    size = data.draw(st.tuples(st.integers(1, 60), st.integers(1, 60)))
    beta = np.array([between(0.01, 10) for _ in range(3)])
    G = beta * [data.draw(st.sampled_from((0.0, 0.02, 0.3, 0.9))) for _ in range(3)]
    law = PointSpread(between(0.01, 30), between(0.4, 2))
    medium = Medium.from_coefficients(
        tuple(beta), tuple(G), (0.3,) * 3, b_mean=between(0.01, 5), point_spread=law
    )
    near = between(0.01, 5)
    z = near * (1 + between(0.1, 30) * rand(1, 1, *size))
    where = data.draw(st.sampled_from(("plane", "lens", "open water", "everywhere")))
    if where == "plane":
        z[:] = near
    elif where != "everywhere":
        z[..., : size[1] // 3] = 0.0 if where == "lens" else math.inf
    order = data.draw(st.sampled_from(("line_of_sight", "source")))
    tolerance = data.draw(st.sampled_from((0.01, 0.002, 0.0005)))
    image = torch.from_numpy(reference.picture(*size))[None]
    check(
        form_image(image, z, medium, order=order, tolerance=tolerance),
        image,
        z,
        medium,
        order,
        1.3 * tolerance,
    )


def test_a_plan_may_be_given() -> None:
    medium = coefficients()
    image = torch.from_numpy(reference.picture(30, 30))[None]
    z = stepped(1, 1, 30, 30)
    plan = blur_demand(medium, (float(z.min()), float(z.max())), 0.002).plan((30, 30), shared=True)
    planned = form_image(image, z, medium, plan=plan).image
    assert torch.equal(planned, form_image(image, z, medium).image)


def test_tighter_tolerance_is_nearer() -> None:
    medium = coefficients(law=PointSpread(3.0, 1.0))
    image = torch.from_numpy(reference.picture(60, 60))[None]
    z = stepped(1, 1, 60, 60)
    exact = expected(image[0], z[0, 0], medium)[1]
    found = []
    for tolerance in (0.02, 0.002, 0.0002):
        forward = form_image(image, z, medium, tolerance=tolerance).forward
        found.append(reference.psnr(forward[0], exact))
    assert found[0] < found[1] < found[2]
    assert found[2] >= 74


@pytest.mark.parametrize("dtype, precision", [(torch.float32, 3e-5), (torch.float64, 1e-12)])
def test_the_veil_is_as_precise_near_as_far(dtype, precision) -> None:
    # either side of where 1 − e^−x begins to cancel, a near and a far sample, with one medium and
    # with one for each
    image = torch.rand(2, 3, 5, 7, dtype=dtype)
    for media in (coefficients(3), Medium.stack([coefficients(3), coefficients(4)])):
        media = media.to(dtype)
        slowest = float(media.G.min())
        for near in (1e-6, 0.9 / 256, 1.1 / 256, 0.3):
            z = torch.full((2, 1, 5, 7), near / slowest, dtype=dtype)
            z[1] = 5.0
            veil = form_image(image, z, media).backscatter.double().numpy()
            for n in range(2):
                row = n % len(media)
                wanted = reference.medium_curves(media, z[n, 0].double().numpy(), row).veil
                np.testing.assert_allclose(veil[n], wanted, rtol=precision)
