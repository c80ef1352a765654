"""Singular points beside those of the stability matrix, term by term and in spectra."""

import math
from typing import Any

import pytest
import torch
from referees import reference
from referees.terms import check
from scenes import LAW, coefficients, rand, stepped, uniform
from torch import Tensor

from uwaug import Medium, PointSpread, Terms, Water, form_image


def water(**options: Any) -> Medium:
    law = {"point_spread": LAW, "tolerance": 0}
    return Medium.from_water(Water.jerlov("3C"), **{**law, **options})


def spectra(**options: Any) -> Medium:
    return water(surfaces="spectral", **options)


def spread(scale: float, exponent: float) -> Medium:
    return coefficients(law=PointSpread(scale, exponent))


def same(z: Tensor) -> Tensor:
    return z


def open_water(z: Tensor) -> Tensor:
    return torch.where(z > 3, math.inf, z)


# a medium, and what becomes of the distances
SINGULAR = {
    "the lens and open water": (coefficients, lambda z: torch.where(z > 3, math.inf, 0.0).to(z)),
    "absurdly far": (coefficients, lambda z: 1e20 * z),
    "almost at the lens": (coefficients, lambda z: 1e-12 * z),
    "nothing is lost, open water": (uniform(0.5, 0.0), open_water),
    "no light is kept": (lambda: water(g=1.0), same),
    "deep down": (lambda: water(vertical_depth=500.0), same),
    "colours, reduced": (lambda: spectra(tolerance=0.002), same),
    "colours, some open water": (spectra, open_water),
    "colours deep down": (lambda: spectra(vertical_depth=500.0), same),
    "colours, no light is kept": (lambda: spectra(g=1.0), same),
    "optical depth 1e-4": (uniform(1e-4, 3e-5), same),
    "a blur far wider than the image": (lambda: spread(3000.0, 0.3), same),
    "a steep width law, open water": (lambda: spread(0.5, 3.0), open_water),
    "a flat width law": (lambda: spread(3.0, 0.3), lambda z: (z - 2).clamp(min=0)),
    "a blur without end": (
        uniform(0.5, 0.0, 0.2, 1.0, PointSpread(2.0, 1.0)),
        lambda z: torch.logspace(-1, 9, 20).double().expand_as(z),
    ),
}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("name", SINGULAR)
def test_terms_are_right_and_slopes_finite(name: str, dtype: torch.dtype) -> None:
    make, change = SINGULAR[name]
    medium, z = make(), change(stepped(1, 1, 16, 20)).to(dtype)
    image = torch.from_numpy(reference.picture(16, 20)).to(dtype)[None]
    leaves = [t.clone().requires_grad_() for t in (image, z, *medium.tensors()[:8])]
    terms = form_image(*leaves[:2], Medium(*leaves[2:], law=medium.law))
    detached = Terms(*(term.detach() for term in (*terms, terms.image)))
    check(detached, image, z.double(), medium)
    (terms.image * rand(1, 3, 16, 20, seed=9).to(dtype)).sum().backward()
    for leaf_name, leaf in zip(("image", "distance", *Medium.TENSORS), leaves, strict=False):
        assert leaf.grad is None or leaf.grad.isfinite().all(), leaf_name
    assert all(leaf.grad is not None for leaf in leaves[:2])
