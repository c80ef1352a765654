import itertools
import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import pytest
import reference
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from uwaug.blur.demand import blur_demand
from uwaug.blur.stack import varying_blur
from uwaug.formation import Terms, form_image
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water

TERMS = ("direct", "forward", "backscatter")
LAW = PointSpread(1.2, 0.8)


def rand(*shape: int, dtype: torch.dtype = torch.float64, seed: int = 0) -> Tensor:
    return torch.rand(*shape, dtype=dtype, generator=torch.Generator().manual_seed(seed))


def distances(*shape: int, far: float = 6.0, seed: int = 1) -> Tensor:
    """Distances with steps, as a scene has them."""
    steps = torch.nn.functional.interpolate(
        rand(shape[0], 1, 3, 4, seed=seed), shape[-2:], mode="nearest"
    )
    return 0.3 + (far - 0.5) * steps + 0.2 * rand(*shape, seed=seed)


def coefficients(seed: int = 3, law: PointSpread = LAW) -> Medium:
    beta, share, veil, light = rand(4, 3, seed=seed)
    return Medium.from_coefficients(
        0.3 + beta,
        (0.3 + beta) * (0.1 + 0.4 * share),
        veil,
        b_mean=0.7,
        light=light,
        point_spread=law,
    )


def expected(
    image: Tensor, z: Tensor, medium: Medium, row: int = 0, order: str = "line_of_sight"
) -> tuple[np.ndarray, ...]:
    """The terms of one image (3, H, W) at effective distances (H, W), by a blur that is exact at every pixel."""
    z = z.double().numpy()
    law = medium.point_spread
    scale, exponent = (
        float(v.reshape(-1)[row if v.numel() > 1 else 0]) if isinstance(v, Tensor) else v
        for v in (law.scale, law.exponent)
    )
    if law.reference_size is not None:
        scale *= min(z.shape) / law.reference_size
    sigma = scale * np.minimum(float(medium.b_mean[row]) * z, 1e6) ** exponent
    return reference.terms(
        image.double().numpy(),
        z,
        reference.medium_curves(medium, z, row),
        np.minimum(sigma, 1e4),
        order,
        law.shape,
    )


def check(
    terms: Terms,
    image: Tensor,
    z: Tensor,
    medium: Medium,
    order: str = "line_of_sight",
    tolerance: float = 0.002,
):
    """Every term of every image of a batch against the reference: forward to the tolerance, the others to rounding.

    In source order the width of open water is infinite where the model wants none of its scattered light: left out.
    """
    rounding = 1e-12 if terms.direct.dtype == torch.float64 else 3e-6
    for i, parts in enumerate(zip(terms.direct, terms.forward, terms.backscatter, strict=True)):
        j, distance = (v[i if len(v) > 1 else 0] for v in (image, z))
        direct, forward, veil = expected(j, distance[0], medium, i if len(medium) > 1 else 0, order)
        peak = max(1.0, float(j.abs().max()))
        for part, exact in ((parts[0], direct), (parts[2], veil)):
            np.testing.assert_allclose(
                part.double().numpy(), exact, rtol=rounding, atol=rounding * peak
            )
        squares = (parts[1].double().numpy() - forward) ** 2
        if order == "source":
            squares = squares[:, distance[0].isfinite().numpy()]
        assert math.sqrt(squares.mean() if squares.size else 0.0) <= tolerance * peak


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
    image, z, m = (
        torch.from_numpy(reference.picture(40, 52))[None],
        distances(1, 1, 40, 52),
        0.7 + 0.6 * rand(1, 1, 40, 52),
    )
    law = PointSpread(2.5, 0.6)
    kwargs = {"vertical_depth": case.depth, "g": case.g, "mu": case.mu, "point_spread": law}
    path = (z * m)[0, 0].numpy()
    curves = reference.spectral_curves(water, path, depth=case.depth, g=case.g, mu=case.mu)
    b_mean = float(Medium.from_water(water, **kwargs).b_mean)
    exact = reference.terms(image[0].numpy(), path, curves, 2.5 * (b_mean * path) ** 0.6, order)
    for tolerance, bound in ((0, 1e-12), (0.002, 0.002)):
        terms = form_image(
            image, z, Medium.from_water(water, tolerance=tolerance, **kwargs), m, order=order
        )
        assert np.abs(terms.direct[0].numpy() - exact[0]).max() <= bound
        assert np.abs(terms.backscatter[0].numpy() - exact[2]).max() <= bound
        assert reference.psnr(terms.forward[0], exact[1]) >= 54
        torch.testing.assert_close(
            terms.image, terms.direct + terms.forward + terms.backscatter, rtol=0, atol=1e-15
        )


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


