import numpy as np
import pytest
import torch

import uwaug
from uwaug.fitting import fit_veil, fit_water
from uwaug.fitting.data import Pictures


def veil(clean, observed, distance, **options):
    return fit_veil(observed, distance, **options)


EVERY = (uwaug.fit, fit_water, veil)
PAIRED = (uwaug.fit, fit_water)
REFUSED = [
    (EVERY, lambda c, o, z: {"distance": torch.full_like(z, 3.0)}, "flat: all pixels lie at 3–3"),
    (EVERY, lambda c, o, z: {"distance": 1000 * z}, "distance must be in metres.*divide by 1000"),
    (EVERY, lambda c, o, z: {"distance": z * torch.inf}, "only 0 of 7455 pixels"),
    (EVERY, lambda c, o, z: {"distance": torch.stack([z] * 3), "observed": torch.stack([o] * 2)},
     "batch sizes must agree"),
    (EVERY, lambda c, o, z: {"observed": torch.full_like(o, 255)},
     "only 0 of 7455 pixels"),
    (EVERY, lambda c, o, z: {"observed": 0 * o}, "only 0 of 7455 pixels"),
    (EVERY, lambda c, o, z: {"observed": o.float()}, "observed reaches [0-9]+"),
    (EVERY, lambda c, o, z: {"color_space": "xyz"}, "color_space must be one of srgb"),
    (PAIRED, lambda c, o, z: {"observed": c}, "clean and observed are the same picture"),
    (PAIRED, lambda c, o, z: {"clean": c.numpy()}, "clean must be a floating-point tensor"),
    (PAIRED, lambda c, o, z: {"pixels": 10}, r"pixels must be in \[500, 100000\]"),
    (PAIRED[:1], lambda c, o, z: {"model": "paper"}, "model must be one of auto, haze"),
    (PAIRED[1:], lambda c, o, z: {"observed": torch.rand(3, 71, 105) * 1e-4, "pixels": 500},
     "above the noise"),
    (PAIRED[1:], lambda c, o, z: {"g": 1.5}, r"g must be in \[0, 1\]"),
    (EVERY[2:], lambda c, o, z: {"observed": torch.full((3, 71, 105), 0.4)}, "one colour"),
    (EVERY[2:], lambda c, o, z: {"distance": torch.where(z < 4, 2.0, 6.0) + 1e-3 * z},
     "steps of distance hold 50 pixels, expected 3"),
]  # fmt: skip


def test_what_does_not_suit_is_refused(known):
    inputs = dict(zip(("clean", "observed", "distance"), known, strict=True))
    for doors, change, message in REFUSED:
        for door in doors:
            with pytest.raises((TypeError, ValueError), match=message):
                door(**(inputs | change(*known)))


def test_relative_distances_are_doubted(known):
    clean, observed, z = known
    relative = (z - z.min()) / (z.max() - z.min())
    for pictures in (clean, None):
        with pytest.warns(UserWarning, match="in 0…1, which looks relative: a fit needs metres"):
            Pictures.of(pictures, observed, relative, "srgb")


def test_what_is_unknown_and_what_is_open_water(known):
    clean, observed, z = known
    sea = torch.arange(z.numel()).reshape(z.shape) % 5 == 0
    for number in (torch.nan, 1e7, 1e10, torch.inf):
        pictures = Pictures.of(clean, observed, torch.where(sea, number, z), "srgb")
        is_open = (pictures.usable & ~pictures.finite)[0]
        assert bool((is_open == (sea & pictures.usable[0] & (number > 0))).all())
        assert pictures.geometry.farthest < 10
        assert pictures.z.isfinite().all()


def test_pixels_are_spread_over_the_distances():
    z = torch.full((2, 1, 100, 100), 2.0)
    z[:, 0, :10] = torch.linspace(2.0, 6.0, 1000).reshape(10, 100)
    z[0, ..., 50:] = torch.nan
    z[1] = torch.where(z[1] > 5.5, z[1], torch.nan)
    colour = torch.rand(2, 3, 100, 100) * 0.9
    pictures = Pictures.of(colour[:1], 0.5 * colour, z, "linear")
    drawn = pictures.sample((), 1000, 0)
    # 500 of the first picture, and all of the second that are known
    few = int((z[1] > 5.5).sum())
    assert drawn.z.shape == (1, 1, 1, 500 + few)
    # 500 of 5000 usable pixels of the first lie beyond 2 m
    assert float((drawn.z[..., :500] > 2.1).double().mean()) > 0.4
    assert np.intersect1d(drawn.blocks[:500], drawn.blocks[500:]).size == 0
    assert drawn.subsample(100, 0).z.shape[-1] == 100
