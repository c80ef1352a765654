import math
from collections.abc import Callable
from typing import NamedTuple

import pytest
import torch
from referees import reference
from referees.terms import TERMS, check
from scenes import LAW, coefficients, rand, stepped, tracked, uniform
from torch import Tensor

from uwaug.formation.model import form_image
from uwaug.formation.scene import Terms
from uwaug.optics.medium import Medium
from uwaug.optics.point_spread import PointSpread
from uwaug.optics.water import Water


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


def spectra(**kwargs: object) -> Callable[[], Medium]:
    return water(surfaces="spectral", **kwargs)


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
    "colours": Case(medium=spectra()),
    "colours, reduced": Case(medium=spectra(tolerance=0.002)),
    "colours at the lens": Case(medium=spectra(), distance=torch.zeros_like),
    "colours, some open water": Case(
        medium=spectra(), distance=lambda z: torch.where(z > 3, math.inf, z)
    ),
    "colours deep down": Case(medium=spectra(vertical_depth=500.0)),
    "colours, all light is kept": Case(medium=spectra(g=0.0)),
    "colours, no light is kept": Case(medium=spectra(g=1.0)),
    "colours of high dynamic range": Case(medium=spectra(), image=lambda j: 20 * j - 5),
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


LEAVES = (
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


@pytest.mark.parametrize(
    "dtype, order", [(torch.float32, "line_of_sight"), (torch.float64, "source")], ids=str
)
@pytest.mark.parametrize("name", SINGULAR)
def test_singular_points(name, dtype, order) -> None:
    case = SINGULAR[name]
    image = case.image(torch.from_numpy(reference.picture(16, 20))).to(dtype)[None]
    z = case.distance(stepped(1, 1, 16, 20)).to(dtype)
    field = None if case.field is None else case.field(0.7 + 0.6 * rand(1, 1, 16, 20)).to(dtype)
    medium = case.medium()
    path = z.double() if field is None else z.double().clamp(max=1e30) * field.double()

    plain = form_image(image, z, medium, field, order=order)
    check(plain, image, path, medium, order)

    law = medium.point_spread
    scale = torch.tensor([float(law.scale)], dtype=torch.float64, requires_grad=True)
    exponent = torch.tensor([float(law.exponent)], dtype=torch.float64, requires_grad=True)
    leaves = [t.clone().requires_grad_() for t in (image, z, *medium.tensors())]
    if field is not None:
        field = field.clone().requires_grad_()
    learned = Medium(*leaves[2:], PointSpread(scale, exponent, law.shape, law.reference_size))
    terms = form_image(leaves[0], leaves[1], learned, field, order=order)
    values = Terms(*(getattr(terms, name).detach() for name in TERMS))
    check(values, image, path, medium, order)
    weight = rand(1, 3, 16, 20, seed=9).to(dtype)
    (terms.image * weight).sum().backward()
    for leaf_name, leaf in zip(LEAVES, [*leaves, scale, exponent, field], strict=True):
        if leaf is not None and leaf.grad is not None:
            assert leaf.grad.isfinite().all(), leaf_name
    assert all(leaf.grad is not None for leaf in leaves[:2])


def test_water_so_clear_that_the_blur_grows_without_end() -> None:
    medium = Medium.from_coefficients(
        (0.5,) * 3, (0,) * 3, (0.2,) * 3, b_mean=1.0, point_spread=PointSpread(2.0, 1.0)
    )
    image = torch.from_numpy(reference.picture(40, 48))[None]
    z = torch.logspace(-1, 9, 48).double().expand(1, 1, 40, 48)
    check(form_image(image, z, medium), image, z, medium)
    check(form_image(image.float(), z.float(), medium), image.float(), z.float(), medium)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_an_empty_batch(dtype) -> None:
    medium = coefficients()
    image = torch.rand(0, 3, 8, 9)
    for z in (torch.rand(0, 1, 8, 9), torch.rand(1, 1, 8, 9)):
        for m in (medium, tracked(medium)):
            terms = form_image(image.to(dtype), z.to(dtype), m)
            assert terms.image.shape == (0, 3, 8, 9)
            assert terms.image.dtype == dtype


def test_an_empty_image() -> None:
    terms = form_image(torch.rand(2, 3, 0, 9), torch.rand(2, 1, 0, 9), coefficients())
    assert terms.image.shape == (2, 3, 0, 9)
