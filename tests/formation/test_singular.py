"""Singular points beside those of the stability matrix, term by term and in spectra."""

import math
from collections.abc import Callable
from typing import NamedTuple

import pytest
import torch
from referees import reference
from referees.terms import check
from scenes import LAW, coefficients, rand, stepped, uniform
from torch import Tensor

from uwaug import Medium, PointSpread, Terms, Water, form_image


class Case(NamedTuple):
    """What replaces the ordinary image, distance and medium."""

    image: Callable[[Tensor], Tensor] = lambda j: j
    distance: Callable[[Tensor], Tensor] = lambda z: z
    medium: Callable[[], Medium] = coefficients


def water(**kwargs: object) -> Callable[[], Medium]:
    return lambda: Medium.from_water(
        Water.jerlov("3C"), **{"point_spread": LAW, "tolerance": 0, **kwargs}
    )


def spectra(**kwargs: object) -> Callable[[], Medium]:
    return water(surfaces="spectral", **kwargs)


def spread(scale: float, exponent: float) -> Callable[[], Medium]:
    return lambda: coefficients(law=PointSpread(scale, exponent))


def open_water(z: Tensor) -> Tensor:
    return torch.where(z > 3, math.inf, z)


SINGULAR = {
    "ordinary": Case(),
    "almost at the lens": Case(distance=lambda z: 1e-12 * z),
    "the lens and open water": Case(distance=lambda z: torch.where(z > 3, math.inf, 0.0).to(z)),
    "step edge": Case(distance=lambda z: torch.where(z > 3, 20.0, 0.1).to(z)),
    "absurdly far": Case(distance=lambda z: 1e20 * z),
    "nothing is lost, open water": Case(medium=uniform(0.5, 0.0), distance=open_water),
    "no scattering": Case(medium=uniform(0.4, 0.4, 0.0, 0.0)),
    "no light is kept": Case(medium=water(g=1.0)),
    "all light is kept": Case(medium=water(g=0.0)),
    "deep down": Case(medium=water(vertical_depth=500.0)),
    "colours": Case(medium=spectra()),
    "colours, reduced": Case(medium=spectra(tolerance=0.002)),
    "colours, some open water": Case(medium=spectra(), distance=open_water),
    "colours deep down": Case(medium=spectra(vertical_depth=500.0)),
    "colours, no light is kept": Case(medium=spectra(g=1.0)),
    "colours of high dynamic range": Case(medium=spectra(), image=lambda j: 20 * j - 5),
    "optical depth 1e4": Case(medium=uniform(1e4, 2e3)),
    "optical depth 1e-4": Case(medium=uniform(1e-4, 3e-5)),
    "a blur too small to show": Case(medium=spread(0.01, 1.0)),
    "a blur as wide as the image": Case(medium=spread(10.0, 1.0)),
    "a blur far wider than the image": Case(medium=spread(3000.0, 0.3)),
    "a steep width law, open water": Case(medium=spread(0.5, 3.0), distance=open_water),
    "a flat width law": Case(medium=spread(3.0, 0.3), distance=lambda z: (z - 2).clamp(min=0)),
}
LEAVES = ("image", "distance", *Medium.TENSORS)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("name", SINGULAR)
def test_terms_are_right_and_slopes_finite(name: str, dtype: torch.dtype) -> None:
    case = SINGULAR[name]
    image = case.image(torch.from_numpy(reference.picture(16, 20))).to(dtype)[None]
    z = case.distance(stepped(1, 1, 16, 20)).to(dtype)
    medium = case.medium()
    leaves = [t.clone().requires_grad_() for t in (image, z, *medium.tensors()[:8])]
    terms = form_image(*leaves[:2], Medium(*leaves[2:], law=medium.law))
    detached = Terms(*(term.detach() for term in (*terms, terms.image)))
    check(detached, image, z.double(), medium)
    (terms.image * rand(1, 3, 16, 20, seed=9).to(dtype)).sum().backward()
    for leaf_name, leaf in zip(LEAVES, leaves, strict=False):
        assert leaf.grad is None or leaf.grad.isfinite().all(), leaf_name
    assert all(leaf.grad is not None for leaf in leaves[:2])


def test_water_so_clear_that_the_blur_grows_without_end() -> None:
    medium = uniform(0.5, 0.0, 0.2, 1.0, PointSpread(2.0, 1.0))()
    image = torch.from_numpy(reference.picture(20, 48))[None]
    z = torch.logspace(-1, 9, 48).double().expand(1, 1, 20, 48)
    for dtype in (torch.float64, torch.float32):
        inputs = image.to(dtype), z.to(dtype), medium
        check(form_image(*inputs), *inputs)


@pytest.mark.parametrize("shape", [(0, 3, 8, 9), (2, 3, 0, 9)])
def test_nothing_to_form(shape: tuple[int, ...]) -> None:
    terms = form_image(torch.rand(shape), torch.rand(shape[0], 1, *shape[2:]), coefficients())
    assert (terms.image.shape, terms.image.dtype) == (shape, torch.float32)
