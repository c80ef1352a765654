import pytest
import torch
from fitted import medium, seen

import uwaug


@pytest.fixture(scope="module")
def known():
    return seen(medium(), step=5)


def refused(match, *arguments, error=ValueError, **options):
    with pytest.raises(error, match=match):
        uwaug.fit(*arguments, **options)


def test_flat_distance(known):
    clean, observed, z = known
    refused(r"distance is flat: all pixels lie at 3–3 m", clean, observed, torch.full_like(z, 3.0))


def test_one_picture_twice(known):
    refused("clean and observed are the same picture", known.clean, known.clean, known.distance)


def test_millimetres(known):
    refused("distance must be in metres.*millimetres", *known[:2], 1000 * known.distance)


def test_sizes(known):
    clean, observed, z = known
    refused("observed is .* but clean is", clean, observed[:, 1:], z)
    refused("distance is .* but clean is", clean, observed, z[:, 1:])


def test_saturated_and_black(known):
    clean, observed, z = known
    white = torch.full_like(observed, 255)
    refused(r"only 0 pixels can be used, expected 500: .* saturated", clean, white, z)
    refused("only 0 pixels can be used", clean, torch.zeros_like(observed), z)


def test_no_overlap(known):
    clean, observed, z = known
    left, right = torch.zeros_like(z), torch.zeros_like(z)
    left[..., :70], right[..., 70:] = 1, 1
    refused("only 0 pixels can be used.*must overlap", clean, observed, z * left, mask=right)


def test_one_pixel(known):
    clean, observed, z = (one[:, :1, :1] for one in known)
    refused("only 1 pixels can be used", clean, observed, z)


def test_nan(known):
    clean, observed, z = known
    bright = observed.float() / 255
    bright[0, 0, 0] = torch.nan
    refused("observed is NaN at 1", clean, bright, z)
    unknown = torch.where(torch.rand(z.shape) < 0.3, torch.nan, z)
    found = uwaug.fit(clean, observed, unknown, model="haze", pixels=1000)
    assert found.residual[0].isnan().any()


def test_types_and_options(known):
    clean, observed, z = known
    refused("clean must be a floating-point tensor", clean.numpy(), observed, z, error=TypeError)
    refused("distance must be a floating-point", clean, observed, z.int(), error=TypeError)
    refused("model must be one of auto, attenuation", *known, model="best")
    refused("gain must be one of fixed", *known, gain="yes")
    refused("color_space must be one of srgb", *known, color_space="xyz")
    refused(r"noise must be a uwaug\.Noise, got float", *known, noise=0.01, error=TypeError)
    refused("focal_px: the calibrated width law needs", *known, model="calibrated")
    refused("focal_px must be finite and > 0 px", *known, focal_px=0)
    refused(r"g must be in \[0, 0\.99\]", *known, g=1.0)
    refused(r"pixels must be in \[500, 100000\]", *known, pixels=10)
    refused(r"fixed\['beta_red'\] must be in \[0, 1e\+06\], got -1", *known, fixed={"beta_red": -1})
    refused("distance: expected one or as many as observed", clean, [observed] * 2, [z] * 3)
    refused("clean is empty", [], observed, z)
    refused("observed reaches [0-9]+", clean, observed.float(), z)


def test_open_water_counts(known):
    clean, observed, z = known
    water = uwaug.Underwater(medium(), None)
    sea = z.clone()
    sea[:, :20] = torch.inf
    observed = water(clean, sea)
    found = uwaug.fit(clean, observed, sea, model="gaussian", pixels=3000)
    assert found.parameters["veil_red"].value == pytest.approx(0.1, rel=0.02)