def tracked(medium: Medium) -> Medium:
    return Medium(
        *(t.clone().requires_grad_() for t in medium.tensors()), medium.point_spread, medium.notes
    )


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize(
    "dtype, atol", [(torch.float32, 3e-6), (torch.float64, 1e-12)], ids=["float32", "float64"]
)
def test_the_path_without_gradients_equals_the_one_with(size, dtype, atol) -> None:
    image, z = rand(2, 3, *size, dtype=dtype), distances(2, 1, *size).to(dtype)
    medium = Medium.stack([coefficients(), coefficients(5)])
    with_gradients, without = (
        form_image(image, z, m, tolerance=0.001) for m in (tracked(medium), medium)
    )
    for name in TERMS:
        a, b = getattr(with_gradients, name), getattr(without, name)
        assert (a.requires_grad, b.requires_grad) == (True, False)
        torch.testing.assert_close(a.detach(), b, rtol=0, atol=atol)


@pytest.mark.parametrize("batch", BATCHES, ids=str)
@pytest.mark.parametrize("order", ["line_of_sight", "source"])
def test_batches_broadcast(batch, order) -> None:
    images, zs, media, fields = batch
    image, z = (
        torch.from_numpy(np.stack([reference.picture(20, 36, seed) for seed in range(images)])),
        distances(zs, 1, 20, 36),
    )
    medium = Medium.stack([coefficients(seed) for seed in range(media)])
    field = 0.7 + 0.6 * rand(fields, 1, 20, 36) if fields else None
    for m in (medium, tracked(medium)):
        terms = form_image(image, z, m, field, order=order)
        assert terms.image.shape == (max(batch), 3, 20, 36)
        check(
            Terms(*(getattr(terms, n).detach() for n in TERMS)),
            image,
            z if field is None else z * field,
            medium,
            order,
        )


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
    image, z, field, medium = (
        rand(3, 9, 12),
        distances(1, 1, 9, 12)[0],
        0.7 + 0.6 * rand(1, 9, 12),
        coefficients(),
    )
    terms = form_image(image, z, medium, field)
    assert terms.image.shape == (3, 9, 12)
    batched = form_image(image[None], z[None], medium, field[None])
    assert torch.equal(batched.image[0], terms.image)
    assert form_image(image, z, Medium.stack([medium] * 4)).image.shape == (4, 3, 9, 12)
    assert form_image(image, z.expand(2, 1, 9, 12), medium).image.shape == (2, 3, 9, 12)


def test_per_image_width_laws() -> None:
    laws = (
        PointSpread(torch.tensor([0.5]), 0.5),
        PointSpread(torch.tensor([3.0]), torch.tensor([1.0])),
        PointSpread(0.0),
    )
    medium = Medium.stack([coefficients(3, law) for law in laws])
    image, z = torch.from_numpy(reference.picture(30, 30))[None], distances(1, 1, 30, 30)
    check(form_image(image, z, medium), image, z, medium)


