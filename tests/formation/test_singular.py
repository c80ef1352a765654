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
    """One singular point: what replaces the ordinary image, distance and medium."""

    image: Callable[[Tensor], Tensor] = lambda j: j
    distance: Callable[[Tensor], Tensor] = lambda z: z
    medium: Callable[[], Medium] = coefficients


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
}


LEAVES = ("image", "distance", "beta", "direct_weights", "G", "signal_weights", "veil_weights")
LEAVES += ("b_mean", "scale", "exponent")


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("name", SINGULAR)
def test_singular_points(name: str, dtype: torch.dtype) -> None:
    case = SINGULAR[name]
    image = case.image(torch.from_numpy(reference.picture(16, 20))).to(dtype)[None]
    z = case.distance(stepped(1, 1, 16, 20)).to(dtype)
    medium = case.medium()
    check(form_image(image, z, medium), image, z.double(), medium)

    leaves = [t.clone().requires_grad_() for t in (image, z, *medium.tensors()[:8])]
    terms = form_image(*leaves[:2], Medium(*leaves[2:], law=medium.law))
    detached = Terms(*(term.detach() for term in (*terms, terms.image)))
    check(detached, image, z.double(), medium)
    (terms.image * rand(1, 3, 16, 20, seed=9).to(dtype)).sum().backward()
    for leaf_name, leaf in zip(LEAVES, leaves, strict=True):
        assert leaf.grad is None or leaf.grad.isfinite().all(), leaf_name
    assert all(leaf.grad is not None for leaf in leaves[:2])


def test_water_so_clear_that_the_blur_grows_without_end() -> None:
    medium = uniform(0.5, 0.0, 0.2, 1.0, PointSpread(2.0, 1.0))()
    image = torch.from_numpy(reference.picture(40, 48))[None]
    z = torch.logspace(-1, 9, 48).double().expand(1, 1, 40, 48)
    for dtype in (torch.float64, torch.float32):
        inputs = image.to(dtype), z.to(dtype), medium
        check(form_image(*inputs), *inputs)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_nothing_to_form(dtype: torch.dtype) -> None:
    for image, z in (((0, 3, 8, 9), (0, 1, 8, 9)), ((0, 3, 8, 9), (1, 1, 8, 9))):
        terms = form_image(torch.rand(image).to(dtype), torch.rand(z).to(dtype), coefficients())
        assert (terms.image.shape, terms.image.dtype) == (image, dtype)
    terms = form_image(torch.rand(2, 3, 0, 9), torch.rand(2, 1, 0, 9), coefficients())
    assert terms.image.shape == (2, 3, 0, 9)
