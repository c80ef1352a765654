import numpy as np
import pytest
import torch

import uwaug
from uwaug.fitting.data import Observations, Pair


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c, o, z: {"distance": torch.full_like(z, 3.0)}, "flat: all pixels lie at 3–3 m"),
        (lambda c, o, z: {"observed": c}, "clean and observed are the same picture"),
        (lambda c, o, z: {"distance": 1000 * z}, "distance must be in metres.*millimetres"),
        (lambda c, o, z: {"observed": o[:, 1:]}, "observed is .* but clean is"),
        (lambda c, o, z: {"distance": z[:, 1:]}, "distance is .* but clean is"),
        (
            lambda c, o, z: {"observed": torch.full_like(o, 255)},
            "only 0 pixels can be used, expected 500: .* 7455 are saturated",
        ),
        (lambda c, o, z: {"observed": 0 * o}, "only 0 pixels can be used.* 7455 black in observed"),
        (lambda c, o, z: {"distance": z * torch.inf}, "7455 lie in open water"),
        (lambda c, o, z: {"mask": torch.zeros_like(z)}, "only 0 pixels can be used.*must overlap"),
        (lambda c, o, z: {"observed": [o, o], "distance": [z, 0 * z]}, "pair 2 of 2 has 0 pixels"),
        (lambda c, o, z: {"observed": [o] * 2, "distance": [z] * 3}, "distance: expected one or"),
        (lambda c, o, z: {"clean": [c, c]}, "clean: expected one or as many as observed"),
        (lambda c, o, z: {"clean": []}, "clean is empty"),
        (lambda c, o, z: {"observed": o.float()}, "observed reaches [0-9]+"),
        (lambda c, o, z: {"observed": o / torch.nan}, "observed is NaN at"),
        (lambda c, o, z: {"field": z * torch.nan}, "field is NaN at"),
        (lambda c, o, z: {"field": -z}, "field is .*negative at"),
        (lambda c, o, z: {"color_space": "xyz"}, "color_space must be one of srgb"),
        (lambda c, o, z: {"clean": c.numpy()}, "clean must be a floating-point tensor"),
        (lambda c, o, z: {"distance": z.int()}, "distance must be a floating-point"),
        (lambda c, o, z: {"observed": "picture"}, "observed must be a floating-point"),
    ],
)
def test_what_does_not_suit_is_refused(known, change, message):
    inputs = dict(zip(("clean", "observed", "distance"), known, strict=True))
    with pytest.raises((TypeError, ValueError), match=message):
        Observations.of(**(inputs | change(*known)))


def series(clean, observed, distance, **options):
    return uwaug.fitting.fit_series([(clean, observed, distance)] * 2, [1.0, 2.0], **options)


def veil(clean, observed, distance, **options):
    return uwaug.fitting.fit_veil(observed, distance, **options)


@pytest.mark.parametrize("door", [uwaug.fit, series, uwaug.fitting.fit_water, veil])
def test_every_door_refuses_the_same(known, door):
    options = [({"color_space": "sRGB"}, "color_space must be one of"), ({"seed": -1}, "seed must")]
    if door is not veil:
        options.append(({"pixels": 10}, r"pixels must be in \[500, 100000\]"))
        with pytest.raises(TypeError, match=r"noise must be a uwaug\.Noise, got float"):
            door(*known, noise=0.01)
    for option, message in options:
        with pytest.raises(ValueError, match=message):
            door(*known, **option)
    with pytest.raises(ValueError, match="distance is flat"):
        door(*known[:2], torch.full_like(known.distance, 3.0))


def test_unknown_distances_are_left_out(known):
    clean, observed, z = known
    unknown = torch.where(torch.rand(z.shape) < 0.3, torch.nan, z)
    (pair,) = Observations.of(clean, observed, unknown).pairs
    assert not (pair.usable & unknown.isnan()).any()
    assert pair.z.isfinite().all()


def test_rounding_is_seen(known):
    clean, observed, z = known
    for picture, bits in ((observed, 8), (observed / 255, 8), (observed / 254.9, None)):
        assert Observations.of(clean, picture, z).bits == bits


def test_pixels_are_spread_over_the_distances():
    z = torch.full((1, 100, 100), 2.0, dtype=torch.float64)
    z[:, :10] = torch.linspace(2.0, 6.0, 1000, dtype=torch.float64).reshape(1, 10, 100)
    colour = torch.rand(3, 100, 100, dtype=torch.float64)
    usable = torch.ones_like(z, dtype=torch.bool)
    usable[..., 50:] = False
    pair = Pair(colour, colour, z, usable)
    drawn = Observations((pair,), "srgb", 8, "m").sample_pixels((), 600, 0)
    assert drawn.z.shape == (1, 1, 1, 600)
    # 500 of 5000 usable pixels lie beyond 2 m
    assert float((drawn.z > 2.1).double().mean()) > 0.4
    assert drawn.subsample(100, 0).z.shape[-1] == 100
    # one pair has fewer pixels: the rest of its row has no weight
    small = Pair(colour, colour, z, usable & (z > 5.5))
    both = Observations((pair, small), "srgb", 8, "m").sample_pixels((), 1000, 0)
    count = int((usable & (z > 5.5)).sum())
    assert int((both.weights[1, 0] > 0).sum()) == count
    assert int((both.weights[0, 0] > 0).sum()) == 500
    assert np.intersect1d(both.clusters[0], both.clusters[1]).size == 0