@pytest.mark.parametrize("order", ["line_of_sight", "source"])
def test_a_batch_of_focal_lengths(order) -> None:
    media = [
        coefficients(seed, PointSpread.calibrated(focal))
        for seed, focal in ((3, 20.0), (4, 55.0), (5, 300.0))
    ]
    image, z = torch.from_numpy(reference.picture(30, 36))[None], distances(1, 1, 30, 36)
    together = form_image(image, z, Medium.stack(media), order=order)
    check(together, image, z, Medium.stack(media), order)
    for i, medium in enumerate(media):
        alone = form_image(image, z, medium, order=order).forward[0]
        assert (
            reference.psnr(together.forward[i], alone) >= 54
        )  # the batch has one plan, of more blurs


@pytest.mark.parametrize("reference_size", [None, 10.0, 400.0])
def test_resolution_of_the_width_law(reference_size) -> None:
    medium = coefficients(3, PointSpread(2.0, 0.5, reference_size=reference_size))
    image, z = torch.from_numpy(reference.picture(28, 60))[None], distances(1, 1, 28, 60)
    check(form_image(image, z, medium), image, z, medium)


def test_an_exponential_point_spread() -> None:
    image, z = (
        torch.from_numpy(reference.picture(48, 48))[None],
        torch.full((1, 1, 48, 48), 3.0).double(),
    )
    medium = Medium.from_coefficients(
        (1e3,) * 3,
        (0.1,) * 3,
        (0,) * 3,
        b_mean=1.0,
        point_spread=PointSpread(0.5, shape="exponential"),
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
    # D + F = T_G·J for a constant image at a constant distance; in line-of-sight order at any distances
    medium, image = coefficients(3, law), torch.full((1, 3, 40, 30), 0.8).double()
    for z in (
        torch.full((1, 1, 40, 30), 2.5).double(),
        *([distances(1, 1, 40, 30)] if order == "line_of_sight" else []),
    ):
        terms = form_image(image, z, medium, order=order)
        torch.testing.assert_close(
            terms.direct + terms.forward, 0.8 * medium.signal(z), rtol=0, atol=1e-7
        )


def test_all_scattered_light_leaves_the_line_of_sight() -> None:
    water, image, z = Water.jerlov("3C"), rand(1, 3, 12, 12), distances(1, 1, 12, 12)
    assert (
        form_image(image, z, Medium.from_water(water, g=1.0, tolerance=0)).forward.abs().max()
        < 1e-14
    )
    assert form_image(image, z, Medium.from_water(water, g=1.0)).forward.abs().max() < 0.004
    assert form_image(image, z, Medium.from_water(water, g=0.2)).forward.abs().max() > 0.1


def test_one_pixel_of_open_water_does_not_spoil_the_others() -> None:
    # its distance stretches the range that the blur is planned for
    image, z = torch.from_numpy(reference.picture(64, 64))[None], 4 + 8 * rand(1, 1, 64, 64)
    open_water = z.clone()
    open_water[..., 0, 0] = math.inf
    for law, water in itertools.product(
        (PointSpread.calibrated(55.0), PointSpread(2.0, 1.0)), ("I", "II", "9C")
    ):
        medium = Medium.from_water(Water.jerlov(water), vertical_depth=0.0, point_spread=law)
        for distance in (z, open_water):
            terms = form_image(image, distance, medium)
            check(terms, image, distance, medium)
        torch.testing.assert_close(
            terms.image[0, :, 0, 0], medium.veil_weights.sum(-1)[0], rtol=0, atol=1e-12
        )


@pytest.mark.parametrize("tolerance", [0.002, 0.0005])
def test_open_water_does_not_hide_where_light_scatters(tolerance) -> None:
    # a channel that hardly fades scatters for a kilometre, the others for metres; with +inf the range is endless
    image, z = torch.from_numpy(reference.picture(67, 24))[None], 0.12 + 0.4 * rand(1, 1, 67, 24)
    medium = Medium.from_coefficients(
        (0.5, 0.9, 7.0),
        (0.004, 0.02, 0.024),
        (0.3,) * 3,
        b_mean=0.32,
        point_spread=PointSpread(1.3, 1.14),
    )
    for _ in range(2):
        check(
            form_image(image, z, medium, tolerance=tolerance), image, z, medium, tolerance=tolerance
        )
        z[..., :16, :] = math.inf


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


def test_water_so_clear_that_the_blur_grows_without_end() -> None:
    medium = Medium.from_coefficients(
        (0.5,) * 3, (0,) * 3, (0.2,) * 3, b_mean=1.0, point_spread=PointSpread(2.0, 1.0)
    )
    image, z = (
        torch.from_numpy(reference.picture(40, 48))[None],
        torch.logspace(-1, 9, 48).double().expand(1, 1, 40, 48),
    )
    check(form_image(image, z, medium), image, z, medium)
    check(form_image(image.float(), z.float(), medium), image.float(), z.float(), medium)


class Case(NamedTuple):
    """One singular point: what replaces the ordinary image, distance, medium and field."""

    image: Callable[[Tensor], Tensor] = lambda j: j
    distance: Callable[[Tensor], Tensor] = lambda z: z
    medium: Callable[[], Medium] = coefficients
    field: Callable[[Tensor], Tensor] | None = None


def water(**kwargs: object) -> Callable[[], Medium]:
    return lambda: Medium.from_water(
        Water.jerlov("3C"), **{"point_spread": LAW, "tolerance": 0, **kwargs}
    )


def uniform(
    beta: float, G: float, veil: float = 0.3, b_mean: float = 0.7, law: PointSpread = LAW
) -> Callable[[], Medium]:
    return lambda: Medium.from_coefficients(
        (beta,) * 3, (G,) * 3, (veil,) * 3, b_mean=b_mean, point_spread=law
    )


def far_plane(z: Tensor) -> Tensor:
    return torch.where(torch.arange(z.shape[-1]) > 9, torch.tensor(6.0, dtype=z.dtype), z)


SINGULAR = {
    "ordinary": Case(),
    "at the lens": Case(distance=torch.zeros_like),
    "almost at the lens": Case(distance=lambda z: 1e-12 * z),
    "some pixels at the lens": Case(distance=lambda z: (z - 2).clamp(min=0)),
    "open water": Case(distance=lambda z: torch.full_like(z, math.inf)),
    "some open water": Case(distance=lambda z: torch.where(z > 3, math.inf, z)),
    "the lens and open water": Case(distance=lambda z: torch.where(z > 3, math.inf, 0.0).to(z)),
    "one distance": Case(distance=lambda z: torch.full_like(z, 2.0)),
    "one far plane": Case(distance=far_plane),
    "step edge": Case(distance=lambda z: torch.where(z > 3, 20.0, 0.1).to(z)),
    "absurdly far": Case(distance=lambda z: 1e20 * z),
    "no attenuation at all": Case(medium=uniform(0.0, 0.0, 0.0, 0.0)),
    "nothing is lost": Case(medium=uniform(0.5, 0.0)),
    "nothing is lost, open water": Case(
        medium=uniform(0.5, 0.0), distance=lambda z: torch.where(z > 3, math.inf, z)
    ),
    "no scattering": Case(medium=uniform(0.4, 0.4, 0.0, 0.0)),
    "no light is kept": Case(medium=water(g=1.0)),
    "all light is kept": Case(medium=water(g=0.0)),
    "no veil": Case(medium=water(mu=0.0)),
    "full veil": Case(medium=water(mu=1.0)),
    "deep down": Case(medium=water(vertical_depth=500.0)),
    "optical depth 1e4": Case(medium=uniform(1e4, 2e3)),
    "optical depth 1e-4": Case(medium=uniform(1e-4, 3e-5)),
    "no blur": Case(medium=lambda: coefficients(law=PointSpread.none())),
    "a blur too small to show": Case(medium=lambda: coefficients(law=PointSpread(0.01, 1.0))),
    "a blur as wide as the image": Case(medium=lambda: coefficients(law=PointSpread(10.0, 1.0))),
    "a blur far wider than the image": Case(
        medium=lambda: coefficients(law=PointSpread(3000.0, 0.3))
    ),
    "a steep width law": Case(medium=lambda: coefficients(law=PointSpread(0.5, 3.0))),
    "a steep width law, open water": Case(
        medium=lambda: coefficients(law=PointSpread(0.5, 3.0)),
        distance=lambda z: torch.where(z > 3, math.inf, z),
    ),
    "a flat width law": Case(
        medium=lambda: coefficients(law=PointSpread(3.0, 0.3)),
        distance=lambda z: (z - 2).clamp(min=0),
    ),
    "black": Case(image=torch.zeros_like),
    "white": Case(image=torch.ones_like),
    "only 0 and 1": Case(image=torch.round),
    "high dynamic range": Case(image=lambda j: 20 * j - 5),
    "field 0": Case(field=torch.zeros_like),
    "field 0 and open water": Case(
        field=torch.zeros_like, distance=lambda z: torch.where(z > 3, math.inf, z)
    ),
}


@pytest.mark.parametrize("order", ["line_of_sight", "source"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=["float32", "float64"])
@pytest.mark.parametrize("name", SINGULAR)
def test_singular_points(name, dtype, order) -> None:
    case = SINGULAR[name]
    image = case.image(torch.from_numpy(reference.picture(16, 20))).to(dtype)[None]
    z = case.distance(distances(1, 1, 16, 20)).to(dtype)
    field = None if case.field is None else case.field(0.7 + 0.6 * rand(1, 1, 16, 20)).to(dtype)
    medium = case.medium()
    path = z.double() if field is None else z.double().clamp(max=1e30) * field.double()

    plain = form_image(image, z, medium, field, order=order)
    check(plain, image, path, medium, order)

    law = medium.point_spread
    scale, exponent = (
        torch.tensor([float(v)], dtype=torch.float64).requires_grad_()
        for v in (law.scale, law.exponent)
    )
    leaves = [
        image.clone().requires_grad_(),
        z.clone().requires_grad_(),
        *(t.clone().requires_grad_() for t in medium.tensors()),
    ]
    if field is not None:
        field = field.clone().requires_grad_()
    learned = Medium(*leaves[2:], PointSpread(scale, exponent, law.shape, law.reference_size))
    terms = form_image(leaves[0], leaves[1], learned, field, order=order)
    check(Terms(*(getattr(terms, n).detach() for n in TERMS)), image, path, medium, order)
    weight = rand(1, 3, 16, 20, seed=9).to(dtype)
    (terms.image * weight).sum().backward()
    names = (
        "image",
        "distance",
        "beta",
        "direct_weights",
        "G",
        "signal_weights",
        "veil_weights",
        "b_mean",
        "scale",
        "exponent",
        "field",
    )
    for leaf_name, leaf in zip(names, [*leaves, scale, exponent, field], strict=True):
        if leaf is not None and leaf.grad is not None:
            assert leaf.grad.isfinite().all(), leaf_name
    assert all(leaf.grad is not None for leaf in leaves[:2])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_an_empty_batch(dtype) -> None:
    medium = coefficients()
    for image, z in (
        (torch.rand(0, 3, 8, 9), torch.rand(0, 1, 8, 9)),
        (torch.rand(0, 3, 8, 9), torch.rand(1, 1, 8, 9)),
    ):
        for m in (medium, tracked(medium)):
            terms = form_image(image.to(dtype), z.to(dtype), m)
            assert terms.image.shape == (0, 3, 8, 9)
            assert terms.image.dtype == dtype


def test_an_empty_image() -> None:
    assert form_image(
        torch.rand(2, 3, 0, 9), torch.rand(2, 1, 0, 9), coefficients()
    ).image.shape == (2, 3, 0, 9)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
@pytest.mark.parametrize("grad", [False, True])
def test_half_precision_is_computed_in_single(dtype, grad) -> None:
    image, z, field = (
        rand(2, 3, 20, 24).to(dtype),
        distances(2, 1, 20, 24).to(dtype),
        (0.7 + 0.6 * rand(2, 1, 20, 24)).to(dtype),
    )
    image.requires_grad_(grad)
    terms = form_image(image, z, coefficients(), field)
    single = form_image(image.float(), z.float(), coefficients(), field.float())
    for name in TERMS:
        assert getattr(terms, name).dtype == dtype
        torch.testing.assert_close(
            getattr(terms, name), getattr(single, name).to(dtype), rtol=0, atol=0
        )
    if grad:
        terms.image.sum().backward()
        assert image.grad.dtype == dtype
        assert image.grad.isfinite().all()


def test_the_result_has_the_type_of_the_image() -> None:
    image, z = rand(1, 3, 8, 8), distances(1, 1, 8, 8)
    for dtype, other in itertools.product((torch.float16, torch.float32, torch.float64), repeat=2):
        result = form_image(
            image.to(dtype),
            z.to(other),
            coefficients().to(torch.float32 if other == torch.float16 else other),
        )
        assert result.image.dtype == dtype


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
@pytest.mark.parametrize("grad", [False, True])
def test_autocast_changes_nothing(dtype, grad) -> None:
    image, z = (
        rand(1, 3, 40, 33, dtype=torch.float32).requires_grad_(grad),
        distances(1, 1, 40, 33).float(),
    )
    medium = Medium.stack([coefficients(), coefficients(5)])
    expected = form_image(image, z, medium).image
    with torch.autocast("cpu", dtype):
        result = form_image(image, z, medium).image
    assert torch.equal(result, expected)


@pytest.mark.parametrize("grad", [False, True])
def test_layout_does_not_matter(grad) -> None:
    image, z = rand(2, 3, 30, 22), distances(2, 1, 30, 22)
    medium = tracked(coefficients()) if grad else coefficients()
    expected = form_image(image, z, medium).image
    layouts = {
        "channels last": (
            image.contiguous(memory_format=torch.channels_last),
            z.contiguous(memory_format=torch.channels_last),
        ),
        "transposed": (image.mT.contiguous().mT, z.mT.contiguous().mT),
        "sliced": (
            torch.nn.functional.pad(image, (3, 4, 1, 2))[..., 1:-2, 3:-4],
            z.repeat(1, 2, 1, 1)[:, 1:],
        ),
        "channels from the back": (image.permute(0, 2, 3, 1).contiguous().permute(0, 3, 1, 2), z),
    }
    for name, (x, y) in layouts.items():
        assert not (x.is_contiguous() and y.is_contiguous()), name
        torch.testing.assert_close(form_image(x, y, medium).image, expected, rtol=0, atol=1e-13)
    grey = image[:, :1].expand(-1, 3, -1, -1)
    torch.testing.assert_close(
        form_image(grey, z, medium).image,
        form_image(grey.contiguous(), z, medium).image,
        rtol=0,
        atol=1e-13,
    )


def test_inputs_are_left_alone() -> None:
    image, z, field, medium = (
        rand(2, 3, 12, 12),
        distances(2, 1, 12, 12),
        rand(2, 1, 12, 12),
        coefficients(),
    )
    z[0, 0, 0, 0] = math.inf
    copies = [t.clone() for t in (image, z, field, *medium.tensors())]
    form_image(image, z, medium, field)
    assert all(
        torch.equal(a, b) for a, b in zip(copies, (image, z, field, *medium.tensors()), strict=True)
    )


@pytest.fixture
def deterministic() -> Iterator[None]:
    torch.use_deterministic_algorithms(True)
    yield
    torch.use_deterministic_algorithms(False)


@pytest.mark.usefixtures("deterministic")
def test_deterministic_algorithms() -> None:
    grads = []
    for _ in range(2):
        image, z = rand(2, 3, 40, 40).requires_grad_(), distances(2, 1, 40, 40).requires_grad_()
        form_image(
            image, z, tracked(coefficients(law=PointSpread(4.0, 0.5)))
        ).image.square().sum().backward()
        form_image(image.detach(), z.detach(), coefficients())
        grads.append((image.grad, z.grad))
    assert all(torch.equal(a, b) for a, b in zip(*grads, strict=True))


@pytest.mark.parametrize("order", ["line_of_sight", "source"])
def test_gradcheck(order) -> None:
    medium = coefficients()
    plan = blur_demand(medium, (0.2, 8.0), 0.01).plan((4, 5))

    def evaluate(
        image: Tensor, z: Tensor, field: Tensor, scale: Tensor, exponent: Tensor, *tensors: Tensor
    ) -> Tensor:
        return form_image(
            image, z, Medium(*tensors, PointSpread(scale, exponent)), field, order=order, plan=plan
        ).image

    inputs = [
        rand(1, 3, 4, 5),
        distances(1, 1, 4, 5),
        0.7 + 0.6 * rand(1, 1, 4, 5),
        torch.tensor([1.2]),
        torch.tensor([0.8]),
        *medium.tensors(),
    ]
    assert torch.autograd.gradcheck(evaluate, [t.double().clone().requires_grad_() for t in inputs])


def test_a_plan_may_be_given() -> None:
    medium, image, z = (
        coefficients(),
        torch.from_numpy(reference.picture(30, 30))[None],
        distances(1, 1, 30, 30),
    )
    plan = blur_demand(medium, (float(z.min()), float(z.max())), 0.002).plan((30, 30), shared=True)
    assert torch.equal(
        form_image(image, z, medium, plan=plan).image, form_image(image, z, medium).image
    )


def test_tighter_tolerance_is_nearer() -> None:
    medium, image, z = (
        coefficients(law=PointSpread(3.0, 1.0)),
        torch.from_numpy(reference.picture(60, 60))[None],
        distances(1, 1, 60, 60),
    )
    exact = expected(image[0], z[0, 0], medium)[1]
    found = [
        reference.psnr(form_image(image, z, medium, tolerance=t).forward[0], exact)
        for t in (0.02, 0.002, 0.0002)
    ]
    assert found[0] < found[1] < found[2]
    assert found[2] >= 74


def test_demand_leaves_out_what_cannot_show() -> None:
    medium = coefficients(law=PointSpread(1.0, 1.0))
    near, far = blur_demand(medium, (0.1, 3.0)), blur_demand(medium, (0.1, 1e6))
    assert far.high < 0.7 * 1e3, "at a million metres nothing is left to be blurred"
    assert far.high > near.high
    assert blur_demand(uniform(0.4, 0.4)(), (0.1, 20.0)).high == 0
    assert blur_demand(uniform(1e4, 1e4 - 1)(), (1.0, 20.0)).high == 0
    widened = blur_demand(medium, (0.1, 3.0), margin=2.0)
    assert (widened.low, widened.high) == pytest.approx((near.low / 2, near.high * 2))


def test_similar_media_share_a_plan() -> None:
    demands = (
        blur_demand(uniform(0.5, 0.2, b_mean=b)(), (1.0, 6.0)) for b in np.linspace(0.7, 0.72, 9)
    )
    plans = {demand.plan((100, 100), shared=True) for demand in demands}
    assert len(plans) <= 2


def test_forward_scatter_is_the_blurred_scene() -> None:
    medium, image, z = (
        coefficients(),
        torch.from_numpy(reference.picture(40, 44))[None],
        distances(1, 1, 40, 44),
    )
    share = medium.signal(z) - medium.transmission(z)
    blurred = varying_blur(image, medium.width(z, (40, 44)), tolerance=0.0002)
    assert reference.psnr(form_image(image, z, medium).forward, share * blurred) >= 57


GOOD = {
    "image": torch.rand(2, 3, 6, 8),
    "distance": 1 + torch.rand(2, 1, 6, 8),
    "medium": coefficients(),
}
MIXED = torch.rand(2, 1, 6, 8)
MIXED[0, 0, :2, 0] = math.nan
MIXED[1, 0, :3, 0] = -1


@pytest.mark.parametrize(
    "change, error, match",
    [
        ({"image": (255 * GOOD["image"]).byte()}, TypeError, r"image.*uint8.*0…255"),
        ({"image": GOOD["image"].numpy()}, TypeError, "image.*ndarray"),
        ({"distance": GOOD["distance"].long()}, TypeError, "distance.*int64"),
        ({"distance": 3.0}, TypeError, "distance.*float"),
        ({"distance": None}, TypeError, "distance.*NoneType"),
        ({"field": 1.0}, TypeError, "field.*float"),
        ({"medium": Water.jerlov("II")}, TypeError, "medium.*Water"),
        ({"image": torch.rand(6, 8)}, ValueError, r"image.*\(6, 8\)"),
        ({"image": torch.rand(1, 2, 3, 6, 8)}, ValueError, r"image.*\(1, 2, 3, 6, 8\)"),
        ({"image": torch.rand(2, 1, 6, 8)}, ValueError, r"image must.*3.*\(2, 1, 6, 8\)"),
        ({"image": torch.rand(2, 6, 8, 3)}, ValueError, r"image must.*3.*\(2, 6, 8, 3\)"),
        ({"distance": torch.rand(2, 6, 8)}, ValueError, r"distance must.*1.*\(2, 6, 8\)"),
        ({"distance": torch.rand(2, 3, 6, 8)}, ValueError, r"distance must.*1.*\(2, 3, 6, 8\)"),
        ({"distance": torch.rand(6, 8)}, ValueError, r"distance.*\(6, 8\)"),
        ({"distance": torch.rand(2, 1, 8, 6)}, ValueError, r"distance.*\(8, 6\).*\(6, 8\)"),
        ({"field": torch.rand(2, 1, 6, 9)}, ValueError, r"field.*\(6, 9\).*\(6, 8\)"),
        ({"field": torch.rand(2, 3, 6, 8)}, ValueError, r"field must.*1.*\(2, 3, 6, 8\)"),
        ({"distance": torch.rand(3, 1, 6, 8)}, ValueError, "batch.*'image': 2, 'distance': 3"),
        ({"medium": Medium.stack([coefficients()] * 3)}, ValueError, "batch.*'medium': 3"),
        ({"field": torch.rand(3, 1, 6, 8)}, ValueError, "field"),
        ({"distance": MIXED}, ValueError, "distance is NaN at 2 and negative at 3 of 96 pixels"),
        ({"distance": -GOOD["distance"]}, ValueError, "distance.*negative"),
        ({"distance": torch.full((2, 1, 6, 8), -math.inf)}, ValueError, "distance.*negative"),
        ({"field": -torch.rand(2, 1, 6, 8)}, ValueError, "field.*negative"),
        ({"field": MIXED}, ValueError, "field"),
        ({"field": torch.full((2, 1, 6, 8), math.inf)}, ValueError, "field.*inf"),
        ({"order": "backwards"}, ValueError, "order.*backwards"),
        ({"tolerance": 0.0}, ValueError, "tolerance.*0"),
        ({"tolerance": -1.0}, ValueError, "tolerance.*-1"),
        ({"tolerance": math.nan}, ValueError, "tolerance.*nan"),
        ({"tolerance": 2.0}, ValueError, "tolerance.*2"),
    ],
)
def test_form_image_rejects(change, error, match) -> None:
    with pytest.raises(error, match=match):
        form_image(**{**GOOD, **change})


@pytest.mark.parametrize("dtype, precision", [(torch.float32, 3e-5), (torch.float64, 1e-12)])
def test_the_veil_is_as_precise_near_as_far(dtype, precision) -> None:
    # either side of where 1 − e^−x begins to cancel, a near and a far sample, with one medium and with one for each
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
